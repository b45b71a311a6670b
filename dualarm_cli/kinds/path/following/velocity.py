"""Following at the level of velocities: least norm, and virtual springs that pull the elbows in the null space."""

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
    """Gains and margins of the velocity-level program."""

    absolute: float = 1e-9
    """Absolute tolerance of the solver."""
    relative: float = 1e-10
    """Relative tolerance of the solver."""
    largest_step: float = 0.5
    """A joint that would move farther between two instants is at a singular posture [rad]."""
    corrections: int = 10
    """Maximum number of Newton corrections of the tools after a step."""
    settled: float = 1e-11
    """Expected tool error at which the corrections end [m, rad]."""
    self_share: float = 0.5
    """Largest share of a tool-speed cap that self-motion gives other arms' tools."""
    self_speed: float = 0.4
    """Largest share of a joint's speed limit that self-motion may use."""
    kept_free: float = 1e-3
    """Distance from the joints' limits at which they are stopped [rad]."""
    braking: float = 4.0
    """Maximum ratio of a joint's speed to its distance from a limit [1/s]."""
    margin: float = 1e-3
    """Share of the speed limits that is kept free: instants are joined by curves."""


VELOCITY = VelocitySettings()


class LeastSquares:
    """min |x - wish|² subject to A x = b, least <= x <= most, and low <= G x <= high.

    Set up once, then updated: an interior-point method, which does not start from the solution before. An augmented
    Lagrangian one that does (proxsuite's, warm) took half of its 25 us, but left one instant in a hundred unsolved at
    this accuracy.
    """

    def __init__(self) -> None:
        """Loads the solver."""
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
        """Returns x, shape (n,), or None where the solver finds none.

        Args:
            wish: shape (n,).
            A: of the equations, shape (m, n).
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
            return NoPath(Refusal("joints_stop", more={"also": singular_there(problem, q)}), k)
        if not np.abs(moved - q).max() < VELOCITY.largest_step:
            found = _judged(problem, room, position[:k])
            if isinstance(found, NoPath):
                return found
            also = singular_there(problem, q) or [Refusal("perhaps_beyond_reach")]
            return NoPath(Refusal("joints_stop", more={"also": also}), k)
        position[k] = q = moved
    return _judged(problem, room, position)


def _judged(problem: PathProblem, room: Room, position: FloatArray) -> PathMotion | NoPath:
    """Returns the motion, or where a joint is beyond its limit; slower may help where there was no room to stop it."""
    found = within_limits(problem, position)
    return replace(found, excess=np.inf) if isinstance(found, NoPath) and room.lacked else found


def make_step(
    problem: PathProblem, room: Room, *, exact: bool, pulled: bool
) -> Callable[[FloatArray, int], FloatArray]:
    """Returns the function from the joints at one instant and the number of the next to the joints there.

    Args:
        problem: what is to be followed.
        room: how far joints may move in a step.
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
        """Returns how many times faster than it may self-motion swings the tools of arms that do not follow."""
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
                # Self-motion leaves joints enough of their speed for the tools' motion.
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
    """Returns joints near given ones whose tools are where they belong, by Newton steps with one Jacobian.

    As many as it takes: each leaves a share of the error that grows with the joints' way from where the Jacobian is
    from, which is far where bounds or means have moved them.

    Args:
        problem: whose tools.
        q: all joints [rad], shape (n,).
        plus: pseudo-inverse of the Jacobian of the tools that follow, shape (n, 6 b).
        R_goal: rotations to be reached, shape (b, 3, 3).
        p_goal: positions to be reached [m], shape (b, 3).
    """
    body, which, before = problem.body, np.flatnonzero(problem.follows), 0.0
    for _ in range(VELOCITY.corrections):
        R, p = body.tools(q)
        left = pose_error(R_goal, p_goal, R[which], p[which])
        q = q + product(plus, left)
        size = float(np.abs(left).max())
        # What this step leaves, at the rate of the one before.
        if size * size <= VELOCITY.settled * before:
            break
        before = size
    return q


class Room:
    """How far joints may move in one step so that they come to rest before their limits, and the move that does."""

    lacked: bool = False
    """Whether at some instant no move followed the tools within bounds; slower, joints may come nearer to limits."""

    def __init__(self, problem: PathProblem) -> None:
        """Prepares a problem's limits."""
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
        """Returns least and greatest moves from positions [rad], each shape (n,)."""
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
        """Returns the move nearest to a pull that makes up for the error within bounds, (n,), or None without one.

        Where the bounds are far it is that of the exact projector, and it does not jump where they come near.
        """
        free = self._free
        if self._program is None:
            self._program = LeastSquares()
        # In units in which a step is about 1, so that the solver's tolerances mean something.
        scale = 1.0 / float(self._farthest[free].min())
        found = self._program.solve(
            pull[free] * scale, J[:, free], error * scale, least[free] * scale, most[free] * scale
        )
        if found is None:
            self.lacked = True
            return None
        moved = np.zeros(len(pull))
        moved[free] = found / scale
        return moved


def pose_error(R_goal: FloatArray, p_goal: FloatArray, R: FloatArray, p: FloatArray) -> FloatArray:
    """Returns the ways from tools to where they belong, linear part first, shape (6 b,); for small turns.

    The turn is the sine of the angle about the axis, that is the rotation vector but for its third power.

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
