"""Interpolation between samples as in robot controllers: linear, cubic or quintic."""

from __future__ import annotations

from typing import Literal

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.elementary import cube, power
from dualarm_cli.records import dataclass

Interpolation = Literal["linear", "cubic", "quintic"]
"""Interpolation of a receiver: of positions, of velocities as well, or of accelerations as well."""
INTERPOLATIONS: tuple[Interpolation, ...] = ("linear", "cubic", "quintic")
_BISECTIONS = 60


@dataclass(frozen=True)
class PiecewisePolynomial:
    """Motion of n joints, a polynomial of degree d on each piece."""

    time: FloatArray
    """Borders of the k pieces, rising [s], shape (k + 1,)."""
    coefficients: FloatArray
    """Coefficients by piece and power, lowest first, shape (k, d + 1, n)."""

    def derivatives(self, time: FloatArray) -> FloatArray:
        """Evaluate the motion and all its derivatives, shape (m, d + 1, n).

        At the border of two pieces the later one counts. Before the start and after the end the motion stays there.

        Args:
            time: instants [s], shape (m,).
        """
        time = np.clip(time, self.time[0], self.time[-1])
        last = len(self.coefficients) - 1
        index = np.clip(np.searchsorted(self.time, time, side="right") - 1, 0, last)
        dt = (time - self.time[index])[:, None]
        rows = self.coefficients[index]
        values = np.empty_like(rows)
        for order in range(rows.shape[1]):
            values[:, order] = _horner(rows, dt)
            powers = np.arange(1, rows.shape[1])
            rows = rows[:, 1:] * powers[:, None]
            if rows.shape[1] == 0:
                break
        return values

    def extrema(self) -> tuple[FloatArray, FloatArray]:
        """Compute the minimum and maximum of every joint over all pieces, each (n,)."""
        low, high = extrema(self.coefficients, np.diff(self.time))
        return low.min(axis=0), high.max(axis=0)

    def peak(self, order: int) -> FloatArray | None:
        """Compute the largest magnitude of a derivative over all pieces, shape (n,).

        None if a lower derivative jumps. Linear pieces jump in their first derivative, cubic ones in their second,
        quintic ones in their third.

        Args:
            order: of the derivative, from 1.
        """
        rows = self.coefficients
        if order > rows.shape[1] // 2:
            return None
        for _ in range(order):
            rows = rows[:, 1:] * np.arange(1, rows.shape[1])[:, None]
        low, high = extrema(rows, np.diff(self.time))
        return np.maximum(-low, high).max(axis=0)


def interpolated(
    kind: Interpolation,
    time: FloatArray,
    position: FloatArray,
    velocity: FloatArray | None = None,
    acceleration: FloatArray | None = None,
) -> PiecewisePolynomial:
    """Interpolate samples of a motion.

    Cubic and quintic pieces are Hermite's: they have the samples' derivatives at both ends, as the
    joint_trajectory_controller of ros2_control computes them.

    Args:
        kind: linear uses positions; cubic velocities as well; quintic accelerations as well.
        time: of the samples, rising [s], shape (k,) with k > 1.
        position: shape (k, n).
        velocity: shape (k, n).
        acceleration: shape (k, n).

    Raises:
        ValueError: a derivative is missing that the interpolation needs.
    """
    h = np.diff(time)[:, None]
    q, travel = position[:-1], np.diff(position, axis=0)
    if kind == "linear":
        return PiecewisePolynomial(time, np.stack([q, travel / h], axis=1))
    if velocity is None:
        raise ValueError(f"{kind} interpolation needs velocities")
    v, w = velocity[:-1], velocity[1:]
    if kind == "cubic":
        rows = [
            q,
            v,
            (3.0 * travel / h - 2.0 * v - w) / h,
            (v + w - 2.0 * travel / h) / np.square(h),
        ]
        return PiecewisePolynomial(time, np.stack(rows, axis=1))
    if acceleration is None:
        raise ValueError("quintic interpolation needs accelerations")
    a, b = acceleration[:-1], acceleration[1:]
    rows = [
        q,
        v,
        a / 2.0,
        (10.0 * travel / h - 4.0 * w - 6.0 * v) / np.square(h) - (3.0 * a - b) / (2.0 * h),
        (7.0 * w + 8.0 * v - 15.0 * travel / h) / cube(h)
        + (3.0 * a - 2.0 * b) / (2.0 * np.square(h)),
        (6.0 * travel / h - 3.0 * (v + w)) / power(h, 4) + (b - a) / (2.0 * cube(h)),
    ]
    return PiecewisePolynomial(time, np.stack(rows, axis=1))


def extrema(coefficients: FloatArray, length: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Compute the minimum and maximum of polynomials, each over [0, length].

    Args:
        coefficients: of powers, lowest first, shape (m, d + 1, n).
        length: shape (m,), not negative.

    Returns:
        Two arrays (m, n).
    """
    powers = power(length[:, None], np.arange(coefficients.shape[1]))
    # Polynomials over [0, 1], one row for each joint.
    m, _, n = coefficients.shape
    scaled = (coefficients * powers[:, :, None]).transpose(0, 2, 1).reshape(m * n, -1)
    slope = scaled[:, 1:] * np.arange(1, scaled.shape[1])
    inside = _zeros(slope) if slope.shape[1] > 1 else np.ones((m * n, 0))
    ends = np.ones((m * n, 1))
    values = _values(scaled, np.concatenate([0.0 * ends, inside, ends], axis=1))
    return values.min(axis=1).reshape(m, n), values.max(axis=1).reshape(m, n)


def _zeros(c: FloatArray) -> FloatArray:
    """Bisect the sign changes of polynomials in [0, 1], shape (m, d).

    Rows with fewer than d sign changes are filled with 1. Between neighbouring zeros of its derivative a polynomial
    is monotone, so that a change of sign encloses a single zero.
    """
    count, terms = c.shape
    ends = np.ones((count, 1))
    slope = c[:, 1:] * np.arange(1, terms)
    inner = _zeros(slope) if terms > 2 else np.ones((count, 0))
    edges = np.sort(np.concatenate([0.0 * ends, inner, ends], axis=1), axis=1)
    low, high = edges[:, :-1].copy(), edges[:, 1:].copy()
    at_low = _values(c, low)
    changes = at_low * _values(c, high) < 0.0
    rows = np.flatnonzero(changes.any(axis=1))
    c, a, b, sign = c[rows], low[rows], high[rows], at_low[rows]
    for _ in range(_BISECTIONS):
        middle = 0.5 * (a + b)
        same = _values(c, middle) * sign > 0.0
        a, b = np.where(same, middle, a), np.where(same, b, middle)
    zeros = np.ones_like(low)
    zeros[rows] = np.where(changes[rows], b, 1.0)
    return zeros


def _values(c: FloatArray, u: FloatArray) -> FloatArray:
    """Evaluate polynomials (m, d + 1) at points (m, p) each."""
    value = np.zeros_like(u)
    for k in range(c.shape[1] - 1, -1, -1):
        value = value * u + c[:, k : k + 1]
    return value


def _horner(rows: FloatArray, dt: FloatArray) -> FloatArray:
    """Evaluate each polynomial (m, d + 1, n) at a point (m, 1)."""
    value = np.zeros_like(rows[:, 0])
    for k in range(rows.shape[1] - 1, -1, -1):
        value = value * dt + rows[:, k]
    return value
