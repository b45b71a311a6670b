"""The exact solver: equal elbow displacements in closed form, or else the least imbalance."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.geometry.elementary import arccos, arctan2, complex_product, cos, sin
from dualarm_cli.geometry.roots import real_zeros, second_order_zeros
from dualarm_cli.platform_angle.problem import (
    REACH_SLACK,
    Kind,
    PlatformProblem,
    cosine_coefficients,
)
from dualarm_cli.platform_angle.solution import (
    PlatformSolution,
    build_solution,
    is_degenerate,
    nearest_turn,
)
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class ExactSettings:
    """Tolerances and iterations of exact platform angles."""

    nearly_real: float = 1e-3
    """Imaginary part up to which a zero is tried as a real zero.

    Where the two branches of the squared equation nearly touch, rounding makes a complex pair of its zeros. The
    unsquared equation decides.
    """
    newton_steps: int = 5
    """Maximum number of Newton steps on the unsquared equation from each zero."""
    solved: float = 1e-13
    """Difference of displacements at which a root has converged [rad]."""
    root_tolerance: float = 5e-10
    """Largest difference of displacements at a root [rad]."""
    false_root: float = 0.05
    """Difference of displacements from which a zero is discarded [rad].

    It then belongs to the squared equation only.
    """
    nearly_stretched: float = 1e-3
    """Distance of |x| from 1 below which the squared equation gives the first step."""
    close_pair: float = 1e-3
    """Distance below which two zeros of the squared equation are a pair [rad].

    Both may be nearest to the same zero of the unsquared equation.
    """
    stiff: float = 1e-7
    """Sine of an elbow angle below which an arm counts as stretched or folded."""
    identity: float = 1e-11
    """Coefficient below which a sign's equation counts as true at every angle."""
    fixed_point_steps: int = 4
    """Number of fixed-point steps; each reduces the error by `square` or more."""
    square: float = 1e-4
    """Relative size of h up to which the squared equation is nearly a square.

    Relative to the swing of x_1 - m x_2. The zeros are then nearly double and inaccurate.
    """
    same_root: float = 1e-8
    """Distance below which two roots are the same [rad]."""
    boundary_margin: float = 1e-12
    """Distance of a boundary inside its limit of x.

    Rounding then does not put the boundary out of reach.
    """
    chunk: int = 4096
    """Number of moves in a batch, whose arrays fit the processor's cache."""
    fallbacks: int = 4
    """Number of candidates of a move without a reachable root, least imbalance first."""


EXACT = ExactSettings()


def balanced_angles(
    coefficients: FloatArray, elbow_0: FloatArray, angle_0: FloatArray
) -> tuple[FloatArray, BoolArray, BoolArray]:
    """Compute all angles with equal elbow displacements, four for each sign s.

    Args:
        coefficients: u, v, w of x_i, shape (n, 2, 3).
        elbow_0: elbow angles before the move [rad], shape (n, 2).
        angle_0: platform angle before the move [rad], shape (n,).

    Returns:
        Angles within half a turn of the start [rad], first for s = +1, then for s = -1, and the mask of roots, both of
        shape (n, 8); and the mask of moves for which the equation of a sign is true at every angle, so that the start
        represents all, shape (n,).
    """
    n = len(angle_0)
    sign, start = np.repeat([1.0, -1.0], n), np.tile(angle_0, 2)
    arms = np.tile(coefficients.reshape(n, 6).T, 2)  # u1, v1, w1, u2, v2, w2
    target = np.tile(elbow_0[:, 0], 2) - sign * np.tile(elbow_0[:, 1], 2)
    mirror, half, always = _difference_form(arms, target, sign)
    weight = 4.0 * mirror * half * half
    zeros, imaginary = second_order_zeros(_squared(arms, mirror, weight))
    swing = np.hypot(arms[1] - mirror * arms[4], arms[2] - mirror * arms[5])
    square = np.flatnonzero((np.abs(half) <= EXACT.square * swing) & (mirror == sign))
    if square.size:
        zeros[square, :2], exist = _first_order(arms[:, square], sign[square], half[square])
        imaginary[square] = np.inf
        imaginary[square, :2] = np.where(exist, 0.0, np.inf)
    # If every angle is equal the start represents all, if it is a solution.
    any_angle = always | np.tile(is_degenerate(coefficients), 2)
    zeros[any_angle, 0] = start[any_angle]
    imaginary[any_angle] = [0.0, np.inf, np.inf, np.inf]
    row, column = np.nonzero(imaginary <= EXACT.nearly_real)
    # Each factor of the quartic gives two neighbouring columns: 0 and 1, 2 and 3.
    partner = nearest_turn(zeros - zeros[:, [1, 0, 3, 2]], np.zeros(1))
    split = np.where(np.abs(partner) < EXACT.close_pair, [-1.0, 1.0, -1.0, 1.0], 0.0)[row, column]
    form = np.vstack([arms, sign, target, start, mirror, weight])[:, row]
    rows, phi = _polish(np.vstack([form, split]), zeros[row, column])
    row, column = row[rows], column[rows]
    roots, true = np.zeros_like(zeros), np.zeros(zeros.shape, dtype=np.bool_)
    roots[row, column], true[row, column] = phi, True
    true = _distinct(roots, true)
    return (
        np.hstack([roots[:n], roots[n:]]),
        np.hstack([true[:n], true[n:]]),
        always[:n] | always[n:],
    )


