"""Kinematics, model, phantom, tracker, identification."""

import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

import needle_steer as ns

ROOT = Path(__file__).resolve().parents[2]
VIPER = ROOT / "robots" / "urdf" / "viper_s650.urdf"
CLI = os.environ.get("NEEDLE_STEER_CLI")


def test_kinematics_are_consistent_over_arrays():
    chain = ns.Chain(VIPER, "needle_base")
    rng = np.random.default_rng(3)
    low, high = chain.limits.T
    joints = rng.uniform(0.5 * low, 0.5 * high, (4, 5, len(chain)))
    poses, jacobians = chain.fk(joints), chain.jacobian(joints)
    assert poses.shape == (4, 5, 4, 4) and jacobians.shape == (4, 5, 6, 6)
    q, step = joints[1, 2], 1e-6
    for k in range(len(chain)):
        moved = q.copy()
        moved[k] += step
        rate = (chain.fk(moved)[:3, 3] - chain.fk(q)[:3, 3]) / step
        assert np.allclose(rate, jacobians[1, 2, :3, k], atol=1e-5)
    found = chain.ik(poses[1, 2])
    assert np.allclose(chain.fk(found), poses[1, 2], atol=1e-9)
    assert np.min(np.abs(found - q).max(axis=1)) < 1e-6
    assert len(chain.ik(poses[0])) == 5
    far = np.eye(4)
    far[0, 3] = 9.0
    assert chain.ik(far).shape == (0, 6)


def test_kinematics_name_what_cannot_be_used(tmp_path):
    chain = ns.Chain(VIPER, "needle_base")
    for wrong in [np.zeros(5), np.full(6, np.nan), "home"]:
        with pytest.raises((ns.InputError, ValueError)):
            chain.fk(wrong)
    for wrong in [np.eye(3), 2 * np.eye(4), np.full((4, 4), np.nan)]:
        with pytest.raises(ns.InputError, match="homogeneous transform"):
            chain.ik(wrong)
    with pytest.raises(ns.InputError, match="none.urdf: cannot be read"):
        ns.Chain(tmp_path / "none.urdf", "tip")
    with pytest.raises(ns.InputError, match="viper_s650.urdf.*no_such_link"):
        ns.Chain(VIPER, "no_such_link")


def test_the_model_inserts_bends_and_has_derivatives():
    model = ns.NeedleModel()
    base = model.base
    ahead = np.eye(4)
    ahead[2, 3] = 1e-3
    for _ in range(40):
        base = base @ ahead
        model.insert(base)
    assert 0.035 < model.depth < 0.04
    rests, stiffness = model.springs
    assert len(rests) == len(stiffness) > 10 and (stiffness > 0).all()
    shape = model.shape(64)
    assert shape.shape == (64, 3) and np.allclose(shape[0], base[:3, 3], atol=1e-9)
    assert np.allclose(shape[-1], model.tip[:3, 3], atol=1e-6)
    before, jacobian, stretch = model.tip, model.jacobian, model.mean_stretch
    gradient, step = model.mean_stretch_jacobian, 1e-6
    aside = base.copy()
    aside[0, 3] += step
    model.move_base(aside)
    assert np.allclose((model.tip[:3, 3] - before[:3, 3]) / step, jacobian[:3, 0], atol=1e-3)
    assert abs((model.mean_stretch - stretch) / step - gradient[0]) < 1e-2
    assert model.base_wrench.shape == (6,)


def test_a_model_without_equilibrium_says_so_and_stays():
    model = ns.NeedleModel()
    over = model.base
    over[:3, 3] += 0.04 * over[:3, 2]
    model.insert(over)
    tip = model.tip
    over[:3, :3] = over[:3, :3] @ np.diag([1.0, -1.0, -1.0])
    with pytest.raises(ns.Error):
        model.insert(over)
    # Solved again from where it was, to the solver's tolerance.
    assert np.allclose(model.tip, tip, atol=1e-6)
    with pytest.raises(ns.InputError, match="measured_tip: expected 3 finite numbers"):
        model.insert(model.base, [0.0, 1.0])


def test_a_phantom_is_stepped_by_hand():
    quick = {"phantom.needle.elements": 42}
    phantoms = [ns.Phantom(seed=4, set=quick) for _ in range(2)]
    base = phantoms[0].base
    sensed = []
    for k in range(1, 301):
        pose = base.copy()
        pose[:3, 3] += base[:3, 2] * 1e-3 * k / 30.0
        for phantom in phantoms:
            phantom.advance(pose, k / 30.0)
        shapes = [phantom.sense() for phantom in phantoms]
        if shapes[0] is not None:
            sensed.append(shapes[0])
            assert np.array_equal(shapes[0]["points"], shapes[1]["points"])
    truth = phantoms[0].truth()
    assert truth["tip"].shape == (4, 4) and truth["centreline"].shape == (43, 3)
    assert 5e-3 < truth["depth"] < 12e-3 and truth["max_stretch"] >= truth["mean_stretch"] >= 0
    assert np.linalg.norm(sensed[-1]["tip"] - truth["tip"][:3, 3]) < 1e-3
    assert len(sensed) > 100
    with pytest.raises(ns.InputError, match="must not run backwards"):
        phantoms[0].advance(pose, 1.0)
    with pytest.raises(ns.InputError, match="time NaN"):
        phantoms[0].advance(pose, float("nan"))
    assert abs(phantoms[0].time - 10.0) < 1e-9


