"""Along a joint path at one steady speed, with a ramp at each end."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, readonly


@dataclass(frozen=True)
class PathRates:
    """What the joints do per unit of the share of a path, at equidistant places."""

    first: FloatArray
    """q' [rad], shape (k, n)."""
    second: FloatArray
    """q'' [rad], shape (k, n)."""
    third: FloatArray
    """q''' [rad], shape (k, n)."""

    def __post_init__(self) -> None:
        """Freezes the arrays."""
        for name in ("first", "second", "third"):
            object.__setattr__(self, name, readonly(getattr(self, name)))

    def backwards(self) -> PathRates:
        """Returns the same path from its end."""
        return PathRates(-self.first[::-1], self.second[::-1], -self.third[::-1])

    def at(self, share: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Returns them at shares (...,) of the path, linear between places, each (..., n)."""
        last = len(self.first) - 1
        place = np.clip(share, 0.0, 1.0) * last
        k = np.minimum(place.astype(np.int64), last - 1)
        x = (place - k)[..., None]
        return (
            self.first[k] * (1.0 - x) + self.first[k + 1] * x,
            self.second[k] * (1.0 - x) + self.second[k + 1] * x,
            self.third[k] * (1.0 - x) + self.third[k + 1] * x,
        )


@dataclass(frozen=True)
class Ramp:
    """From rest to a speed: acceleration up, steady, down, the mirror image at the other end."""

    time: float
    """How long it takes [s]."""
    jerk_time: float
    """How long the acceleration takes to rise, and to fall [s]; 0 for a trapezoid."""


@dataclass(frozen=True)
class SteadyProfile:
    """Share of a path over time: a ramp, a steady speed, a ramp."""

    speed: float
    """Steady speed [1/s]."""
    start: Ramp
    """From rest."""
    end: Ramp
    """To rest."""

    @property
    def duration(self) -> float:
        """How long it takes [s]: a ramp covers half of what its time would at full speed."""
        return 1.0 / self.speed + (self.start.time + self.end.time) / 2.0

    def edges(self) -> FloatArray:
        """Returns where phases meet, from 0 to the duration [s], shape (8,)."""
        a, b, T = self.start, self.end, self.duration
        found: FloatArray = np.array(
            [
                0.0,
                a.jerk_time,
                a.time - a.jerk_time,
                a.time,
                T - b.time,
                T - b.time + b.jerk_time,
                T - b.jerk_time,
                T,
            ]
        )
        return found

    def at(self, time: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Returns share, speed [1/s] and acceleration [1/s²] at instants (k,) [s]."""
        first = ramp_at(np.minimum(time, self.start.time), self.speed, self.start)
        last = ramp_at(np.minimum(self.duration - time, self.end.time), self.speed, self.end)
        steady = np.clip(
            time - self.start.time, 0.0, self.duration - self.start.time - self.end.time
        )
        covered = self.speed * self.end.time / 2.0
        share = first[0] + self.speed * steady + np.maximum(covered - last[0], 0.0)
        ending = time > self.duration - self.end.time
        speed = np.where(ending, last[1], first[1])
        acceleration = np.where(ending, -last[2], np.where(time < self.start.time, first[2], 0.0))
        return np.clip(share, 0.0, 1.0), speed, acceleration


def ramp_at(
    time: FloatArray, speed: float, ramp: Ramp
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns share, speed and acceleration after times in a ramp from rest; after its end nothing more is covered.

    With the acceleration a = v / (T - x) reached in x: a t²/2 x while it rises, then steady, then as at the start
    backwards.
    """
    T, x = ramp.time, ramp.jerk_time
    a = speed / (T - x)
    t = np.clip(time, 0.0, T)
    left = T - t
    safe = np.where(np.asarray(x) > 0.0, x, 1.0)
    rising, falling = t < x, left < x
    first = a * t**3 / (6.0 * safe)
    middle = a * (t**2 / 2.0 - x * t / 2.0 + x**2 / 6.0)
    last = speed * T / 2.0 - speed * left + a * left**3 / (6.0 * safe)
    share = np.where(rising, first, np.where(falling, last, middle))
    speeds = np.where(
        rising,
        a * t**2 / (2.0 * safe),
        np.where(falling, speed - a * left**2 / (2.0 * safe), a * (t - x / 2.0)),
    )
    accelerations = np.where(rising, a * t / safe, np.where(falling, a * left / safe, a))
    return share, speeds, accelerations
