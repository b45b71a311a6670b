"""Zeros of trigonometric polynomials: closed forms for batches, and enclosed real zeros."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry import elementary
from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.geometry.elementary import TURN
from dualarm_cli.geometry.linear_systems import zeros_of
from dualarm_cli.geometry.products import product
from dualarm_cli.records import dataclass

_CHARTS = np.arange(6) * (np.pi / 3)
"""Candidate angles for the point at infinity [rad]; the largest value decides."""


def first_order_zeros(
    f0: FloatArray, f1: FloatArray, f2: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Compute the zeros of f0 + f1 cos + f2 sin.

    Returns angles [rad], shape (n, 2), and a mask of those that exist, shape (n, 2).
    Written with atan2 and acos, so that no coefficient is a special case. A row without cos and sin has no
    zeros (or only zeros) and gives none.
    """
    amplitude = np.hypot(f1, f2)
    ratio = -f0 / np.where(amplitude > 0, amplitude, 1.0)
    exists = (amplitude > 0) & (np.abs(ratio) <= 1.0)
    middle, half = elementary.arctan2(f2, f1), elementary.arccos(np.clip(ratio, -1.0, 1.0))
    angle = np.where(exists[:, None], np.column_stack([middle - half, middle + half]), 0.0)
    return angle, np.column_stack([exists, exists])


