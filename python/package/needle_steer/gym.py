"""Gymnasium environments: ``needle_steer/Steer-v0``, one at a time or many in Rust threads.

``import needle_steer`` registers it where gymnasium is installed. ``docs/PYTHON.md`` has the tables of
actions, observations and rewards.
"""

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from . import _core

ID = "needle_steer/Steer-v0"
# Largest number of an observation, with either sign.
BOUND = 2.0
# Seeds that the phantom takes, and numpy draws.
SEEDS = 2**63


def register():
    """Registers the environment; doing so twice changes nothing."""
    if ID not in gymnasium.registry:
        gymnasium.register(
            ID,
            entry_point="needle_steer.gym:SteerEnv",
            vector_entry_point="needle_steer.gym:SteerVectorEnv",
        )


def _range(value):
    """A range from one number or two."""
    if value is None:
        return None
    low, high = (value, value) if np.isscalar(value) else value
    return [float(low), float(high)]


def _pool(
    count,
    seed,
    *,
    config=None,
    set=None,
    phantoms=None,
    depth_mm=None,
    offset_mm=None,
    angle_deg=None,
    actions="twist",
    reward="dense",
    repeat=1,
    threads=None,
):
    phantoms = [phantoms] if isinstance(phantoms, str) else phantoms
    ranges = (_range(depth_mm), _range(offset_mm), _range(angle_deg))
    return _core.EnvPool(
        config, set, phantoms, *ranges, actions, reward, repeat, count, threads, seed
    )


def _spaces(pool):
    seen, acted = pool.sizes
    observations = gymnasium.spaces.Box(-BOUND, BOUND, (seen,), np.float32)
    return observations, gymnasium.spaces.Box(-1.0, 1.0, (acted,), np.float32)


class SteerEnv(gymnasium.Env):
    """One insertion after the other, by base twists; the phantom's fast sensor at 30 Hz, no arm.

    Parameters
    ----------
    config, set : optional
        Limits, tissue, needle, goal, phantom and target, as for `needle_steer.run`. With
        ``set={"run.plant": "continuum"}`` the needle is in an elastic half-space.
    phantoms : str or list of str, optional
        Presets that episodes are drawn from, each as likely: ``ideal``, ``paper``, ``paper-compliant``
        (the other family of tip laws), ``harsh``.
    depth_mm, offset_mm, angle_deg : float or (float, float), optional
        Target, or ranges that it is drawn from.
    actions : {"twist", "pivot", "bevel"}, optional
        Which numbers a policy gives.
    reward : {"dense", "sparse"}, optional
    repeat : int, optional
        Control steps that an action lasts.
    """

    metadata = {"render_modes": [], "render_fps": 30}

    def __init__(self, *, render_mode=None, **settings):
        self.render_mode = render_mode
        self._settings = settings
        self._pool = _pool(1, 0, threads=1, **settings)
        self.observation_space, self.action_space = _spaces(self._pool)
        self._seeded = False

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        if seed is None and not self._seeded:
            seed = int(self.np_random.integers(SEEDS))
        self._seeded = True
        observations, *_, truth = self._pool.reset([seed], None)
        return observations[0], _of(truth, 0)

    def step(self, action):
        action = np.asarray(action, dtype=np.float32).reshape(1, -1)
        observations, rewards, terminated, truncated, truth = self._pool.step(action)
        return (
            observations[0],
            float(rewards[0]),
            bool(terminated[0]),
            bool(truncated[0]),
            _of(truth, 0),
        )


def _of(truth, k):
    """The truth of one environment in plain numbers."""
    return {
        name: column[k].item() if isinstance(column, np.ndarray) else column[k]
        for name, column in truth.items()
    }


class SteerVectorEnv(VectorEnv):
    """Many of `SteerEnv`, stepped in Rust threads; an environment whose episode ended begins the next
    at the next step.

    Parameters
    ----------
    num_envs : int
    threads : int, optional
        All cores by default. Results do not depend on it.
    **settings
        As for `SteerEnv`.
    """

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}

    def __init__(self, num_envs=1, *, render_mode=None, **settings):
        self.num_envs = num_envs
        self.render_mode = render_mode
        self._pool = _pool(num_envs, 0, **settings)
        self.single_observation_space, self.single_action_space = _spaces(self._pool)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._seeded = False

    def reset(self, *, seed=None, options=None):
        chosen = (options or {}).get("reset_mask")
        if seed is None and not self._seeded:
            seed = int(np.random.default_rng().integers(SEEDS - self.num_envs))
        if seed is None or isinstance(seed, (int, np.integer)):
            super().reset(seed=None if seed is None else int(seed))
        if seed is None:
            seeds = [None] * self.num_envs
        elif isinstance(seed, (int, np.integer)):
            seeds = [int(seed) + k for k in range(self.num_envs)]
        else:
            seeds = list(seed)
        self._seeded = True
        chosen = None if chosen is None else [bool(c) for c in chosen]
        observations, *_, truth = self._pool.reset(seeds, chosen)
        return observations, _infos(truth)

    def step(self, actions):
        observations, rewards, terminated, truncated, truth = self._pool.step(actions)
        return observations, rewards, terminated, truncated, _infos(truth)


def _infos(truth):
    """Arrays with the masks that vector environments have for their infos."""
    infos = {}
    for name, column in truth.items():
        column = np.asarray(column, dtype=object if isinstance(column, list) else None)
        infos[name] = column
        infos[f"_{name}"] = np.ones(len(column), dtype=bool)
    return infos


register()
