"""Whether and by how much arms without closed forms miss flange poses."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.geometry.products import norm
from dualarm_cli.kinematics.general_arm import GeneralArm
from dualarm_cli.kinematics.numeric_inverse import least_distances, solve_poses

SCAN_STEP = np.radians(10.0)
"""Spacing of the platform angles that are looked at [rad]."""


def numeric_reach(arm: GeneralArm, R: FloatArray, p: FloatArray) -> tuple[BoolArray, FloatArray]:
    """Returns which flange poses some posture within limits reaches, and by how much the others are missed [m].

    The miss is the least distance found with the rotation as it should be. Where no pose is reached it is looked for at
    the most promising ones only, and infinite at all others.

    Args:
        arm: kinematics and limits.
        R: flange rotations in the carried frame, shape (a, y, 3, 3).
        p: flange positions [m], shape (a, y, 3).
    """
    R = np.broadcast_to(R, (*p.shape[:-1], 3, 3))
    flat_R, flat_p = R.reshape(-1, 3, 3), p.reshape(-1, 3)
    found = solve_poses(arm, flat_R, flat_p, first_only=True)
    feasible = (found.miss == 0.0).all(axis=1)
    miss = np.where(feasible, 0.0, found.miss.sum(axis=1))
    if not feasible.any():
        far = norm(flat_p - arm.p_parent_joint[0], axis=1)
        nearest = np.unique(
            [*np.argsort(miss, kind="stable")[:6], *np.argsort(far, kind="stable")[:6]]
        )
        exact = least_distances(arm, flat_R[nearest], flat_p[nearest])
        miss = np.full(len(flat_p), np.inf)
        miss[nearest] = exact
    return feasible.reshape(p.shape[:-1]), miss.reshape(p.shape[:-1])
