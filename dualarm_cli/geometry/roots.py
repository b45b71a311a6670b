"""Zeros of trigonometric polynomials, for many of them at once."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray

_CHARTS = np.arange(6) * (np.pi / 3)
"""Angles of which the one with the largest value becomes the point at infinity."""


def first_order_zeros(
    f0: FloatArray, f1: FloatArray, f2: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Returns the zeros of f0 + f1 cos + f2 sin: angles [rad] (n, 2) and which exist (n, 2).

    Written with atan2 and acos, so that no coefficient is a special case. A row without cos and sin has no
    zeros (or only zeros) and gives none.
    """
    amplitude = np.hypot(f1, f2)
    ratio = -f0 / np.where(amplitude > 0, amplitude, 1.0)
    exists = (amplitude > 0) & (np.abs(ratio) <= 1.0)
    middle, half = np.arctan2(f2, f1), np.arccos(np.clip(ratio, -1.0, 1.0))
    angle = np.where(exists[:, None], np.column_stack([middle - half, middle + half]), 0.0)
    return angle, np.column_stack([exists, exists])


def second_order_zeros(coefficients: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Returns the four zeros of f0 + f1 cos + f2 sin + f3 cos 2 + f4 sin 2 of many rows.

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
        + np.cos(_CHARTS)[:, None] * f1
        + np.sin(_CHARTS)[:, None] * f2
        + np.cos(2 * _CHARTS)[:, None] * f3
        + np.sin(2 * _CHARTS)[:, None] * f4
    )
    infinity = _CHARTS[np.argmax(np.abs(values), axis=0)]
    # Turned by chart = infinity + pi: cos and sin of first order change their sign.
    c, s = np.cos(infinity), np.sin(infinity)
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
    return 2.0 * np.arctan(t) + (infinity + np.pi)[:, None], imaginary / (1.0 + t * t)


def _quartic_zeros(
    b: FloatArray, c: FloatArray, d: FloatArray, e: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Returns real and imaginary parts (n, 4) of the zeros of t⁴ + b t³ + c t² + d t + e."""
    shift = b / 4.0
    b2 = shift * shift
    p = c - 6.0 * b2
    q = d - 2.0 * c * shift + 8.0 * b2 * shift
    r = e - d * shift + c * b2 - 3.0 * b2 * b2
    m = _largest_cubic_zero(2.0 * p, p * p - 4.0 * r, -q * q)
    m = np.maximum(m, 0.0)
    a = np.sqrt(m)
    w = np.sqrt(np.maximum((m + p) ** 2 - 4.0 * r, 0.0)) * np.where(q < 0, -1.0, 1.0)
    first = _quadratic_zeros(a, (p + m - w) / 2.0)
    second = _quadratic_zeros(-a, (p + m + w) / 2.0)
    real = np.column_stack([first[0], first[1], second[0], second[1]])
    imaginary = np.column_stack([first[2], first[2], second[2], second[2]])
    return real - shift[:, None], imaginary


def _largest_cubic_zero(a: FloatArray, b: FloatArray, c: FloatArray) -> FloatArray:
    """Returns the largest real zero of m³ + a m² + b m + c, polished by Newton steps."""
    third = a / 3.0
    p = b / 3.0 - third * third
    q = third * third * third - third * b / 2.0 + c / 2.0
    discriminant = q * q + p * p * p
    root_p = np.sqrt(np.maximum(-p, 0.0))
    # Three real zeros: the largest has the smallest angle.
    ratio = -q / np.where(root_p > 0, root_p**3, 1.0)
    three = 2.0 * root_p * np.cos(np.arccos(np.clip(ratio, -1.0, 1.0)) / 3.0)
    u = np.cbrt(np.abs(q) + np.sqrt(np.maximum(discriminant, 0.0))) * np.where(q < 0, 1.0, -1.0)
    one = u - p / np.where(u == 0.0, 1.0, u)
    m = np.where(discriminant < 0, three, one) - third
    for _ in range(2):
        slope = (3.0 * m + 2.0 * a) * m + b
        value = ((m + a) * m + b) * m + c
        step = value / np.where(slope == 0.0, 1.0, slope)
        # Near a double zero the slope is noise: a step that is not small is not taken.
        m = np.where(np.abs(step) < 1e-3 * (1.0 + np.abs(m)), m - step, m)
    return m


def _quadratic_zeros(b: FloatArray, c: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns the zeros of y² + b y + c: both real parts, and the imaginary part of a pair."""
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


def zeros_by_companion(laurent: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Returns zeros of real trigonometric polynomials of any order k, by eigenvalues.

    Slower than a closed form and safe for every row: the polynomial is turned per row so that its
    leading coefficient is not small, then solved in t by batched companion matrices.

    Args:
        laurent: cosine and sine coefficients f0, f1, f2, ..., shape (n, 2k + 1), as cos 1, sin 1, cos 2, ...

    Returns:
        Angles [rad], shape (n, 2k), and imaginary parts of t relative to 1 + |t|², shape (n, 2k).
    """
    n, width = laurent.shape
    k = width // 2
    orders = np.arange(1, k + 1)
    charts = np.arange(2 * k + 2) * (2.0 * np.pi / (2 * k + 2))
    cos, sin = np.cos(charts[:, None] * orders), np.sin(charts[:, None] * orders)
    values = laurent[:, :1] + laurent[:, 1::2] @ cos.T + laurent[:, 2::2] @ sin.T
    infinity = charts[np.argmax(np.abs(values), axis=1)]
    turn = (infinity + np.pi)[:, None] * orders
    g_cos = laurent[:, 1::2] * np.cos(turn) + laurent[:, 2::2] * np.sin(turn)
    g_sin = laurent[:, 2::2] * np.cos(turn) - laurent[:, 1::2] * np.sin(turn)
    polynomial = _half_angle_basis(k) @ np.hstack([laurent[:, :1], g_cos, g_sin]).T
    lead = polynomial[-1]
    flat = np.abs(lead) <= 1e-300
    monic = (polynomial[:-1] / np.where(flat, 1.0, lead)).T
    matrix = np.zeros((n, 2 * k, 2 * k))
    matrix[:, np.arange(1, 2 * k), np.arange(2 * k - 1)] = 1.0
    matrix[:, :, -1] = -np.where(flat[:, None], 1.0, monic)
    t = np.linalg.eigvals(matrix)
    angle = 2.0 * np.arctan(t.real) + (infinity + np.pi)[:, None]
    return angle, np.abs(t.imag) / (1.0 + np.abs(t) ** 2)


def _half_angle_basis(k: int) -> FloatArray:
    """Returns the matrix from (f0, cos 1..k, sin 1..k) to coefficients of t^0..t^2k.

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
