"""Postures at the targets of many stops: all branches over a grid of arm angles."""

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
from dualarm_cli.postures.stop_candidates import StopCandidates
from dualarm_cli.refusals import Refusal


def target_postures(batch: StopBatch) -> list[StopCandidates | NoPosture]:
    """Select each problem's target postures of quickest transfer, best first.

    Transfers have the closed-form time of the slowest joint.
    """
    if batch.given:
        return [_given_postures(batch, row) for row in range(len(batch.problems))]
    owner, target, yaw = batch.turned_targets()
    poses = batch.poses(owner, target, yaw)
    angles = np.linspace(-np.pi, np.pi, POSTURES.target_arm_angles, endpoint=False)
    slowest = _transfer_times(batch.problems[0], poses.R, poses.p, batch.start[owner], angles)
    edges = np.searchsorted(owner, np.arange(len(batch.problems) + 1))
    answers: list[StopCandidates | NoPosture] = []
    for row, (low, high) in enumerate(pairwise(edges.tolist())):
        time = slowest[low:high].ravel()

        def postures(index: IntArray, low: int = low, high: int = high) -> StopCandidates:
            pose, angle, branch = np.unravel_index(index, (high - low, *slowest.shape[1:]))
            pose = pose + low
            return StopCandidates.at_targets(
                owner[pose], target[pose], yaw[pose], branch, angles[angle]
            )

        best = _quickest(time, POSTURES.max_targets)
        if not len(best):
            these = slice(low, high)
            answers.append(_interval_middles(batch, owner[these], target[these], yaw[these]))
        elif batch.problems[row].is_free is None:
            answers.append(postures(best))
        else:
            answers.append(_quickest_clear(batch, row, time, postures))
    return answers


def _quickest_clear(
    batch: StopBatch,
    row: int,
    time: FloatArray,
    postures: Callable[[IntArray], StopCandidates],
) -> StopCandidates | NoPosture:
    """Select the quickest collision-free postures of a problem, best first.

    Args:
        batch: the problems.
        row: number of the problem.
        time: transfer times of its postures [s], infinite out of reach or limits.
        postures: creates candidates from numbers of postures.
    """
    order = _quickest(time, len(time))
    clear_blocks: list[IntArray] = []
    for first in range(0, len(order), POSTURES.tested_targets):
        block = order[first : first + POSTURES.tested_targets]
        candidates = postures(block)
        poses = candidates.poses(batch)
        q, _ = batch.arm.solve_branch(poses.R, poses.p, candidates.psi, candidates.branch)
        q = batch.arm.nearest_turns(q, batch.start[row])
        clear_blocks.append(block[_is_clear(batch, row, q)])
        if sum(map(len, clear_blocks)) >= POSTURES.max_targets:
            break
    clear = np.concatenate(clear_blocks)[: POSTURES.max_targets]
    return postures(clear) if len(clear) else NoPosture(Refusal("target_touches"))


def _is_clear(batch: StopBatch, row: int, q: FloatArray) -> BoolArray:
    """Flag collision-free joints (n, 7) at a problem's target, shape (n,)."""
    test = batch.problems[row].is_free
    return np.ones(len(q), dtype=np.bool_) if test is None else test(q, "target")


def least_transfer_times(problem: StopProblem, R: FloatArray, p: FloatArray) -> FloatArray:
    """Estimate the least transfer times to flange poses [s], shape (m,).

    Over few arm angles and all branches, without the platform's time; infinite if no posture is within limits. Given
    configurations replace the poses.

    Args:
        problem: the arm, its start and its times.
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
    """Compute transfer times to flange poses, over arm angles and branches [s], (k, a, 8).

    Each joint has only two values over the eight branches of one arm angle, so that times and limits are computed
    twice, not eight times. Infinite out of reach or limits.

    Args:
        problem: the arm and its times.
        R: flange rotations, shape (k, 3, 3).
        p: flange positions [m], shape (k, 3).
        start: joints before the transfers [rad], shape (k, 7).
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
    """Find the indices of at most `count` least finite times, best first."""
    if len(time) > count:
        least = np.partition(time, count - 1)[count - 1]
        candidates = np.flatnonzero(time <= least)
    else:
        candidates = np.arange(len(time))
    order = candidates[np.argsort(time[candidates], kind="stable")][:count]
    best: IntArray = order[np.isfinite(time[order])]
    return best


def _given_postures(batch: StopBatch, row: int) -> StopCandidates | NoPosture:
    """Select a problem's collision-free given configurations."""
    q = batch.problems[row].configurations
    index = np.arange(0 if q is None else len(q))
    q = batch.configurations(np.full(len(index), row), index)
    clear = _is_clear(batch, row, q)
    if not clear.any():
        return NoPosture(Refusal("target_touches"))
    index, q = index[clear], q[clear]
    arm = batch.arm
    return StopCandidates.at_targets(
        np.full(len(index), row), index, np.zeros(len(index)), arm.branch(q), arm.arm_angle(q)
    )


def _interval_middles(
    batch: StopBatch, owner: IntArray, target: IntArray, yaw: FloatArray
) -> StopCandidates | NoPosture:
    """Select the middles of feasible arm-angle intervals if the grid has missed them.

    The intervals are exact, so that a target is refused only if no arm angle of any branch is feasible at the sampled
    yaws.
    """
    poses = batch.poses(owner, target, yaw)
    intervals = batch.arm.feasible_arm_angles(poses.R, poses.p)
    pose, branch, k = np.nonzero(np.isfinite(intervals.start))
    if pose.size:
        psi = 0.5 * (intervals.start + intervals.end)[pose, branch, k]
        return StopCandidates.at_targets(owner[pose], target[pose], yaw[pose], branch, psi)
    if float(batch.arm.reach_miss(poses.R, poses.p).min()) > 0:
        return NoPosture(Refusal("target_out_of_reach"))
    return NoPosture(Refusal("target_beyond_limits"))
