"""Exactly equal elbow displacements, in closed form; where there are none, the exact best."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

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

CHUNK = 4096
"""Moves solved at a time: their arrays stay in the processor's cache."""
NEARLY_REAL = 1e-3
"""Imaginary part up to which a zero of the squared equation may stand for a real one: where its two branches
nearly touch, rounding makes a complex pair of them. The unsquared equation decides."""
NEWTON_STEPS = 3
"""Steps on the unsquared equation from each zero of the squared one."""
ROOT_TOLERANCE = 1e-10
"""Largest difference of displacements at a root [rad]."""
FALSE_ROOT = 0.05
"""Difference of displacements beyond which a zero of the squared equation is none of the unsquared [rad]."""
STIFF = 1e-7
"""Sine of an elbow angle below which an arm counts as stretched or folded."""
SAME_ROOT = 1e-8
"""Roots nearer than this are one [rad]."""
FALLBACKS = 4
"""Stationary points and reach boundaries kept for a move without a reachable root, best balanced first."""
ROOT_KINDS = np.repeat(np.array([Kind.ROOT_SAME, Kind.ROOT_OPPOSITE], dtype=np.int64), 4)
FALLBACK_KINDS = np.repeat(
    np.array([Kind.STATIONARY_SAME, Kind.STATIONARY_OPPOSITE, Kind.BOUNDARY], dtype=np.int64),
    [6, 6, 8],
)


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
    chunks = [_solve_chunk(problem.rows(slice(k, k + CHUNK))) for k in range(0, max(n, 1), CHUNK)]
    if len(chunks) == 1:
        return chunks[0]
    width = max(chunk.angle.shape[1] for chunk in chunks)

    def joined(name: str) -> Any:
        return np.concatenate([_widened(getattr(chunk, name), width) for chunk in chunks])

    return PlatformSolution(
        problem,
        angle=joined("angle"),
        kind=joined("kind"),
        valid=joined("valid"),
        reachable=joined("reachable"),
        delta=joined("delta"),
        degenerate=np.concatenate([chunk.degenerate for chunk in chunks]),
        balanced_first=True,
    )


def _widened(values: FloatArray, width: int) -> FloatArray:
    """Returns values with columns of zeros added up to a width."""
    wide = np.zeros((len(values), width, *values.shape[2:]), dtype=values.dtype)
    wide[:, : values.shape[1]] = values
    return wide


def _solve_chunk(problem: PlatformProblem) -> PlatformSolution:
    """Returns the candidates of a few thousand moves."""
    coefficients = cosine_coefficients(problem)
    roots = build_solution(problem, *_roots(problem, coefficients), balanced_first=True)
    u, swing = coefficients[..., 0], np.hypot(coefficients[..., 1], coefficients[..., 2])
    # An arm that no platform angle brings within reach makes every search for one idle.
    in_reach = (np.abs(u) - swing <= 1.0).all(axis=1)
    missing = np.flatnonzero(~roots.reachable.any(axis=1) & in_reach)
    if missing.size == 0:
        return roots
    rest = build_solution(
        problem.rows(missing), *_fallbacks(coefficients[missing]), balanced_first=True
    )
    best = rest.order[:, :FALLBACKS]
    wide: dict[str, Any] = {}
    for name in ("angle", "kind", "valid", "reachable", "delta"):
        values = getattr(roots, name)
        more = np.zeros((len(values), FALLBACKS, *values.shape[2:]), dtype=values.dtype)
        found = getattr(rest, name)
        index = best.reshape(best.shape + (1,) * (found.ndim - 2))
        more[missing] = np.take_along_axis(found, index, axis=1)
        wide[name] = np.concatenate([values, more], axis=1)
    return replace(roots, **wide)