def _difference_form(
    arms: FloatArray, target: FloatArray, sign: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Compute m and h of the squared equation, and the mask of identities.

    With m the sign of cos K and h = sin(K/2) for m = 1, cos(K/2) for m = -1, the squared equation is

        (x_1 - m x_2)² + 4 m h² (x_1 x_2 - m (1 - h²)) = 0.

    Arms with nearly the same motion and start make both terms small, each without cancellation. Where both vanish and
    m = s, q4_1 - s q4_2 is K at every angle.
    """
    mirror = np.where(cos(target) >= 0.0, 1.0, -1.0)
    half = np.where(mirror > 0.0, sin(target / 2.0), cos(target / 2.0))
    gap = np.abs(arms[:3] - mirror * arms[3:]).sum(axis=0)
    identity = (gap <= EXACT.identity) & (np.abs(half) <= EXACT.identity) & (mirror == sign)
    return mirror, half, identity


def _squared(arms: FloatArray, mirror: FloatArray, weight: FloatArray) -> FloatArray:
    """Compute the coefficients f0 to f4 of the squared equation, shape (m, 5)."""
    u1, v1, w1, u2, v2, w2 = arms
    u, v, w = arms[:3] - mirror * arms[3:]
    # m (1 - h²) with h² = m weight / 4
    constant = mirror - weight / 4.0
    rows = np.empty((5, arms.shape[1]))
    rows[0] = u * u + (v * v + w * w) / 2.0
    rows[0] += weight * (u1 * u2 + (v1 * v2 + w1 * w2) / 2.0 - constant)
    rows[1] = 2.0 * u * v + weight * (u1 * v2 + u2 * v1)
    rows[2] = 2.0 * u * w + weight * (u1 * w2 + u2 * w1)
    rows[3] = (v * v - w * w + weight * (v1 * v2 - w1 * w2)) / 2.0
    rows[4] = v * w + weight * (v1 * w2 + w1 * v2) / 2.0
    return rows.T


def _first_order(
    arms: FloatArray, sign: FloatArray, half: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Compute the zeros of nearly square equations, and their mask, (m, 2).

    For s = m sums of cosines as products give the unsquared equation itself,

        x_1 - x_2 = -2 h sin((q4_1 + q4_2) / 2)  or  x_1 + x_2 = 2 h cos((q4_1 - q4_2) / 2),

    whose left side is of first order and whose right side is small and changes little: a fixed point.
    """
    f0, f1, f2 = (row[:, None] for row in arms[:3] - sign * arms[3:])
    swing, middle = np.hypot(f1, f2), arctan2(f2, f1)
    u, v, w = (arms[[k, k + 3]][:, :, None] for k in range(3))
    s, right = sign[:, None], np.zeros((len(half), 2))
    for _ in range(EXACT.fixed_point_steps):
        ratio = (right - f0) / np.where(swing > 0.0, swing, 1.0)
        opening = arccos(np.clip(ratio, -1.0, 1.0))
        phi = middle + opening * [-1.0, 1.0]
        q = arccos(np.clip(u + v * cos(phi) + w * sin(phi), -1.0, 1.0))
        mean = np.where(s > 0.0, -sin((q[0] + q[1]) / 2.0), cos((q[0] - q[1]) / 2.0))
        right = 2.0 * half[:, None] * mean
    # At an extremum the existence of a zero is a matter of rounding: the unsquared equation decides.
    return phi, (np.abs(ratio) <= 1.0 + 1e-9) & (swing > 0.0)


def _polish(form: FloatArray, phi: FloatArray) -> tuple[IntArray, FloatArray]:
    """Refine zeros of the squared equation to solutions of the unsquared one.

    Newton's method on q4_1 - s q4_2 = K. With an arm nearly stretched, or just beyond by rounding, its slope is
    useless: such zeros first take a step on the squared equation, which is smooth.

    Args:
        form: u1, v1, w1, u2, v2, w2, s, K, the start angle, m, 4 m h² and the direction out of a close pair (-1 and 1;
            0 for others) of every zero, shape (12, m).
        phi: the zeros [rad], shape (m,).

    Returns:
        Columns of the zeros that are solutions, and the solutions [rad].
    """
    # Wrapped before it is tested, so that the angle tested last is the angle returned.
    phi = nearest_turn(phi, form[8])
    columns: IntArray = np.arange(len(phi))
    active, true = columns, np.zeros(len(phi), dtype=np.bool_)
    for step in range(EXACT.newton_steps + 1):
        part = form[:, active]
        x, slope, difference = _evaluate(part, phi[active])
        inside = (np.abs(x) <= 1.0 + 1e-12).all(axis=0)
        true[active] = (np.abs(difference) <= EXACT.root_tolerance) & inside
        # Most zeros solve the squared equation only: they are dropped at once.
        size = np.abs(difference)
        candidate = size < EXACT.false_root
        if step == 0:
            stretched: BoolArray = np.asarray(
                (np.abs(x) > 1.0 - EXACT.nearly_stretched).any(axis=0)
            )
            candidate |= stretched
        unsolved = np.flatnonzero((size > EXACT.solved) & candidate)
        if unsolved.size == 0 or step == EXACT.newton_steps:
            break
        active = active[unsolved]
        part, x, slope = part[:, unsolved], x[:, unsolved], slope[:, unsolved]
        move = _newton_step(part, x, slope, difference[unsolved])
        if step == 0:
            from_stretched = np.flatnonzero(stretched[unsolved])
            move[from_stretched] = _squared_step(
                part[:, from_stretched], x[:, from_stretched], slope[:, from_stretched]
            )
        phi[active] = nearest_turn(phi[active] + move, form[8, active])
    return columns[true], phi[true]


def _evaluate(form: FloatArray, phi: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Evaluate x and x' of both arms, (2, m), and the residual [rad], (m,)."""
    c, s = cos(phi), sin(phi)
    # The same sums in the same order as `elbow_cosine`: near a stretched arm the last digit of x matters.
    x = np.stack([form[0] + form[1] * c + form[2] * s, form[3] + form[4] * c + form[5] * s])
    slope = np.stack([form[2] * c - form[1] * s, form[5] * c - form[4] * s])
    q = arccos(np.clip(x, -1.0, 1.0))
    return x, slope, q[0] - form[6] * q[1] - form[7]


def _newton_step(
    form: FloatArray, x: FloatArray, slope: FloatArray, difference: FloatArray
) -> FloatArray:
    """Compute Newton's step on q4_1 - s q4_2 = K [rad].

    Zero where the step is large, and where an arm is stretched, so that the slope is infinite.
    """
    sine = np.sqrt(np.maximum((1.0 - x) * (1.0 + x), 0.0))
    rate = -slope / np.maximum(sine, EXACT.stiff)
    change = rate[0] - form[6] * rate[1]
    move = -difference / np.where(np.abs(change) > 1e-9, change, np.inf)
    valid = (np.abs(move) < EXACT.false_root) & (np.minimum(sine[0], sine[1]) > EXACT.stiff)
    return np.where(valid, move, 0.0)


def _squared_step(form: FloatArray, x: FloatArray, slope: FloatArray) -> FloatArray:
    """Compute steps to a zero of the squared equation's local quadratic [rad].

    To the nearer zero; the members of a close pair go to different zeros. Exact for simple and double zeros; zero
    where the step is large.
    """
    mirror, weight, swing = form[9], form[10], x - form[[0, 3]]
    gap, gap_1 = x[0] - mirror * x[1], slope[0] - mirror * slope[1]
    gap_2 = mirror * swing[1] - swing[0]
    f = gap * gap + weight * (x[0] * x[1] - (mirror - weight / 4.0))
    f1 = 2.0 * gap * gap_1 + weight * (slope[0] * x[1] + x[0] * slope[1])
    f2 = 2.0 * (gap_1 * gap_1 + gap * gap_2)
    f2 += weight * (2.0 * slope[0] * slope[1] - swing[0] * x[1] - x[0] * swing[1])
    root = np.sqrt(np.maximum(f1 * f1 - 2.0 * f * f2, 0.0))
    larger = f1 + np.where(f1 < 0.0, -root, root)
    nearer = -2.0 * f / np.where(larger == 0.0, np.inf, larger)
    separate = (form[11] * root - f1) / np.where(f2 == 0.0, np.inf, f2)
    step = np.where(form[11] == 0.0, nearer, separate)
    return np.where(np.abs(step) < EXACT.false_root, step, 0.0)


def _distinct(angle: FloatArray, valid: BoolArray) -> BoolArray:
    """Select the valid roots that differ from all roots before them."""
    several = np.flatnonzero(valid.sum(axis=1) > 1)
    mask, angle = valid[several], angle[several]
    for k in range(1, angle.shape[1]):
        for i in range(k):
            turn = np.abs(nearest_turn(angle[:, k] - angle[:, i], np.zeros(1)))
            mask[:, k] &= ~(mask[:, i] & (turn < EXACT.same_root))
    valid[several] = mask
    return valid


FALLBACK_KINDS = np.repeat(
    np.array([Kind.START, Kind.STATIONARY_SAME, Kind.STATIONARY_OPPOSITE, Kind.BOUNDARY]),
    [1, 6, 6, 8],
)


def unbalanced_angles(
    coefficients: FloatArray, angle_0: FloatArray
) -> tuple[FloatArray, IntArray, BoolArray]:
    """Compute candidates for moves without a root: angles [rad], kinds, validity, (n, 21).

    On every interval of platform angles in which both arms reach, q4_1 - s q4_2 has its extrema at the ends or at zeros
    of its derivative; the candidates are all of these, for both signs. If the angle changes no elbow, the start is the
    single candidate.

    Args:
        coefficients: u, v, w of x_i, shape (n, 2, 3).
        angle_0: platform angle before the move [rad], shape (n,).
    """
    degenerate = is_degenerate(coefficients)
    boundary, exists = _boundaries(coefficients)
    # Both arms reach an angle if they reach an end of an arm's interval, or if there are no ends.
    reached = _reached(coefficients, boundary) & exists
    unlimited = _reached(coefficients, np.zeros((len(angle_0), 1)))[:, 0] & ~exists.any(axis=1)
    rows = np.flatnonzero((reached.any(axis=1) | unlimited) & ~degenerate)
    stationary = np.zeros((len(angle_0), 6))
    valid = np.zeros((2, *stationary.shape), dtype=np.bool_)
    if rows.size:
        stationary[rows], valid[0, rows], valid[1, rows] = _stationary(coefficients[rows])
    return (
        np.hstack([angle_0[:, None], stationary, stationary, boundary]),
        FALLBACK_KINDS,
        np.hstack([degenerate[:, None], valid[0], valid[1], exists & ~degenerate[:, None]]),
    )


def _boundaries(coefficients: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Compute the boundaries of the arms' reach, and their mask, shape (n, 8).

    An arm that touches its limit within rounding has its boundary at the nearest angle.
    """
    angles, exist = [], []
    for arm in (0, 1):
        u, v, w = coefficients[:, arm].T
        swing, middle = np.hypot(v, w), arctan2(w, v)
        for limit in (1.0 - EXACT.boundary_margin, EXACT.boundary_margin - 1.0):
            exists = (np.abs(limit - u) <= swing + REACH_SLACK) & (swing > 0.0)
            ratio = np.where(exists, limit - u, 0.0) / np.where(exists, swing, 1.0)
            half = arccos(np.clip(ratio, -1.0, 1.0))
            angles += [middle - half, middle + half]
            exist += [exists, exists]
    return np.column_stack(angles), np.column_stack(exist)


def _reached(coefficients: FloatArray, angle: FloatArray) -> BoolArray:
    """Check that both arms reach at angles [rad], shape (n, k)."""
    u, v, w = (coefficients[:, None, :, k] for k in range(3))
    x = u + v * cos(angle)[..., None] + w * sin(angle)[..., None]
    return np.asarray((np.abs(x) <= 1.0 + REACH_SLACK).all(axis=-1))


def _stationary(coefficients: FloatArray) -> tuple[FloatArray, BoolArray, BoolArray]:
    """Compute the stationary points of q4_1 - q4_2 and q4_1 + q4_2.

    Returns angles [rad] and the masks of those of the difference and of the sum, shape (n, 6) each.
    """
    zeros = real_zeros(stationary_polynomial(coefficients))
    u, v, w = (coefficients[..., k][:, :, None] for k in range(3))
    c, s = cos(zeros.angle)[:, None], sin(zeros.angle)[:, None]
    x = u + v * c + w * s
    # q4_1' ∓ q4_2' = 0 is x_1' sin q4_2 = ± x_2' sin q4_1.
    slope = (w * c - v * s) * np.sqrt(np.clip(1.0 - np.square(x[:, ::-1]), 0.0, None))
    same = slope[:, 0] * slope[:, 1] >= 0.0
    return zeros.angle, zeros.exists & same, zeros.exists & ~same


def stationary_polynomial(coefficients: FloatArray) -> FloatArray:
    """Compute the polynomial whose zeros are the stationary points, shape (n, 7).

    It is x_1'² (1 - x_2²) - x_2'² (1 - x_1²), whose parts of order four cancel. With D = x_1' x_2 - x_1 x_2' (of order
    one) it is x_1'² - x_2'² - D (x_1' x_2 + x_1 x_2'); columns are 1, cos, sin, cos 2, sin 2, cos 3, sin 3. Our own
    derivation.
    """
    # Laurent coefficients in z = e^{i phi}: x = (v + i w)/2 z^-1 + u + (v - i w)/2 z.
    u, v, w = (coefficients[..., i] for i in range(3))
    x = np.stack([(v + 1j * w) / 2.0, u + 0j, (v - 1j * w) / 2.0], axis=-1)
    dx = x * np.array([-1j, 0.0, 1j])
    x1, x2, d1, d2 = x[:, 0], x[:, 1], dx[:, 0], dx[:, 1]
    first, second = _product(d1, x2), _product(x1, d2)
    D = (first - second)[:, 1:4]
    f = np.zeros((len(x), 7), dtype=np.complex128)
    f[:, 1:6] = _product(d1 - d2, d1 + d2)
    f -= _product(D, first + second)
    columns = [f[:, 3].real]
    for k in (1, 2, 3):
        columns += [2.0 * f[:, 3 + k].real, -2.0 * f[:, 3 + k].imag]
    return np.column_stack(columns)


def _product(a: FloatArray, b: FloatArray) -> FloatArray:
    """Multiply Laurent polynomials row by row."""
    out = np.zeros((len(a), a.shape[1] + b.shape[1] - 1), dtype=np.complex128)
    for k in range(a.shape[1]):
        out[:, k : k + b.shape[1]] += complex_product(a[:, k : k + 1], b)
    return out


ROOTS = (int(Kind.ROOT_SAME), int(Kind.ROOT_OPPOSITE))
ROOT_KINDS = np.repeat(np.array(ROOTS, dtype=np.int64), 4)
FIELDS = ("angle", "kind", "valid", "reachable", "delta")
"""Arrays of a solution with one column per candidate."""


def solve_exact(problem: PlatformProblem) -> PlatformSolution:
    """Compute all angles with equal elbow displacements, or else the least imbalance.

    With K = q4_1,0 - s q4_2,0 and s = ±1 we want q4_1 - s q4_2 = K. Taking cosines and squaring the root away gives

        x_1² + x_2² - 2 cos(K) x_1 x_2 - sin²(K) = 0,

    a trigonometric polynomial of order two in the platform angle, because every x_i is of order one. Its
    zeros (at most four) are refined by Newton steps on the unsquared equation and selected only if they solve it.
    A move without a reachable root gets the stationary points of q4_1 - s q4_2 and the angles at which an arm is
    just stretched or folded, least imbalance first. If every angle is a root, the start is returned, or the boundaries
    of reach if the start is out of reach. Within 1e-6 rad of a stretched or folded elbow the last digit of a platform
    angle can move the elbow by more than the tolerance of a root; a root there counts as the boundary, which is
    listed if no other root is reachable. Our own derivation, after [Bottin2021] Eq. 3.
    """
    n = len(problem.angle_0)
    chunks = [
        _solve_chunk(problem.rows(slice(k, k + EXACT.chunk)))
        for k in range(0, max(n, 1), EXACT.chunk)
    ]
    if len(chunks) == 1:
        return chunks[0]

    def joined(name: str) -> Any:
        return np.concatenate([getattr(chunk, name) for chunk in chunks])

    return PlatformSolution(
        problem,
        **{name: joined(name) for name in (*FIELDS, "degenerate", "always_balanced")},
        balanced_first=True,
    )


def _solve_chunk(problem: PlatformProblem) -> PlatformSolution:
    """Solve a batch of moves: eight columns of roots, then the fallbacks."""
    n, coefficients = len(problem.angle_0), cosine_coefficients(problem)
    angle, valid, always = balanced_angles(coefficients, problem.elbow_0, problem.angle_0)
    angle = np.hstack([angle, np.zeros((n, EXACT.fallbacks))])
    valid = np.hstack([valid, np.zeros((n, EXACT.fallbacks), dtype=np.bool_)])
    kind = np.zeros(angle.shape, dtype=np.int64)
    kind[:, : ROOT_KINDS.size] = ROOT_KINDS
    # A start out of reach cannot represent all angles: then the boundaries of reach do.
    lost = always & ~(angle == problem.angle_0[:, None]).any(axis=1, where=valid)
    missing = np.flatnonzero((~valid.any(axis=1) | lost) & _each_reaches(coefficients))
    if missing.size:
        fallbacks = build_solution(
            problem.rows(missing),
            *unbalanced_angles(coefficients[missing], problem.angle_0[missing]),
            coefficients=coefficients[missing],
        )
        order = replace(fallbacks, balanced_first=True).order[:, : EXACT.fallbacks]
        balanced = (fallbacks.imbalance <= EXACT.root_tolerance) & always[missing, None]
        root_kind = np.where((fallbacks.delta[..., 0] * fallbacks.delta[..., 1]) >= 0.0, *ROOTS)
        kinds = np.where(balanced, root_kind, fallbacks.kind)
        for values, candidates in (
            (angle, fallbacks.angle),
            (valid, fallbacks.valid),
            (kind, kinds),
        ):
            values[missing, ROOT_KINDS.size :] = np.take_along_axis(candidates, order, axis=1)
    solution = build_solution(problem, angle, kind, valid, always, coefficients)
    return replace(solution, balanced_first=True)


def _each_reaches(coefficients: FloatArray) -> BoolArray:
    """Select the moves in which each arm reaches at some platform angle: a mask, shape (n,)."""
    swing = np.hypot(coefficients[..., 1], coefficients[..., 2])
    return np.asarray((np.abs(coefficients[..., 0]) - swing <= 1.0 + 1e-9).all(axis=1))
