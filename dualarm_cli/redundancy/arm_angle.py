"""Posture of least time: all branches over the arm angle, lines included, then refined."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.kinematics.arm_angle_intervals import feasible_arm_angles
from dualarm_cli.redundancy.problem import NoPosture, StopPosture, StopProblem

ARM_ANGLE_STEPS = 48
"""Arm angles tried at each target: 7.5 degrees apart."""
KEPT = 48
"""Target postures, quickest transfer first, whose lines are looked at."""
SWINGS = np.array([0.0, -0.2, 0.2, -0.5, 0.5])
"""Changes of the arm angle along a line that are tried first [rad]."""
LINE_SAMPLES = 7
"""Samples of a line while postures are compared."""
DENSE_SAMPLES = 65
"""Samples of a line at which the posture that is taken must keep its limits."""
REFINEMENTS = 5
"""Rounds of local refinement, each half as wide as the one before."""
REFINEMENT_WIDTH = 0.25
"""Half-width of the first round [rad]."""
LARGEST_STEP = np.pi / 2
"""A joint that turns more than this between two samples of a line has jumped [rad]."""
TRAVEL_WEIGHT = 1e-3
"""Share of the summed joint times in the cost: among equals, the one that moves least."""


@dataclass(frozen=True)
class _Candidates:
    """n ways to make the stop; every array has n rows."""

    target: IntArray
    yaw: FloatArray
    branch: IntArray
    psi_target: FloatArray
    psi_approach: FloatArray
    psi_retract: FloatArray

    def take(self, index: IntArray) -> _Candidates:
        return _Candidates(*(getattr(self, name)[index] for name in self.__dataclass_fields__))


@dataclass(frozen=True)
class _Evaluation:
    """What n candidates cost, infinite where they are infeasible."""

    approach_cost: FloatArray
    retract_cost: FloatArray
    q_approach: FloatArray
    q_target: FloatArray
    q_retract: FloatArray


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
    value = _evaluate(problem, spread)
    for best in _best_pairs(spread, value, len(coarse.branch)):
        if _holds_between_samples(problem, best):
            return _refine(problem, best)
    return NoPosture("no posture at the target can follow its approach and retract lines", 0.0)


def line_path(
    problem: StopProblem, posture: StopPosture, line: str, samples: int
) -> tuple[FloatArray, FloatArray]:
    """Returns the joints along a line in the direction of motion, and the length travelled.

    Args:
        problem: the stop.
        posture: its solution.
        line: `approach` (ends at the target) or `retract` (starts there).
        samples: number of equidistant samples, at least 2.

    Returns:
        Joints [rad], shape (samples, 7), exact inverse kinematics at every sample, and lengths [m],
        shape (samples,).
    """
    away = line == "retract"
    length = problem.retract if away else problem.approach
    psi_end = posture.psi_retract if away else posture.psi_approach
    candidate = _Candidates(
        np.array([posture.target]),
        np.array([posture.yaw]),
        np.array([posture.branch]),
        np.array([posture.psi_target]),
        np.array([psi_end]),
        np.array([psi_end]),
    )
    q = _follow(problem, candidate, candidate.psi_approach, np.array([length]), samples)[0][0]
    return (q if away else q[::-1]), np.linspace(0.0, length, samples)


def _flange(
    problem: StopProblem, target: IntArray, yaw: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns flange rotations, positions and tool directions for targets turned by yaws."""
    R_tool = problem.R_base_tool[target] @ _rotation_z(yaw)
    R = R_tool @ problem.R_tool_flange
    p = problem.p_base_tool[target] + R_tool @ problem.p_tool_flange
    return R, p, R_tool[..., :, 2]


def _rotation_z(angle: FloatArray) -> FloatArray:
    R = np.zeros((*angle.shape, 3, 3))
    R[..., 0, 0] = R[..., 1, 1] = np.cos(angle)
    R[..., 1, 0] = np.sin(angle)
    R[..., 0, 1] = -R[..., 1, 0]
    R[..., 2, 2] = 1.0
    return R


