"""Path following by accelerations: one quadratic program per instant, towards manipulability."""

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
    """Fraction of the jerk limits that is used.

    Accelerations are constant between instants, their curve is rougher.
    """
    kept_free: float = 5e-4
    """Margin to the position limits [rad]."""
    margin: float = 5e-3
    """Fraction of every limit that is kept free. Knots are joined by curves."""
    torque_share: float = 0.98
    """Fraction of the torque limits that is used.

    Smoothing and curves between instants change accelerations a little.
    """
    braking: float = 0.15
    """Least fraction of the duration in which self-motion dies out at the end."""
    least_braking: float = 0.8
    """Least time in which self-motion dies out [s].

    Paths shorter than twice that use half of their duration.
    """
    order: float = 3.0
    """Exponent of the remaining time in the decay of self-motion.

    With it velocity, acceleration and jerk end at zero.
    """


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
    """Whether Eq. 23 is used as printed.

    It brakes too late for the position limits.
    """

    @classmethod
    def of(cls, problem: PathProblem) -> Bounds:
        """Compute the bounds from a problem's limits."""
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
        """Compute the acceleration range at positions and velocities [rad/s²], each shape (n,).

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
    """Follow by accelerations that seek manipulability within all limits.

    [Zhang2024] Eq. 24, corrected.

    Minimises |qdd - qdd*|² with qdd* = a_2 dg/dt - k (qd - a_2 g), g = grad log M, subject to the tools' accelerations
    and the bounds. The paper prints +k qd in (18), against (17), and the gradient of M, which is too small to act.
    """
    weights = problem.weights

    most = stoppable(problem)

    def desired(S: FloatArray, qd: FloatArray) -> FloatArray:
        rates = manipulability_rates(problem.body, S, qd, problem.follows)
        size = float((weights.gain * np.abs(rates.inner) / most).max())
        gain = weights.gain / max(1.0, size)
        acceleration: FloatArray = gain * rates.rate - weights.damping * (
            qd - gain * rates.gradient
        )
        return acceleration

    return _follow(problem, desired)


def braking_time(problem: PathProblem) -> float:
    """Compute the time before the end at which self-motion begins to die out [s]."""
    whole = (problem.instants - 1) * problem.step
    return max(ACCELERATION.braking * whole, min(ACCELERATION.least_braking, 0.5 * whole))


def stoppable(problem: PathProblem) -> FloatArray:
    """Compute the largest self-motion speeds that can die out [rad/s], shape (n,).

    In the braking time t, a speed v (remaining / t)³ starts with its largest acceleration 3 v / t and jerk 6 v / t².
    """
    t, limits = braking_time(problem), problem.limits
    return np.minimum(
        limits.acceleration * t / ACCELERATION.order,
        limits.jerk * np.square(t) / (ACCELERATION.order * (ACCELERATION.order - 1.0)),
    )


def follow_min_acceleration(problem: PathProblem) -> PathMotion | NoPath:
    """Follow by least accelerations within all limits.

    [Zhang2024] Eq. 9 without gradient.
    """
    return _follow(problem, lambda _, qd: np.zeros_like(qd))


DesiredAcceleration = Callable[[FloatArray, FloatArray], FloatArray]
"""Function that returns desired accelerations (n,) from screws (n, 6) and velocities (n,)."""


def _follow(problem: PathProblem, desired: DesiredAcceleration) -> PathMotion | NoPath:
    step = AccelerationStep(problem, desired)
    q, qd = np.array(problem.start), np.zeros(len(problem.start))
    position = np.empty((problem.instants, len(q)))
    position[0], h = q, problem.step
    acceleration = np.zeros_like(q)
    for k in range(1, problem.instants):
        try:
            solution = step.solve(q, qd, acceleration, k - 1)
        except SingularMatrixError:
            return NoPath(Refusal("tools_stop", data={"also": singular_there(problem, q)}), k)
        if solution is None:
            also = [*_not_held(problem, q), *singular_there(problem, q)]
            return NoPath(Refusal("accelerations_stop", data={"also": also}), k, np.inf)
        acceleration, correction = solution
        # Feedback reduces the tools' errors; this removes the rest from the result, not from the state.
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
    holding_torque = np.abs(problem.dynamics(q, np.zeros_like(q))[1])
    fraction = np.where(
        problem.free, holding_torque / (problem.torque * ACCELERATION.torque_share), 0.0
    )
    joint = int(np.argmax(fraction))
    if fraction[joint] <= 1.0:
        return []
    measured, allowed = float(holding_torque[joint]), float(problem.torque[joint])
    data = {"joint": problem.limits.joints[joint]}
    return [Refusal("posture_not_held", measured=measured, allowed=allowed, data=data)]


class AccelerationStep:
    """Quadratic program of one instant, set up once."""

    def __init__(self, problem: PathProblem, desired: DesiredAcceleration) -> None:
        """Prepare the solver."""
        self._problem, self._desired = problem, desired
        self._bounds, self._braking = Bounds.of(problem), braking_time(problem)
        self._velocity, self._acceleration = problem.twists()
        self._free = np.flatnonzero(problem.free)
        self._follows = np.flatnonzero(problem.follows)
        self._jerk = problem.limits.jerk * (problem.step * ACCELERATION.jerk_share)
        self._program = LeastSquares()

    def solve(
        self, q: FloatArray, qd: FloatArray, before: FloatArray, k: int
    ) -> tuple[FloatArray, FloatArray] | None:
        """Solve the step to the next instant.

        None if no accelerations are within bounds.

        It consists of accelerations [rad/s²] and a correction of the joints [rad], each (n,).

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
        remaining = (problem.instants - 1 - k) * problem.step
        desired = (
            self._braking_acceleration(J, qd, remaining)
            if remaining < self._braking
            else self._desired(state.S, qd)
        )
        low, high = self._bounds.at(q, qd)
        least = np.maximum(low, before - self._jerk)
        most = np.minimum(high, before + self._jerk)
        # Limits of acceleration win over those of jerk.
        crossed = least > most
        least[crossed] = most[crossed] = np.clip(before, low, high)[crossed]
        accelerations = np.zeros_like(q)
        rows, torques = J[:, free], self._torques(q, qd)
        solution = self._program.solve(desired[free], rows, A, least[free], most[free], torques)
        if solution is None:
            # Without the jerk limits, which the curve through the instants has to keep anyway.
            solution = self._program.solve(desired[free], rows, A, low[free], high[free], torques)
        if solution is None:
            return None
        accelerations[free] = solution
        return accelerations, self._towards(J, error)

    def correction(self, q: FloatArray, k: int) -> FloatArray:
        """Compute the joint correction [rad], (n,), that removes the tools' error at an instant."""
        problem, which = self._problem, self._follows
        state = problem.body.at(q)
        error = pose_error(problem.R[k], problem.p[k], state.R[which], state.p[which])
        return self._towards(state.J[problem.rows], error)

    def _towards(self, J: FloatArray, error: FloatArray) -> FloatArray:
        correction = np.zeros(J.shape[1])
        J_free = J[:, self._free]
        correction[self._free] = product(J_free.T, solve(product(J_free, J_free.T), error))
        return correction

    def _braking_acceleration(self, J: FloatArray, qd: FloatArray, remaining: float) -> FloatArray:
        """Compute accelerations under which self-motion ends with the path, shape (n,)."""
        inner = qd - product(J.T, solve(product(J, J.T), product(J, qd)))
        return -ACCELERATION.order / max(remaining, self._problem.step) * inner

    def _torques(
        self, q: FloatArray, qd: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray] | None:
        """Compute matrix and bounds of torques as rows over the free joints, or None."""
        problem = self._problem
        if not problem.torque_in_method or problem.torque is None or problem.dynamics is None:
            return None
        mass, bias = problem.dynamics(q, qd)
        free, limit = self._free, problem.torque
        limit = limit * ACCELERATION.torque_share
        return mass[np.ix_(free, free)], (-limit - bias)[free], (limit - bias)[free]
