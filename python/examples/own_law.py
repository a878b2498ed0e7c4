"""A law of one's own against `hybrid` on the shifted target: python own_law.py [FIRST COUNT].

Needs numpy alone. The target is the configuration's: 80 mm ahead, 10 mm aside.
"""

import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np

import needle_steer as ns

# Whether a law can reach the target is to be seen, not to be foretold.
SETUP = {"run.sensor": "shape", "run.check_reach": False}
PASSED = "target passed"

# First guesses that did on seeds 1000 to 1005.
LEAN = 0.3  # pivot of the base for the angle of the miss as the tip sees it [1/s]
LEAN_UNTIL = 0.03  # depth at which the tip no longer follows the base [m]
FACE = 2.0  # spin for an angle between bevel and miss [1/s]
NEAR = 2e-5  # predicted miss that is none [m]


class LeanAndFace:
    """Leans the base while the tip follows it, and turns the bevel to the side of what is left.

    Both look at where the tip will end if nothing more is done.
    """

    def decide(self, view):
        miss = view.predicted_miss
        if np.linalg.norm(miss) < NEAR:
            return view.screw(view.insertion_speed, 0.0)
        left = max(view.target_in_tip[2], 0.01)
        fade = max(0.0, 1.0 - view.depth / LEAN_UNTIL)
        lean = LEAN * fade * np.cross(view.base[:3, 2], miss) / left
        x, y, _ = view.to_tip(miss)
        turn = np.arctan2(x, -y)  # the bevel bends the path to the tip's -y
        negative, positive = view.roll_travel
        if turn > positive:
            turn -= 2.0 * np.pi
        elif -turn > negative:
            turn += 2.0 * np.pi
        return view.screw(view.insertion_speed, FACE * turn) + view.pivot(lean)


def run(law, seed):
    law = LeanAndFace() if law is LeanAndFace else law
    return ns.run(law=law, seed=seed, set=SETUP).summary


def main(first=201, count=50):
    seeds = range(first, first + count)
    laws = [LeanAndFace, "hybrid", "tip-only"]
    with ThreadPoolExecutor(2) as executor:
        results = {law: list(executor.map(run, [law] * count, seeds)) for law in laws}
    hybrid = np.array([summary["true_error_mm"] for summary in results["hybrid"]])
    print("| law | median [mm] | 95 % | largest | minus `hybrid`'s, median | nearer than it | passed |")
    print("|---|---|---|---|---|---|---|")
    for summaries in results.values():
        errors = np.array([summary["true_error_mm"] for summary in summaries])
        passed = np.array([summary["ended"] == PASSED for summary in summaries])
        apart = errors - hybrid
        print(
            f"| `{summaries[0]['law']}` | {np.median(errors):.3f} | {np.percentile(errors, 95):.3f} "
            f"| {errors.max():.3f} | {np.median(apart):+.3f} | {np.sum(apart < 0.0)} of {count} "
            f"| {np.sum(passed)}/{count} |"
        )


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
