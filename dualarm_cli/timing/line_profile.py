"""Lines: a jerk-limited profile of the path length, as fast as every joint's limits allow."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.timing.problem import LineProblem
from dualarm_cli.timing.shapes import Shapes, samples_within, symmetric_grid
from dualarm_cli.timing.spline import largest_rates, rest_to_rest_spline

STENCIL = 8
"""Neighbouring gridpoints in the local interpolation of a path: of seventh degree."""
SAMPLES_PER_PHASE = 5
"""Instants per phase at which shapes are compared."""
ROUNDS = 3
"""Rounds in which the best shape is varied, each half as wide."""
SPEED_MARGIN = 1e-4
"""Share of a tool-speed cap kept free, since the spline follows the profile only nearly."""
SEARCH_RAMPS = np.array([0.5, 0.45, 0.4, 0.33, 0.25])
SEARCH_JERKS = np.array([0.5, 0.35, 0.25, 0.15])
ESTIMATE_SHAPES = symmetric_grid(np.array([0.5, 0.4, 0.3]), np.array([0.5, 0.3]))
"""The few shapes by which many lines are compared."""


def solve_line(problem: LineProblem) -> Trajectory:
    """Returns the timed line: C2, constant jerk between knots, every limit met.

    Of a family of double-S shapes of the path length the one is taken whose time, scaled until velocity,
    acceleration and jerk of every joint hold, is least. The joints then pass through the path at the knots
    on a cubic spline, and time is scaled once more by the spline's own exact extrema. Our own method; it is
    not proven time-optimal among all profiles.
    """
    length, limits = float(problem.length[-1]), problem.limits
    shape = _best_shape(problem.position, limits)
    time = _knots(shape, problem.knots)
    s = shape.at(time[None])[0][0]
    q, v, a = rest_to_rest_spline(time, _interpolate(problem.position, s))
    speed, acceleration, jerk = largest_rates(time, v, a)
    factor = max(
        float((speed / limits.velocity).max()),
        float(np.sqrt((acceleration / limits.acceleration).max())),
        float(np.cbrt((jerk / limits.jerk).max())),
    )
    if problem.tool_speed is not None:
        fastest = float(shape.peak[0]) * length
        factor = max(factor, fastest / (problem.tool_speed * (1.0 - SPEED_MARGIN)))
    # A hair slower, so that rounding cannot push a joint over its limit.
    factor *= 1.0 + 1e-12
    return Trajectory(problem.joints, time * factor, q, v / factor, a / factor**2)


def estimate_line_durations(
    position: FloatArray, length: FloatArray, limits: JointLimits
) -> FloatArray:
    """Returns about how long each of many lines takes [s], shape (n,).

    The best of a few fixed shapes, from the path's derivatives at its samples; the exact line is a few percent
    faster or slower.

    Args:
        position: joints at equidistant samples [rad], shape (n, m, d).
        length: path length at the samples [m], shape (m,); only their number counts.
        limits: of the d joints.
    """
    operators = _estimate_operators(len(length))
    flat = np.moveaxis(position, 1, 0).reshape(len(length), -1)
    g = len(ESTIMATE_SHAPES.start)
    rates = [
        np.abs(operator @ flat).reshape(g, -1, len(position), position.shape[2]).max(axis=1)
        for operator in operators
    ]
    time = np.maximum(
        (rates[0] / limits.velocity).max(axis=-1),
        np.maximum(
            np.sqrt((rates[1] / limits.acceleration).max(axis=-1)),
            np.cbrt((rates[2] / limits.jerk).max(axis=-1)),
        ),
    )
    shortest: FloatArray = time.min(axis=0)
    return shortest


@lru_cache(maxsize=8)
def _estimate_operators(samples: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns matrices from path samples to q', q'', q''' in unit time at all instants."""
    time = samples_within(ESTIMATE_SHAPES, 2)
    s, sd, sdd, sddd = (values.ravel() for values in ESTIMATE_SHAPES.at(time))
    nodes = np.linspace(0.0, 1.0, samples)
    D = _differentiation_matrix(nodes)
    at = _lagrange(nodes, s)
    first, second, third = at @ D, at @ D @ D, at @ D @ D @ D
    sd, sdd, sddd = sd[:, None], sdd[:, None], sddd[:, None]
    return (
        sd * first,
        sdd * first + sd**2 * second,
        sddd * first + 3.0 * sd * sdd * second + sd**3 * third,
    )


def _best_shape(position: FloatArray, limits: JointLimits) -> Shapes:
    """Returns the shape of least time: a symmetric grid, then variations of all four shares."""
    derivatives = _derivatives(position)
    shapes = symmetric_grid(SEARCH_RAMPS, SEARCH_JERKS)
    best = shapes.take(int(np.argmin(_scaled_time(shapes, derivatives, limits))))
    for k in range(ROUNDS):
        shapes = _vary(best, 0.5**k)
        best = shapes.take(int(np.argmin(_scaled_time(shapes, derivatives, limits))))
    return best


