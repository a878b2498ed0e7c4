"""Kinematics of arms."""

import numpy as np

from . import _core


class Chain:
    """An arm's chain from its URDF, from the root (or ``base``) to ``tip``.

    Parameters
    ----------
    urdf : path
        The URDF file.
    tip : str
        Link at the end of the chain.
    base : str, optional
        Link at which it begins; the URDF's root without.
    hold : dict, optional
        Joints that are held still, and where [rad, m].
    mechanism : bool, optional
        Take prismatic joints, and any number of joints up to seven.

    Attributes
    ----------
    names : list of str
    limits : ndarray (n, 2)
        Lower and upper [rad, m].
    exhaustive : bool
        Whether `ik` finds every solution; if not, none does not mean out of reach.
    """

    def __init__(self, urdf, tip, *, base=None, hold=None, mechanism=False):
        self._chain = _core.ArmChain(urdf, tip, base, dict(hold or {}), mechanism)
        self.names = self._chain.names
        self.limits = self._chain.limits
        self.exhaustive = self._chain.exhaustive

    def __len__(self):
        return len(self.names)

    def _each(self, compute, joints):
        joints = np.asarray(joints, dtype=float)
        rows = compute(joints.reshape(-1, joints.shape[-1]) if joints.ndim else joints)
        return rows.reshape(joints.shape[:-1] + rows.shape[1:])

    def fk(self, joints):
        """Poses (..., 4, 4) of the tip in the base, for joints (..., n) [rad, m]."""
        return self._each(self._chain.fk, joints)

    def jacobian(self, joints):
        """Jacobians (..., 6, n) for joints (..., n): joint rates to the tip's twist (velocity of its
        origin, then angular velocity) in the base's axes."""
        return self._each(self._chain.jacobian, joints)

    def ik(self, pose, *, all_turns=False):
        """Joint vectors (k, n) within the limits that reach ``pose`` (4, 4).

        Parameters
        ----------
        pose : array_like (4, 4)
            Of the tip in the base. A stack (m, 4, 4) gives a list of m results.
        all_turns : bool, optional
            Also solutions that differ by full turns of a joint.
        """
        pose = np.asarray(pose, dtype=float)
        if pose.ndim == 3:
            return [self._chain.ik(one, all_turns) for one in pose]
        return self._chain.ik(pose, all_turns)

    def __repr__(self):
        return f"Chain({', '.join(self.names)})"
