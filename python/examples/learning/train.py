"""Trains a policy on the shifted target with stable-baselines3's PPO: python train.py FOLDER.

Writes policy.zip and curve.csv into the folder. Needs stable-baselines3 and needle_steer[gym].
"""

import argparse
import csv
import time
from pathlib import Path

import gymnasium
import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

import needle_steer  # noqa: F401  (registers the environment)
import steering

# Phantoms are trained on from this seed on; results count on others.
SEED = 1000


class Steers(VecEnv):
    """Gymnasium's vectorised environment as stable-baselines3 takes one: an episode that ended is begun
    anew in the same step."""

    def __init__(self, count, **settings):
        self.envs = gymnasium.make_vec(steering.ENVIRONMENT, num_envs=count, **settings)
        box = gymnasium.spaces.Box
        super().__init__(
            count,
            box(-np.inf, np.inf, (steering.FEATURES,), np.float32),
            box(-1.0, 1.0, (steering.CHOICES,), np.float32),
        )
        self.start = SEED

    def reset(self):
        seen, _ = self.envs.reset(seed=self.start)
        return steering.of_observation(seen)

    def seed(self, seed=None):
        self.start = SEED if seed is None else seed
        return [self.start + k for k in range(self.num_envs)]

    def step_async(self, chosen):
        self.chosen = chosen

    def step_wait(self):
        seen, rewards, terminated, truncated, truth = self.envs.step(steering.actions(self.chosen))
        done = terminated | truncated
        shown = steering.of_observation(seen)
        infos = [{} for _ in range(self.num_envs)]
        if done.any():
            for k in np.flatnonzero(done):
                infos[k] = {
                    "terminal_observation": shown[k],
                    "TimeLimit.truncated": bool(truncated[k]),
                    "true_error_mm": float(truth["true_error_mm"][k]),
                    "reached": bool(truth["passed"][k] and not truth["spoilt"][k]),
                }
            seen, _ = self.envs.reset(options={"reset_mask": done})
            shown = steering.of_observation(seen)
        return shown, rewards.astype(np.float32), done, infos

    def close(self):
        self.envs.close()

    def get_attr(self, attr_name, indices=None):
        return [getattr(self, attr_name, None)] * self.num_envs

    def set_attr(self, attr_name, value, indices=None):
        raise NotImplementedError

    def env_method(self, method_name, *args, indices=None, **kwargs):
        raise NotImplementedError

    def env_is_wrapped(self, wrapper_class, indices=None):
        return [False] * self.num_envs


class Curve(BaseCallback):
    """Notes how the episodes of each update ended."""

    def __init__(self):
        super().__init__()
        self.rows, self.ends, self.begun = [], [], time.monotonic()

    def _on_step(self):
        self.ends += [info for info in self.locals["infos"] if "true_error_mm" in info]
        return True

    def _on_rollout_end(self):
        if not self.ends:
            return
        errors = [end["true_error_mm"] for end in self.ends]
        self.rows.append(
            {
                "actions": self.num_timesteps,
                "minutes": round((time.monotonic() - self.begun) / 60.0, 2),
                "episodes": len(self.ends),
                "median_mm": round(float(np.median(errors)), 3),
                "p95_mm": round(float(np.percentile(errors, 95)), 3),
                "reached": round(float(np.mean([end["reached"] for end in self.ends])), 3),
            }
        )
        print(self.rows[-1], flush=True)
        self.ends = []


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--actions", type=int, default=200_000, help="how many in all")
    parser.add_argument("--envs", type=int, default=64, help="how many at once")
    parser.add_argument("--steps", type=int, default=81, help="of each between updates")
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)

    # Observations have their scales in steering.py; the returns are scaled as they come.
    envs = VecNormalize(Steers(given.envs, set=steering.COARSE, **steering.SETTINGS), norm_obs=False, gamma=0.97)
    model = PPO(
        "MlpPolicy",
        envs,
        seed=SEED,
        n_steps=given.steps,
        batch_size=given.envs * given.steps // 8,
        n_epochs=10,
        gamma=0.97,
        gae_lambda=0.95,
        learning_rate=lambda left: 1e-3 * left + 5e-5,
        policy_kwargs={"net_arch": [64, 64], "log_std_init": -0.7},
        device="cpu",
    )
    curve = Curve()
    model.learn(given.actions, callback=curve)
    model.save(given.folder / "policy.zip")
    with open(given.folder / "curve.csv", "w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, curve.rows[0])
        writer.writeheader()
        writer.writerows(curve.rows)


if __name__ == "__main__":
    main()
