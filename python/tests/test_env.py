"""Gymnasium environments."""

import os
import tracemalloc

import numpy as np
import pytest

import needle_steer as ns

gymnasium = pytest.importorskip("gymnasium")
from gymnasium.utils.env_checker import check_env  # noqa: E402

# Short, and on a coarse rod.
NEAR = {
    "depth_mm": 6,
    "offset_mm": (0, 1),
    "set": {"phantom.needle.elements": 42, "run.insertion_speed_mm_s": 3.0},
}


def make(**settings):
    return gymnasium.make("needle_steer/Steer-v0", **{**NEAR, **settings})


def make_vec(count, **settings):
    return gymnasium.make_vec("needle_steer/Steer-v0", num_envs=count, **{**NEAR, **settings})


def forward(env):
    """Straight on at full speed."""
    action = np.zeros(env.action_space.shape, np.float32)
    action[..., 2 if action.shape[-1] == 6 else 0] = 1.0
    return action


@pytest.mark.filterwarnings("ignore:.*render.*")
@pytest.mark.parametrize("actions", ["twist", "pivot", "bevel"])
def test_the_checker_passes(actions):
    check_env(make(actions=actions).unwrapped, skip_render_check=True)


@pytest.mark.parametrize("actions", ["twist", "pivot", "bevel"])
def test_the_checker_of_stable_baselines3_passes(actions):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    checker.check_env(make(actions=actions).unwrapped)


def episode(env, seed=None):
    seen, truth = env.reset(seed=seed)
    rows, done = [seen], False
    while not done:
        seen, reward, terminated, truncated, truth = env.step(forward(env))
        assert env.observation_space.contains(seen)
        rows.append(np.append(seen, reward))
        done = terminated or truncated
    return rows, truth, terminated


def test_an_episode_passes_its_target_and_seeds_repeat_it():
    env, other = make(), make()
    rows, truth, terminated = episode(env, 5)
    assert terminated and truth["passed"] and not truth["spoilt"]
    assert truth["axial_error_mm"] <= 0.0 and 0.0 <= truth["true_error_mm"] < 3.0
    for again in (env, other):
        repeated, same, _ = episode(again, 5)
        assert same == truth and all(np.array_equal(a, b) for a, b in zip(rows, repeated))
    later, another, _ = episode(env)
    assert another["phantom_seed"] != truth["phantom_seed"]
    assert not np.array_equal(later[0], rows[0])
    episode(other)


def test_the_truth_is_in_the_infos_alone():
    """Two phantoms whose measurements agree look alike, whatever the truth."""
    exact, off = (
        make(phantoms="ideal", set={**NEAR["set"], "phantom.sensor.noise_mm": noise})
        for noise in (0.0, 0.3)
    )
    seen, truth = exact.reset(seed=3)
    noisy, same = off.reset(seed=3)
    assert truth == same and not np.array_equal(seen, noisy)


def test_rewards_add_up_and_the_sparse_one_is_the_hit():
    rows, truth, _ = episode(make(reward="dense"), 6)
    first = make(reward="dense").reset(seed=6)[1]
    total = sum(row[-1] for row in rows[1:])
    nearer = first["true_error_mm"] - truth["true_error_mm"]
    advance = first["axial_error_mm"] - truth["axial_error_mm"]
    assert abs(total - (nearer + 0.01 * advance + 1.0)) < 1e-6
    for goal, earned in [(100.0, 1.0), (1e-3, 0.0)]:
        sets = {**NEAR["set"], "target.goal_mm": goal}
        rows, _, _ = episode(make(reward="sparse", set=sets), 6)
        assert [row[-1] for row in rows[1:]] == [0.0] * (len(rows) - 2) + [earned]


def test_who_stands_still_runs_out_of_time():
    env = make(repeat=4)
    env.reset(seed=1)
    still = np.zeros(env.action_space.shape, np.float32)
    for steps in range(1, 1000):
        *_, reward, terminated, truncated, truth = env.step(still)
        if terminated or truncated:
            break
    assert truncated and not terminated and not truth["passed"]
    # Half as long again as the nominal speed takes, at 30 Hz, four steps an action.
    assert steps == 1 + int(1.5 * 6.0 / 3.0 * 30 / 4)
    assert reward < -9.0


