"""What the learnt policy sees and does, the same in the environment and as a law on the bench.

Everything is in the axes of the base, which turn with the bevel: a policy that has learnt to steer to one
side steers to every side.
"""

import numpy as np

ENVIRONMENT = "needle_steer/Steer-v0"
# The paper's shifted target (e4) before the phantom that the tables are measured on.
TARGET = {"depth_mm": 80.0, "offset_mm": 10.0, "angle_deg": 135.0}
# Control steps that an action lasts: a third of a second, in which the tip advances by a millimetre.
REPEAT = 10
SETTINGS = {**TARGET, "actions": "pivot", "repeat": REPEAT, "phantoms": "paper"}
# Trained on rods of 2 mm edges, which cost a fourth of the 0.5 mm that results are measured on.
COARSE = {"phantom.needle.elements": 63}
# Part of the greatest speed at which the needle is pushed in; the policy does not choose it.
INSERTION = 1.0

# Units in which what the policy sees is of the order of one.
MISS = 0.01  # [m]
NEAR = 0.0005  # distance below which the direction of a miss fades [m]
LENGTH = 0.1  # [m]
BEND = 0.1  # [rad]
TILT = 0.2  # [rad]
FEATURES = 11
CHOICES = 3
# Lengths in the environment's observations are in decimetres.
OBSERVED = 0.1


def features(base, bearing, direction, axial, depth, inward, roll):
    """The numbers that the policy sees (..., 11).

    Parameters
    ----------
    base : (..., 3, 3)
        Axes of the base as columns.
    bearing : (..., 3)
        Target minus tip [m].
    direction, inward : (..., 3)
        Axis of the tip; normal of the surface, into the tissue.
    axial, depth, roll : (...,)
        Target ahead along the tip's axis, depth of the tip [m]; turns of the base.
    """

    def in_base(vector):
        return np.einsum("...ij,...i->...j", base, vector)[..., :2]

    miss = in_base(bearing - axial[..., None] * direction)
    aside = miss / (np.linalg.norm(miss, axis=-1, keepdims=True) + NEAR)
    bend, tilt = in_base(direction) / BEND, in_base(inward) / TILT
    rest = np.stack([axial / LENGTH, depth / LENGTH, roll], axis=-1)
    return np.concatenate([miss / MISS, aside, bend, tilt, rest], axis=-1).astype(np.float32)


def of_observation(seen):
    """The same from the environment's observations (..., 45)."""
    seen = np.asarray(seen, dtype=float)
    z, y = seen[..., 15:18], -seen[..., 9:12]
    base = np.stack([np.cross(y, z), y, z], axis=-1)
    bearing, direction = seen[..., 0:3] * OBSERVED, seen[..., 6:9]
    axial = np.sum(bearing * direction, axis=-1)
    inward = np.broadcast_to([0.0, 0.0, 1.0], bearing.shape)
    return features(
        base, bearing, direction, axial, seen[..., 5] * OBSERVED, inward, seen[..., 42]
    )


def actions(chosen):
    """The environment's actions (n, 4) for what the policy chose (n, 3): two pivots and the spin."""
    chosen = np.clip(chosen, -1.0, 1.0)
    push = np.full((len(chosen), 1), INSERTION)
    return np.concatenate([push, chosen], axis=1).astype(np.float32)


class Learnt:
    """A policy as a law for `needle_steer.run`.

    Parameters
    ----------
    policy : callable
        From what is seen (11,) to what is chosen (3,), from -1 to 1.
    """

    def __init__(self, policy, name="learnt"):
        self.policy, self.name = policy, name
        self.reset()

    def reset(self):
        self.steps, self.travel = 0, None

    def decide(self, view):
        if self.steps % REPEAT == 0:
            self.chosen = np.clip(self.policy(self.see(view)), -1.0, 1.0)
        self.steps += 1
        limits = view.limits
        omega = view.base[:3, :2] @ self.chosen[:2] * np.radians(limits["tilt_speed_deg_s"])
        push = INSERTION * limits["insertion_speed_mm_s"] * 1e-3
        spin = self.chosen[2] * np.radians(limits["spin_speed_deg_s"])
        return view.screw(push, spin) + view.pivot(omega)

    def see(self, view):
        tip, base = view.tip, view.base[:3, :3]
        bearing, direction = view.target - tip[:3, 3], tip[:3, 2]
        negative, positive = view.roll_travel
        if self.travel is None:
            self.travel = negative
        depth = np.dot(tip[:3, 3] - view.entry, view.inward)
        return features(
            base,
            bearing,
            direction,
            np.dot(bearing, direction),
            depth,
            view.inward,
            (negative - self.travel) / (2.0 * np.pi),
        )