def _target_candidates(problem: StopProblem) -> _Candidates | NoPosture:
    """Returns the KEPT quickest postures at the target, or why there is none."""
    if problem.configurations is not None:
        q = problem.configurations
        psi, branch = problem.arm.arm_angle(q), problem.arm.branch(q)
        index = np.arange(len(q))
        return _Candidates(index, np.zeros(len(q)), branch, psi, psi, psi)
    targets = len(problem.p_base_tool)
    target = np.repeat(np.arange(targets, dtype=np.int64), len(problem.yaw))
    yaw = np.tile(problem.yaw, targets)
    psi = np.linspace(-np.pi, np.pi, ARM_ANGLE_STEPS, endpoint=False)
    R, p, _ = _flange(problem, target, yaw)
    solutions = problem.arm.solve(R[:, None], p[:, None], psi[None, :])
    q = problem.arm.nearest_turns(solutions.q, problem.start)
    ok = solutions.reachable[..., None] & problem.arm.within_limits(q)
    if not ok.any():
        return _between_the_grid(problem, target, yaw, R, p)
    time = np.where(ok, problem.transfer_time(q - problem.start), np.inf)
    order = np.argsort(time, axis=None, kind="stable")[: min(KEPT, int(ok.sum()))]
    row, angle, branch = np.unravel_index(order, time.shape)
    return _Candidates(target[row], yaw[row], branch, psi[angle], psi[angle], psi[angle])


def _between_the_grid(
    problem: StopProblem, target: IntArray, yaw: FloatArray, R: FloatArray, p: FloatArray
) -> _Candidates | NoPosture:
    """Returns the middles of all feasible arm-angle intervals where the grid met none of them.

    The intervals are exact, so that a target is refused only if no arm angle of any branch will do (at the yaws
    that were tried).
    """
    intervals = feasible_arm_angles(problem.arm, R, p)
    row, branch, k = np.nonzero(np.isfinite(intervals.start))
    if row.size:
        psi = 0.5 * (intervals.start + intervals.end)[row, branch, k]
        return _Candidates(target[row], yaw[row], branch, psi, psi, psi)
    miss = float(problem.arm.reach_miss(R, p).min())
    if miss > 0:
        return NoPosture(f"the target is {miss * 1000:.1f} mm beyond the arm's reach", miss)
    return NoPosture("no arm angle and branch keeps all joints within their limits", 0.0)


def _with_swings(candidates: _Candidates) -> _Candidates:
    """Returns every candidate with every change of the arm angle along its lines."""
    n = len(candidates.branch)
    repeated = candidates.take(np.repeat(np.arange(n), len(SWINGS)))
    psi_end = repeated.psi_target + np.tile(SWINGS, n)
    return _Candidates(
        repeated.target, repeated.yaw, repeated.branch, repeated.psi_target, psi_end, psi_end
    )


def _best_pairs(candidates: _Candidates, value: _Evaluation, n: int) -> Iterator[_Candidates]:
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


def _holds_between_samples(problem: StopProblem, one: _Candidates) -> bool:
    """Returns whether one candidate's lines keep all limits at many more samples."""
    for psi_end, length in (
        (one.psi_approach, problem.approach),
        (one.psi_retract, problem.retract),
    ):
        if length > 0:
            _, ok = _follow(problem, one, psi_end, np.array([length]), DENSE_SAMPLES)
            if not ok[0]:
                return False
    return True


def _follow(
    problem: StopProblem,
    candidates: _Candidates,
    psi_end: FloatArray,
    length: FloatArray,
    samples: int,
) -> tuple[FloatArray, BoolArray]:
    """Returns joints from the target outward along a line, (n, samples, 7), and feasibility (n,).

    The branch is fixed and angles are unwrapped from the target, so that the joints are continuous.
    """
    R, p, z = _flange(problem, candidates.target, candidates.yaw)
    share = np.linspace(0.0, 1.0, samples)
    points = p[:, None, :] - z[:, None, :] * (share * length[:, None])[:, :, None]
    psi = candidates.psi_target[:, None] + (psi_end - candidates.psi_target)[:, None] * share
    q, reachable = problem.arm.solve_branch(R[:, None], points, psi, candidates.branch[:, None])
    reference = problem.start
    if problem.configurations is not None:
        reference = problem.configurations[candidates.target]
    first = problem.arm.nearest_turns(q[:, 0], reference)
    turn = 2.0 * np.pi
    steps = np.diff(q, axis=1)
    steps -= turn * np.round(steps / turn)
    q = np.concatenate([first[:, None], first[:, None] + np.cumsum(steps, axis=1)], axis=1)
    jumps = np.abs(steps).max(axis=(1, 2), initial=0.0) > LARGEST_STEP
    ok = reachable.all(axis=1) & problem.arm.within_limits(q).all(axis=1) & ~jumps
    return q, ok


