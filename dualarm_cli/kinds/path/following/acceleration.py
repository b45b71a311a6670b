"""Following at the level of accelerations: one quadratic program per instant, towards more manipulability."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.linear_systems import SingularMatrixError, solve
from dualarm_cli.geometry.products import product
from dualarm_cli.kinds.path.following.problem import (
    NoPath,
    PathMotion,
    PathProblem,
    singular_there,
    within_limits,
)
from dualarm_cli.kinds.path.following.velocity import LeastSquares, pose_error
from dualarm_cli.kinematics.manipulability import manipulability_rates
from dualarm_cli.kinematics.whole_body import tool_drift
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal


@dataclass(frozen=True)
class AccelerationSettings:
    """Gains and margins of the acceleration-level program."""

    stiffness: float = 400.0
    """Task-space feedback on the tools' errors [1/s²]."""
    damping: float = 40.0
    """Task-space feedback on their velocities [1/s]: critical."""
    eta: float = 20.0
    """eta_1 of [Zhang2024] Eq. 23 [1/s]; eta_2 is a quarter of it."""
    jerk_share: float = 0.8
    """Share of the jerk limits that is used: accelerations are constant between instants, their curve is rougher."""
    kept_free: float = 5e-4
    """Distance from the position limits that is kept [rad]."""
    margin: float = 5e-3
    """Share of every limit that is kept free: knots are joined by curves."""
    torque_share: float = 0.98
    """Share of the torque limits that is used: evening out and curves between instants change accelerations
    a little."""
    braking: float = 0.15
    """Share of the time at the end in which self-motion dies out, at least."""
    least_braking: float = 0.8
    """Least time in which self-motion dies out [s]. Paths that take less than twice as long use half of their time."""
    order: float = 3.0
    """Exponent of the remaining time with which self-motion dies out. With it velocity, acceleration and jerk end at
    zero."""


ACCELERATION = AccelerationSettings()


