"""Path following by velocities: least norm, and virtual springs in the null space.

The springs pull the elbows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from dualarm_cli.geometry import linear_systems
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.linear_systems import SingularMatrixError, solve
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.geometry.programs import plain_piqp
from dualarm_cli.kinds.path.following.problem import (
    NoPath,
    PathMotion,
    PathProblem,
    Spring,
    singular_there,
    within_limits,
)
from dualarm_cli.kinematics.whole_body import BodyState, WholeBody
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal


@dataclass(frozen=True)
class VelocitySettings:
    """Settings of the velocity-level methods."""

    absolute: float = 1e-9
    """Absolute tolerance of the solver."""
    relative: float = 1e-10
    """Relative tolerance of the solver."""
    largest_step: float = 0.5
    """Largest joint motion between two instants; more is a singular posture [rad]."""
    corrections: int = 10
    """Maximum number of Newton corrections of the tools after a step."""
    settled: float = 1e-11
    """Expected tool error at which the corrections end [m, rad]."""
    self_share: float = 0.5
    """Largest fraction of the tool-speed cap that self-motion may use on idle tools."""
    self_speed: float = 0.4
    """Largest fraction of a joint's speed limit that self-motion may use."""
    kept_free: float = 1e-3
    """Margin to the joints' limits [rad]."""
    braking: float = 4.0
    """Maximum ratio of a joint's speed to its distance from a limit [1/s]."""
    margin: float = 1e-3
    """Fraction of the speed limits that is kept free. Instants are joined by curves."""


VELOCITY = VelocitySettings()


class LeastSquares:
    """Least-squares program with linear constraints.

    min |x - wish|² subject to A x = b, least <= x <= most, and low <= G x <= high.

    Set up once, then updated: an interior-point method without warm start. A warm-started augmented Lagrangian
    (proxsuite) took half of its 25 us, but left one instant in a hundred unsolved at this accuracy.
    """

    def __init__(self) -> None:
        """Load the solver."""
        piqp = plain_piqp()
        self._solver: Any = piqp.DenseSolver()
        self._solver.settings.eps_abs = VELOCITY.absolute
        self._solver.settings.eps_rel = VELOCITY.relative
        self._solved = piqp.PIQP_SOLVED
        self._ready = False

    def solve(
        self,
        wish: FloatArray,
        A: FloatArray,
        b: FloatArray,
        least: FloatArray,
        most: FloatArray,
        rows: tuple[FloatArray, FloatArray, FloatArray] | None = None,
    ) -> FloatArray | None:
        """Solve for x, shape (n,), or return None if the solver fails.

        Args:
            wish: target of x, shape (n,).
            A: matrix of the equations, shape (m, n).
            b: their right sides, shape (m,).
            least: lower bounds, shape (n,).
            most: upper bounds, shape (n,).
            rows: G (k, n), low (k,) and high (k,), the same k every time; None for none.
        """
        given = (wish, A, b, least, most, *(rows or ()))
        # A NaN would be read as no bound, or as a solution.
        if not all(np.isfinite(part).all() for part in given):
            return None
        if not self._ready:
            G, low, high = rows or (None, None, None)
            self._solver.setup(np.eye(len(wish)), -wish, A, b, G, low, high, least, most)
            self._ready = True
        elif rows:
            G, low, high = rows
            self._solver.update(c=-wish, A=A, b=b, G=G, h_l=low, h_u=high, x_l=least, x_u=most)
        else:
            self._solver.update(c=-wish, A=A, b=b, x_l=least, x_u=most)
        if self._solver.solve() != self._solved:
            return None
        return np.array(self._solver.result.x)


def follow_min_norm(problem: PathProblem) -> PathMotion | NoPath:
    """Follow by least joint motion at every instant, with exact tools.

    Damped least squares ([Choi2020] Eq. 3).

    Corrections without damping remove the error that the damping leaves.
    """
    return _follow(problem, exact=True, pulled=False)


def follow_spring(problem: PathProblem) -> PathMotion | NoPath:
    """Follow with virtual springs between elbows and critical points, with exact tools.

    The springs of [Choi2020] act through the exact null-space projector I - J+ J, and corrections keep the tools exact.
    """
    return _follow(problem, exact=True, pulled=True)