def _roots(
    problem: PlatformProblem, coefficients: FloatArray
) -> tuple[FloatArray, IntArray, BoolArray]:
    """Returns the zeros for s = +1 (four columns) and s = -1, their kinds, and which are roots."""
    angles, valid = [], []
    for sign in (1.0, -1.0):
        target = problem.elbow_0[:, 0] - sign * problem.elbow_0[:, 1]
        angle, imaginary = second_order_zeros(_squared(coefficients, target))
        angle, true = _polish(coefficients, angle, imaginary <= NEARLY_REAL, sign, target)
        angles.append(angle)
        valid.append(_distinct(angle, true))
    return np.hstack(angles), ROOT_KINDS, np.hstack(valid)


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
    coefficients: FloatArray, angle: FloatArray, real: BoolArray, sign: float, target: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Returns angles after Newton steps on q4_1 - s q4_2 = K, and whether they solve it.

    Only zeros that are real and nearly solve it are worked on: most do not.
    """
    solved = np.zeros(angle.shape, dtype=np.bool_)
    row, column = np.nonzero(real)
    phi = angle[row, column]
    arms = coefficients[row]
    for step in range(NEWTON_STEPS + 1):
        c, s = np.cos(phi), np.sin(phi)
        difference, change = -target[row], np.zeros(len(row))
        inside, stiff = np.ones(len(row), dtype=np.bool_), np.zeros(len(row), dtype=np.bool_)
        for arm, weight in ((0, 1.0), (1, -sign)):
            u, v, w = arms[:, arm].T
            x = u + v * c + w * s
            inside &= np.abs(x) <= 1.0 + 1e-12
            x = np.clip(x, -1.0, 1.0)
            difference += weight * np.arccos(x)
            sine = np.sqrt((1.0 - x) * (1.0 + x))
            stiff |= sine <= STIFF
            change += weight * (v * s - w * c) / np.maximum(sine, STIFF)
        if step == NEWTON_STEPS:
            break
        keep = np.flatnonzero(np.abs(difference) < FALSE_ROOT)
        row, column, phi, arms = row[keep], column[keep], phi[keep], arms[keep]
        change, stiff = change[keep], stiff[keep]
        move = -difference[keep] / np.where(np.abs(change) > 1e-9, change, np.inf)
        # A step that is not small would leave the zero it is meant to polish; where an arm is stretched
        # the slope is infinite and the zero stays as it is.
        phi = np.where((np.abs(move) < FALSE_ROOT) & ~stiff, phi + move, phi)
    angle = angle.copy()
    angle[row, column] = phi
    solved[row, column] = (np.abs(difference) <= ROOT_TOLERANCE) & inside
    return angle, solved


def _distinct(angle: FloatArray, valid: BoolArray) -> BoolArray:
    """Returns which roots are valid and not equal to one before them."""
    valid = valid.copy()
    for k in range(1, angle.shape[1]):
        for i in range(k):
            turn = np.mod(angle[:, k] - angle[:, i] + np.pi, 2.0 * np.pi) - np.pi
            valid[:, k] &= ~(valid[:, i] & (np.abs(turn) < SAME_ROOT))
    return valid


def _fallbacks(coefficients: FloatArray) -> tuple[FloatArray, IntArray, BoolArray]:
    """Returns stationary points of both signs and reach boundaries: angles, kinds, validity."""
    zeros, imaginary = zeros_by_companion(_stationary_polynomial(coefficients))
    real = imaginary <= NEARLY_REAL
    u, v, w = (coefficients[..., i][:, :, None] for i in range(3))
    c, s = np.cos(zeros)[:, None], np.sin(zeros)[:, None]
    x = u + v * c + w * s
    slope = (w * c - v * s) * np.sqrt(np.clip(1.0 - x[:, ::-1] ** 2, 0.0, None))
    same = slope[:, 0] * slope[:, 1] >= 0
    angles, valid = [zeros, zeros], [real & same, real & ~same]
    for arm in (0, 1):
        for limit in (1.0, -1.0):
            u_i, v_i, w_i = coefficients[:, arm].T
            # A hair inside, so that rounding does not put the candidate out of reach.
            boundary, exists = first_order_zeros(u_i - limit * (1.0 - 1e-12), v_i, w_i)
            angles.append(boundary)
            valid.append(exists)
    return np.hstack(angles), FALLBACK_KINDS, np.hstack(valid)


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
