"""Postures at the targets of many stops: all branches over a grid of arm angles, the quickest kept."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.kinematics.arm_angle_intervals import feasible_arm_angles
from dualarm_cli.kinematics.srs_limits import LIMIT_SLACK
from dualarm_cli.redundancy.line_following import FLIPPED
from dualarm_cli.redundancy.problem import NoPosture
from dualarm_cli.redundancy.stop_batch import StopBatch

ARM_ANGLE_STEPS = 48
"""Arm angles tried at each target: 7.5 degrees apart."""
KEPT = 48
"""Target postures, quickest transfer first, whose lines are looked at."""
_ARM_ANGLES = np.linspace(-np.pi, np.pi, ARM_ANGLE_STEPS, endpoint=False)
_SECOND = FLIPPED.astype(np.int64)


@dataclass(frozen=True)
class TargetPostures:
    """Postures at targets, of one problem; every array has shape (n,)."""

    target: IntArray
    """Which nominal target."""
    yaw: FloatArray
    """Turn about the tool's z axis [rad]."""
    branch: IntArray
    """Branch of the inverse kinematics."""
    psi: FloatArray
    """Arm angle [rad]."""


def target_postures(batch: StopBatch) -> list[TargetPostures | NoPosture]:
    """Returns for every problem the KEPT quickest postures at its target, best first, or why there is none.

    Quickest to get to, that is, by the closed form of the slowest joint. Each joint has only two values over the eight
    branches of one arm angle, so that times and limits are looked at twice and not eight times.
    """
    if batch.given:
        return [_given(batch, row) for row in range(len(batch.problems))]
    owner, target, yaw = _poses(batch)
    poses = batch.poses(owner, target, yaw)
    curves = batch.arm.curves(poses.R[:, None], poses.p[:, None])
    pairs = curves.pairs(np.sin(_ARM_ANGLES), np.cos(_ARM_ANGLES))
    values = np.array(pairs).transpose(1, 2, 3, 0)
    start = batch.start[owner][:, None]
    values = batch.arm.nearest_turns(values, start)
    time = batch.problems[0].joint_times(values - start)
    inside = (values >= batch.arm.lower - LIMIT_SLACK) & (values <= batch.arm.upper + LIMIT_SLACK)
    time = np.where(inside & curves.plane.reachable[..., None], time, np.inf)
    slowest = time[_SECOND[:, 0], :, :, 0]
    for joint in range(1, 7):
        np.maximum(slowest, time[_SECOND[:, joint], :, :, joint], out=slowest)
    slowest = np.moveaxis(slowest, 0, -1)
    edges = np.searchsorted(owner, np.arange(len(batch.problems) + 1))
    found: list[TargetPostures | NoPosture] = []
    for low, high in pairwise(edges.tolist()):
        best = _quickest(slowest[low:high].ravel())
        if not len(best):
            these = slice(low, high)
            found.append(_between_the_grid(batch, owner[these], target[these], yaw[these]))
            continue
        pose, angle, branch = np.unravel_index(best, (high - low, *slowest.shape[1:]))
        pose = pose + low
        found.append(TargetPostures(target[pose], yaw[pose], branch, _ARM_ANGLES[angle]))
    return found


def _poses(batch: StopBatch) -> tuple[IntArray, IntArray, FloatArray]:
    """Returns problem, target and yaw of every target of every problem under every yaw."""
    owner, target, yaw = [], [], []
    for row, problem in enumerate(batch.problems):
        targets = len(problem.p_base_tool)
        owner.append(np.full(targets * len(problem.yaw), row, dtype=np.int64))
        target.append(np.repeat(np.arange(targets, dtype=np.int64), len(problem.yaw)))
        yaw.append(np.tile(problem.yaw, targets))
    return np.concatenate(owner), np.concatenate(target), np.concatenate(yaw)


def _quickest(time: FloatArray) -> IntArray:
    """Returns the indices of the KEPT least finite times, best first."""
    if len(time) > KEPT:
        least = np.partition(time, KEPT - 1)[KEPT - 1]
        candidates = np.flatnonzero(time <= least)
    else:
        candidates = np.arange(len(time))
    order = candidates[np.argsort(time[candidates], kind="stable")][:KEPT]
    best: IntArray = order[np.isfinite(time[order])]
    return best


def _given(batch: StopBatch, row: int) -> TargetPostures:
    """Returns a problem's configurations as postures at targets."""
    q = batch.problems[row].configurations
    index = np.arange(0 if q is None else len(q))
    q = batch.configurations(np.full(len(index), row), index)
    arm = batch.arm
    return TargetPostures(index, np.zeros(len(index)), arm.branch(q), arm.arm_angle(q))


def _between_the_grid(
    batch: StopBatch, owner: IntArray, target: IntArray, yaw: FloatArray
) -> TargetPostures | NoPosture:
    """Returns the middles of all feasible arm-angle intervals where the grid met none of them.

    The intervals are exact, so that a target is refused only if no arm angle of any branch will do (at the yaws
    that were tried).
    """
    poses = batch.poses(owner, target, yaw)
    intervals = feasible_arm_angles(batch.arm, poses.R, poses.p)
    pose, branch, k = np.nonzero(np.isfinite(intervals.start))
    if pose.size:
        psi = 0.5 * (intervals.start + intervals.end)[pose, branch, k]
        return TargetPostures(target[pose], yaw[pose], branch, psi)
    if float(batch.arm.reach_miss(poses.R, poses.p).min()) > 0:
        return NoPosture("the target is out of the arm's reach")
    return NoPosture("no arm angle and branch keeps all joints within their limits")