def follow_spring_damped(problem: PathProblem) -> PathMotion | NoPath:
    """Follow with virtual springs as [Choi2020] prints it, without correction.

    Eq. 4 with the damped J+ of Eq. 5: I - J+ J is then no projector, and the springs disturb the tools.
    """
    return _follow(problem, exact=False, pulled=True)


def spring_gradient(
    body: WholeBody, state: BodyState, spring: Spring
) -> tuple[FloatArray, FloatArray]:
    """Compute the spring velocity v, shape (n,), and the spring lengths [m], shape (a,).

    v = -gain d/dq of half the sum of squared lengths.

    [Choi2020] Eq. 13-35: sum of (J_EB - dCP/dq)^T (EB - CP) over the arms.

    Args:
        body: kinematics.
        state: of the robot.
        spring: critical points and gain.
    """
    places, carried = body.carried_points(state, spring.points)
    D = state.elbow - places
    v = -spring.gain * np.einsum("ij,ijk->k", D, body.elbow_jacobian(state) - carried)
    return v, np.sqrt((D * D).sum(axis=1))


def _follow(problem: PathProblem, *, exact: bool, pulled: bool) -> PathMotion | NoPath:
    room = Room(problem)
    step = make_step(problem, room, exact=exact, pulled=pulled)
    q = np.array(problem.start)
    position = np.empty((problem.instants, len(q)))
    position[0] = q
    for k in range(1, problem.instants):
        try:
            moved = step(q, k)
        except SingularMatrixError:
            return NoPath(Refusal("joints_stop", data={"also": singular_there(problem, q)}), k)
        if not np.abs(moved - q).max() < VELOCITY.largest_step:
            result = _judged(problem, room, position[:k])
            if isinstance(result, NoPath):
                return result
            also = singular_there(problem, q) or [Refusal("perhaps_beyond_reach")]
            return NoPath(Refusal("joints_stop", data={"also": also}), k)
        position[k] = q = moved
    return _judged(problem, room, position)


def _judged(problem: PathProblem, room: Room, position: FloatArray) -> PathMotion | NoPath:
    """Check the position limits.

    Lower speed may help where a joint had no room to stop.
    """
    result = within_limits(problem, position)
    return replace(result, excess=np.inf) if isinstance(result, NoPath) and room.lacked else result


def make_step(
    problem: PathProblem, room: Room, *, exact: bool, pulled: bool
) -> Callable[[FloatArray, int], FloatArray]:
    """Create the function that advances the joints from one instant to the next.

    Args:
        problem: the follower's problem.
        room: range of joint motions per step.
        exact: whether the null-space projector is exact and the tools are corrected.
        pulled: whether the springs pull.
    """
    body, spring, rows, free = problem.body, problem.spring, problem.rows, problem.free
    every = bool(rows.all() and free.all())
    follows = np.flatnonzero(problem.follows)
    speed = problem.pace * problem.step
    damping = np.square(problem.damping) * np.eye(6 * len(follows))
    most = VELOCITY.self_speed * problem.limits.velocity
    idle = ~problem.rows
    cap = VELOCITY.self_share * problem.tool_speed if problem.tool_speed is not None else np.inf

    def swing(J: FloatArray, v: FloatArray) -> float:
        """Compute the ratio of self-motion's speed of idle tools to its limit."""
        if not np.isfinite(cap) or not idle.any():
            return 0.0
        speeds = product(J[idle], v).reshape(-1, 6)[:, :3]
        return float(norm(speeds, axis=1).max()) / cap

    def step(q: FloatArray, k: int) -> FloatArray:
        state = body.at(q)
        J = state.J if every else state.J[rows] * free
        gram = product(J, J.T)
        error = pose_error(problem.R[k], problem.p[k], state.R[follows], state.p[follows])
        moved = product(J.T, solve(gram + damping, error))
        inverse = linear_systems.inverse(gram if exact else gram + damping)
        pull = np.zeros(len(q))
        if pulled:
            v = spring_gradient(body, state, spring)[0]
            v *= free
            v -= product(J.T, product(inverse, product(J, v)))
            if exact:
                # Self-motion is limited, to leave speed for the tools' motion.
                v /= max(1.0, float((np.abs(v) / most).max()), swing(state.J, v))
            pull = v * speed[k]
            moved += pull
        if exact:
            least, greatest = room.at(q)
            if ((moved < least) | (moved > greatest)).any():
                held = room.nearest(J, error, pull, least, greatest)
                moved = moved if held is None else held
        q = q + moved
        if exact:
            q = corrected(problem, q, product(J.T, inverse), problem.R[k], problem.p[k])
        return q

    return step


