"""Laws and plants in Python."""

import numpy as np
import pytest

import needle_steer as ns
from tip_only import TipOnly


@pytest.mark.parametrize("seed", [11, 12, 13])
def test_a_copy_of_tip_only_has_the_built_in_laws_result(seed):
    setup = {"run.law": "tip-only", "run.sensor": "shape", "target.offset_mm": 2.0}
    built_in = ns.run(seed=seed, set=setup)
    law = TipOnly(ns.config()["law"]["paper"])
    own = ns.run(law=law, seed=seed, set=setup)
    assert own.summary["law"] == "tip-only in Python" and own.ended == built_in.ended
    for name in ["true_error_mm", "measured_error_mm", "axial_error_mm", "duration_s"]:
        assert abs(own.summary[name] - built_in.summary[name]) < 1e-9, name
    for name in ["base_x_mm", "depth_mm", "roll_deg", "true_lateral_error_mm"]:
        apart = np.abs(own.series[name] - built_in.series[name])
        assert np.nanmax(apart) < 1e-9, name


class Looking:
    """Goes straight on and looks at everything."""

    def __init__(self):
        self.views, self.resets = 0, 0

    def reset(self):
        self.resets += 1

    def decide(self, view):
        self.views += 1
        tip, base, jacobian = view.tip, view.base, view.jacobian
        assert tip.shape == base.shape == (4, 4) and jacobian.shape == (6, 6)
        rotation = tip[:3, :3]
        assert np.allclose(rotation @ rotation.T, np.eye(3)) and np.linalg.det(rotation) > 0.0
        inverse = np.linalg.inv(tip)
        assert np.allclose((inverse @ np.append(view.target, 1.0))[:3], view.target_in_tip)
        assert view.shape.shape[1] == 3 and len(view.shape) > 2
        assert np.linalg.norm(view.shape[0] - base[:3, 3]) < 1e-9
        assert np.linalg.norm(view.shape[-1] - tip[:3, 3]) < 5e-3
        assert view.predicted_miss.shape == view.entry.shape == view.inward.shape == (3,)
        assert view.roll_travel.shape == (2,) and (view.roll_travel >= 0.0).all()
        assert view.limits["spin_speed_deg_s"] > 0.0 and view.stiffness > 0.0
        omega = np.array([0.1, 0.2, 0.3])
        arm = base[:3, 3] - view.entry
        assert np.allclose(view.pivot(omega), np.append(np.cross(omega, arm), omega))
        return view.screw(view.insertion_speed, 0.0)


def test_a_view_holds_what_it_says(quick):
    law = Looking()
    run = ns.run(law=law, set=quick)
    straight = ns.run(law="none", set={**quick})
    assert law.views > 100 and law.resets == 1
    assert run.summary["law"] == "Looking"
    assert run.summary["true_error_mm"] == straight.summary["true_error_mm"]


class Answers:
    def __init__(self, answer):
        self.answer = answer

    def decide(self, view):
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer


@pytest.mark.parametrize(
    "answer", [None, "fast", [0.0] * 5, np.zeros((6, 1)), [0, 0, 1e-3, 0, 0, float("nan")]]
)
def test_what_is_no_twist_ends_the_run(tmp_path, quick, answer):
    with pytest.raises(ns.InputError, match="law Answers: decide's base twist.*6 finite numbers"):
        ns.run(law=Answers(answer), set=quick, out=tmp_path / "run")
    assert ns.read_log(tmp_path / "run").ended == "interrupted"


def test_a_laws_exception_comes_out_of_the_call(quick):
    with pytest.raises(ZeroDivisionError, match="mine"):
        ns.run(law=Answers(ZeroDivisionError("mine")), set=quick)


def test_a_law_is_held_to_the_limits(quick):
    class Wild:
        def decide(self, view):
            return [0.0, 1.0, 0.0, 3.0, 0.0, 0.0] + 10.0 * view.screw(1.0, 100.0)

    run = ns.run(law=Wild(), set={**quick, "run.max_duration_s": 60})
    advance = np.diff(run.series["advance_mm"]) / np.diff(run.series["t_s"])
    assert np.max(np.abs(advance)) < 1.2 * run.config["limits"]["insertion_speed_mm_s"]
    assert any("InsertionSpeed" in limits for limits in run.series["limits"])


def test_objects_that_are_neither_are_refused():
    with pytest.raises(ns.InputError, match="decide\\(view\\)"):
        ns.run(law=object())
    with pytest.raises(ns.InputError, match="advance\\(world_from_base, time\\)"):
        ns.run(plant=object())


class Straight:
    """A rigid needle: goes where its base points."""

    def __init__(self, length=0.126, points=50):
        self.arcs = np.linspace(0.0, length, points)
        self.times = []

    def advance(self, world_from_base, time):
        self.base = world_from_base
        self.times.append(time)

    def shape(self):
        return self.base[:3, 3] + self.arcs[:, None] * self.base[:3, 2]


def test_a_plant_of_ones_own_runs_on_the_bench(quick):
    plant = Straight()
    ahead = {**quick, "target.kind": "aligned", "run.phantom": "ideal", "run.law": "none"}
    # A sensor without noise claims to be exact, which no estimator believes.
    noise = {"phantom.sensor.noise_mm": 0.02, "phantom.sensor.direction_noise_deg": 0.1}
    run = ns.run(plant=plant, set={**ahead, **noise})
    assert run.ended == "target passed"
    assert run.summary["true_error_mm"] < 1e-2
    assert plant.times == sorted(plant.times) and len(plant.times) > 300


@pytest.mark.parametrize(
    "shape,words",
    [
        (lambda base: None, "expected an array"),
        (lambda base: np.zeros((5, 2)), "expected an array \\(n, 3\\)"),
        (lambda base: np.full((5, 3), np.nan), "finite places apart"),
        (lambda base: np.zeros((1, 3)), "a shape of 1 points"),
        (lambda base: base[:3, 3] + np.linspace(0, 0.05, 9)[:, None] * base[:3, 2], "50.0 mm long"),
        (lambda base: np.linspace(0, 0.126, 9)[:, None] * base[:3, 2], "from the base"),
    ],
)
@pytest.mark.parametrize("late", [False, True])
def test_what_is_no_shape_ends_the_run(quick, shape, words, late):
    class Broken(Straight):
        def shape(self):
            if late and self.times[-1] < 2.0:
                return super().shape()
            return shape(self.base)

    with pytest.raises(ns.InputError, match=words):
        ns.run(plant=Broken(), set=quick)


def test_a_plants_exception_comes_out_of_the_call(quick):
    class Fails(Straight):
        def advance(self, world_from_base, time):
            super().advance(world_from_base, time)
            if time > 2.0:
                raise OSError("the simulator is gone")

    with pytest.raises(OSError, match="the simulator is gone"):
        ns.run(plant=Fails(), set=quick)
