"""Exactly equal elbow displacements, in closed form; where there are none, the exact best."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.geometry.roots import first_order_zeros, second_order_zeros, zeros_by_companion
from dualarm_cli.platform_angle.problem import (
    Kind,
    PlatformProblem,
    PlatformSolution,
    build_solution,
    cosine_coefficients,
)

CHUNK = 8192
"""Moves solved at a time: their arrays stay in the processor's cache."""
NEARLY_REAL = 1e-3
"""Imaginary part up to which a zero of the squared equation may stand for a real one: where its two branches
nearly touch, rounding makes a complex pair of them. The unsquared equation decides."""
NEWTON_STEPS = 3
"""Steps on the unsquared equation from each zero of the squared one."""
ROOT_TOLERANCE = 1e-10
"""Largest difference of displacements at a root [rad]."""
SAME_ROOT = 1e-8
"""Roots nearer than this are one [rad]."""
ROOT_KINDS = np.repeat(np.array([Kind.ROOT_SAME, Kind.ROOT_OPPOSITE], dtype=np.int64), 4)


def solve_exact(problem: PlatformProblem) -> PlatformSolution:
    """Returns all angles at which the elbows move equally; where there is none, what is nearest.

    With K = q4_1,0 - s q4_2,0 and s = ±1 we want q4_1 - s q4_2 = K. The cosine of both sides, the root squared away:

        x_1² + x_2² - 2 cos(K) x_1 x_2 - sin²(K) = 0,

    a trigonometric polynomial of order two in the platform angle, because every x_i is of order one. Its
    zeros (at most four) are polished by Newton steps on the unsquared equation and kept only if they solve it.
    A move without a reachable root gets the stationary points of q4_1 - s q4_2 and the angles at which an arm is
    just stretched or folded, best balanced first. Our own derivation.
    """
    n = len(problem.angle_0)
    roots = [_roots(problem.rows(slice(k, k + CHUNK))) for k in range(0, n, CHUNK)]
    angle = np.vstack([part[0] for part in roots]) if roots else np.zeros((0, 8))
    valid = np.vstack([part[1] for part in roots]) if roots else np.zeros((0, 8), dtype=np.bool_)
    solution = build_solution(problem, angle, ROOT_KINDS, valid)
    missing = np.flatnonzero(~solution.reachable.any(axis=1))
    if missing.size == 0:
        return solution
    more_angle, more_kind, more_valid = _fallbacks(problem.rows(missing))
    width = more_angle.shape[1]
    wide_angle, wide_valid = np.zeros((n, width)), np.zeros((n, width), dtype=np.bool_)
    wide_angle[missing], wide_valid[missing] = more_angle, more_valid
    return build_solution(
        problem,
        np.hstack([angle, wide_angle]),
        np.concatenate([ROOT_KINDS, more_kind]),
        np.hstack([valid, wide_valid]),
        balanced_first=True,
    )


def _roots(problem: PlatformProblem) -> tuple[FloatArray, BoolArray]:
    """Returns the roots for s = +1 (four columns) and s = -1 (four columns), and which are true."""
    coefficients = cosine_coefficients(problem)
    angles, valid = [], []
    for sign in (1.0, -1.0):
        target = problem.elbow_0[:, 0] - sign * problem.elbow_0[:, 1]
        angle, imaginary = second_order_zeros(_squared(coefficients, target))
        angle, true = _polish(coefficients, angle, sign, target)
        true &= imaginary <= NEARLY_REAL
        angle, true = _distinct(angle, true)
        angles.append(angle)
        valid.append(true)
    return np.hstack(angles), np.hstack(valid)


def _squared(coefficients: FloatArray, target: FloatArray) -> FloatArray:
    """Returns f0 to f4 of x_1² + x_2² - 2 cos K x_1 x_2 - sin² K, shape (n, 5)."""
    u1, v1, w1 = coefficients[:, 0].T
    u2, v2, w2 = coefficients[:, 1].T
    c = np.cos(target)

    def form(a1: FloatArray, b1: FloatArray, a2: FloatArray, b2: FloatArray) -> FloatArray:
        """The symmetric bilinear form of the equation."""
        product: FloatArray = a1 * b1 + a2 * b2 - c * (a1 * b2 + a2 * b1)
        return product

    vv, ww = form(v1, v1, v2, v2), form(w1, w1, w2, w2)
    return np.column_stack(
        [
            form(u1, u1, u2, u2) + (vv + ww) / 2.0 - np.sin(target) ** 2,
            2.0 * form(u1, v1, u2, v2),
            2.0 * form(u1, w1, u2, w2),
            (vv - ww) / 2.0,
            form(v1, w1, v2, w2),
        ]
    )


