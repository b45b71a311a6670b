"""Transfers by ruckig: jerk-limited, time-synchronised, state to state."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from dualarm_cli.compiled import trajectories
from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.geometry.elementary import cube
from dualarm_cli.geometry.linear_systems import least_squares
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.records import dataclass
from dualarm_cli.timing import double_s
from dualarm_cli.timing.composition import hold
from dualarm_cli.timing.double_s import PHASES, Phases, transfer_trajectory
from dualarm_cli.timing.problem import TransferProblem


@dataclass(frozen=True)
class TransferTolerances:
    """Tolerances of transfers by ruckig."""

    same_duration: float = 1e-9
    """Relative difference below which durations are equal."""
    same_position: float = 1e-10
    """Largest position error of a joint at ruckig's goal [rad]; its own is 1e-8."""
    same_limit: float = 1e-10
    """Relative excess of an acceleration limit by rounding; ruckig's may be 6e-9."""
    same_rate: float = 1e-9
    """Largest velocity error of a joint at ruckig's goal [rad/s]."""
    same_end: float = 1e-12
    """Largest error at the goal of a transfer in motion [s, rad, rad/s, rad/s²]."""
    corrections: int = 5
    """Maximum number of corrections of a joint's phases in a transfer in motion."""
    shortest_phase: float = 1e-6
    """Longest phase that makes a profile unusable [s].

    Knots a nanosecond apart are merged.
    """


TOLERANCES = TransferTolerances()


def solve_transfer(problem: TransferProblem) -> Trajectory:
    """Time a transfer: minimum time of the slowest joint, or the minimum duration.

    Intermediate waypoints are never given to ruckig: its community edition would send them to a service on
    the network. The knots are ruckig's own switching times, so that nothing is lost by sampling.

    Joints keep their full acceleration and jerk and cruise more slowly. Where that makes a phase as short as
    rounding (1e-12 rad in a second), or ruckig exceeds a limit or fails, as it sometimes does
    if a joint takes a thousand seconds, the joint's closed form is slowed down instead.
    """
    limits = problem.limits
    moving = np.flatnonzero(problem.start != problem.goal).astype(np.int64)
    if moving.size == 0:
        return hold(problem.joints, problem.start, problem.minimum_duration)
    law = limits.law
    duration = max(float(law.duration(problem.goal - problem.start)), problem.minimum_duration)
    profiles = _calculate(problem, moving, duration)
    phases = np.zeros((3, len(problem.joints), PHASES))
    if len(profiles) < moving.size:
        slowed = double_s.fastest_phases(problem.goal - problem.start, law).slowed(duration)
        phases[:] = slowed.duration, slowed.acceleration, slowed.jerk
    for joint, profile in profiles.items():
        phases[:, joint] = profile.t, profile.a[:PHASES], profile.j
    return transfer_trajectory(problem, Phases(*phases), duration)


def solve_moving_transfer(problem: TransferProblem) -> Trajectory | None:
    """Time a transfer that begins or ends in motion; None if ruckig has no usable one.

    Its duration is the shortest in which all joints can arrive together, or the minimum duration.

    Args:
        problem: the transfer.
    """
    transfer = MovingTransfer(problem)
    trajectory, limits = transfer.calculated(*problem.rates()), problem.limits
    if trajectory is None or not transfer.is_within(trajectory):
        return None
    leaving, arriving = problem.rates()
    ends = np.stack([np.vstack([problem.start, leaving]), np.vstack([problem.goal, arriving])])
    rows = []
    for k, profile in enumerate(trajectory.profiles[0]):
        if profile.brake.duration != 0.0 or profile.accel.duration != 0.0:
            return None
        if _is_usable(profile, ends[1, :, k], limits.acceleration[k]):
            rows.append(np.array([profile.t, profile.a[:PHASES], profile.j]))
            continue
        joint = _corrected(profile, ends[:, :, k], float(trajectory.duration))
        if joint is None or not transfer.is_kept(joint, ends[0, :, k], k):
            joint = _even(ends[:, :, k], float(trajectory.duration))
            if not transfer.is_kept(joint, ends[0, :, k], k):
                return None
        rows.append(joint)
    phases = Phases(*np.moveaxis(np.array(rows), 1, 0))
    return transfer_trajectory(problem, phases, float(trajectory.duration))


def _is_usable(profile: Any, goal: FloatArray, acceleration: float) -> bool:
    """Check that a profile has no short phase, reaches its goal and keeps its limit."""
    return bool(
        all(t == 0.0 or t > TOLERANCES.shortest_phase for t in profile.t)
        and abs(profile.p[-1] - goal[0]) <= TOLERANCES.same_position
        and abs(profile.v[-1] - goal[1]) <= TOLERANCES.same_rate
        and max(map(abs, profile.a)) <= acceleration * (1.0 + TOLERANCES.same_limit)
    )