def second_order_zeros(coefficients: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Compute the four zeros of second-order trigonometric polynomials.

    With t = tan((phi - chart)/2) the polynomial becomes a real quartic; the chart of each row is turned so that its
    leading coefficient, the value opposite the chart, is large. The depressed quartic y⁴ + p y² + q y + r is split
    into (y² + a y + b)(y² - a y + d) by the largest root m = a² of its resolvent cubic, in the form that
    stays exact for q = 0: q/a = ±sqrt((m + p)² - 4 r).

    Args:
        coefficients: f0 to f4, shape (n, 5).

    Returns:
        Real parts as angles [rad], shape (n, 4), and imaginary parts of t, relative to 1 + t², shape (n, 4):
        0 for real zeros. A double zero may come out as a close pair on either side of real.
    """
    f0, f1, f2, f3, f4 = coefficients.T
    values = (
        f0
        + elementary.cos(_CHARTS)[:, None] * f1
        + elementary.sin(_CHARTS)[:, None] * f2
        + elementary.cos(2 * _CHARTS)[:, None] * f3
        + elementary.sin(2 * _CHARTS)[:, None] * f4
    )
    infinity = _CHARTS[np.argmax(np.abs(values), axis=0)]
    # Turned by chart = infinity + pi: cos and sin of first order change their sign.
    c, s = elementary.cos(infinity), elementary.sin(infinity)
    c2, s2 = c * c - s * s, 2.0 * c * s
    g1, g2 = -(f1 * c + f2 * s), -(f2 * c - f1 * s)
    g3, g4 = f3 * c2 + f4 * s2, f4 * c2 - f3 * s2
    lead = f0 - g1 + g3
    lead = np.where(lead == 0.0, 1.0, lead)
    t, imaginary = _quartic_zeros(
        (2.0 * g2 - 4.0 * g4) / lead,
        (2.0 * f0 - 6.0 * g3) / lead,
        (2.0 * g2 + 4.0 * g4) / lead,
        (f0 + g1 + g3) / lead,
    )
    return 2.0 * elementary.arctan(t) + (infinity + np.pi)[:, None], imaginary / (1.0 + t * t)


def _quartic_zeros(
    b: FloatArray, c: FloatArray, d: FloatArray, e: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Compute the zeros of monic quartics: real and imaginary parts, both (n, 4)."""
    shift = b / 4.0
    b2 = shift * shift
    p = c - 6.0 * b2
    q = d - 2.0 * c * shift + 8.0 * b2 * shift
    r = e - d * shift + c * b2 - 3.0 * b2 * b2
    m = _largest_cubic_zero(2.0 * p, p * p - 4.0 * r, -q * q)
    m = np.maximum(m, 0.0)
    a = np.sqrt(m)
    w = np.sqrt(np.maximum(np.square(m + p) - 4.0 * r, 0.0)) * np.where(q < 0, -1.0, 1.0)
    first = _quadratic_zeros(a, (p + m - w) / 2.0)
    second = _quadratic_zeros(-a, (p + m + w) / 2.0)
    real = np.column_stack([first[0], first[1], second[0], second[1]])
    imaginary = np.column_stack([first[2], first[2], second[2], second[2]])
    return real - shift[:, None], imaginary


def _largest_cubic_zero(a: FloatArray, b: FloatArray, c: FloatArray) -> FloatArray:
    """Compute the largest real zero of monic cubics."""
    third = a / 3.0
    p = b / 3.0 - third * third
    q = third * third * third - third * b / 2.0 + c / 2.0
    discriminant = q * q + p * p * p
    root_p = np.sqrt(np.maximum(-p, 0.0))
    # Three real zeros: the largest has the smallest angle.
    ratio = -q / np.where(root_p > 0, elementary.cube(root_p), 1.0)
    trigonometric = (
        2.0 * root_p * elementary.cos(elementary.arccos(np.clip(ratio, -1.0, 1.0)) / 3.0)
    )
    u = elementary.cbrt(np.abs(q) + np.sqrt(np.maximum(discriminant, 0.0))) * np.where(
        q < 0, 1.0, -1.0
    )
    cardano = u - p / np.where(u == 0.0, 1.0, u)
    m = np.where(discriminant < 0, trigonometric, cardano) - third
    for _ in range(2):
        slope = (3.0 * m + 2.0 * a) * m + b
        value = ((m + a) * m + b) * m + c
        step = value / np.where(slope == 0.0, 1.0, slope)
        # Near a double zero the slope is noise: a step that is not small is not taken.
        m = np.where(np.abs(step) < 1e-3 * (1.0 + np.abs(m)), m - step, m)
    return m


def _quadratic_zeros(b: FloatArray, c: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Compute the zeros of y² + b y + c as real and imaginary parts."""
    half = -b / 2.0
    discriminant = half * half - c
    root = np.sqrt(np.abs(discriminant))
    real = discriminant >= 0
    # The larger zero without cancellation; the other from the product.
    large = half + np.where(half < 0, -root, root)
    small = c / np.where(large == 0.0, 1.0, large)
    return (
        np.where(real, large, half),
        np.where(real, np.where(large == 0.0, 0.0, small), half),
        np.where(real, 0.0, root),
    )


def zeros_of_any_order(laurent: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Compute all zeros of real trigonometric polynomials of any order k.

    Slower than a closed form and safe for every row: the polynomial is turned per row so that its
    leading coefficient is not small, then all zeros in t = tan(phi / 2) are computed by Aberth's method.

    Args:
        laurent: cosine and sine coefficients f0, f1, f2, ..., shape (n, 2k + 1), as cos 1, sin 1, cos 2, ...

    Returns:
        Angles [rad], shape (n, 2k), and imaginary parts of t relative to 1 + |t|², shape (n, 2k).
    """
    k = laurent.shape[1] // 2
    orders = np.arange(1, k + 1)
    charts = np.arange(2 * k + 2) * (TURN / (2 * k + 2))
    cos, sin = elementary.cos(charts[:, None] * orders), elementary.sin(charts[:, None] * orders)
    values = laurent[:, :1] + product(laurent[:, 1::2], cos.T) + product(laurent[:, 2::2], sin.T)
    infinity = charts[np.argmax(np.abs(values), axis=1)]
    turn = (infinity + np.pi)[:, None] * orders
    g_cos = laurent[:, 1::2] * elementary.cos(turn) + laurent[:, 2::2] * elementary.sin(turn)
    g_sin = laurent[:, 2::2] * elementary.cos(turn) - laurent[:, 1::2] * elementary.sin(turn)
    polynomial = product(_half_angle_basis(k), np.hstack([laurent[:, :1], g_cos, g_sin]).T)
    lead = polynomial[-1]
    flat = np.abs(lead) <= 1e-300
    monic = (polynomial[:-1] / np.where(flat, 1.0, lead)).T
    real, imaginary = zeros_of(np.where(flat[:, None], 1.0, monic))
    angle = 2.0 * elementary.arctan(real) + (infinity + np.pi)[:, None]
    return angle, np.abs(imaginary) / (1.0 + (real * real + imaginary * imaginary))


def _half_angle_basis(k: int) -> FloatArray:
    """Build the matrix from (f0, cos 1..k, sin 1..k) to coefficients of t^0..t^2k.

    (1 + t²)^k cos(m phi) and sin(m phi) are the real and imaginary parts of (1 + i t)^2m (1 + t²)^(k-m).
    """
    from numpy.polynomial import polynomial as P

    square = np.array([1.0, 0.0, 1.0])
    columns = [P.polypow(square, k).astype(complex)]
    for part in ("real", "imag"):
        for m in range(1, k + 1):
            wave = P.polypow(np.array([1.0, 1.0j]), 2 * m)
            values = P.polymul(wave, P.polypow(square, k - m)) if k > m else wave
            columns.append(getattr(values, part).astype(complex))
    matrix = np.zeros((2 * k + 1, 2 * k + 1))
    for i, column in enumerate(columns):
        matrix[: len(column), i] = column.real
    return matrix


TOUCH = 1e-14
"""Relative value at an extremum that counts as a zero of even order."""
ONE_ZERO = 1e-2
"""Distance below which touching points are a single zero of higher order [rad]."""
ITERATIONS = 100
"""Maximum number of Newton and bisection steps; bisection alone needs 53."""


@dataclass(frozen=True)
class RealZeros:
    """Real zeros of n trigonometric polynomials of order k, at most 2k each.

    None where they vanish.
    """

    angle: FloatArray
    """Zeros in (-pi, pi], ascending, padded with 0 [rad], shape (n, 2k)."""
    exists: BoolArray
    """Mask of the entries that are zeros, shape (n, 2k)."""


def real_zeros(coefficients: FloatArray) -> RealZeros:
    """Compute all real zeros of trigonometric polynomials of order 1, 2 or 3.

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
    gap[:, -1] += TURN
    # The last of touching neighbours represents them.
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
    return RealZeros(np.where(exists, angle, 0.0).reshape(n, width - 1), exists)


def polynomial_value(coefficients: FloatArray, angle: FloatArray) -> FloatArray:
    """Evaluate f0 + f1 cos + f2 sin + f3 cos 2 + ...

    At angles [rad], shape (n, m).
    """
    return _value_and_slope(coefficients.T[:, :, None], angle)[0]


def _value_and_slope(columns: FloatArray, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Evaluate a polynomial and its derivative; coefficients come first, (2k + 1, ...)."""
    cos, sin = elementary.cos(angle), elementary.sin(angle)
    value = columns[0] + columns[1] * cos + columns[2] * sin
    slope = columns[2] * cos - columns[1] * sin
    c, s = cos, sin
    for order in range(2, len(columns) // 2 + 1):
        c, s = c * cos - s * sin, s * cos + c * sin
        a, b = columns[2 * order - 1], columns[2 * order]
        value += a * c + b * s
        slope += order * (b * c - a * s)
    return value, slope


def first_order_square(rows: FloatArray) -> FloatArray:
    """Square first-order polynomials (n, 3); the result is of second order, (n, 5)."""
    k, a, b = rows.T
    return np.stack(
        [k * k + 0.5 * (a * a + b * b), 2 * k * a, 2 * k * b, 0.5 * (a * a - b * b), a * b], axis=1
    )


def derivative(coefficients: FloatArray) -> FloatArray:
    """Differentiate polynomials by the angle: coefficients of the same shape."""
    slope = np.zeros_like(coefficients)
    order = np.arange(1, coefficients.shape[1] // 2 + 1)
    slope[:, 1::2] = order * coefficients[:, 2::2]
    slope[:, 2::2] = -order * coefficients[:, 1::2]
    return slope


def _derivative_zeros(coefficients: FloatArray) -> FloatArray:
    """Compute candidates for the real zeros of the derivative [rad], shape (n, 2k).

    All simple real zeros are among them.
    """
    slope = derivative(coefficients)
    k = coefficients.shape[1] // 2
    if k == 1:
        top = elementary.arctan2(coefficients[:, 2], coefficients[:, 1])
        return np.column_stack([top, top + np.pi])
    return (second_order_zeros if k == 2 else zeros_of_any_order)(slope)[0]


def _wrapped(angle: FloatArray) -> FloatArray:
    """Wrap angles to (-pi, pi]; angles in that range keep their bits."""
    turned = angle - TURN * np.round(angle / TURN)
    return np.where(turned <= -np.pi, np.pi, turned)


def _enclosed_zeros(
    columns: FloatArray, low: FloatArray, gap: FloatArray, before: FloatArray, after: FloatArray
) -> FloatArray:
    """Compute the zero in each interval whose ends are extrema of opposite signs.

    Newton's method starts at the zero of the half wave through both ends. A step that leaves the enclosure or does
    not halve the previous step is replaced by bisection.

    Args:
        columns: coefficients, shape (2k + 1, m).
        low: lower ends [rad], shape (m,).
        gap: lengths [rad], shape (m,).
        before: values at the lower ends, shape (m,).
        after: values at the upper ends, shape (m,).
    """
    high, sign, last = low + gap, np.sign(before), gap
    angle = low + gap * elementary.arccos(-(before + after) / (before - after)) / np.pi
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
        done = (size <= 4e-16) | (
            use & (elementary.cube(size) <= 1e-17 * last * last) & (last < 0.1)
        )
        last = size
        if done.any():
            remaining = np.flatnonzero(~done)
            active, columns = active[remaining], columns[:, remaining]
            angle, last, low, high, sign = (a[remaining] for a in (angle, last, low, high, sign))
    return zero
