"""The balance of both elbows: the equation q4_1 - s q4_2 = K, squared, solved and unsquared."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.geometry.roots import second_order_zeros
from dualarm_cli.platform_angle.solution import is_degenerate, nearest_turn

NEARLY_REAL = 1e-3
"""Imaginary part up to which a zero of the squared equation may stand for a real one: where its two branches
nearly touch, rounding makes a complex pair of them. The unsquared equation decides."""
NEWTON_STEPS = 5
"""Steps on the unsquared equation from each zero of the squared one, at most."""
SOLVED = 1e-13
"""Difference of displacements at which a root is as good as it gets [rad]."""
ROOT_TOLERANCE = 5e-10
"""Largest difference of displacements at a root [rad]."""
FALSE_ROOT = 0.05
"""Difference of displacements beyond which a zero of the squared equation is none of the unsquared [rad]."""
STIFF = 1e-7
"""Sine of an elbow angle below which an arm counts as stretched or folded."""
ALIKE = 1e-11
"""Difference of displacements below which a sign's equation counts as true at every angle."""
SAME_ROOT = 1e-8
"""Roots nearer than this are one [rad]."""


def balanced_angles(
    coefficients: FloatArray, elbow_0: FloatArray, angle_0: FloatArray
) -> tuple[FloatArray, BoolArray, BoolArray]:
    """Returns all angles at which the elbows move equally: four for s = +1, then four for s = -1.

    Args:
        coefficients: u, v, w of x_i, shape (n, 2, 3).
        elbow_0: elbow angles before the move [rad], shape (n, 2).
        angle_0: platform angle before the move [rad], shape (n,).

    Returns:
        Angles [rad], at most half a turn from the start, shape (n, 8); which of them are roots; and the moves
        for which the equation of one sign is true at every angle, so that the start stands for all, shape (n,).
    """
    n = len(angle_0)
    sign, start = np.repeat([1.0, -1.0], n), np.tile(angle_0, 2)
    arms = np.tile(coefficients.reshape(n, 6).T, 2)  # u1, v1, w1, u2, v2, w2
    target = np.tile(elbow_0[:, 0], 2) - sign * np.tile(elbow_0[:, 1], 2)
    mirror, weight, alike = _difference_form(arms, target, sign)
    zeros, imaginary = second_order_zeros(_squared(arms, mirror, weight))
    # Where every angle is equal the start stands for all, if it is a solution.
    every = alike | np.tile(is_degenerate(coefficients), 2)
    zeros[every, 0] = start[every]
    imaginary[every] = [0.0, np.inf, np.inf, np.inf]
    row, column = np.nonzero(imaginary <= NEARLY_REAL)
    form = np.vstack([arms, sign, target, start])
    kept, phi = _polish(form[:, row], zeros[row, column])
    row, column = row[kept], column[kept]
    roots, true = np.zeros_like(zeros), np.zeros(zeros.shape, dtype=np.bool_)
    roots[row, column], true[row, column] = phi, True
    true = _distinct(roots, true)
    return (
        np.hstack([roots[:n], roots[n:]]),
        np.hstack([true[:n], true[n:]]),
        alike[:n] | alike[n:],
    )


def _difference_form(
    arms: FloatArray, target: FloatArray, sign: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Returns m and 4 m h² of the squared equation without cancellation, and where it says nothing.

    With m the sign of cos K and h = sin(K/2) for m = 1, cos(K/2) for m = -1, the squared equation is

        (x_1 - m x_2)² + 4 m h² (x_1 x_2 - m (1 - h²)) = 0.

    Arms that move nearly alike and start nearly alike make both terms small, each with all its digits. Where both
    vanish and m = s, q4_1 - s q4_2 is K at every angle.
    """
    mirror = np.where(np.cos(target) >= 0.0, 1.0, -1.0)
    half = np.where(mirror > 0.0, np.sin(target / 2.0), np.cos(target / 2.0))
    gap = np.abs(arms[:3] - mirror * arms[3:]).sum(axis=0)
    alike = (gap <= ALIKE) & (np.abs(half) <= ALIKE) & (mirror == sign)
    return mirror, 4.0 * mirror * half * half, alike


def _squared(arms: FloatArray, mirror: FloatArray, weight: FloatArray) -> FloatArray:
    """Returns f0 to f4 of the squared equation, shape (m, 5)."""
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


def _polish(form: FloatArray, phi: FloatArray) -> tuple[IntArray, FloatArray]:
    """Returns which zeros of the squared equation solve q4_1 - s q4_2 = K, and those angles.

    Args:
        form: u1, v1, w1, u2, v2, w2, s, K and the start angle of every zero, shape (9, m).
        phi: the zeros [rad], shape (m,).
    """
    # Wrapped before it is looked at, so that the angle looked at last is the angle given.
    phi = nearest_turn(phi, form[8])
    kept: IntArray = np.arange(len(phi))
    busy, true = kept, np.zeros(len(phi), dtype=np.bool_)
    for step in range(NEWTON_STEPS + 1):
        part = form[:, busy]
        x, slope, difference = _evaluate(part, phi[busy])
        inside = (np.abs(x) <= 1.0 + 1e-12).all(axis=0)
        true[busy] = (np.abs(difference) <= ROOT_TOLERANCE) & inside
        # Most zeros belong to the false branch: they go at once.
        size = np.abs(difference)
        on = np.flatnonzero((size > SOLVED) & (size < FALSE_ROOT))
        if on.size == 0 or step == NEWTON_STEPS:
            break
        busy = busy[on]
        move = _newton_step(part[:, on], x[:, on], slope[:, on], difference[on])
        phi[busy] = nearest_turn(phi[busy] + move, form[8, busy])
    return kept[true], phi[true]


def _evaluate(form: FloatArray, phi: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns x and x' of both arms, shape (2, m), and q4_1 - s q4_2 - K, shape (m,)."""
    c, s = np.cos(phi), np.sin(phi)
    # The same sums in the same order as `elbow_cosine`: near a stretched arm the last digit of x shows.
    x = np.stack([form[0] + form[1] * c + form[2] * s, form[3] + form[4] * c + form[5] * s])
    slope = np.stack([form[2] * c - form[1] * s, form[5] * c - form[4] * s])
    q = np.arccos(np.clip(x, -1.0, 1.0))
    return x, slope, q[0] - form[6] * q[1] - form[7]


def _newton_step(
    form: FloatArray, x: FloatArray, slope: FloatArray, difference: FloatArray
) -> FloatArray:
    """Returns Newton's step on q4_1 - s q4_2 = K; none where it would leave the zero it is to polish.

    That is where it is not small, and where an arm is stretched, so that the slope is infinite.
    """
    sine = np.sqrt(np.maximum((1.0 - x) * (1.0 + x), 0.0))
    rate = -slope / np.maximum(sine, STIFF)
    change = rate[0] - form[6] * rate[1]
    move = -difference / np.where(np.abs(change) > 1e-9, change, np.inf)
    good = (np.abs(move) < FALSE_ROOT) & (np.minimum(sine[0], sine[1]) > STIFF)
    return np.where(good, move, 0.0)


def _distinct(angle: FloatArray, valid: BoolArray) -> BoolArray:
    """Returns which roots are valid and not equal to one before them."""
    several = np.flatnonzero(valid.sum(axis=1) > 1)
    some, angle = valid[several], angle[several]
    for k in range(1, angle.shape[1]):
        for i in range(k):
            turn = np.abs(nearest_turn(angle[:, k] - angle[:, i], np.zeros(1)))
            some[:, k] &= ~(some[:, i] & (turn < SAME_ROOT))
    valid[several] = some
    return valid