def _corrected(profile: Any, ends: FloatArray, duration: float) -> FloatArray | None:
    """Correct a joint's phases to reach its goal, shape (3, 7); None if impossible.

    The rows are lengths, accelerations and jerks.

    Ruckig ends up to 1e-8 rad from the goal and has phases as short as rounding. Those are removed, and the lengths
    of the others are corrected by Newton's method. Ramps to the acceleration limit are not changed.

    Args:
        profile: profile of ruckig.
        ends: position, velocity, acceleration at the start and at the end, shape (2, 3).
        duration: duration of the transfer [s].
    """
    time, jerk = np.array(profile.t), np.array(profile.j)
    time[time <= TOLERANCES.shortest_phase] = 0.0
    free = time > 0.0
    for limited, ramp in ((1, 0), (5, 6)):
        free[ramp] &= time[limited] == 0.0
    for _ in range(TOLERANCES.corrections):
        q, v, a = _states(time, jerk, ends[0])
        errors = np.array([duration - time.sum(), *(ends[1] - [q[-1], v[-1], a[-1]])])
        if (np.abs(errors) <= TOLERANCES.same_end).all():
            return np.stack([time, a[:-1], jerk])
        remaining = time.sum() - np.cumsum(time)
        # Derivatives of the end state by the length of each phase.
        sensitivities = np.stack(
            [
                np.ones(PHASES),
                v[1:] + remaining * (a[1:] + remaining * jerk / 2.0),
                a[1:] + remaining * jerk,
                jerk,
            ]
        )
        time[free] += least_squares(sensitivities[:, free], errors)
        if time.min() < 0.0:
            return None
    return None


def _even(ends: FloatArray, duration: float) -> FloatArray:
    """Compute a joint's motion in three phases of equal length and constant jerk.

    It suits a joint that has time to spare, above all one that moves only by rounding: ruckig's phases for it
    are as short as rounding. The three jerks follow from position, velocity and acceleration at the end.

    Args:
        ends: position, velocity, acceleration at the start and at the end, shape (2, 3).
        duration: duration of the transfer [s].

    Returns:
        Lengths, accelerations at the starts and jerks of seven phases, the last four without length, shape (3, 7).
    """
    (q, v, a), (q_end, v_end, a_end) = ends.tolist()
    step = duration / 3.0
    # Required changes of the end state by the jerks, in powers of the step.
    delta_q = (q_end - q - duration * (v + duration * a / 2.0)) / cube(step)
    delta_v = (v_end - v - duration * a) / np.square(step)
    delta_a = (a_end - a) / step
    first = delta_q - delta_v + delta_a / 3.0
    jerk = [first, delta_v - delta_a / 2.0 - 2.0 * first, 1.5 * delta_a - delta_v + first]
    time, jerks = np.zeros(PHASES), np.zeros(PHASES)
    time[:3], jerks[:3] = step, jerk
    return np.stack([time, _states(time, jerks, ends[0])[2, :PHASES], jerks])


def _states(time: FloatArray, jerk: FloatArray, start: FloatArray) -> FloatArray:
    """Compute position, velocity and acceleration at the borders of phases, shape (3, 8).

    Args:
        time: lengths of the phases [s], shape (7,).
        jerk: jerks in them [rad/s³], shape (7,).
        start: position, velocity, acceleration at the start.
    """
    q, v, a = start.tolist()
    states = [(q, v, a)]
    for dt, j in zip(time.tolist(), jerk.tolist(), strict=True):
        q, v, a = (
            q + dt * (v + dt * (a / 2.0 + dt * j / 6.0)),
            v + dt * (a + dt * j / 2.0),
            a + dt * j,
        )
        states.append((q, v, a))
    return np.array(states).T


State = Sequence[Sequence[float]]
"""Position, velocity and acceleration, a list of n numbers each."""


class StatesToStates:
    """Repeated transfers of some joints between states of motion."""

    def __init__(self, limits: JointLimits, minimum_duration: float = 0.0) -> None:
        """Prepare the request.

        Args:
            limits: limits of the joints; position limits are ignored.
            minimum_duration: minimum duration of a transfer [s].
        """
        import ruckig

        n = len(limits.joints)
        self._request = ruckig.InputParameter(n)
        self._request.max_velocity = limits.velocity.tolist()
        self._request.max_acceleration = limits.acceleration.tolist()
        self._request.max_jerk = limits.jerk.tolist()
        if minimum_duration > 0.0:
            self._request.minimum_duration = minimum_duration
        self._solver = ruckig.Ruckig(n)
        self._answer = ruckig.Trajectory(n)
        self._good = (ruckig.Result.Working, ruckig.Result.Finished)
        self._errors = (ruckig.RuckigError, ValueError)

    def calculated(self, start: State, goal: State) -> Any:
        """Compute ruckig's trajectory or None; it is valid until the next call."""
        request = self._request
        (
            request.current_position,
            request.current_velocity,
            request.current_acceleration,
        ) = start
        request.target_position, request.target_velocity, request.target_acceleration = goal
        try:
            result = self._solver.calculate(request, self._answer)
        except self._errors:
            # ValueError: result codes that are missing in its Python binding.
            return None
        return self._answer if result in self._good else None