def _vary(best: Shapes, width: float) -> Shapes:
    """Returns the shape itself and variations of its shares, up to ±0.12 of the time at width 1."""
    change = width * _VARIATIONS
    start = np.clip(best.start + 0.12 * change[:, 0], 0.05, 0.9)
    end = np.clip(best.end + 0.12 * change[:, 1], 0.05, 0.9)
    too_long = np.maximum(start + end, 1.0)
    return Shapes(
        start / too_long,
        np.clip(best.start_jerk + 0.15 * change[:, 2], 0.05, 0.5),
        end / too_long,
        np.clip(best.end_jerk + 0.15 * change[:, 3], 0.05, 0.5),
    )


def _scaled_time(
    shapes: Shapes, derivatives: tuple[FloatArray, ...], limits: JointLimits
) -> FloatArray:
    """Returns the time of each shape under the limits [s], shape (g,), from path derivatives."""
    first, second, third = derivatives
    s, sd, sdd, sddd = shapes.at(samples_within(shapes, SAMPLES_PER_PHASE))
    grid = np.clip(np.round(s * (len(first) - 1)).astype(np.int64), 0, len(first) - 1)
    q1, q2, q3 = first[grid], second[grid], third[grid]
    sd, sdd, sddd = sd[..., None], sdd[..., None], sddd[..., None]
    v = np.abs(q1 * sd) / limits.velocity
    a = np.abs(q1 * sdd + q2 * sd**2) / limits.acceleration
    j = np.abs(q1 * sddd + 3.0 * q2 * sd * sdd + q3 * sd**3) / limits.jerk
    worst = [rate.max(axis=(1, 2)) for rate in (v, a, j)]
    return np.maximum(worst[0], np.maximum(np.sqrt(worst[1]), np.cbrt(worst[2])))


def _derivatives(position: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns the first three derivatives by the path's share in [0, 1], each (m, n)."""
    step = 1.0 / (len(position) - 1)
    first = np.gradient(position, step, axis=0, edge_order=2)
    second = np.gradient(first, step, axis=0, edge_order=2)
    return first, second, np.gradient(second, step, axis=0, edge_order=2)


def _knots(shape: Shapes, count: int) -> FloatArray:
    """Returns at least `count` knots in [0, 1]: every end of a phase, and equal parts within.

    Each end phase has three parts or more: its first two knots belong to the boundary.
    """
    edges = shape.breakpoints()[0]
    edges = edges[np.concatenate([[True], np.diff(edges) > 1e-6])]
    edges[-1] = 1.0
    parts = np.maximum(1, np.ceil(np.diff(edges) * count).astype(np.int64))
    parts[[0, -1]] = np.maximum(3, parts[[0, -1]])
    pieces = [
        np.linspace(low, high, n, endpoint=False)
        for low, high, n in zip(edges[:-1], edges[1:], parts, strict=True)
    ]
    return np.append(np.concatenate(pieces), 1.0)


def _interpolate(position: FloatArray, share: FloatArray) -> FloatArray:
    """Returns the path at shares of its length in [0, 1], by local polynomials, shape (k, n)."""
    m = len(position)
    place = share * (m - 1)
    first = np.clip(np.floor(place).astype(np.int64) - STENCIL // 2 + 1, 0, m - STENCIL)
    x = place - first
    weights = _lagrange(np.arange(STENCIL, dtype=np.float64), x)
    gathered = position[first[:, None] + np.arange(STENCIL)]
    values: FloatArray = np.einsum("ks,ksn->kn", weights, gathered)
    values[0], values[-1] = position[0], position[-1]
    return values


def _lagrange(nodes: FloatArray, x: FloatArray) -> FloatArray:
    """Returns the Lagrange basis of the nodes (m,) at x (k,), shape (k, m)."""
    gap = x[:, None] - nodes
    basis = np.empty_like(gap)
    for i in range(len(nodes)):
        others = np.delete(np.arange(len(nodes)), i)
        basis[:, i] = (gap[:, others] / (nodes[i] - nodes[others])).prod(axis=1)
    return basis


def _differentiation_matrix(nodes: FloatArray) -> FloatArray:
    """Returns the matrix that takes values at nodes to the polynomial's derivative there."""
    gap = nodes[:, None] - nodes + np.eye(len(nodes))
    weight = gap.prod(axis=1)
    D = weight[:, None] / (weight * gap)
    np.fill_diagonal(D, 0.0)
    np.fill_diagonal(D, -D.sum(axis=1))
    return D


def _variations() -> FloatArray:
    """Returns no change, each share alone up and down, both ramps together, and their jerks."""
    one = np.eye(4)
    pairs = np.array([[1, 1, 0, 0], [1, -1, 0, 0], [0, 0, 1, 1], [1, 1, 1, 1], [1, 1, -1, -1]])
    steps = np.vstack([one, pairs])
    return np.vstack([np.zeros((1, 4)), steps, -steps, steps / 2, -steps / 2])


_VARIATIONS = _variations()
