"""Compares the policy of train.py with built-in laws on the shifted target: python evaluate.py FOLDER.

All of them drive the bench of `needle-steer run` (arm with its flaws, fast sensor, supervisor), on the same
phantoms, none of which was trained on. Prints the table; writes runs.csv and, with matplotlib, curve.svg.
"""

import argparse
import csv
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import gymnasium
import numpy as np
import torch
from stable_baselines3 import PPO

import needle_steer as ns
import steering

LAWS = ["hybrid", "paper", "tip-only", "none"]
COLUMNS = ["seed", "law", "ended", "true_error_mm", "max_stretch_mm", "duration_s"]
PASSED = "target passed"


def on_the_bench(law, seed):
    """A run's row. Whether a law can reach the target is to be seen, not to be foretold."""
    config = ns.config(set={"run.sensor": "shape", "run.check_reach": False})
    config["target"].update(steering.TARGET)
    if not isinstance(law, str):
        law = steering.Learnt(law)
    summary = ns.run(config, law=law, seed=seed).summary
    return {name: summary[name] for name in COLUMNS}


def in_the_environment(policy, seeds):
    """True errors [mm] and whether the target's plane was reached, an environment a seed."""
    envs = gymnasium.make_vec(steering.ENVIRONMENT, num_envs=len(seeds), **steering.SETTINGS)
    seen, _ = envs.reset(seed=list(seeds))
    errors, reached = np.full(len(seeds), np.nan), np.zeros(len(seeds), dtype=bool)
    running = np.ones(len(seeds), dtype=bool)
    while running.any():
        chosen = policy(steering.of_observation(seen))
        seen, _, terminated, truncated, truth = envs.step(steering.actions(chosen))
        ended = running & (terminated | truncated)
        errors[ended] = truth["true_error_mm"][ended]
        reached[ended] = (truth["passed"] & ~truth["spoilt"])[ended]
        running &= ~ended
    return errors, reached


def row(name, errors, passed, rest):
    """A line of the table: figures of the runs that passed."""
    errors = np.asarray(errors, dtype=float)[np.asarray(passed)]
    figures = [np.median(errors), *np.percentile(errors, [95, 100])] if len(errors) else []
    cells = [f"{figure:.3f}" for figure in figures] or ["-"] * 3
    return f"| {name} | {' | '.join(cells)} | {np.sum(passed)}/{len(passed)} | {rest} |"


def draw(folder, runs):
    """The learning curve beside what the laws reach."""
    import matplotlib

    matplotlib.use("svg")
    from matplotlib import pyplot as plt

    # The same picture is the same file.
    plt.rcParams["svg.hashsalt"] = "curve"
    with open(folder / "curve.csv", newline="", encoding="utf-8") as file:
        curve = [{k: float(v) for k, v in line.items()} for line in csv.DictReader(file)]
    figure, axes = plt.subplots(figsize=(7.0, 4.0), layout="constrained")
    actions = [line["actions"] / 1e3 for line in curve]
    axes.plot(actions, [line["median_mm"] for line in curve], "C0", label="training, median")
    axes.plot(actions, [line["p95_mm"] for line in curve], "C0:", label="training, 95 %")
    ends = {}
    for run in runs:
        if run["ended"] == PASSED:
            ends.setdefault(run["law"], []).append(run["true_error_mm"])
    for k, (law, errors) in enumerate(ends.items()):
        axes.axhline(np.median(errors), color=f"C{k + 1}", lw=1.0)
        axes.annotate(
            f"{law} on the bench, median",
            (0.99, np.median(errors)),
            xycoords=("axes fraction", "data"),
            ha="right",
            va="bottom",
            color=f"C{k + 1}",
            fontsize=8,
        )
    axes.set(yscale="log", xlabel="actions in thousands", ylabel="true error [mm]", ylim=(0.01, 30))
    axes.legend(loc="lower left", fontsize=8)
    figure.savefig(folder / "curve.svg", metadata={"Date": None})


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="what train.py wrote")
    parser.add_argument("--first", type=int, default=501, help="first seed")
    parser.add_argument("--count", type=int, default=50, help="how many seeds")
    parser.add_argument("--jobs", type=int, default=2, help="runs at once")
    given = parser.parse_args()
    torch.set_num_threads(1)
    model = PPO.load(given.folder / "policy.zip", device="cpu")
    seeds = range(given.first, given.first + given.count)

    def policy(seen):
        return model.predict(seen, deterministic=True)[0]

    work = [(law, seed) for law in [policy, *LAWS] for seed in seeds]
    with ThreadPoolExecutor(given.jobs) as executor:
        runs = list(executor.map(on_the_bench, *zip(*work)))
    print("| law | median [mm] | 95 % | largest | passed | median stretch [mm], duration [s] |")
    print("|---|---|---|---|---|---|")
    for law in dict.fromkeys(run["law"] for run in runs):
        mine = [run for run in runs if run["law"] == law]
        stretch, lasted = (
            np.median([run[name] for run in mine]) for name in ["max_stretch_mm", "duration_s"]
        )
        errors, passed = zip(*((run["true_error_mm"], run["ended"] == PASSED) for run in mine))
        print(row(f"`{law}`", errors, passed, f"{stretch:.2f}, {lasted:.0f}"))
    print(row("`learnt`, in the environment", *in_the_environment(policy, seeds), "-"))
    with open(given.folder / "runs.csv", "w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows(runs)
    try:
        draw(given.folder, runs)
    except ImportError:
        print("no curve.svg: pip install matplotlib")


if __name__ == "__main__":
    main()