class MovingTransfer:
    """Repeated transfers between two postures with given rates."""

    def __init__(self, problem: TransferProblem, room: float = 0.0) -> None:
        """Prepare the request.

        Args:
            problem: the transfer; its rates are ignored.
            room: margin to position limits [rad], if both ends keep it.
        """
        limits = problem.limits
        self._limits = limits
        self._start, self._goal = problem.start.tolist(), problem.goal.tolist()
        self._transfers = StatesToStates(limits, problem.minimum_duration)
        # If an end is outside by rounding, the transfer may stay there, and rates of rounding may continue outwards.
        ends = np.stack([problem.start, problem.goal])
        self._lower = np.minimum(limits.lower + room, ends.min(axis=0)) - TOLERANCES.same_end
        self._upper = np.maximum(limits.upper - room, ends.max(axis=0)) + TOLERANCES.same_end

    def calculated(self, leaving: FloatArray, arriving: FloatArray) -> Any:
        """Compute ruckig's trajectory or None; it is valid until the next call.

        Args:
            leaving: rates at the start, shape (2, n).
            arriving: rates at the end, shape (2, n).
        """
        start, goal = (self._start, *leaving.tolist()), (self._goal, *arriving.tolist())
        return self._transfers.calculated(start, goal)

    def duration(self, leaving: FloatArray, arriving: FloatArray, most: float = np.inf) -> float:
        """Compute the duration of the transfer [s], see `calculated`.

        Infinite if no transfer keeps the position limits, or none takes less than `most` [s].
        """
        trajectory = self.calculated(leaving, arriving)
        if trajectory is None or trajectory.duration >= most:
            return np.inf
        return float(trajectory.duration) if self.is_within(trajectory) else np.inf

    def is_within(self, trajectory: Any) -> bool:
        """Check that every joint keeps its position limits.

        Ruckig's own extrema miss some.
        """
        phases = np.array(
            [(p.t, p.p[:PHASES], p.v[:PHASES], p.a[:PHASES], p.j) for p in trajectory.profiles[0]]
        )
        return trajectories.stays_between(phases, self._lower, self._upper)

    def is_kept(self, phases: FloatArray, start: FloatArray, joint: int) -> bool:
        """Check that a joint keeps its limits of position, velocity, acceleration and jerk.

        Args:
            phases: lengths, accelerations and jerks of phases, shape (3, 7).
            start: position, velocity, acceleration at the start.
            joint: index of the joint.
        """
        time, _, jerk = phases
        q, v, a = _states(time, jerk, start)
        reverses = a[:-1] * a[1:] < 0.0
        inner = v[:-1][reverses] - np.square(a[:-1][reverses]) / (2.0 * jerk[reverses])
        factor = 1.0 + TOLERANCES.same_limit
        begins = np.stack([time, q[:-1], v[:-1], a[:-1], jerk])[None]
        return bool(
            np.abs(a).max() <= self._limits.acceleration[joint] * factor
            and np.abs([*v, *inner]).max() <= self._limits.velocity[joint] * factor
            and np.abs(jerk).max() <= self._limits.jerk[joint] * factor
            and trajectories.stays_between(begins, self._lower[[joint]], self._upper[[joint]])
        )


def _calculate(problem: TransferProblem, moving: IntArray, duration: float) -> dict[int, Any]:
    """Compute ruckig's usable profiles by joint, if they take the duration [s], else none."""
    import ruckig

    limits = problem.limits
    request = ruckig.InputParameter(len(moving))
    rest = [0.0] * len(moving)
    request.current_position = problem.start[moving].tolist()
    request.target_position = problem.goal[moving].tolist()
    request.current_velocity = request.target_velocity = rest
    request.current_acceleration = request.target_acceleration = rest
    request.max_velocity = limits.velocity[moving].tolist()
    request.max_acceleration = limits.acceleration[moving].tolist()
    request.max_jerk = limits.jerk[moving].tolist()
    if problem.minimum_duration > 0.0:
        request.minimum_duration = problem.minimum_duration
    trajectory = ruckig.Trajectory(len(moving))
    try:
        result = ruckig.Ruckig(len(moving)).calculate(request, trajectory)
    except (ruckig.RuckigError, ValueError):
        # ValueError: result codes that are missing in its Python binding.
        return {}
    if result not in (ruckig.Result.Working, ruckig.Result.Finished):
        return {}
    if not abs(trajectory.duration - duration) <= TOLERANCES.same_duration * duration:
        return {}
    return {
        k: profile
        for k, profile in zip(moving.tolist(), trajectory.profiles[0], strict=True)
        if all(t == 0.0 or t > TOLERANCES.shortest_phase for t in profile.t)
        and abs(profile.p[-1] - problem.goal[k]) <= TOLERANCES.same_position
        and max(map(abs, profile.a)) <= limits.acceleration[k] * (1.0 + TOLERANCES.same_limit)
    }
