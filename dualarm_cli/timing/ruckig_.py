"""Transfers by ruckig: jerk-limited, time-synchronised, state to state."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from dualarm_cli.compiled import trajectories
from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.geometry.elementary import cube
from dualarm_cli.geometry.linear_systems import least_squares
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.records import dataclass
from dualarm_cli.timing import double_s
from dualarm_cli.timing.composition import hold
from dualarm_cli.timing.double_s import PHASES, Phases, transfer_trajectory
from dualarm_cli.timing.problem import TransferProblem


@dataclass(frozen=True)
class TransferTolerances:
    """Differences that count as none in transfers by ruckig."""

    same_duration: float = 1e-9
    """Relative difference up to which ruckig's duration is the closed form's."""
    same_position: float = 1e-10
    """Largest position error of a joint at ruckig's goal [rad]; it promises 1e-8."""
    same_limit: float = 1e-10
    """Share by which ruckig's acceleration may exceed its limit by rounding; now and then it is 6e-9."""
    same_rate: float = 1e-9
    """Largest velocity error of a joint at ruckig's goal [rad/s]."""
    same_end: float = 1e-12
    """Largest error at the goal of a transfer in motion [s, rad, rad/s, rad/s²]."""
    corrections: int = 5
    """Maximum number of corrections of a joint's phases in a transfer in motion."""
    shortest_phase: float = 1e-6
    """Phases that are not longer [s] make a profile unusable: knots a nanosecond apart become one."""


TOLERANCES = TransferTolerances()


def solve_transfer(problem: TransferProblem) -> Trajectory:
    """Returns the transfer: least time of the slowest joint, or the minimum duration.

    Intermediate waypoints are never given to ruckig: its community edition would send them to a service on
    the network. The knots are ruckig's own switching times, so that nothing is lost by sampling.

    Joints keep their full acceleration and jerk and cruise more slowly. Where that makes a phase as short as
    rounding (a way of 1e-12 rad in a second), or ruckig exceeds a limit or fails, which it does now
    and then where a joint has to take a thousand seconds, the joint's closed form is slowed down instead.
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
    """Returns a transfer that begins or ends in motion, None where ruckig has no usable one.

    It takes the least time in which every joint can arrive then, or the minimum duration.

    Args:
        problem: the transfer.
    """
    asked = MovingTransfer(problem)
    trajectory, limits = asked.calculated(*problem.rates()), problem.limits
    if trajectory is None or not asked.is_within(trajectory):
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
        if joint is None or not asked.is_kept(joint, ends[0, :, k], k):
            joint = _even(ends[:, :, k], float(trajectory.duration))
            if not asked.is_kept(joint, ends[0, :, k], k):
                return None
        rows.append(joint)
    phases = Phases(*np.moveaxis(np.array(rows), 1, 0))
    return transfer_trajectory(problem, phases, float(trajectory.duration))


def _is_usable(profile: Any, goal: FloatArray, acceleration: float) -> bool:
    """Returns whether a joint's profile has no phase that is too short, and ends where it has to within its limit."""
    return bool(
        all(t == 0.0 or t > TOLERANCES.shortest_phase for t in profile.t)
        and abs(profile.p[-1] - goal[0]) <= TOLERANCES.same_position
        and abs(profile.v[-1] - goal[1]) <= TOLERANCES.same_rate
        and max(map(abs, profile.a)) <= acceleration * (1.0 + TOLERANCES.same_limit)
    )


def _corrected(profile: Any, ends: FloatArray, duration: float) -> FloatArray | None:
    """Returns lengths, accelerations, jerks of a joint's phases, shape (3, 7), that lead to its end; None for none.

    Ruckig ends up to 1e-8 rad beside the goal and has phases of rounding. Those are left out, and the lengths of the
    others corrected by Newton's method. Lengths that lead to the acceleration limit stay.

    Args:
        profile: ruckig's.
        ends: position, velocity, acceleration at the start and at the end, shape (2, 3).
        duration: of the transfer [s].
    """
    time, jerk = np.array(profile.t), np.array(profile.j)
    time[time <= TOLERANCES.shortest_phase] = 0.0
    free = time > 0.0
    for limited, ramp in ((1, 0), (5, 6)):
        free[ramp] &= time[limited] == 0.0
    for _ in range(TOLERANCES.corrections):
        q, v, a = _states(time, jerk, ends[0])
        missing = np.array([duration - time.sum(), *(ends[1] - [q[-1], v[-1], a[-1]])])
        if (np.abs(missing) <= TOLERANCES.same_end).all():
            return np.stack([time, a[:-1], jerk])
        left = time.sum() - np.cumsum(time)
        # A moment more of a phase, and the same phases after it.
        more = np.stack(
            [
                np.ones(PHASES),
                v[1:] + left * (a[1:] + left * jerk / 2.0),
                a[1:] + left * jerk,
                jerk,
            ]
        )
        time[free] += least_squares(more[:, free], missing)
        if time.min() < 0.0:
            return None
    return None