def test_many_are_single_ones_whatever_the_threads():
    settings = {"phantoms": ["paper", "paper-compliant"], "actions": "pivot"}
    envs = [make_vec(3, threads=threads, **settings) for threads in (1, 2)]
    singles = [make(**settings) for _ in range(3)]
    starts = [env.reset(seed=20) for env in envs]
    for k, single in enumerate(singles):
        seen, truth = single.reset(seed=20 + k)
        assert np.array_equal(starts[0][0][k], seen)
        assert truth["phantom"] == starts[0][1]["phantom"][k]
    rng = np.random.default_rng(1)
    ended, begun = [False] * 3, 0
    for _ in range(150):
        actions = rng.uniform(-1, 1, (3, 4)).astype(np.float32)
        actions[:, 0] = 1.0
        results = [env.step(actions) for env in envs]
        for one, two in zip(results[0][:4], results[1][:4]):
            assert np.array_equal(one, two)
        for k, single in enumerate(singles):
            if ended[k]:
                seen, _ = single.reset()
                reward, ended[k] = 0.0, False
                begun += 1
            else:
                seen, reward, terminated, truncated, _ = single.step(actions[k])
                ended[k] = terminated or truncated
            assert np.array_equal(results[0][0][k], seen)
            assert results[0][1][k] == reward
    assert begun > 3


def test_a_mask_resets_some():
    envs = make_vec(3)
    first, _ = envs.reset(seed=1)
    moved = envs.step(forward(envs))[0]
    mask = np.array([True, False, True])
    again, _ = envs.reset(seed=1, options={"reset_mask": mask})
    assert np.array_equal(again[[0, 2]], first[[0, 2]]) and np.array_equal(again[1], moved[1])


@pytest.mark.parametrize(
    "settings,words",
    [
        ({"actions": "wild"}, "actions: expected one of twist, pivot, bevel"),
        ({"reward": "none"}, "reward: expected one of dense, sparse"),
        ({"phantoms": "papper"}, "no preset `papper`"),
        ({"phantoms": []}, "phantoms: expected at least one"),
        ({"depth_mm": (9, 3)}, "depth_mm: expected least and most"),
        ({"depth_mm": float("nan")}, "depth_mm: expected least and most"),
        ({"repeat": 0}, "repeat: expected 1 to 60"),
        ({"set": {"limits.tilt_degree": 3}}, "did you mean `tilt_deg`"),
        ({"set": {"phantom.needle.lenght_mm": 3}}, "phantom"),
    ],
)
def test_settings_that_make_no_environment_are_named(settings, words):
    with pytest.raises(ns.InputError, match=words):
        make(**settings)


@pytest.mark.parametrize("action", [np.zeros(5), np.zeros((2, 6)), np.full(6, np.nan), ["a"] * 6])
def test_what_is_no_action_is_an_exception(action):
    env = make().unwrapped
    env.reset(seed=1)
    with pytest.raises((ns.InputError, ValueError)):
        env.step(action)


# Environments that are made and dropped; docs/PYTHON.md has the figures of ten thousand.
DROPPED = int(os.environ.get("NEEDLE_STEER_DROPPED_ENVIRONMENTS", "300"))


def test_environments_leave_no_memory_behind():
    def resident():
        with open("/proc/self/statm", encoding="ascii") as file:
            return int(file.read().split()[1]) * 4096

    def some(count):
        for _ in range(count):
            make().unwrapped.reset(seed=1)

    tracemalloc.start()
    some(100)
    before, traced = resident(), tracemalloc.get_traced_memory()[0]
    some(DROPPED)
    grown, kept = resident() - before, tracemalloc.get_traced_memory()[0] - traced
    tracemalloc.stop()
    print(f"{DROPPED} environments: {grown / 1e3:+.0f} kB resident, {kept / 1e3:+.0f} kB in Python")
    # An environment holds a megabyte or so: three hundred would show.
    assert grown < 30e6 and kept < 1e6