FOCUS, WIDTH, HEIGHT, BASELINE, DISTANCE = 900.0, 640, 480, 0.06, 0.35


def calibration(folder):
    """Two parallel cameras without distortion."""

    def rows(name, values, height, width):
        numbers = ", ".join(f"{value:.17g}" for value in np.ravel(values))
        head = f"{name}: !!opencv-matrix\n   rows: {height}\n   cols: {width}\n   dt: d\n"
        return f"{head}   data: [ {numbers} ]\n"

    camera = [[FOCUS, 0, 319.5], [0, FOCUS, 239.5], [0, 0, 1]]
    text = f"%YAML:1.0\n---\nimage_width: {WIDTH}\nimage_height: {HEIGHT}\n"
    for k in "12":
        text += rows(f"M{k}", camera, 3, 3) + rows(f"D{k}", np.zeros(5), 1, 5)
    text += rows("R", np.eye(3), 3, 3) + rows("T", [-BASELINE, 0, 0], 3, 1)
    file = folder / "stereo.yml"
    file.write_text(text)
    return file


def picture(x, depth):
    """A dark needle of 0.7 mm that hangs down to ``depth`` [m] below the image's middle at ``x``."""
    at = 319.5 + FOCUS * x / DISTANCE
    end = 239.5 + FOCUS * depth / DISTANCE
    half, blur = 0.5 * FOCUS * 0.7e-3 / DISTANCE, 1.0
    u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    across = 0.5 - 0.5 * np.tanh((np.abs(u - at) - half) / blur)
    along = 0.5 - 0.5 * np.tanh((v - end) / blur)
    texture = np.random.default_rng(1).normal(0.0, 1.5, u.shape)
    return np.clip(200.0 - 140.0 * across * along + texture, 0, 255).astype(np.uint8)


def test_a_needle_is_tracked_in_arrays(tmp_path):
    tracker = ns.Tracker(calibration(tmp_path))
    x = 0.5 * BASELINE
    for k in range(10):
        depth = 0.01 + 2e-4 * k
        found = tracker.track(picture(x, depth), picture(x - BASELINE, depth), k / 30.0)
    assert found["status"] == "tracked", found["reason"]
    assert np.linalg.norm(np.array(found["tip_m"]) - [x, depth, DISTANCE]) < 1e-3
    assert np.shape(found["tip_covariance_m2"]) == (3, 3)
    blank = np.full((HEIGHT, WIDTH), 128, np.uint8)
    tracker.reset()
    assert tracker.track(blank, blank, 1.0)["reason"]


def test_images_that_are_none_are_named(tmp_path):
    tracker = ns.Tracker(calibration(tmp_path))
    good = np.zeros((HEIGHT, WIDTH), np.uint8)
    for wrong in [good.astype(float), good[..., None], None]:
        with pytest.raises(ns.InputError, match="left: expected a grey image"):
            tracker.track(wrong, good, 0.0)
    assert "calibration" in tracker.track(good[:100], good, 0.0)["reason"]
    with pytest.raises(ns.InputError, match="none.yml"):
        ns.Tracker(tmp_path / "none.yml")


def test_calibration_names_what_it_cannot_use(tmp_path):
    with pytest.raises(ns.InputError, match="--board"):
        ns.calibrate_stereo([], [], "many", 25.0)
    with pytest.raises(ns.InputError, match="--lens fish"):
        ns.calibrate_stereo([], [], "9x6", 25.0, lens="fish")
    with pytest.raises(ns.InputError, match="gone.png"):
        ns.calibrate_stereo([tmp_path / "gone.png"], [tmp_path / "gone.png"], "9x6", 25.0)


def test_a_needle_is_identified_and_validated_from_logs(tmp_path, quick):
    for seed in (21, 22):
        ns.run(seed=seed, set={**quick, "target.depth_mm": 40}, out=tmp_path / str(seed))
    logs = [tmp_path / str(seed) / "run.mcap" for seed in (21, 22)]
    found, config = ns.estimate(logs)
    assert found["stiffness_n_m2"]["value"] > 0 and found["recordings"] == 2
    assert ns.config(config) == config
    checked = ns.validate(logs, config, html=tmp_path / "page.html")
    assert "tip" in checked and (tmp_path / "page.html").exists()
    if CLI:
        told = subprocess.run(
            [CLI, "estimate", "--json", *map(str, logs)], capture_output=True, text=True, check=True
        )
        assert json.loads(told.stdout) == found
    with pytest.raises(ns.InputError, match="none.csv"):
        ns.estimate(tmp_path / "none.csv")


def test_the_papers_experiments_are_the_command_lines():
    quick = {"phantom.needle.elements": 63}
    steps = []

    class Meter:
        def __init__(self, **_):
            pass

        def update(self, n):
            steps.append(n)

        def close(self):
            pass

    own = ns.reproduce(
        ["e1"], runs=2, seed=31, sensor="shape", jobs=1, set=quick, progress=Meter
    )
    assert own["finished"] == own["planned"] == 2 == len(steps)
    if CLI:
        told = subprocess.run(
            [CLI, "reproduce", "--json", "--experiments=e1", "--runs=2", "--seed=31"]
            + ["--sensor=shape", "--set=phantom.needle.elements=63"],
            capture_output=True,
            text=True,
            check=True,
        )
        assert json.loads(told.stdout) == own
    with pytest.raises(ns.InputError, match="`e9` is unknown"):
        ns.reproduce(["e9"])