def _polish(
    coefficients: FloatArray, angle: FloatArray, sign: float, target: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Returns angles after Newton steps on q4_1 - s q4_2 = K, and whether they solve it."""
    u, v, w = (coefficients[..., i][:, :, None] for i in range(3))
    for step in range(NEWTON_STEPS + 1):
        c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
        x = u + v * c + w * s
        inside = np.abs(x) <= 1.0 + 1e-12
        x = np.clip(x, -1.0, 1.0)
        q = np.arccos(x)
        difference = q[:, 0] - sign * q[:, 1] - target[:, None]
        if step == NEWTON_STEPS:
            break
        sine = np.sqrt((1.0 - x) * (1.0 + x))
        slope = (v * s - w * c) / np.where(sine > 0, sine, 1.0)
        change = slope[:, 0] - sign * slope[:, 1]
        move = -difference / np.where(np.abs(change) > 1e-9, change, np.inf)
        # A step that is not small would leave the zero it is meant to polish.
        angle = np.where((np.abs(move) < 0.05) & (sine > 1e-7).all(axis=1), angle + move, angle)
    return angle, (np.abs(difference) <= ROOT_TOLERANCE) & inside.all(axis=1)


def _distinct(angle: FloatArray, valid: BoolArray) -> tuple[FloatArray, BoolArray]:
    """Returns the same with all but the first of equal roots taken out."""
    valid = valid.copy()
    for k in range(1, angle.shape[1]):
        for i in range(k):
            turn = np.mod(angle[:, k] - angle[:, i] + np.pi, 2.0 * np.pi) - np.pi
            valid[:, k] &= ~(valid[:, i] & (np.abs(turn) < SAME_ROOT))
    return angle, valid


def _fallbacks(problem: PlatformProblem) -> tuple[FloatArray, IntArray, BoolArray]:
    """Returns stationary points of both signs and reach boundaries: angles, kinds, validity."""
    coefficients = cosine_coefficients(problem)
    zeros, imaginary = zeros_by_companion(_stationary_polynomial(coefficients))
    real = imaginary <= NEARLY_REAL
    u, v, w = (coefficients[..., i][:, :, None] for i in range(3))
    c, s = np.cos(zeros)[:, None], np.sin(zeros)[:, None]
    x = u + v * c + w * s
    slope = (w * c - v * s) * np.sqrt(np.clip(1.0 - x[:, ::-1] ** 2, 0.0, None))
    same = slope[:, 0] * slope[:, 1] >= 0
    angles, kinds, valid = [zeros, zeros], [], [real & same, real & ~same]
    kinds += [Kind.STATIONARY_SAME] * zeros.shape[1] + [Kind.STATIONARY_OPPOSITE] * zeros.shape[1]
    for arm in (0, 1):
        for limit in (1.0, -1.0):
            u_i, v_i, w_i = coefficients[:, arm].T
            # A hair inside, so that rounding does not put the candidate out of reach.
            boundary, exists = first_order_zeros(u_i - limit * (1.0 - 1e-12), v_i, w_i)
            angles.append(boundary)
            valid.append(exists)
            kinds += [Kind.BOUNDARY] * 2
    return np.hstack(angles), np.array(kinds, dtype=np.int64), np.hstack(valid)


def _stationary_polynomial(coefficients: FloatArray) -> FloatArray:
    """Returns x_1'² (1 - x_2²) - x_2'² (1 - x_1²), whose order-four parts cancel, shape (n, 7).

    With D = x_1' x_2 - x_1 x_2' (of order one) it is x_1'² - x_2'² - D (x_1' x_2 + x_1 x_2'); columns are
    1, cos, sin, cos 2, sin 2, cos 3, sin 3.
    """
    # Laurent coefficients in z = e^{i phi}: x = (v + i w)/2 z^-1 + u + (v - i w)/2 z.
    u, v, w = (coefficients[..., i] for i in range(3))
    x = np.stack([(v + 1j * w) / 2.0, u + 0j, (v - 1j * w) / 2.0], axis=-1)
    dx = x * np.array([-1j, 0.0, 1j])
    x1, x2, d1, d2 = x[:, 0], x[:, 1], dx[:, 0], dx[:, 1]
    one, other = _product(d1, x2), _product(x1, d2)
    D = (one - other)[:, 1:4]
    f = np.zeros((len(x), 7), dtype=np.complex128)
    f[:, 1:6] = _product(d1, d1) - _product(d2, d2)
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
