"""Postures at the targets of many stops: all branches over a grid of arm angles, the quickest kept."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.geometry.elementary import cos, sin
from dualarm_cli.kinematics.srs.srs_limits import LIMIT_SLACK
from dualarm_cli.kinematics.srs_arm import closed_form
from dualarm_cli.postures.line_following import FLIPPED
from dualarm_cli.postures.problem import POSTURES, NoPosture, StopProblem
from dualarm_cli.postures.stop_batch import StopBatch
from dualarm_cli.postures.ways import StopWays
from dualarm_cli.refusals import Refusal


def target_postures(batch: StopBatch) -> list[StopWays | NoPosture]:
    """Returns for every problem the quickest postures at its target, best first, or why there is none.

    Quickest to get to, that is, by the closed form of the slowest joint.
    """
    if batch.given:
        return [_given(batch, row) for row in range(len(batch.problems))]
    owner, target, yaw = batch.turned_targets()
    poses = batch.poses(owner, target, yaw)
    angles = np.linspace(-np.pi, np.pi, POSTURES.target_arm_angles, endpoint=False)
    slowest = _transfer_times(batch.problems[0], poses.R, poses.p, batch.start[owner], angles)
    edges = np.searchsorted(owner, np.arange(len(batch.problems) + 1))
    found: list[StopWays | NoPosture] = []
    for row, (low, high) in enumerate(pairwise(edges.tolist())):
        time = slowest[low:high].ravel()

        def postures(index: IntArray, low: int = low, high: int = high) -> StopWays:
            pose, angle, branch = np.unravel_index(index, (high - low, *slowest.shape[1:]))
            pose = pose + low
            return StopWays.at_targets(owner[pose], target[pose], yaw[pose], branch, angles[angle])

        best = _quickest(time, POSTURES.kept_targets)
        if not len(best):
            these = slice(low, high)
            found.append(_between_the_grid(batch, owner[these], target[these], yaw[these]))
        elif batch.problems[row].clear is None:
            found.append(postures(best))
        else:
            found.append(_clear_ones(batch, row, time, postures))
    return found


def _clear_ones(
    batch: StopBatch,
    row: int,
    time: FloatArray,
    postures: Callable[[IntArray], StopWays],
) -> StopWays | NoPosture:
    """Returns the quickest postures of a problem that are collision-free, best first, or why there is none.

    Args:
        batch: the problems.
        row: which of them.
        time: of all its postures [s], infinite where one is out of reach or limits.
        postures: makes postures of numbers among those.
    """
    order = _quickest(time, len(time))
    kept: list[IntArray] = []
    for first in range(0, len(order), POSTURES.tested_targets):
        some = order[first : first + POSTURES.tested_targets]
        found = postures(some)
        poses = found.poses(batch)
        q, _ = batch.arm.solve_branch(poses.R, poses.p, found.psi, found.branch)
        q = batch.arm.nearest_turns(q, batch.start[row])
        kept.append(some[_clear(batch, row, q)])
        if sum(map(len, kept)) >= POSTURES.kept_targets:
            break
    clear = np.concatenate(kept)[: POSTURES.kept_targets]
    return postures(clear) if len(clear) else NoPosture(Refusal("target_touches"))


def _clear(batch: StopBatch, row: int, q: FloatArray) -> BoolArray:
    """Returns which joints at a problem's target (n, 7) are collision-free, shape (n,)."""
    test = batch.problems[row].clear
    return np.ones(len(q), dtype=np.bool_) if test is None else test(q, "target")