@dataclass(frozen=True)
class Bounds:
    """Acceleration bounds that keep positions and velocities within limits."""

    lower: FloatArray
    """Lowest positions [rad], shape (n,)."""
    upper: FloatArray
    """Highest positions [rad], shape (n,)."""
    velocity: FloatArray
    """Largest speeds [rad/s], shape (n,)."""
    acceleration: FloatArray
    """Largest accelerations [rad/s²], shape (n,)."""
    eta: FloatArray
    """eta_1 [1/s], shape (n,); eta_2 is a quarter."""
    printed: bool = False
    """Whether they are those of Eq. 23 as printed, which brake too late for the position limits."""

    @classmethod
    def of(cls, problem: PathProblem) -> Bounds:
        """Returns the bounds of a problem's limits."""
        limits, share = problem.limits, 1.0 - ACCELERATION.margin
        eta = np.minimum(
            ACCELERATION.eta, ACCELERATION.jerk_share * limits.jerk / limits.acceleration
        )
        room = np.minimum(ACCELERATION.kept_free, (limits.upper - limits.lower) / 4.0)
        return cls(
            limits.lower + room,
            limits.upper - room,
            limits.velocity * share,
            limits.acceleration * share,
            eta,
            problem.weights.printed_bounds,
        )

    def at(self, q: FloatArray, qd: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Returns lowest and highest accelerations [rad/s²] at positions and velocities, each shape (n,).

        [Zhang2024] Eq. 22-23 corrected: the speed towards a position limit falls with the distance from it,
        upper = min(eta_1 (min(eta_2 (q_max - q), v_max) - qd), a_max), and its mirror. With eta_1 >= 4 eta_2 a joint
        that starts at rest within its limits stays there.
        """
        low, high, v, eta = self.lower - q, self.upper - q, self.velocity, self.eta
        slow = eta / 4.0
        if self.printed:
            least = np.maximum(eta * slow * low, eta * (-v - qd))
            most = np.minimum(eta * slow * high, eta * (v - qd))
        else:
            least = eta * (np.maximum(slow * low, -v) - qd)
            most = eta * (np.minimum(slow * high, v) - qd)
        return np.maximum(least, -self.acceleration), np.minimum(most, self.acceleration)


def follow_manipulability(problem: PathProblem) -> PathMotion | NoPath:
    """Returns the joints that seek manipulability within all limits ([Zhang2024] Eq. 24, corrected).

    Minimises |qdd - qdd*|² with qdd* = a_2 dg/dt - k (qd - a_2 g), g = grad log M, subject to the tools' accelerations
    and to the bounds. The print has +k qd in (18), against (17), and the gradient of M, which is too small to act.
    """
    weights = problem.weights

    most = stoppable(problem)

    def wanted(S: FloatArray, qd: FloatArray) -> FloatArray:
        rates = manipulability_rates(problem.body, S, qd, problem.follows)
        size = float((weights.gain * np.abs(rates.inner) / most).max())
        gain = weights.gain / max(1.0, size)
        found: FloatArray = gain * rates.rate - weights.damping * (qd - gain * rates.gradient)
        return found

    return _follow(problem, wanted)


def braking_time(problem: PathProblem) -> float:
    """Returns how long before the end self-motion begins to die out [s]."""
    whole = (problem.instants - 1) * problem.step
    return max(ACCELERATION.braking * whole, min(ACCELERATION.least_braking, 0.5 * whole))


def stoppable(problem: PathProblem) -> FloatArray:
    """Returns the speeds of self-motion that can die out in the braking time t [rad/s], shape (n,).

    A speed v (left / t)³ has its largest acceleration 3 v / t and its largest jerk 6 v / t² at first.
    """
    t, limits = braking_time(problem), problem.limits
    return np.minimum(
        limits.acceleration * t / ACCELERATION.order,
        limits.jerk * np.square(t) / (ACCELERATION.order * (ACCELERATION.order - 1.0)),
    )


def follow_min_acceleration(problem: PathProblem) -> PathMotion | NoPath:
    """Returns the joints of least acceleration within all limits ([Zhang2024] Eq. 9 without gradient)."""
    return _follow(problem, lambda _, qd: np.zeros_like(qd))


Wanted = Callable[[FloatArray, FloatArray], FloatArray]
"""Accelerations that are sought, of screws (n, 6) and velocities (n,)."""


def _follow(problem: PathProblem, wanted: Wanted) -> PathMotion | NoPath:
    step = AccelerationStep(problem, wanted)
    q, qd = np.array(problem.start), np.zeros(len(problem.start))
    position = np.empty((problem.instants, len(q)))
    position[0], h = q, problem.step
    acceleration = np.zeros_like(q)
    for k in range(1, problem.instants):
        try:
            found = step.solve(q, qd, acceleration, k - 1)
        except SingularMatrixError:
            return NoPath(Refusal("tools_stop", more={"also": singular_there(problem, q)}), k)
        if found is None:
            also = [*_not_held(problem, q), *singular_there(problem, q)]
            return NoPath(Refusal("accelerations_stop", more={"also": also}), k, np.inf)
        acceleration, correction = found
        # The tools' errors are corrected by feedback as well; here what it leaves, for the answer alone.
        position[k - 1] += correction
        q = q + h * (qd + 0.5 * h * acceleration)
        qd = qd + h * acceleration
        position[k] = q
    position[-1] += step.correction(q, problem.instants - 1)
    motion = within_limits(problem, position)
    return motion if isinstance(motion, NoPath) else replace(motion, keeps_rates=True)


def _not_held(problem: PathProblem, q: FloatArray) -> list[Refusal]:
    """List the joint that cannot even hold a posture (n,) [rad], or nothing."""
    if problem.torque is None or problem.dynamics is None:
        return []
    rest = np.abs(problem.dynamics(q, np.zeros_like(q))[1])
    share = np.where(problem.free, rest / (problem.torque * ACCELERATION.torque_share), 0.0)
    joint = int(np.argmax(share))
    if share[joint] <= 1.0:
        return []
    measured, allowed = float(rest[joint]), float(problem.torque[joint])
    more = {"joint": problem.limits.joints[joint]}
    return [Refusal("posture_not_held", measured=measured, allowed=allowed, more=more)]


class AccelerationStep:
    """The quadratic program of one instant, set up once."""

    def __init__(self, problem: PathProblem, wanted: Wanted) -> None:
        """Prepares the solver."""
        self._problem, self._wanted = problem, wanted
        self._bounds, self._braking = Bounds.of(problem), braking_time(problem)
        self._velocity, self._acceleration = problem.twists()
        self._free = np.flatnonzero(problem.free)
        self._follows = np.flatnonzero(problem.follows)
        self._jerk = problem.limits.jerk * (problem.step * ACCELERATION.jerk_share)
        self._program = LeastSquares()

    def solve(
        self, q: FloatArray, qd: FloatArray, before: FloatArray, k: int
    ) -> tuple[FloatArray, FloatArray] | None:
        """Returns accelerations from one instant to the next [rad/s²] and a correction of the joints [rad], each (n,).

        None where no accelerations are within the bounds.

        Args:
            q: joints at the instant [rad], shape (n,).
            qd: velocities [rad/s], shape (n,).
            before: accelerations of the step before [rad/s²], shape (n,).
            k: number of the instant.
        """
        problem, body, free = self._problem, self._problem.body, self._free
        state = body.at(q)
        J = state.J[problem.rows]
        error = pose_error(
            problem.R[k], problem.p[k], state.R[self._follows], state.p[self._follows]
        )
        drift = tool_drift(state.S, state.p, body.moves, body.before, qd)[problem.rows]
        slip = self._velocity[k] - product(J, qd)
        A = (
            self._acceleration[k]
            + ACCELERATION.damping * slip
            + ACCELERATION.stiffness * error
            - drift
        )
        left = (problem.instants - 1 - k) * problem.step
        aim = self._rest(J, qd, left) if left < self._braking else self._wanted(state.S, qd)
        low, high = self._bounds.at(q, qd)
        least = np.maximum(low, before - self._jerk)
        most = np.minimum(high, before + self._jerk)
        # Where a limit and the jerk exclude one another the limit counts.
        crossed = least > most
        least[crossed] = most[crossed] = np.clip(before, low, high)[crossed]
        found = np.zeros_like(q)
        rows, torques = J[:, free], self._torques(q, qd)
        solved = self._program.solve(aim[free], rows, A, least[free], most[free], torques)
        if solved is None:
            # Without the jerk limits, which are for the curve through the instants to keep.
            solved = self._program.solve(aim[free], rows, A, low[free], high[free], torques)
        if solved is None:
            return None
        found[free] = solved
        return found, self._towards(J, error)

    def correction(self, q: FloatArray, k: int) -> FloatArray:
        """Returns the small change of the joints [rad], (n,), that puts the tools where they belong at an instant."""
        problem, which = self._problem, self._follows
        state = problem.body.at(q)
        error = pose_error(problem.R[k], problem.p[k], state.R[which], state.p[which])
        return self._towards(state.J[problem.rows], error)

    def _towards(self, J: FloatArray, error: FloatArray) -> FloatArray:
        found = np.zeros(J.shape[1])
        own = J[:, self._free]
        found[self._free] = product(own.T, solve(product(own, own.T), error))
        return found

    def _rest(self, J: FloatArray, qd: FloatArray, left: float) -> FloatArray:
        """Returns the accelerations under which self-motion ends when the path does, shape (n,)."""
        inner = qd - product(J.T, solve(product(J, J.T), product(J, qd)))
        return -ACCELERATION.order / max(left, self._problem.step) * inner

    def _torques(
        self, q: FloatArray, qd: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray] | None:
        """Returns matrix and bounds of the joints' torques as rows over the free joints, or None."""
        problem = self._problem
        if problem.torque is None or problem.dynamics is None:
            return None
        mass, rest = problem.dynamics(q, qd)
        free, limit = self._free, problem.torque
        limit = limit * ACCELERATION.torque_share
        return mass[np.ix_(free, free)], (-limit - rest)[free], (limit - rest)[free]
