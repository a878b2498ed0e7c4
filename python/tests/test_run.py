"""Runs, configurations, logs, shapes: against the command line, bit for bit."""

import csv
import json
import math
import os
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

import needle_steer as ns

CLI = os.environ.get("NEEDLE_STEER_CLI")
needs_cli = pytest.mark.skipif(not CLI, reason="NEEDLE_STEER_CLI names no command")
PLACES = {"out", "log", "log_complete"}


def command(*arguments, cwd):
    return subprocess.run(
        [CLI, *arguments], cwd=cwd, capture_output=True, text=True, check=True
    ).stdout


@needs_cli
@pytest.mark.parametrize("law,seed", [("hybrid", 7), ("tip-only", 8)])
def test_a_run_is_the_command_lines_bit_for_bit(tmp_path, quick, law, seed):
    sets = [f"--set={key}={value}" for key, value in quick.items()]
    told = command(
        "run", "--law", law, "--seed", str(seed), "--out", "cli", "--json", *sets, cwd=tmp_path
    )
    run = ns.run(law=law, seed=seed, set=quick, out=tmp_path / "own")
    told = json.loads(told)
    assert {k: v for k, v in told.items() if k not in PLACES} == {
        k: v for k, v in run.summary.items() if k not in PLACES
    }
    assert (tmp_path / "own" / "series.csv").read_bytes() == (
        tmp_path / "cli" / "series.csv"
    ).read_bytes()
    rows = list(csv.DictReader((tmp_path / "cli" / "series.csv").open()))
    assert list(run.series) == list(rows[0])
    for name, column in run.series.items():
        texts = [row[name] for row in rows]
        if isinstance(column, np.ndarray):
            numbers = np.array([float(text) if text else math.nan for text in texts])
            column = np.where(np.isfinite(column), column, math.nan)
            assert np.array_equal(column, numbers, equal_nan=True), name
        else:
            assert column == texts, name


def test_a_log_holds_the_run(tmp_path, quick):
    run = ns.run(seed=9, set=quick, out=tmp_path / "run")
    read = ns.read_log(tmp_path / "run" / "run.mcap")
    assert read.complete and read.config == run.config
    known = {k: v for k, v in run.summary.items() if k not in PLACES}
    assert {k: v for k, v in read.summary.items() if k not in PLACES} == known
    for name, column in run.series.items():
        if isinstance(column, np.ndarray):
            assert np.array_equal(column, read.series[name], equal_nan=True), name
        else:
            assert column == read.series[name]
    run.report(tmp_path / "page.html")
    assert "<html" in (tmp_path / "page.html").read_text(encoding="utf-8").lower()
    assert run.ended in run._repr_html_()


