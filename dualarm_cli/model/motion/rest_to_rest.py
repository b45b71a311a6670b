"""Minimum times of joint motions under velocity, acceleration and jerk limits, in closed form.

Times hold between states at rest, and as lower bounds between any states of motion.
"""

from __future__ import annotations

from dataclasses import field
from functools import cached_property, reduce

import numpy as np
from numpy.typing import NDArray

from dualarm_cli.geometry.arrays import FloatArray, readonly
from dualarm_cli.geometry.elementary import cbrt, cube
from dualarm_cli.records import dataclass

TABLE_STEPS = 1 << 13
"""Steps of `RestToRest.reach_table` and `RestToRest.time_table`."""


@dataclass(frozen=True)
class RestToRest:
    """Double-S timing law of n joints, with precomputed constants.

    With v, a, j the limits (j may be infinite: a trapezoid), a joint that reaches its speed limit needs
    d/v + t_v, with t_v = v/a + a/j where the acceleration limit is reached (v j >= a²) and 2 sqrt(v/j)
    where it is not. Shorter distances reach a peak speed w < v: with the acceleration limit, w (w/a + a/j) = d;
    without, four jerk phases of (d / 2j)^(1/3). Source: [Biagiotti2008] §3.4; the case distinction by distance is
    ours.
    """

    velocity: FloatArray
    """Velocity limits [rad/s], shape (n,)."""
    acceleration: FloatArray
    """Acceleration limits [rad/s²], shape (n,)."""
    jerk: FloatArray
    """Jerk limits [rad/s³] or infinity, shape (n,)."""

    def __post_init__(self) -> None:
        """Freeze the arrays and compute the constants."""
        for name in ("velocity", "acceleration", "jerk"):
            object.__setattr__(self, name, readonly(getattr(self, name)))
        v, a, j = self.velocity, self.acceleration, self.jerk
        ramp = a / j
        reaches_a = v * j >= a * a
        t_v = np.where(reaches_a, v / a + ramp, 2.0 * np.sqrt(v / j))
        constants = {
            "_ramp": ramp,
            "_half": 0.5 * a * ramp,
            "_t_v": t_v,
            # From this distance on the speed limit is reached.
            "_d_v": v * t_v,
            # Up to this distance not even the acceleration limit is, or up to this duration.
            "_d_a": np.where(reaches_a, 2.0 * a * ramp * ramp, np.inf),
            "_t_a": np.where(reaches_a, 4.0 * ramp, np.inf),
        }
        for name, value in constants.items():
            object.__setattr__(self, name, readonly(value))

    _ramp: FloatArray = field(init=False, repr=False)
    _half: FloatArray = field(init=False, repr=False)
    _t_v: FloatArray = field(init=False, repr=False)
    _d_v: FloatArray = field(init=False, repr=False)
    _d_a: FloatArray = field(init=False, repr=False)
    _t_a: FloatArray = field(init=False, repr=False)

    def per_joint(self, distance: FloatArray) -> FloatArray:
        """Compute each joint's minimum time [s], shape (..., n), for displacements [rad], (..., n)."""
        d = np.abs(distance)
        a = self.acceleration
        # Peak speed w of a motion that reaches the acceleration limit, 2 (w/a + a/j): the positive
        # root of w²/a + w a/j = d. In place, since this is the inner loop of everything.
        time: FloatArray = d * a
        time += np.square(self._half)
        np.sqrt(time, out=time)
        time -= self._half
        time *= 2.0 / a
        time += 2.0 * self._ramp
        short = d <= self._d_a
        time[short] = cbrt((d * (32.0 / self.jerk))[short])
        np.copyto(time, d / self.velocity + self._t_v, where=d >= self._d_v)
        return time

    def duration(self, distance: FloatArray) -> FloatArray:
        """Compute the time of the slowest joint [s], shape (...), for displacements (..., n)."""
        times = np.moveaxis(self.per_joint(distance), -1, 0)
        # Along rows of seven numpy's maximum takes sixteen times as long as from column to column.
        slowest: FloatArray = reduce(np.maximum, times) if times.size > 512 else times.max(axis=0)
        return slowest

    def reachable_distance(self, duration: FloatArray) -> FloatArray:
        """Compute each joint's largest distance in given times [rad]: the inverse of `per_joint`.

        With the speed limit reached v (T - t_v); with the acceleration limit w T/2 with the peak speed
        w = a (T/2 - a/j); with neither j T³/32.

        Args:
            duration: times T [s], 0 or more, shape (..., n) or (..., 1).
        """
        a, ramp = self.acceleration, self._ramp
        medium = a * np.maximum(0.5 * duration - ramp, 0.0) * 0.5 * duration
        # Where there is no jerk limit the third case has no duration; 0 keeps infinity out.
        jerk = np.where(np.isinf(self.jerk), 0.0, self.jerk)
        distance = np.where(duration <= self._t_a, jerk * cube(duration) / 32.0, medium)
        full = self.velocity * (duration - self._t_v)
        return np.where(duration >= 2.0 * self._t_v, full, distance)

    @cached_property
    def reach_table(self) -> tuple[float, FloatArray]:
        """Time step [s], and the reach after 0, 1, … steps [rad], shape (n, TABLE_STEPS).

        The table covers half a turn of every joint.
        """
        longest = float(self.duration(np.full(len(self.velocity), np.pi)))
        times = np.linspace(0.0, longest, TABLE_STEPS)
        return float(times[1]), readonly(self.reachable_distance(times[:, None]).T)

    @cached_property
    def time_table(self) -> tuple[float, NDArray[np.float32]]:
        """Steps per radian, and minimum times of 0, 1, … steps [s], shape (n, TABLE_STEPS).

        Times are rounded down. The inverse of `reach_table`, up to half a turn.
        """
        step, reach = self.reach_table
        distance = np.arange(TABLE_STEPS) * (np.pi / TABLE_STEPS)
        times = [
            step * (np.searchsorted(joint_reach, distance, side="right") - 1)
            for joint_reach in reach
        ]
        table = np.nextafter(np.array(times, dtype=np.float32), np.float32(0.0))
        table.flags.writeable = False
        return TABLE_STEPS / np.pi, table


