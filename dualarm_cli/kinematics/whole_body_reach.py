"""Configurations of a whole body whose tools are where they are wanted, near a given one: numeric, for any arms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.geometry.rotations import log_rotation
from dualarm_cli.kinematics.whole_body import WholeBody
from dualarm_cli.model.robot import JointLimits

ROUNDS = 200
LONGEST = 0.3
"""Longest error that one round removes [m, rad]."""
EXACT = 1e-11
"""Error that counts as none [m, rad]."""
DAMPING = 1e-3
"""Damping of the steps while the error is large, in units of the Jacobian squared."""
KEPT_FREE = 1e-3
"""Distance from the joints' limits that is kept [rad]."""


@dataclass(frozen=True)
class Reached:
    """Joints, and by how much their tools miss."""

    q: FloatArray
    """All joints [rad], shape (n,)."""
    distance: float
    """How far the tools are from where they should be [m]; 0 where they are there."""
    angle: float
    """By how much they are turned away [rad]."""

    @property
    def exact(self) -> bool:
        """Whether the tools are where they should be."""
        return self.distance == 0.0 and self.angle == 0.0


def reach(
    body: WholeBody,
    limits: JointLimits,
    q: FloatArray,
    follows: BoolArray,
    R: FloatArray,
    p: FloatArray,
) -> Reached:
    """Returns joints within limits whose tools are at given poses, near given joints, or as near as they get.

    Damped Gauss-Newton (Levenberg-Marquardt) with steps of least norm; joints of arms that are not asked for stay.

    Args:
        body: kinematics.
        limits: of its n joints.
        q: where to begin [rad], shape (n,).
        follows: which arms' tools have to be somewhere, shape (a,).
        R: rotations of their tools, shape (b, 3, 3).
        p: their tool centre points [m], shape (b, 3).
    """
    rows, free = np.repeat(follows, 6), body.moves[follows].any(axis=0)
    room = np.minimum(KEPT_FREE, (limits.upper - limits.lower) / 4.0)
    lower, upper = limits.lower + room, limits.upper - room
    q = np.where(free, np.clip(q, lower, upper), q)
    which = np.flatnonzero(follows)
    best = Reached(q, np.inf, np.inf)
    for _ in range(ROUNDS):
        state = body.at(q)
        turn = log_rotation(R @ state.R[which].transpose(0, 2, 1))
        error = np.concatenate([p - state.p[which], turn], axis=1).ravel()
        size = float(np.linalg.norm(error))
        if np.abs(error).max() < EXACT:
            return Reached(q, 0.0, 0.0)
        parts = np.linalg.norm(error.reshape(-1, 2, 3), axis=2).max(axis=0)
        if parts.sum() < best.distance + best.angle:
            best = Reached(q, float(parts[0]), float(parts[1]))
        # Joints at a limit that the step would cross are left out of it.
        active = free.copy()
        for _ in range(3):
            J = state.J[rows] * active
            damping = DAMPING * min(1.0, size) * np.eye(len(J))
            step = J.T @ np.linalg.solve(J @ J.T + damping, error * min(1.0, LONGEST / size))
            blocked = active & ((q + step < lower) | (q + step > upper))
            stuck = blocked & ((q <= lower) | (q >= upper))
            if not stuck.any():
                break
            active &= ~stuck
        q = np.where(free, np.clip(q + step, lower, upper), q)
    return best
