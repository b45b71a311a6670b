"""Arms whose flanges go through poses in the world while the platform that carries them moves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.elementary import arcsin
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.kinematics.continuation import follow_poses
from dualarm_cli.kinematics.general_arm import GeneralArm
from dualarm_cli.kinematics.srs.srs_arm import SrsArm
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.motion.transfers import PLATFORM, Drive
from dualarm_cli.postures import StopPosture
from dualarm_cli.refusals import Refusal

CHECKS_PER_KNOT = 4
"""Instants per interval at which tools are measured."""
LARGEST_STEP = 0.2
"""A joint that moves more between two samples has jumped [rad]."""


def in_carried_frame(
    model: CellModel, platform: FloatArray, R: FloatArray, p: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Returns poses in the frame that carries the arms: rotations (m, 3, 3), positions (m, 3) [m].

    Args:
        model: the job's cell.
        platform: its platform's joints [rad or m], shape (m, k).
        R: rotations in the world, broadcast against (m, 3, 3).
        p: positions in the world [m], broadcast against (m, 3).
    """
    R_carried, p_carried = model.platform.pose(platform)
    R_back = np.swapaxes(R_carried, -1, -2)
    return product(R_back, R), product(R_back, (p - p_carried)[..., None])[..., 0]


def followed(
    arm: SrsArm | GeneralArm,
    made: StopPosture,
    swing: float,
    flange: tuple[FloatArray, FloatArray],
) -> FloatArray:
    """Returns an arm's joints (m, n) as its flange goes through poses in the carried frame, from a posture at a target.

    Args:
        arm: its kinematics and limits.
        made: the posture, which is at the first pose.
        swing: by how much the arm angle changes on the way, linearly [rad]; without closed forms the way along the
            self-motion.
        flange: rotations (m, 3, 3) and positions (m, 3) [m].

    Raises:
        InfeasibleError: it cannot follow.
    """
    (R, p), first = flange, made.q_target
    if isinstance(arm, GeneralArm):
        q, good = follow_poses(arm, first, R, p, swing)
    else:
        psi = made.psi_target + np.linspace(0.0, 1.0, len(R)) * swing
        q, reached = arm.solve_branch(R, p, psi, np.full(len(R), made.branch))
        steps = np.diff(q, axis=0)
        steps -= 2.0 * np.pi * np.round(steps / (2.0 * np.pi))
        q = first + np.vstack([np.zeros_like(first), np.cumsum(steps, axis=0)])
        good = bool(reached.all() and arm.within_limits(q).all())
    if not good or np.abs(np.diff(q, axis=0)).max() > LARGEST_STEP:
        raise InfeasibleError(Refusal("no_plan_on_grid"))
    # To the last digit, so that pieces of motion can be joined.
    q[0] = first
    return q


def measured_tools(
    drive: Drive, groups: Sequence[str], motion: Trajectory, platform: FloatArray
) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Returns the flange rotations (m, 3, 3) and tool positions (m, 3) [m] in the world during a motion, by arm.

    They are measured at its knots and at instants between these, the end left out.

    Args:
        drive: of the job.
        groups: whose joints the motion has, one after the other.
        motion: of these joints.
        platform: its joints where it is not one of the groups [rad or m], shape (k,).
    """
    share = np.arange(CHECKS_PER_KNOT) / CHECKS_PER_KNOT
    times = (motion.time[:-1, None] + np.diff(motion.time)[:, None] * share).ravel()
    joints, columns, first = motion.at(times)[0], dict[str, slice](), 0
    for group in groups:
        columns[group] = slice(first, first + len(drive.columns[group]))
        first = columns[group].stop
    turned = np.tile(platform, (len(times), 1))
    if PLATFORM in groups:
        turned = joints[:, columns[PLATFORM]]
    R_carried, p_carried = drive.model.platform.pose(turned)
    found = {}
    for name in groups:
        if name == PLATFORM:
            continue
        arm = drive.model.arms[name]
        R, p = arm.kinematics.forward(joints[:, columns[name]])
        tip = (
            p_carried
            + product(R_carried, (p + product(R, arm.T_flange_tcp.translation))[..., None])[..., 0]
        )
        found[name] = product(R_carried, R), tip
    return found


def largest_angle(R: FloatArray, reference: FloatArray) -> float:
    """Returns the largest angle [rad] of rotations (m, 3, 3) from one (3, 3), exact for small ones."""
    # |R - R0| in the Frobenius norm is 2 sqrt(2) sin(angle/2); no loss of digits near zero.
    gap = norm(R - reference, axis=(-2, -1)) / (2.0 * np.sqrt(2.0))
    return float(2.0 * arcsin(np.clip(gap, 0.0, 1.0)).max())
