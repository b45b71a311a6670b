"""What is nearest to a balance where there is none: stationary points and limits of the reach."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.geometry.real_zeros import real_zeros
from dualarm_cli.platform_angle.problem import REACH_SLACK, Kind
from dualarm_cli.platform_angle.solution import is_degenerate

HAIR = 1e-12
"""How far inside its limit a boundary is put, so that rounding does not put it out of reach."""
FALLBACK_KINDS = np.repeat(
    np.array([Kind.START, Kind.STATIONARY_SAME, Kind.STATIONARY_OPPOSITE, Kind.BOUNDARY]),
    [1, 6, 6, 8],
)


def unbalanced_angles(
    coefficients: FloatArray, angle_0: FloatArray
) -> tuple[FloatArray, IntArray, BoolArray]:
    """Returns candidates for moves without a balance: angles [rad], kinds and validity, (n, 21).

    On every interval of platform angles in which both arms reach, q4_1 - s q4_2 has its extrema at the ends or
    where its derivative vanishes; the candidates are all of these, for both signs. If the angle
    changes no elbow, the start is the one candidate.

    Args:
        coefficients: u, v, w of x_i, shape (n, 2, 3).
        angle_0: platform angle before the move [rad], shape (n,).
    """
    degenerate = is_degenerate(coefficients)
    boundary, exists = _boundaries(coefficients)
    # Both arms reach some angle if they reach an end of one arm's interval, or if there are no ends.
    reached = _reached(coefficients, boundary) & exists
    open_ = _reached(coefficients, np.zeros((len(angle_0), 1)))[:, 0] & ~exists.any(axis=1)
    some = np.flatnonzero((reached.any(axis=1) | open_) & ~degenerate)
    stationary = np.zeros((len(angle_0), 6))
    valid = np.zeros((2, *stationary.shape), dtype=np.bool_)
    if some.size:
        stationary[some], valid[0, some], valid[1, some] = _stationary(coefficients[some])
    return (
        np.hstack([angle_0[:, None], stationary, stationary, boundary]),
        FALLBACK_KINDS,
        np.hstack([degenerate[:, None], valid[0], valid[1], exists & ~degenerate[:, None]]),
    )


def _boundaries(coefficients: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Returns the angles at which an arm is just stretched or folded, shape (n, 8), and which exist.

    An arm that comes within rounding of its limit without passing it has its boundary where it is nearest.
    """
    angles, exist = [], []
    for arm in (0, 1):
        u, v, w = coefficients[:, arm].T
        swing, middle = np.hypot(v, w), np.arctan2(w, v)
        for limit in (1.0 - HAIR, HAIR - 1.0):
            exists = (np.abs(limit - u) <= swing + REACH_SLACK) & (swing > 0.0)
            ratio = np.where(exists, limit - u, 0.0) / np.where(exists, swing, 1.0)
            half = np.arccos(np.clip(ratio, -1.0, 1.0))
            angles += [middle - half, middle + half]
            exist += [exists, exists]
    return np.column_stack(angles), np.column_stack(exist)


def _reached(coefficients: FloatArray, angle: FloatArray) -> BoolArray:
    """Returns whether both arms reach at angles [rad] (n, k), shape (n, k)."""
    u, v, w = (coefficients[:, None, :, k] for k in range(3))
    x = u + v * np.cos(angle)[..., None] + w * np.sin(angle)[..., None]
    return np.asarray((np.abs(x) <= 1.0 + REACH_SLACK).all(axis=-1))


def _stationary(coefficients: FloatArray) -> tuple[FloatArray, BoolArray, BoolArray]:
    """Returns the stationary points of q4_1 - q4_2 and q4_1 + q4_2: angles (n, 6), and whose they are."""
    zeros = real_zeros(stationary_polynomial(coefficients))
    u, v, w = (coefficients[..., k][:, :, None] for k in range(3))
    c, s = np.cos(zeros.angle)[:, None], np.sin(zeros.angle)[:, None]
    x = u + v * c + w * s
    # q4_1' ∓ q4_2' = 0 is x_1' sin q4_2 = ± x_2' sin q4_1.
    slope = (w * c - v * s) * np.sqrt(np.clip(1.0 - x[:, ::-1] ** 2, 0.0, None))
    same = slope[:, 0] * slope[:, 1] >= 0.0
    return zeros.angle, zeros.exists & same, zeros.exists & ~same


def stationary_polynomial(coefficients: FloatArray) -> FloatArray:
    """Returns x_1'² (1 - x_2²) - x_2'² (1 - x_1²), whose order-four parts cancel, shape (n, 7).

    With D = x_1' x_2 - x_1 x_2' (of order one) it is x_1'² - x_2'² - D (x_1' x_2 + x_1 x_2'); columns are
    1, cos, sin, cos 2, sin 2, cos 3, sin 3. Our own derivation.
    """
    # Laurent coefficients in z = e^{i phi}: x = (v + i w)/2 z^-1 + u + (v - i w)/2 z.
    u, v, w = (coefficients[..., i] for i in range(3))
    x = np.stack([(v + 1j * w) / 2.0, u + 0j, (v - 1j * w) / 2.0], axis=-1)
    dx = x * np.array([-1j, 0.0, 1j])
    x1, x2, d1, d2 = x[:, 0], x[:, 1], dx[:, 0], dx[:, 1]
    one, other = _product(d1, x2), _product(x1, d2)
    D = (one - other)[:, 1:4]
    f = np.zeros((len(x), 7), dtype=np.complex128)
    f[:, 1:6] = _product(d1 - d2, d1 + d2)
    f -= _product(D, one + other)
    columns = [f[:, 3].real]
    for k in (1, 2, 3):
        columns += [2.0 * f[:, 3 + k].real, -2.0 * f[:, 3 + k].imag]
    return np.column_stack(columns)


def _product(a: FloatArray, b: FloatArray) -> FloatArray:
    """Returns products of Laurent polynomials, row by row."""
    out = np.zeros((len(a), a.shape[1] + b.shape[1] - 1), dtype=np.complex128)
    for k in range(a.shape[1]):
        out[:, k : k + b.shape[1]] += a[:, k : k + 1] * b
    return out
