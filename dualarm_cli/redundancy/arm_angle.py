"""Posture of least time: all branches over the arm angle, lines included, then refined."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.kinematics.arm_angle_intervals import feasible_arm_angles
from dualarm_cli.redundancy.candidates import (
    Candidates,
    Evaluation,
    evaluate,
    flange_poses,
    follow_line,
)
from dualarm_cli.redundancy.problem import NoPosture, StopPosture, StopProblem

ARM_ANGLE_STEPS = 48
"""Arm angles tried at each target: 7.5 degrees apart."""
KEPT = 48
"""Target postures, quickest transfer first, whose lines are looked at."""
SWINGS = np.array([0.0, -0.2, 0.2, -0.5, 0.5])
"""Changes of the arm angle along a line that are tried first [rad]."""
DENSE_SAMPLES = 33
"""Samples of a line at which the posture that is taken must keep its limits."""
REFINEMENTS = 5
"""Rounds of local refinement, each half as wide as the one before."""
REFINEMENT_WIDTH = 0.25
"""Half-width of the first round [rad]."""


def choose_posture(problem: StopProblem) -> StopPosture | NoPosture:
    """Returns the posture of least time for transfer, approach and retract, or why there is none.

    The time of the transfer is the closed form of its slowest joint (or of the platform, where that
    is slower). The eight branches are taken over a grid of arm angles and yaws at the target; the quickest
    are followed along their lines with several changes of the arm angle; the best is refined locally where
    the problem asks for it. No optimality over the continuum is claimed.
    """
    coarse = _target_candidates(problem)
    if isinstance(coarse, NoPosture):
        return coarse
    spread = _with_swings(coarse)
    value = evaluate(problem, spread)
    for best in _best_pairs(spread, value, len(coarse.branch)):
        if not problem.refine:
            return _posture(best, evaluate(problem, best))
        for one in reversed(_refinements(problem, best)):
            # Nearly always the first, the most refined one.
            if _holds_between_samples(problem, one):
                return _posture(one, evaluate(problem, one))
    if problem.configurations is not None:
        return NoPosture(
            "no given configuration can follow its approach and retract lines (a straight wrist or "
            "shoulder cannot: give others, or approach: 0 and retract: 0)"
        )
    return NoPosture("no posture at the target can follow its approach and retract lines")


def _target_candidates(problem: StopProblem) -> Candidates | NoPosture:
    """Returns the KEPT quickest postures at the target, or why there is none."""
    if problem.configurations is not None:
        q = problem.configurations
        psi, branch = problem.arm.arm_angle(q), problem.arm.branch(q)
        index = np.arange(len(q))
        return Candidates(index, np.zeros(len(q)), branch, psi, psi, psi)
    targets = len(problem.p_base_tool)
    target = np.repeat(np.arange(targets, dtype=np.int64), len(problem.yaw))
    yaw = np.tile(problem.yaw, targets)
    psi = np.linspace(-np.pi, np.pi, ARM_ANGLE_STEPS, endpoint=False)
    R, p, _ = flange_poses(problem, target, yaw)
    solutions = problem.arm.solve(R[:, None], p[:, None], psi[None, :])
    q = problem.arm.nearest_turns(solutions.q, problem.start)
    ok = solutions.reachable[..., None] & problem.arm.within_limits(q)
    if not ok.any():
        return _between_the_grid(problem, target, yaw, R, p)
    time = np.where(ok, problem.transfer_time(q - problem.start), np.inf)
    order = np.argsort(time, axis=None, kind="stable")[: min(KEPT, int(ok.sum()))]
    row, angle, branch = np.unravel_index(order, time.shape)
    return Candidates(target[row], yaw[row], branch, psi[angle], psi[angle], psi[angle])


def _between_the_grid(
    problem: StopProblem, target: IntArray, yaw: FloatArray, R: FloatArray, p: FloatArray
) -> Candidates | NoPosture:
    """Returns the middles of all feasible arm-angle intervals where the grid met none of them.

    The intervals are exact, so that a target is refused only if no arm angle of any branch will do (at the yaws
    that were tried).
    """
    intervals = feasible_arm_angles(problem.arm, R, p)
    row, branch, k = np.nonzero(np.isfinite(intervals.start))
    if row.size:
        psi = 0.5 * (intervals.start + intervals.end)[row, branch, k]
        return Candidates(target[row], yaw[row], branch, psi, psi, psi)
    if float(problem.arm.reach_miss(R, p).min()) > 0:
        return NoPosture("the target is out of the arm's reach")
    return NoPosture("no arm angle and branch keeps all joints within their limits")


def _with_swings(candidates: Candidates) -> Candidates:
    """Returns every candidate with every change of the arm angle along its lines."""
    n = len(candidates.branch)
    repeated = candidates.take(np.repeat(np.arange(n), len(SWINGS)))
    psi_end = repeated.psi_target + np.tile(SWINGS, n)
    return Candidates(
        repeated.target, repeated.yaw, repeated.branch, repeated.psi_target, psi_end, psi_end
    )


def _best_pairs(candidates: Candidates, value: Evaluation, n: int) -> Iterator[Candidates]:
    """Yields target postures, best first, each with its best swings of approach and retract."""
    approach = value.approach_cost.reshape(n, -1)
    retract = value.retract_cost.reshape(n, -1)
    total = approach.min(axis=1) + retract.min(axis=1)
    width = approach.shape[1]
    for row in np.argsort(total, kind="stable"):
        if not np.isfinite(total[row]):
            return
        a = row * width + int(np.argmin(approach[row]))
        r = row * width + int(np.argmin(retract[row]))
        yield replace(candidates.take(np.array([a])), psi_retract=candidates.psi_retract[[r]])


def _holds_between_samples(problem: StopProblem, one: Candidates) -> bool:
    """Returns whether one candidate's lines keep all limits at many more samples."""
    twice = one.take(np.zeros(2, dtype=np.int64))
    psi_end = np.concatenate([one.psi_approach, one.psi_retract])
    length = np.array([problem.approach, problem.retract])
    psi_end = np.where(length > 0, psi_end, twice.psi_target)
    _, ok = follow_line(problem, twice, psi_end, length, DENSE_SAMPLES if length.any() else 1)
    return bool(ok.all())


