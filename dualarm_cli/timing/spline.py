"""Cubic splines from rest to rest: constant jerk between knots, C2, with exact extrema."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray


def rest_to_rest_spline(
    time: FloatArray, position: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns positions, velocities, accelerations at the knots of a C2 cubic spline.

    The spline stands still at both ends, acceleration included. That takes two conditions more than knots to
    interpolate, so the second knot and the last but one give way: their positions follow from the
    boundary ([Biagiotti2008] §4.4.4, solved here for the accelerations of all inner knots at once).

    Args:
        time: knots [s], increasing, shape (k,), k at least 5.
        position: what to interpolate [rad], shape (k, n).
    """
    h = np.diff(time)
    q = np.array(position)
    # Row i (knot i+1): h_i a_i + 2 (h_i + h_i+1) a_i+1 + h_i+1 a_i+2 = 6 (slope_i+1 - slope_i).
    below, diagonal, above = h[1:-1].copy(), 2.0 * (h[:-1] + h[1:]), h[1:-1].copy()
    # From rest q_1 = q_0 + h_0² a_1 / 6; likewise at the end. The unknown part moves to the left.
    first, last = h[0] ** 2, h[-1] ** 2
    diagonal[0] += first / h[1] + first / h[0]
    below[0] -= first / h[1]
    diagonal[-1] += last / h[-2] + last / h[-1]
    above[-1] -= last / h[-2]
    q[1], q[-2] = q[0], q[-1]
    slope = np.diff(q, axis=0) / h[:, None]
    a = np.zeros_like(q)
    a[1:-1] = _solve_tridiagonal(below, diagonal, above, 6.0 * np.diff(slope, axis=0))
    q[1] += first * a[1] / 6.0
    q[-2] += last * a[-2] / 6.0
    v = np.zeros_like(q)
    v[1:] = np.cumsum(h[:, None] * (a[:-1] + a[1:]) / 2.0, axis=0)
    v[-1] = 0.0
    return q, v, a


def clamped_spline(
    time: FloatArray, position: FloatArray, first: FloatArray, last: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns positions, velocities, accelerations at the knots of a C2 cubic spline with given end velocities.

    [Biagiotti2008] §4.4.1, solved for the accelerations.

    Args:
        time: knots [s], increasing, shape (k,), k at least 3.
        position: what to interpolate [rad], shape (k, n).
        first: velocities at the start [rad/s], shape (n,).
        last: velocities at the end [rad/s], shape (n,).
    """
    h = np.diff(time)
    slope = np.diff(position, axis=0) / h[:, None]
    diagonal = np.concatenate([[2.0 * h[0]], 2.0 * (h[:-1] + h[1:]), [2.0 * h[-1]]])
    rates = np.vstack([first, slope, last])
    a = _solve_tridiagonal(h, diagonal, h, 6.0 * np.diff(rates, axis=0))
    v = np.empty_like(position)
    v[0] = first
    v[1:] = first + np.cumsum(h[:, None] * (a[:-1] + a[1:]) / 2.0, axis=0)
    return position, v, a


def launch_spline(
    time: FloatArray, position: FloatArray, last: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns positions, velocities, accelerations at the knots of a C2 cubic spline from rest to an end velocity.

    It starts at rest as `rest_to_rest_spline` does, its second knot giving way, and ends as `clamped_spline`.

    Args:
        time: knots [s], increasing, shape (k,), k at least 4.
        position: what to interpolate [rad], shape (k, n).
        last: velocities at the end [rad/s], shape (n,).
    """
    h = np.diff(time)
    q = np.array(position)
    # The unknowns are the accelerations of all knots but the first; the last row has the end velocity.
    below, above = h[1:].copy(), h[1:].copy()
    diagonal = np.append(2.0 * (h[:-1] + h[1:]), 2.0 * h[-1])
    first = h[0] ** 2
    diagonal[0] += first / h[1] + first / h[0]
    below[0] -= first / h[1]
    q[1] = q[0]
    rates = np.vstack([np.diff(q, axis=0) / h[:, None], last])
    a = np.zeros_like(q)
    a[1:] = _solve_tridiagonal(below, diagonal, above, 6.0 * np.diff(rates, axis=0))
    q[1] += first * a[1] / 6.0
    v = np.zeros_like(q)
    v[1:] = np.cumsum(h[:, None] * (a[:-1] + a[1:]) / 2.0, axis=0)
    v[-1] = last
    return q, v, a


def _solve_tridiagonal(
    below: FloatArray, diagonal: FloatArray, above: FloatArray, right: FloatArray
) -> FloatArray:
    """Returns the solution (k, n) of a tridiagonal system without pivoting (Thomas' algorithm).

    Args:
        below: below the diagonal, shape (k - 1,).
        diagonal: the diagonal, dominant, shape (k,).
        above: above the diagonal, shape (k - 1,).
        right: right sides, shape (k, n).
    """
    pivot, x = diagonal.tolist(), right.copy()
    factors = [0.0] * len(pivot)
    for i, (low, high) in enumerate(zip(below.tolist(), above.tolist(), strict=True), 1):
        factors[i] = low / pivot[i - 1]
        pivot[i] -= factors[i] * high
        x[i] -= factors[i] * x[i - 1]
    x[-1] /= pivot[-1]
    for i in range(len(pivot) - 2, -1, -1):
        x[i] = (x[i] - above[i] * x[i + 1]) / pivot[i]
    return x


def largest_rates(
    time: FloatArray, velocity: FloatArray, acceleration: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns the largest |velocity|, |acceleration|, |jerk| between all knots, each (n,).

    Args:
        time: knots [s], shape (k,).
        velocity: at the knots [rad/s], shape (k, n).
        acceleration: at the knots [rad/s²], shape (k, n); linear in between. A jump, two knots at one
            time, is no jerk.
    """
    h = np.diff(time)[:, None]
    a0, a1 = acceleration[:-1], acceleration[1:]
    jerk = np.divide(a1 - a0, h, out=np.zeros_like(a0), where=h > 0.0)
    # Where the acceleration changes its sign the velocity has an extremum: v0 - a0² / 2j.
    turns = (a0 * a1 < 0) & (h > 0.0)
    inside = np.where(turns, velocity[:-1] - a0**2 / np.where(turns, 2.0 * jerk, 1.0), 0.0)
    v = np.maximum(np.abs(velocity).max(axis=0), np.abs(inside).max(axis=0))
    return v, np.abs(acceleration).max(axis=0), np.abs(jerk).max(axis=0)