def _even(ends: FloatArray, duration: float) -> FloatArray:
    """Compute a joint's motion in three phases of equal length and constant jerk.

    It suits a joint that has time to spare. Above all it suits one that rests but for rounding: ruckig's phases for it
    are as short as rounding. The three jerks follow from position, velocity and acceleration at the end.

    Args:
        ends: position, velocity, acceleration at the start and at the end, shape (2, 3).
        duration: of the transfer [s].

    Returns:
        Lengths, accelerations at the starts and jerks of seven phases, the last four without length, shape (3, 7).
    """
    (q, v, a), (q_end, v_end, a_end) = ends.tolist()
    step = duration / 3.0
    # What the jerks have to add at the end, in powers of the step.
    more_q = (q_end - q - duration * (v + duration * a / 2.0)) / cube(step)
    more_v = (v_end - v - duration * a) / np.square(step)
    more_a = (a_end - a) / step
    first = more_q - more_v + more_a / 3.0
    jerk = [first, more_v - more_a / 2.0 - 2.0 * first, 1.5 * more_a - more_v + first]
    time, jerks = np.zeros(PHASES), np.zeros(PHASES)
    time[:3], jerks[:3] = step, jerk
    return np.stack([time, _states(time, jerks, ends[0])[2, :PHASES], jerks])


def _states(time: FloatArray, jerk: FloatArray, start: FloatArray) -> FloatArray:
    """Returns position, velocity, acceleration at the ends of phases, shape (3, 8).

    Args:
        time: lengths of the phases [s], shape (7,).
        jerk: in them [rad/s³], shape (7,).
        start: position, velocity, acceleration before the first one.
    """
    q, v, a = start.tolist()
    found = [(q, v, a)]
    for dt, j in zip(time.tolist(), jerk.tolist(), strict=True):
        q, v, a = (
            q + dt * (v + dt * (a / 2.0 + dt * j / 6.0)),
            v + dt * (a + dt * j / 2.0),
            a + dt * j,
        )
        found.append((q, v, a))
    return np.array(found).T


State = Sequence[Sequence[float]]
"""Positions, velocities and accelerations, a list of n numbers each."""


class StatesToStates:
    """Transfers of some joints from any state of motion to any other, of which many are tried."""

    def __init__(self, limits: JointLimits, minimum_duration: float = 0.0) -> None:
        """Prepares the request.

        Args:
            limits: of the joints; those of position do not count.
            minimum_duration: least time that a transfer may take [s].
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
        """Returns ruckig's trajectory, None where it has none; valid until the next one is asked for."""
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
            # ValueError: result codes that its Python binding does not know.
            return None
        return self._answer if result in self._good else None


class MovingTransfer:
    """Transfers between two postures in given states of motion, of which many are tried."""

    def __init__(self, problem: TransferProblem, room: float = 0.0) -> None:
        """Prepares the request.

        Args:
            problem: the transfer; its rates do not count.
            room: what joints keep free of their limits of position on the way [rad], where both ends do.
        """
        limits = problem.limits
        self._limits = limits
        self._start, self._goal = problem.start.tolist(), problem.goal.tolist()
        self._transfers = StatesToStates(limits, problem.minimum_duration)
        # Where it begins or ends outside by rounding, it may stay there, and rates of rounding may lead it on.
        ends = np.stack([problem.start, problem.goal])
        self._lower = np.minimum(limits.lower + room, ends.min(axis=0)) - TOLERANCES.same_end
        self._upper = np.maximum(limits.upper - room, ends.max(axis=0)) + TOLERANCES.same_end

    def calculated(self, leaving: FloatArray, arriving: FloatArray) -> Any:
        """Returns ruckig's trajectory, None where it has none; valid until the next one is asked for.

        Args:
            leaving: velocities and accelerations at the start, shape (2, n).
            arriving: the same at the end.
        """
        start, goal = (self._start, *leaving.tolist()), (self._goal, *arriving.tolist())
        return self._transfers.calculated(start, goal)

    def duration(self, leaving: FloatArray, arriving: FloatArray, most: float = np.inf) -> float:
        """Returns how long the transfer takes [s], see `calculated`.

        Infinite where there is none within the limits of position, or none that takes less than `most` [s].
        """
        found = self.calculated(leaving, arriving)
        if found is None or found.duration >= most:
            return np.inf
        return float(found.duration) if self.is_within(found) else np.inf

    def is_within(self, trajectory: Any) -> bool:
        """Returns whether every joint keeps its limits of position on the way; ruckig's own extrema miss some."""
        phases = np.array(
            [
                (one.t, one.p[:PHASES], one.v[:PHASES], one.a[:PHASES], one.j)
                for one in trajectory.profiles[0]
            ]
        )
        return trajectories.stays_between(phases, self._lower, self._upper)

    def is_kept(self, phases: FloatArray, start: FloatArray, joint: int) -> bool:
        """Returns whether a joint keeps its limits of position, velocity, acceleration and jerk.

        Args:
            phases: their lengths, accelerations and jerks, shape (3, 7).
            start: position, velocity, acceleration before the first one.
            joint: its index.
        """
        time, _, jerk = phases
        q, v, a = _states(time, jerk, start)
        turns = a[:-1] * a[1:] < 0.0
        inside = v[:-1][turns] - np.square(a[:-1][turns]) / (2.0 * jerk[turns])
        most = 1.0 + TOLERANCES.same_limit
        begins = np.stack([time, q[:-1], v[:-1], a[:-1], jerk])[None]
        return bool(
            np.abs(a).max() <= self._limits.acceleration[joint] * most
            and np.abs([*v, *inside]).max() <= self._limits.velocity[joint] * most
            and np.abs(jerk).max() <= self._limits.jerk[joint] * most
            and trajectories.stays_between(begins, self._lower[[joint]], self._upper[[joint]])
        )


def _calculate(problem: TransferProblem, moving: IntArray, duration: float) -> dict[int, Any]:
    """Returns ruckig's usable profiles by joint, if they take the duration [s], else nothing."""
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
        # ValueError: result codes that its Python binding does not know.
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
