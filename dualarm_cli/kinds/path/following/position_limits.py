"""Search for position limits that end a path at any speed."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.geometry.linear_systems import singular_values, solve
from dualarm_cli.geometry.products import product
from dualarm_cli.kinds.path.following.problem import NoPath, PathProblem, limit_reached
from dualarm_cli.kinds.path.following.velocity import pose_error
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class LimitSettings:
    """Settings of the search for position limits."""

    stations: int = 400
    """Number of places along the path at which joints are solved."""
    steps: int = 12
    """Maximum number of Newton steps per place."""
    centring: int = 3
    """Least number of Newton steps per place that move joints off limits by self-motion."""
    share: float = 0.2
    """Fraction of the distance to mid-range by which self-motion moves joints."""
    followed: float = 1e-9
    """Tool error below which a place counts as reached [m, rad]."""
    beyond: float = 1e-4
    """Distance beyond a limit that no follower uses [rad]."""
    singular: float = 1e-3
    """Least singular value of the tools' Jacobian for which joints are moved."""


LIMITS = LimitSettings()


def ended_by_limit(problem: PathProblem, moves: BoolArray | None = None) -> NoPath | None:
    """Find the joint whose position limit ends a path, or None.

    The path is followed by steps of least norm. A joint that would leave its limits is held there, and self-motion
    keeps the others away from theirs. The path ends where the others cannot compensate for it.

    Args:
        problem: the follower's problem.
        moves: joints that may move, shape (n,); None for all that move a following tool.
    """
    limits, free = problem.limits, problem.free if moves is None else moves
    q = np.array(problem.start)
    count = min(problem.instants, LIMITS.stations)
    for k in np.linspace(0, problem.instants - 1, count).round().astype(np.int64).tolist():
        held, worst = np.zeros(len(q), dtype=np.bool_), -1
        while (solution := _solve_instant(problem, q, k, free & ~held)) is not None:
            beyond = np.maximum(limits.lower - solution, solution - limits.upper)
            out = (beyond > LIMITS.beyond) & free & ~held
            if not out.any():
                break
            worst, held = int(np.argmax(np.where(out, beyond, 0.0))), held | out
            q = np.where(out, np.clip(solution, limits.lower, limits.upper), q)
        if solution is None:
            return None if worst < 0 else NoPath(limit_reached(problem, worst, q[worst]), k)
        q = solution
    return None


def _solve_instant(
    problem: PathProblem, q: FloatArray, k: int, moves: BoolArray
) -> FloatArray | None:
    """Solve joints (n,) [rad] near given ones for an instant's poses, or None."""
    limits, follows = problem.limits, np.flatnonzero(problem.follows)
    middle = 0.5 * (limits.lower + limits.upper)
    middle = np.where(np.isfinite(middle), middle, problem.start)
    for number in range(LIMITS.steps):
        state = problem.body.at(q)
        error = pose_error(problem.R[k], problem.p[k], state.R[follows], state.p[follows])
        if np.abs(error).max() < LIMITS.followed and number >= LIMITS.centring:
            return q
        J = state.J[problem.rows][:, moves]
        if J.shape[1] < len(J) or singular_values(J)[-1] < LIMITS.singular:
            return None
        pull = np.zeros(J.shape[1])
        if number < LIMITS.centring and J.shape[1] > len(J):
            pull = LIMITS.share * (middle - q)[moves]
        step = np.zeros(len(q))
        step[moves] = pull + product(J.T, solve(product(J, J.T), error - product(J, pull)))
        q = q + step
    return None