def least_transfer_times(problem: StopProblem, R: FloatArray, p: FloatArray) -> FloatArray:
    """Returns how long the quickest transfer to each of many flange poses takes, nearly [s], shape (m,).

    Over few arm angles and all branches, the platform's own time left out; infinite where none of them is
    within limits. Where configurations are given they are the only poses there are.

    Args:
        problem: for the arm, where it starts, and its times.
        R: flange rotations in the base frame, alternatives second, shape (m, y, 3, 3).
        p: flange positions [m], shape (m, y, 3).
    """
    if problem.configurations is not None:
        least = float(problem.transfer_time(problem.configurations - problem.start).min())
        return np.full(len(p), least)
    angles = np.linspace(-np.pi, np.pi, POSTURES.rough_arm_angles, endpoint=False)
    flat = R.reshape(-1, 3, 3), p.reshape(-1, 3)
    slowest = _transfer_times(
        problem, *flat, np.broadcast_to(problem.start, (len(flat[1]), 7)), angles
    )
    least_of_all: FloatArray = slowest.reshape(len(p), -1).min(axis=1)
    return least_of_all


def _transfer_times(
    problem: StopProblem, R: FloatArray, p: FloatArray, start: FloatArray, angles: FloatArray
) -> FloatArray:
    """Returns times of transfers [s] to k flange poses at a arm angles in 8 branches, shape (k, a, 8).

    Each joint has only two values over the eight branches of one arm angle, so that times and limits are looked at
    twice and not eight times. Infinite where a posture is out of reach or limits.

    Args:
        problem: for the arm and its times.
        R: flange rotations, shape (k, 3, 3).
        p: flange positions [m], shape (k, 3).
        start: where the joints are before [rad], shape (k, 7).
        angles: arm angles [rad], shape (a,).
    """
    arm = closed_form(problem.arm)
    curves = arm.curves(R[:, None], p[:, None])
    values = np.array(curves.pairs(sin(angles), cos(angles))).transpose(1, 2, 3, 0)
    values = arm.nearest_turns(values, start[:, None])
    time = problem.joint_times(values - start[:, None])
    inside = (values >= arm.lower - LIMIT_SLACK) & (values <= arm.upper + LIMIT_SLACK)
    time = np.where(inside & curves.plane.reachable[..., None], time, np.inf)
    second = FLIPPED.astype(np.int64)
    slowest = time[second[:, 0], :, :, 0]
    for joint in range(1, 7):
        np.maximum(slowest, time[second[:, joint], :, :, joint], out=slowest)
    return np.moveaxis(slowest, 0, -1)


def _quickest(time: FloatArray, count: int) -> IntArray:
    """Returns the indices of the least finite times, so many at most, best first."""
    if len(time) > count:
        least = np.partition(time, count - 1)[count - 1]
        candidates = np.flatnonzero(time <= least)
    else:
        candidates = np.arange(len(time))
    order = candidates[np.argsort(time[candidates], kind="stable")][:count]
    best: IntArray = order[np.isfinite(time[order])]
    return best


def _given(batch: StopBatch, row: int) -> StopWays | NoPosture:
    """Returns a problem's configurations that are collision-free as postures at targets, or why there is none."""
    q = batch.problems[row].configurations
    index = np.arange(0 if q is None else len(q))
    q = batch.configurations(np.full(len(index), row), index)
    clear = _clear(batch, row, q)
    if not clear.any():
        return NoPosture(Refusal("target_touches"))
    index, q = index[clear], q[clear]
    arm = batch.arm
    return StopWays.at_targets(
        np.full(len(index), row), index, np.zeros(len(index)), arm.branch(q), arm.arm_angle(q)
    )


def _between_the_grid(
    batch: StopBatch, owner: IntArray, target: IntArray, yaw: FloatArray
) -> StopWays | NoPosture:
    """Returns the middles of all feasible arm-angle intervals where the grid met none of them.

    The intervals are exact, so that a target is refused only if no arm angle of any branch will do (at the yaws
    that were tried).
    """
    poses = batch.poses(owner, target, yaw)
    intervals = batch.arm.feasible_arm_angles(poses.R, poses.p)
    pose, branch, k = np.nonzero(np.isfinite(intervals.start))
    if pose.size:
        psi = 0.5 * (intervals.start + intervals.end)[pose, branch, k]
        return StopWays.at_targets(owner[pose], target[pose], yaw[pose], branch, psi)
    if float(batch.arm.reach_miss(poses.R, poses.p).min()) > 0:
        return NoPosture(Refusal("target_out_of_reach"))
    return NoPosture(Refusal("target_beyond_limits"))