def test_nothing_is_written_unless_asked_for(tmp_path, quick, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run = ns.run(set=quick)
    assert not list(tmp_path.iterdir())
    with pytest.raises(ns.InputError, match="out=FOLDER"):
        run.report("page.html")


def test_configurations_are_dicts_paths_and_keywords(tmp_path):
    whole = ns.config()
    assert whole["target"]["depth_mm"] == 80.0
    assert ns.config(whole) == whole
    changed = ns.config({"target": {"depth_mm": 50}}, set={"target.offset_mm": np.float64(3)})
    assert changed["target"]["depth_mm"] == 50.0 and changed["target"]["offset_mm"] == 3.0
    file = tmp_path / "lab.toml"
    file.write_text("[run]\nseed = 5\n")
    assert ns.config(file)["run"]["seed"] == 5
    assert ns.config(str(file), set={"run": {"seed": np.int64(6)}})["run"]["seed"] == 6


@pytest.mark.parametrize(
    "config,set,words",
    [
        (None, {"run.sede": 3}, "`run.sede`.*did you mean `seed`"),
        ({"needle": {"lenght_mm": 126}}, None, "argument `config`.*did you mean `length_mm`"),
        (None, {"needle.length_mm": float("nan")}, "`needle.length_mm`.*expected"),
        (None, {"needle.length_mm": None}, "set.needle.length_mm: expected a number"),
        (None, {"run.seed": 2**64}, "expected an integer"),
        (None, {"run.law": "hybird"}, "hybrid"),
        ({3: 4}, None, "expected keys of text"),
        (17, None, "expected a dict, a path or None"),
        ("/no/such/file.toml", None, "/no/such/file.toml: cannot be read"),
    ],
)
def test_what_cannot_be_used_is_named_with_its_remedy(config, set, words):
    with pytest.raises(ns.InputError, match=words):
        ns.run(config, set=set)


@pytest.mark.parametrize("seed", [-1, 2**63])
def test_seeds_have_a_range(seed):
    with pytest.raises(ns.InputError, match="expected an integer from 0"):
        ns.run(seed=seed)


def test_dead_files_are_exceptions(tmp_path):
    for file in [tmp_path / "none.mcap", tmp_path]:
        with pytest.raises(ns.InputError):
            ns.read_log(file)
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(b"\x89MCAP0\r\n" + bytes(range(256)))
    with pytest.raises(ns.InputError, match="torn.mcap"):
        ns.read_log(torn)


def test_the_folder_of_another_run_is_left_alone(tmp_path, quick):
    ns.run(set=quick, out=tmp_path / "run")
    with pytest.raises(ns.InputError, match="nothing is written over"):
        ns.run(set=quick, out=tmp_path / "run")


def test_a_panic_is_named():
    for long in (False, True):
        with pytest.raises(ns.InternalError, match="internal fault: asked for by a test"):
            ns._core.panic_on_purpose(long)


def test_shapes_are_the_models():
    case = {
        "needle": {
            "length_m": 0.126,
            "outer_diameter_m": 0.0007,
            "inner_diameter_m": 0.00048,
            "young_modulus_pa": 2e11,
        },
        "world_from_base": np.eye(4).tolist(),
        "tip_force_n": 0.0,
        "tip_moment_nm": 0.0,
        "springs": [{"rest_m": [0.001, 0.0, 0.11], "stiffness_n_per_m": 50.0}],
    }
    solved = ns.shape(case)
    assert 0 < solved["tip_m"][0] < 2e-3 and np.shape(solved["j_tip_base"]) == (6, 6)
    del case["springs"]
    with pytest.raises(ns.InputError, match="springs"):
        ns.shape(case)


def test_progress_speaks_tqdms_protocol(quick):
    class Meter:
        def __init__(self, total, unit):
            self.total, self.unit, self.sum, self.closed = total, unit, 0.0, False
            meters.append(self)

        def update(self, n):
            assert n >= 0
            self.sum += n

        def close(self):
            self.closed = True

    meters = []
    run = ns.run(set=quick, progress=Meter)
    (meter,) = meters
    assert meter.closed and meter.sum <= max(run.series["depth_mm"])
    assert meter.sum > 0.9 * max(run.series["depth_mm"])


def test_the_interpreter_is_free_meanwhile(quick):
    counted, over = [0], threading.Event()

    def count():
        while not over.is_set():
            counted[0] += 1
            time.sleep(1e-3)

    thread = threading.Thread(target=count)
    thread.start()
    ns.run(set=quick)
    over.set()
    thread.join()
    assert counted[0] > 10


def test_ctrl_c_stops_the_run_and_is_raised(tmp_path):
    program = (
        "import needle_steer as ns, signal, sys\n"
        # Whoever starts the tests in the background may have left it ignored.
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "class Meter:\n"
        "    def update(self, n): print('under way', flush=True)\n"
        "    def close(self): pass\n"
        "try:\n"
        "    ns.run(set={'run.sensor': 'shape'}, out=sys.argv[1], progress=lambda **_: Meter())\n"
        "except KeyboardInterrupt:\n"
        "    print('interrupted', flush=True)\n"
    )
    folder = tmp_path / "run"
    process = subprocess.Popen(
        [sys.executable, "-c", program, str(folder)], stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout.readline() == "under way\n"
        process.send_signal(signal.SIGINT)
        rest, _ = process.communicate(timeout=60)
    finally:
        process.kill()
        process.wait()
    assert rest.endswith("interrupted\n")
    # The arm was stopped, and the log leads out.
    log = ns.read_log(folder)
    assert log.complete and log.ended == "interrupted"