def _refinements(problem: StopProblem, best: Candidates) -> list[Candidates]:
    """Returns ever better candidates from rounds of ever narrower variation, the given one first."""
    found = [best]
    if problem.configurations is not None:
        return found
    cost = np.inf
    for k in range(REFINEMENTS):
        # The best so far is in the cloud itself, so that the first round knows its cost.
        cloud = _vary(found[-1], REFINEMENT_WIDTH * 0.5**k, problem.free_yaw)
        values = evaluate(problem, cloud)
        total = values.approach_cost + values.retract_cost
        i = int(np.argmin(total))
        cost = min(cost, float(total[0]))
        if total[i] < cost:
            cost = float(total[i])
            found.append(cloud.take(np.array([i])))
    return found


def _posture(one: Candidates, value: Evaluation) -> StopPosture:
    """Returns one candidate with its evaluation as the solution."""
    return StopPosture(
        target=int(one.target[0]),
        yaw=float(one.yaw[0]),
        branch=int(one.branch[0]),
        psi_target=float(one.psi_target[0]),
        psi_approach=float(one.psi_approach[0]),
        psi_retract=float(one.psi_retract[0]),
        q_approach=value.q_approach[0],
        q_target=value.q_target[0],
        q_retract=value.q_retract[0],
        cost=float(value.approach_cost[0] + value.retract_cost[0]),
    )


def _vary(best: Candidates, width: float, free_yaw: bool) -> Candidates:
    """Returns one candidate and a fixed cloud of variations, every coordinate within ±width."""
    cloud = width * _CLOUD
    n = len(cloud)
    same = best.take(np.zeros(n, dtype=np.int64))
    psi = same.psi_target + cloud[:, 0]
    return Candidates(
        same.target,
        same.yaw + (cloud[:, 3] if free_yaw else 0.0),
        same.branch,
        psi,
        psi + (same.psi_approach - same.psi_target) + cloud[:, 1],
        psi + (same.psi_retract - same.psi_target) + cloud[:, 2],
    )


def _halton(n: int, base: int) -> FloatArray:
    """Returns the first n points of the van der Corput sequence in [0, 1)."""
    index, value, scale = np.arange(1, n + 1), np.zeros(n), 1.0
    while index.any():
        scale /= base
        value += scale * (index % base)
        index = index // base
    return value


_CLOUD = np.vstack(
    [np.zeros((1, 4)), 2.0 * np.column_stack([_halton(64, base) for base in (2, 3, 5, 7)]) - 1.0]
)
