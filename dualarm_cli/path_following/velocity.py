"""Following at the level of velocities: least norm, and virtual springs that pull the elbows in the null space."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinematics.whole_body import BodyState, WholeBody
from dualarm_cli.path_following.limits import singular_words, within_limits
from dualarm_cli.path_following.problem import NoPath, PathMotion, PathProblem, Spring

LARGEST_STEP = 0.5
"""A joint that would move farther between two instants is at a singular posture [rad]."""
CORRECTIONS = 2
"""Newton corrections of the tools after every step."""


def follow_min_norm(problem: PathProblem) -> PathMotion | NoPath:
    """Returns the joints that move least at every instant: damped least squares ([Choi2020] Eq. 3), tools corrected.

    What the damping leaves of a step is made up for by corrections without it, so that the tools are exact.
    """
    return _follow(problem, exact=True, pulled=False)


def follow_spring(problem: PathProblem) -> PathMotion | NoPath:
    """Returns the joints with virtual springs between elbows and critical points ([Choi2020]), tools exact.

    The springs act through the exact null-space projector I - J+ J, and corrections keep the tools where they belong.
    """
    return _follow(problem, exact=True, pulled=True)


def follow_spring_damped(problem: PathProblem) -> PathMotion | NoPath:
    """Returns the joints as [Choi2020] prints the method: Eq. 4 with the damped J+ of Eq. 5, no correction.

    I - J+ J is then no projector: the springs disturb the tools.
    """
    return _follow(problem, exact=False, pulled=True)


def spring_gradient(
    body: WholeBody, state: BodyState, spring: Spring
) -> tuple[FloatArray, FloatArray]:
    """Returns v = -gain d/dq of half the sum of squared spring lengths, shape (n,), and the lengths [m], shape (a,).

    [Choi2020] Eq. 13-35: sum of (J_EB - dCP/dq)^T (EB - CP) over the arms.

    Args:
        body: kinematics.
        state: where the robot is.
        spring: critical points and gain.
    """
    places, carried = body.carried_points(state, spring.points)
    D = state.elbow - places
    v = -spring.gain * np.tensordot(D, body.elbow_jacobian(state) - carried, 2)
    return v, np.sqrt((D * D).sum(axis=1))


def _follow(problem: PathProblem, *, exact: bool, pulled: bool) -> PathMotion | NoPath:
    step = make_step(problem, exact=exact, pulled=pulled)
    q = np.array(problem.start)
    position = np.empty((problem.instants, len(q)))
    position[0] = q
    for k in range(1, problem.instants):
        moved = step(q, k)
        if not np.abs(moved - q).max() < LARGEST_STEP:
            found = within_limits(problem, position[:k])
            if isinstance(found, NoPath):
                return found
            words = singular_words(problem, q) or "; is the path out of reach there?"
            return NoPath(f"the joints cannot follow{words}", k)
        position[k] = q = moved
    return within_limits(problem, position)


def make_step(
    problem: PathProblem, *, exact: bool, pulled: bool
) -> Callable[[FloatArray, int], FloatArray]:
    """Returns the function from the joints at one instant and the number of the next to the joints there.

    Args:
        problem: what is to be followed.
        exact: whether the null-space projector is exact and the tools are corrected.
        pulled: whether the springs pull.
    """
    body, spring, rows, free = problem.body, problem.spring, problem.rows, problem.free
    every = bool(rows.all() and free.all())
    follows, damping = np.flatnonzero(problem.follows), problem.damping**2
    eye = damping * np.eye(6 * len(follows))
    speed = problem.pace * problem.step

    def step(q: FloatArray, k: int) -> FloatArray:
        state = body.at(q)
        J = state.J if every else state.J[rows] * free
        gram = J @ J.T
        error = pose_error(problem.R[k], problem.p[k], state.R[follows], state.p[follows])
        push = np.linalg.solve(gram + eye, error)
        plus = None
        moved = J.T @ push
        if pulled:
            v = spring_gradient(body, state, spring)[0] * (free * speed[k])
            if exact:
                plus = J.T @ np.linalg.inv(gram)
                v -= plus @ (J @ v)
            else:
                v -= J.T @ np.linalg.solve(gram + eye, J @ v)
            moved += v
        q = q + moved
        if exact:
            plus = J.T @ np.linalg.inv(gram) if plus is None else plus
            for _ in range(CORRECTIONS):
                R, p = body.tools(q)
                q = q + plus @ pose_error(problem.R[k], problem.p[k], R[follows], p[follows])
        return q

    return step


def pose_error(R_goal: FloatArray, p_goal: FloatArray, R: FloatArray, p: FloatArray) -> FloatArray:
    """Returns the ways from tools to where they belong, linear part first, shape (6 b,); for small turns.

    The turn is the sine of the angle about the axis, that is the rotation vector but for its third power.

    Args:
        R_goal: rotations to be reached, shape (b, 3, 3).
        p_goal: positions to be reached [m], shape (b, 3).
        R: rotations, shape (b, 3, 3).
        p: positions [m], shape (b, 3).
    """
    E = R_goal @ R.transpose(0, 2, 1)
    error = np.empty((len(p), 6))
    error[:, :3] = p_goal - p
    error[:, 3] = E[:, 2, 1] - E[:, 1, 2]
    error[:, 4] = E[:, 0, 2] - E[:, 2, 0]
    error[:, 5] = E[:, 1, 0] - E[:, 0, 1]
    error[:, 3:] *= 0.5
    return error.ravel()