def rest_to_rest_duration(
    distance: FloatArray, velocity: FloatArray, acceleration: FloatArray, jerk: FloatArray
) -> FloatArray:
    """Compute minimum times [s], shape (..., n); see `RestToRest`.

    Args:
        distance: displacements [rad], shape (..., n).
        velocity: speed limits [rad/s], shape (n,).
        acceleration: acceleration limits [rad/s²], shape (n,).
        jerk: jerk limits [rad/s³], infinite for none, shape (n,).
    """
    return RestToRest(velocity, acceleration, jerk).per_joint(distance)


AT_ONCE = 1e12
"""Acceleration limit that stands for infinity, per speed limit [1/s]."""


@dataclass(frozen=True)
class PassingLaw(RestToRest):
    """Lower bounds on times between any states of motion, and reachable distances from rest.

    The bound on plans with blending rests on it. Each arm moves through transfer, approach, dwell and retract. Only at
    its target a tool is at rest, with zero joint accelerations. Therefore

    - a transfer takes at least each joint's distance at its full speed, whatever its end velocities; the
      platform, which is at rest at both ends, takes its rest-to-rest time;
    - after a retract of time t that begins at rest, a joint has at most the speed `reachable_speed(t)`, and before an
      approach of that time likewise. Accelerating at no more than a, its transfer takes at least the time between these
      speeds. A retract longer by dt raises the speed by a dt or less, and so shortens the transfer by dt or less:
      retract and transfer together take no less than with the least time of the retract;
    - on a line joint j turns at most D_j(T) in time T after it leaves the target or before it arrives, forth and
      back added up: its acceleration is at most min(a, j t) after a time t, and so its speed at most the integral of
      that, and v;
    - a joint that rises on a retract or transfer and falls on the transfer or approach after it turns back between, at
      a speed of zero and above its position between them. Its whole chain of motions takes at least the sum of
      `chain_times` from rest at a target, or from any motion after the retract, to a turn, between turns, and from the
      last turn to rest at the target, or to any motion before the approach. A joint that does not turn back takes
      at least the time over the sum of its distances. All of these grow with the distance.

    The derivation is ours.
    """

    rest_law: RestToRest
    """Law from rest to rest with the joints' limits."""

    @classmethod
    def of(cls, law: RestToRest) -> PassingLaw:
        """Build the passing law of joints with the limits of a rest-to-rest law."""
        velocity = np.asarray(law.velocity)
        return cls(velocity, AT_ONCE * velocity, np.full_like(velocity, np.inf), law)

    def chain_times(self, distance: FloatArray) -> FloatArray:
        """Compute least times [s] of the motions that chains consist of, shape (5, m, n).

        From rest to a turn, to rest and to any motion; from a turn to any motion and to a turn. Acceleration is a
        throughout from a turn to a turn or to any motion: over the distance d to the latter d/v + v/2a, or sqrt(2 d/a)
        where full speed is not reached.

        Args:
            distance: distances of each joint, ascending [rad], shape (m, n).
        """
        v, a = self.rest_law.velocity, self.rest_law.acceleration
        longest = float((distance[-1] / v).max() + 2.0 * self.rest_law.duration(distance[-1]))
        times = np.linspace(0.0, longest, 8 * TABLE_STEPS)
        reach = self.reachable_distance(times[:, None]).T
        to_any = [
            times[np.maximum(np.searchsorted(joint_reach, d) - 1, 0)]
            for joint_reach, d in zip(reach, distance.T, strict=True)
        ]
        ramp = v / a
        from_turn = np.where(
            distance > 0.5 * v * ramp, distance / v + 0.5 * ramp, np.sqrt(2.0 * distance / a)
        )
        between = np.where(distance > v * ramp, distance / v + ramp, 2.0 * np.sqrt(distance / a))
        at_rest = self.rest_law.per_joint(distance)
        to_turn = self.from_turn(distance)
        return np.stack([to_turn, at_rest, np.stack(to_any, axis=1), from_turn, between])

    @cached_property
    def _from_turn_table(self) -> tuple[FloatArray, FloatArray]:
        """Distances [rad] and least times [s] of `from_turn` by peak speed, shape (TABLE_STEPS, n) each."""
        a, j = self.rest_law.acceleration, self.rest_law.jerk
        peak = self.rest_law.velocity * np.square(np.linspace(0.0, 1.0, TABLE_STEPS))[:, None]
        rise = a / j
        time = np.where(peak >= a * rise, peak / a + rise, 2.0 * np.sqrt(peak / j))
        full = peak > 0.5 * a * rise
        rest = np.where(full, peak - 0.5 * a * rise, 0.0)
        back = np.where(full, peak / a + 0.5 * rise, np.sqrt(2.0 * peak / j))
        longer = peak * rise - a * np.square(rise) / 6.0 + np.square(rest) / (2.0 * a)
        distance_by_peak = 0.5 * peak * time + np.where(full, longer, 2.0 / 3.0 * peak * back)
        return readonly(distance_by_peak), readonly(time + back)

    def from_turn(self, distance: FloatArray) -> FloatArray:
        """Compute least times from speed zero, with any acceleration, to rest [s], shape (m, n).

        With a peak speed w the speed u after a time t, from either end, rises at most at min(a, sqrt(2 j (w - u))), and
        from rest at most at j t as well. That joins a ramp from rest to w and one without its last phase of jerk.

        Args:
            distance: distances [rad], 0 or more, shape (m, n).
        """
        distance_by_peak, time = self._from_turn_table
        result = np.empty(distance.shape)
        for k, x in enumerate(distance.T):
            step = np.searchsorted(distance_by_peak[:, k], x, side="right") - 1
            beyond = np.maximum(x - distance_by_peak[-1, k], 0.0) / self.rest_law.velocity[k]
            result[:, k] = time[step, k] + beyond
        return result

    def reachable_speed(self, duration: FloatArray) -> FloatArray:
        """Compute the greatest speed of each joint after given times from rest [rad/s].

        Args:
            duration: times T [s], 0 or more, shape (..., n) or (..., 1).
        """
        rise, jerk = self._rise
        first = np.minimum(duration, rise)
        speed: FloatArray = np.minimum(
            0.5 * jerk * np.square(first)
            + self.rest_law.acceleration * np.maximum(duration - rise, 0.0),
            self.rest_law.velocity,
        )
        return speed

    @cached_property
    def _rise(self) -> tuple[FloatArray, FloatArray]:
        """Rise time of each joint's acceleration from rest [s], and jerk [rad/s³].

        Both 0 without a jerk limit.
        """
        v, a, limit = self.rest_law.velocity, self.rest_law.acceleration, self.rest_law.jerk
        limited = np.isfinite(limit)
        j = np.where(limited, limit, 1.0)
        rise = np.where(limited, np.minimum(a / j, np.sqrt(2.0 * v / j)), 0.0)
        return rise, np.where(limited, limit, 0.0)

    def reachable_distance(self, duration: FloatArray) -> FloatArray:
        """Compute the largest rotation of each joint in given times from rest [rad].

        Args:
            duration: times T [s], 0 or more, shape (..., n) or (..., 1).
        """
        v, a = self.rest_law.velocity, self.rest_law.acceleration
        rise, jerk = self._rise
        ramp_speed = jerk * np.square(rise) / 2.0
        ramp = np.maximum(v - ramp_speed, 0.0) / a
        first = np.minimum(duration, rise)
        second = np.clip(duration - rise, 0.0, ramp)
        third = np.maximum(duration - rise - ramp, 0.0)
        distance: FloatArray = (
            jerk * cube(first) / 6.0 + second * (ramp_speed + a * second / 2.0) + v * third
        )
        return distance
