"""All real zeros of trigonometric polynomials, each enclosed before it is computed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.geometry.roots import second_order_zeros, zeros_by_companion

TOUCH = 1e-14
"""Value at an extremum, relative to the largest coefficient, that counts as a zero of even order."""
ONE_ZERO = 1e-2
"""Touching points nearer than this are one zero of higher order [rad]."""
ITERATIONS = 100
"""Newton or bisection steps at most; bisection alone needs 53."""


@dataclass(frozen=True)
class RealZeros:
    """Real zeros of n trigonometric polynomials of order k, at most 2k each."""

    angle: FloatArray
    """Zeros in (-pi, pi], ascending [rad], shape (n, 2k); 0 where there is none."""
    exists: BoolArray
    """Which entries are zeros, shape (n, 2k)."""
    everywhere: BoolArray
    """Polynomials that vanish identically, which have no zeros to list, shape (n,)."""


def real_zeros(coefficients: FloatArray) -> RealZeros:
    """Returns all real zeros of trigonometric polynomials of order one, two or three.

    Between neighbouring zeros of its derivative a function is monotone, so that a change of sign there encloses
    exactly one zero. A zero of the derivative that is missed is a double one, at which the function goes on
    in its direction; one too many (the real part of a complex one) splits an interval in two. Neither loses a
    zero, however near a double zero the polynomial is. A double zero is listed once.

    Args:
        coefficients: of 1, cos, sin, cos 2, sin 2, ..., finite, shape (n, 2k + 1).
    """
    n, width = coefficients.shape
    scale = np.abs(coefficients).max(axis=1, initial=0.0)
    # Subnormal coefficients would lose their digits when divided: they count as zero.
    everywhere = scale < np.finfo(np.float64).tiny
    unit = (
        np.where(everywhere[:, None], 0.0, coefficients) / np.where(everywhere, 1.0, scale)[:, None]
    )
    split = _wrapped(_derivative_zeros(unit))
    split.sort(axis=1)
    value = polynomial_value(unit, split)
    touching = (np.abs(value) <= TOUCH) & ~everywhere[:, None]
    gap = np.roll(split, -1, axis=1) - split
    gap[:, -1] += 2.0 * np.pi
    # Of touching neighbours the last stands for all.
    listed = touching & ~(np.roll(touching, -1, axis=1) & (gap < ONE_ZERO))
    sign = np.where(touching, 0.0, np.sign(value))
    crossing = sign * np.roll(sign, -1, axis=1) < 0
    row, column = np.nonzero(crossing)
    after = np.roll(value, -1, axis=1)[row, column]
    ends = (split[row, column], gap[row, column], value[row, column], after)
    angle = split.copy()
    angle[row, column] = _enclosed_zeros(np.ascontiguousarray(unit[row].T), *ends)
    exists = crossing | listed
    angle = np.where(exists, _wrapped(angle), np.inf)
    order = np.argsort(angle, axis=1, kind="stable")
    exists = np.take_along_axis(exists, order, axis=1)
    angle = np.take_along_axis(angle, order, axis=1)
    return RealZeros(np.where(exists, angle, 0.0).reshape(n, width - 1), exists, everywhere)


def polynomial_value(coefficients: FloatArray, angle: FloatArray) -> FloatArray:
    """Returns f0 + f1 cos + f2 sin + f3 cos 2 + ... at angles [rad] (n, m), shape (n, m)."""
    return _value_and_slope(coefficients.T[:, :, None], angle)[0]


def _value_and_slope(columns: FloatArray, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Returns a polynomial and its derivative; coefficients come first, (2k + 1, ...)."""
    cos, sin = np.cos(angle), np.sin(angle)
    value = columns[0] + columns[1] * cos + columns[2] * sin
    slope = columns[2] * cos - columns[1] * sin
    c, s = cos, sin
    for order in range(2, len(columns) // 2 + 1):
        c, s = c * cos - s * sin, s * cos + c * sin
        a, b = columns[2 * order - 1], columns[2 * order]
        value += a * c + b * s
        slope += order * (b * c - a * s)
    return value, slope


def derivative(coefficients: FloatArray) -> FloatArray:
    """Returns the coefficients of the derivative by the angle, of the same shape."""
    slope = np.zeros_like(coefficients)
    order = np.arange(1, coefficients.shape[1] // 2 + 1)
    slope[:, 1::2] = order * coefficients[:, 2::2]
    slope[:, 2::2] = -order * coefficients[:, 1::2]
    return slope


def _derivative_zeros(coefficients: FloatArray) -> FloatArray:
    """Returns angles among which are all simple real zeros of the derivative, shape (n, 2k)."""
    slope = derivative(coefficients)
    k = coefficients.shape[1] // 2
    if k == 1:
        top = np.arctan2(coefficients[:, 2], coefficients[:, 1])
        return np.column_stack([top, top + np.pi])
    return (second_order_zeros if k == 2 else zeros_by_companion)(slope)[0]


def _wrapped(angle: FloatArray) -> FloatArray:
    """Returns angles in (-pi, pi], unchanged where they are there already."""
    turned = angle - 2.0 * np.pi * np.round(angle / (2.0 * np.pi))
    return np.where(turned <= -np.pi, np.pi, turned)


def _enclosed_zeros(
    columns: FloatArray, low: FloatArray, gap: FloatArray, before: FloatArray, after: FloatArray
) -> FloatArray:
    """Returns the one zero in each (low, low + gap), whose ends are extrema of opposite signs.

    Newton's method from the zero of the half wave through both ends; where a step leaves the enclosure
    or does not halve the one before, bisection.

    Args:
        columns: coefficients, shape (2k + 1, m).
        low: lower ends [rad], shape (m,).
        gap: lengths [rad], shape (m,).
        before: values at the lower ends, shape (m,).
        after: values at the upper ends, shape (m,).
    """
    high, sign, last = low + gap, np.sign(before), gap
    angle = low + gap * np.arccos(-(before + after) / (before - after)) / np.pi
    zero, active = angle.copy(), np.arange(len(angle))
    for _ in range(ITERATIONS):
        if active.size == 0:
            break
        f, df = _value_and_slope(columns, angle)
        left = f * sign > 0.0
        low, high = np.where(left, angle, low), np.where(left, high, angle)
        newton = -f / np.where(df == 0.0, np.inf, df)
        inside = (angle + newton >= low) & (angle + newton <= high) & (df != 0.0)
        use = (f == 0.0) | (inside & (2.0 * np.abs(newton) <= last))
        step = np.where(use, newton, (low + high) / 2.0 - angle)
        angle, size = angle + step, np.abs(step)
        zero[active] = angle
        # Newton's errors square: the next step is about size³ / last².
        done = (size <= 4e-16) | (use & (size**3 <= 1e-17 * last * last) & (last < 0.1))
        last = size
        if done.any():
            on = np.flatnonzero(~done)
            active, columns = active[on], columns[:, on]
            angle, last, low, high, sign = (a[on] for a in (angle, last, low, high, sign))
    return zero
