"""The examples of docs/PYTHON.md, one after the other."""

import re
from pathlib import Path

import pytest

TEXT = Path(__file__).resolve().parents[2] / "docs" / "PYTHON.md"


def test_the_examples_run(tmp_path, monkeypatch):
    pytest.importorskip("gymnasium")
    monkeypatch.chdir(tmp_path)
    text = TEXT.read_text(encoding="utf-8")
    names = {"__name__": "docs"}
    blocks = list(re.finditer(r"```python\n(.*?)```", text, re.DOTALL))
    assert len(blocks) > 7
    for block in blocks:
        # Errors name the line of the document.
        line = text.count("\n", 0, block.start(1))
        exec(compile("\n" * line + block.group(1), str(TEXT), "exec"), names)