def corrected(
    problem: PathProblem, q: FloatArray, plus: FloatArray, R_goal: FloatArray, p_goal: FloatArray
) -> FloatArray:
    """Correct joints for exact tools by Newton steps with one Jacobian.

    Each step leaves a fraction of the error that grows with the distance from the Jacobian's configuration, which is
    large where bounds or means have moved the joints.

    Args:
        problem: the follower's problem.
        q: all joints [rad], shape (n,).
        plus: pseudo-inverse of the Jacobian of the tools that follow, shape (n, 6 b).
        R_goal: rotations to be reached, shape (b, 3, 3).
        p_goal: positions to be reached [m], shape (b, 3).
    """
    body, which, before = problem.body, np.flatnonzero(problem.follows), 0.0
    for _ in range(VELOCITY.corrections):
        R, p = body.tools(q)
        error = pose_error(R_goal, p_goal, R[which], p[which])
        q = q + product(plus, error)
        size = float(np.abs(error).max())
        # Expected error after this step, at the convergence rate of the one before.
        if size * size <= VELOCITY.settled * before:
            break
        before = size
    return q


class Room:
    """Range of joint motions per step that lets joints stop before their limits."""

    lacked: bool = False
    """Whether an instant had no motion within the range.

    At lower speed, joints may get nearer to limits.
    """

    def __init__(self, problem: PathProblem) -> None:
        """Prepare a problem's limits."""
        limits, step = problem.limits, problem.step
        self._lower, self._upper = (
            limits.lower + VELOCITY.kept_free,
            limits.upper - VELOCITY.kept_free,
        )
        self._farthest = limits.velocity * (step * (1.0 - VELOCITY.margin))
        self._share = min(1.0, VELOCITY.braking * step)
        self._free = np.flatnonzero(problem.free)
        self._program: LeastSquares | None = None

    def at(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute the least and greatest moves from positions [rad], each shape (n,)."""
        least = np.maximum(self._share * (self._lower - q), -self._farthest)
        most = np.minimum(self._share * (self._upper - q), self._farthest)
        return np.minimum(least, 0.0), np.maximum(most, 0.0)

    def nearest(
        self,
        J: FloatArray,
        error: FloatArray,
        pull: FloatArray,
        least: FloatArray,
        most: FloatArray,
    ) -> FloatArray | None:
        """Compute the move nearest to a pull that removes the error, (n,).

        It is within bounds; None if there is no such move.

        With distant bounds it is the move of the exact projector, and it changes continuously as they get near.
        """
        free = self._free
        if self._program is None:
            self._program = LeastSquares()
        # In units in which a step is about 1, so that the solver's tolerances mean something.
        scale = 1.0 / float(self._farthest[free].min())
        solution = self._program.solve(
            pull[free] * scale, J[:, free], error * scale, least[free] * scale, most[free] * scale
        )
        if solution is None:
            self.lacked = True
            return None
        moved = np.zeros(len(pull))
        moved[free] = solution / scale
        return moved


def pose_error(R_goal: FloatArray, p_goal: FloatArray, R: FloatArray, p: FloatArray) -> FloatArray:
    """Compute tools' pose errors for small turns, linear part first, shape (6 b,).

    The turn is the sine of the angle about the axis: the rotation vector up to an error of third order.

    Args:
        R_goal: rotations to be reached, shape (b, 3, 3).
        p_goal: positions to be reached [m], shape (b, 3).
        R: rotations, shape (b, 3, 3).
        p: positions [m], shape (b, 3).
    """
    E = product(R_goal, R.transpose(0, 2, 1))
    error = np.empty((len(p), 6))
    error[:, :3] = p_goal - p
    error[:, 3] = E[:, 2, 1] - E[:, 1, 2]
    error[:, 4] = E[:, 0, 2] - E[:, 2, 0]
    error[:, 5] = E[:, 1, 0] - E[:, 0, 1]
    error[:, 3:] *= 0.5
    return error.ravel()