def _evaluate(problem: StopProblem, candidates: _Candidates) -> _Evaluation:
    """Returns times and postures of the candidates."""
    q_in, time_in, ok_in, q_out, time_out, ok_out = _both_lines(problem, candidates)
    displacement = q_in[:, -1] - problem.start
    transfer = np.maximum(problem.waiting, problem.transfer_time(displacement))
    travel = TRAVEL_WEIGHT * np.abs(displacement).sum(axis=1)
    return _Evaluation(
        np.where(ok_in, transfer + time_in + travel, np.inf),
        np.where(ok_out, time_out, np.inf),
        q_in[:, -1],
        q_in[:, 0],
        q_out[:, -1],
    )


def _both_lines(
    problem: StopProblem, candidates: _Candidates
) -> tuple[FloatArray, FloatArray, BoolArray, FloatArray, FloatArray, BoolArray]:
    """Returns joints, time and feasibility of approach and retract: in one pass for speed."""
    n = len(candidates.branch)
    same = problem.approach == problem.retract and np.array_equal(
        candidates.psi_approach, candidates.psi_retract
    )
    if same:
        length = np.full(n, problem.approach)
        line = _line(problem, candidates, candidates.psi_approach, length)
        return (*line, *line)
    twice = candidates.take(np.tile(np.arange(n), 2))
    psi_end = np.concatenate([candidates.psi_approach, candidates.psi_retract])
    length = np.repeat([problem.approach, problem.retract], n)
    q, time, ok = _line(problem, twice, psi_end, length)
    return q[:n], time[:n], ok[:n], q[n:], time[n:], ok[n:]


def _line(
    problem: StopProblem, candidates: _Candidates, psi_end: FloatArray, length: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Returns joints, time and feasibility of one line per candidate; no time for no length."""
    # Where there is no line the arm angle has nothing to vary along.
    psi_end = np.where(length > 0, psi_end, candidates.psi_target)
    samples = LINE_SAMPLES if length.any() else 1
    q, ok = _follow(problem, candidates, psi_end, length, samples)
    time = np.zeros(len(q))
    timed = ok & (length > 0)
    if timed.any():
        time[timed] = problem.line_time(q[timed], np.linspace(0.0, 1.0, samples))
    return q, time, ok


def _refine(problem: StopProblem, best: _Candidates) -> StopPosture:
    """Returns the best posture after rounds of ever narrower variation around the best so far."""
    value = _evaluate(problem, best)
    if problem.configurations is None and problem.refine:
        for k in range(REFINEMENTS):
            cloud = _vary(best, REFINEMENT_WIDTH * 0.5**k, problem.free_yaw)
            values = _evaluate(problem, cloud)
            total = values.approach_cost + values.retract_cost
            i = np.array([int(np.argmin(total))])
            better = total[i[0]] < value.approach_cost[0] + value.retract_cost[0]
            if better and _holds_between_samples(problem, cloud.take(i)):
                best = cloud.take(i)
                value = _Evaluation(
                    *(getattr(values, name)[i] for name in values.__dataclass_fields__)
                )
    return StopPosture(
        target=int(best.target[0]),
        yaw=float(best.yaw[0]),
        branch=int(best.branch[0]),
        psi_target=float(best.psi_target[0]),
        psi_approach=float(best.psi_approach[0]),
        psi_retract=float(best.psi_retract[0]),
        q_approach=value.q_approach[0],
        q_target=value.q_target[0],
        q_retract=value.q_retract[0],
        cost=float(value.approach_cost[0] + value.retract_cost[0]),
    )


def _vary(best: _Candidates, width: float, free_yaw: bool) -> _Candidates:
    """Returns a fixed cloud of variations of one candidate, every coordinate within ±width."""
    cloud = width * _CLOUD
    n = len(cloud)
    same = best.take(np.zeros(n, dtype=np.int64))
    psi = same.psi_target + cloud[:, 0]
    return _Candidates(
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


_CLOUD = 2.0 * np.column_stack([_halton(64, base) for base in (2, 3, 5, 7)]) - 1.0
