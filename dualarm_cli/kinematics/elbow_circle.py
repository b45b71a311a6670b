"""How near an arm in closed form can bring its elbow to a point while its tool stays where it is."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.elementary import TURN, arctan2, cos, sin
from dualarm_cli.kinematics.srs_arm import SrsArm

THIRDS = np.arange(3) * (TURN / 3.0)
"""Arm angles that tell a sinusoid over the arm angle [rad]."""


def least_elbow_distance(
    arm: SrsArm, R: FloatArray, p: FloatArray, point: FloatArray, along: float = 0.0
) -> FloatArray:
    """Returns the least distance of the elbow from a point over all postures within limits [m], shape (k,).

    The elbow is on a circle about the line from shoulder to wrist, so that its squared distance from a point is
    a + b cos psi + c sin psi: the least is where that is least, or at an end of the interval of arm angles that the
    joints' limits leave. Infinite where they leave none.

    Args:
        arm: the arm and its limits.
        R: flange rotations in the base frame, shape (k, 3, 3).
        p: flange positions in the base frame [m], shape (k, 3).
        point: in the base frame [m], shape (k, 3).
        along: how far along the axis of joint 4 from it what counts as the elbow is [m].
    """
    intervals = arm.feasible_arm_angles(R, p)
    q = np.stack([arm.solve(R, p, float(psi)).q for psi in THIRDS])
    elbow, axis = arm.elbow(q)
    offset = elbow + along * axis - point[..., None, :]
    squared = (offset * offset).sum(axis=-1)
    a = squared.mean(axis=0)
    b, c = (2.0 / 3.0 * np.einsum("i,i...->...", wave(THIRDS), squared) for wave in (cos, sin))
    lowest = arctan2(-c, -b)[..., None]
    a, b, c = a[..., None], b[..., None], c[..., None]
    reached = np.mod(lowest - intervals.start, TURN) <= intervals.end - intervals.start
    ends = (a + b * cos(psi) + c * sin(psi) for psi in (intervals.start, intervals.end))
    least = np.where(reached, a - np.hypot(b, c), np.minimum(*ends))
    least = np.where(np.isnan(intervals.start), np.inf, least).min(axis=(-1, -2))
    found: FloatArray = np.sqrt(np.maximum(least, 0.0))
    return found
