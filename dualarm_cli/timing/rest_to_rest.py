"""Least time from rest to rest under velocity, acceleration and jerk limits, in closed form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, readonly


@dataclass(frozen=True)
class RestToRest:
    """The double-S law of n joints, its constants computed once.

    With v, a, j the limits (j may be infinite: a trapezoid), a joint that reaches its speed limit needs
    d/v + t_v, with t_v = v/a + a/j where the acceleration limit is reached on the way (v j >= a²) and 2 sqrt(v/j)
    where it is not. Shorter ways reach a peak speed w < v: with the acceleration limit, w (w/a + a/j) = d; without,
    four jerk phases of (d / 2j)^(1/3). Source: [Biagiotti2008] §3.4; the case distinction by distance is ours.
    """

    velocity: FloatArray
    """Largest speed [rad/s], shape (n,)."""
    acceleration: FloatArray
    """Largest acceleration [rad/s²], shape (n,)."""
    jerk: FloatArray
    """Largest jerk [rad/s³] or infinity, shape (n,)."""

    def __post_init__(self) -> None:
        """Freezes the arrays and computes the constants."""
        for name in ("velocity", "acceleration", "jerk"):
            object.__setattr__(self, name, readonly(getattr(self, name)))
        v, a, j = self.velocity, self.acceleration, self.jerk
        ramp = a / j
        reaches_a = v * j >= a * a
        t_v = np.where(reaches_a, v / a + ramp, 2.0 * np.sqrt(v / j))
        constants = {
            "_ramp": ramp,
            "_t_v": t_v,
            # From this distance on the speed limit is reached.
            "_d_v": v * t_v,
            # Up to this distance not even the acceleration limit is.
            "_d_a": np.where(reaches_a, 2.0 * a * ramp * ramp, np.inf),
        }
        for name, value in constants.items():
            object.__setattr__(self, name, readonly(value))

    _ramp: FloatArray = None  # type: ignore[assignment]
    _t_v: FloatArray = None  # type: ignore[assignment]
    _d_v: FloatArray = None  # type: ignore[assignment]
    _d_a: FloatArray = None  # type: ignore[assignment]

    def per_joint(self, distance: FloatArray) -> FloatArray:
        """Returns each joint's least time [s], shape (..., n), for displacements [rad], (..., n)."""
        d = np.abs(distance)
        a, ramp = self.acceleration, self._ramp
        half = 0.5 * a * ramp
        short = np.cbrt(32.0 * d / self.jerk)
        # Peak speed of a way that reaches the acceleration limit: the positive root of
        # w²/a + w a/j = d.
        medium = 2.0 * ((np.sqrt(half * half + a * d) - half) / a + ramp)
        time = np.where(d <= self._d_a, short, medium)
        return np.where(d >= self._d_v, d / self.velocity + self._t_v, time) * (d > 0)

    def duration(self, distance: FloatArray) -> FloatArray:
        """Returns the time of the slowest joint [s], shape (...), for displacements (..., n)."""
        slowest: FloatArray = self.per_joint(distance).max(axis=-1)
        return slowest


def rest_to_rest_duration(
    distance: FloatArray, velocity: FloatArray, acceleration: FloatArray, jerk: FloatArray
) -> FloatArray:
    """Returns least times [s], shape (..., n); see `RestToRest`.

    Args:
        distance: displacements [rad], shape (..., n).
        velocity: speed limits [rad/s], shape (n,).
        acceleration: acceleration limits [rad/s²], shape (n,).
        jerk: jerk limits [rad/s³], infinite for none, shape (n,).
    """
    return RestToRest(velocity, acceleration, jerk).per_joint(distance)
