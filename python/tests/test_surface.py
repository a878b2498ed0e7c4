"""The surface: documented, typed, and what its stubs say."""

import ast
import inspect
from pathlib import Path

import needle_steer as ns

PACKAGE = Path(ns.__file__).parent


def test_everything_public_is_documented():
    for name in ns.__all__:
        thing = getattr(ns, name)
        if name == "VERSION":
            continue
        assert inspect.getdoc(thing), name
        if inspect.isclass(thing):
            for member, value in vars(thing).items():
                if not member.startswith("_") and (callable(value) or isinstance(value, property)):
                    assert inspect.getdoc(value), f"{name}.{member}"


def test_the_stubs_have_the_same_names_and_parameters():
    stubs = ast.parse((PACKAGE / "__init__.pyi").read_text(encoding="utf-8"))
    nodes = {
        node.name: node
        for node in stubs.body
        if isinstance(node, (ast.ClassDef, ast.FunctionDef)) and not node.name.startswith("_")
    }
    assert (PACKAGE / "py.typed").exists()
    assert set(nodes) == set(ns.__all__) - {"VERSION"}

    def parameters(function):
        arguments = function.args
        names = arguments.posonlyargs + arguments.args + arguments.kwonlyargs
        return [a.arg for a in names if a.arg != "self"]

    for name, node in nodes.items():
        thing = getattr(ns, name)
        if isinstance(node, ast.FunctionDef):
            assert parameters(node) == list(inspect.signature(thing).parameters), name
            continue
        members = {m.name for m in node.body if isinstance(m, ast.FunctionDef)}
        fields = {m.target.id for m in node.body if isinstance(m, ast.AnnAssign)}
        public = {m for m in dir(thing) if not m.startswith("_")} - set(dir(Exception))
        assert public <= members | fields, f"{name}: {public - members - fields}"
