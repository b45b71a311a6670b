"""Lines: a jerk-limited double-S profile along the path, as fast as every joint's limits allow.

A joint that alone decides moves fastest if its own angle follows a double S. So a good coordinate of a path rises with
the deciding joint's angle rather than with the path length. Three coordinates are tried. The first is the path length.
For the second, each joint's speed along the path is weighted by the joint's own least time over its whole way, and the
8-norm over the joints is the slope: high, so that the slowest joint decides; even, so that it stays smooth. The third
rises by the least time that velocity, acceleration and jerk limits allow each bit of the path at a steady pace, which
matters where the path bends sharply in joint space. Our own derivation.

The search is compiled (`compiled/src/paths.c`, `rest_lines.c`).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from dualarm_cli.compiled import trajectories
from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.geometry.elementary import cbrt
from dualarm_cli.geometry.products import product
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.timing.composition import hold
from dualarm_cli.timing.problem import LineProblem
from dualarm_cli.timing.shapes import symmetric_grid

SPEED_MARGIN = 1e-4
"""Share of a tool-speed cap kept free, since the spline follows the path only nearly."""
UNLIMITED = 1e9
"""Acceleration and jerk limit of the tool, per m/s of its cap: no demand on it."""
ESTIMATE_SHAPES = symmetric_grid(np.array([0.5, 0.4, 0.3]), np.array([0.5, 0.3]))
"""The few shapes by which many lines are compared."""
ESTIMATE_BLOCK = 48
"""Lines that are estimated in one product of matrices: small enough for a linear algebra library not to start
threads, which on a busy machine would cost a hundred times the product."""
DISTINCT_BLOCK = 64
"""The same where only distinct instants are looked at, so that products are smaller."""
SAME_RATE = 1e-12
"""Rows of an operator that differ by less than this share of its largest entry are one."""


def solve_line(problem: LineProblem) -> Trajectory:
    """Returns the timed line: C2, constant jerk between knots, every limit met.

    Of a family of double-S shapes along the coordinates of the path the one is taken whose time, scaled until velocity,
    acceleration and jerk of every joint hold, is least: first symmetric shapes along every coordinate, then variations
    of the best one. The joints then pass through the path at the knots on a cubic spline, and time is scaled once more
    by the spline's own exact extrema. A cap on the tool's speed is a velocity limit on one joint more, the path length.
    Our own method; it is not time-optimal among all profiles (a few percent slower).

    A line on which no joint moves takes no time.
    """
    if problem.tool_speed is None and (problem.position == problem.position[0]).all():
        return hold(problem.joints, problem.position[0], 0.0)
    return trajectory_of(problem, trajectories.rest_line(path_of(problem), problem.knots))


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
    joints_first = np.ascontiguousarray(position.transpose(1, 2, 0))
    lines = range(0, len(position), DISTINCT_BLOCK)
    return np.concatenate(
        [_estimate_block(joints_first[:, :, k : k + DISTINCT_BLOCK], limits) for k in lines]
    )


def _estimate_block(position: FloatArray, limits: JointLimits) -> FloatArray:
    """Returns the estimates of a few lines [s], shape (n,), from samples of shape (m, d, n)."""
    samples, joints, n = position.shape
    rates = []
    scales = limits.velocity, limits.acceleration, limits.jerk
    for (operator, first), scale in zip(distinct_operators(samples), scales, strict=True):
        rate = product(operator, (position / scale[:, None]).reshape(samples, -1))
        np.abs(rate, out=rate)
        largest = rate.reshape(-1, joints, n).max(axis=1)
        rates.append(np.maximum.reduceat(largest, first, axis=0))
    time = np.maximum(rates[0], np.maximum(np.sqrt(rates[1]), cbrt(rates[2])))
    shortest: FloatArray = time.min(axis=0)
    return shortest


@lru_cache(maxsize=8)
def distinct_operators(samples: int) -> tuple[tuple[FloatArray, IntArray], ...]:
    """Returns the rows of each of the `estimate_operators` that differ, and each shape's first row among them.

    Phases meet in the same state, phases of no length are one instant, and at rest nothing moves: more than half of
    the rows say nothing new.
    """
    return tuple(_distinct(operator) for operator in estimate_operators(samples))


def _distinct(operator: FloatArray) -> tuple[FloatArray, IntArray]:
    kept: list[FloatArray] = []
    first = []
    for rows in operator.reshape(len(ESTIMATE_SHAPES.start), -1, operator.shape[1]):
        first.append(len(kept))
        size = np.abs(rows).max()
        for row in rows:
            seen = [np.zeros(len(row)), *kept[first[-1] :]]
            if min(np.abs(row - other).max() for other in seen) > SAME_RATE * size:
                kept.append(row)
    return np.array(kept), np.array(first, dtype=np.int64)


@lru_cache(maxsize=8)
def estimate_operators(samples: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns matrices from path samples to q', q'', q''' in unit time at all instants."""
    return ESTIMATE_SHAPES.path_rates(2, np.linspace(0.0, 1.0, samples))


def path_of(problem: LineProblem) -> trajectories.Path:
    """Returns path and limits, with the path length as one more joint where its speed is capped."""
    own = problem.limits
    limits = own.velocity, own.acceleration, own.jerk
    if problem.tool_speed is None:
        return trajectories.Path.of(problem.position, limits)
    cap = problem.tool_speed * (1.0 - SPEED_MARGIN)
    more = cap, UNLIMITED * cap, np.square(UNLIMITED) * cap
    return trajectories.Path.of(
        np.column_stack([problem.position, problem.length]),
        [np.append(limit, one) for limit, one in zip(limits, more, strict=True)],
    )


def trajectory_of(problem: LineProblem, knots: trajectories.Knots) -> Trajectory:
    """Returns the motion of a line's joints by its knots, without the path length."""
    time, *rows = knots
    return Trajectory(problem.joints, time, *(row[:, : len(problem.joints)] for row in rows))


def joint_line_durations(position: FloatArray, limits: JointLimits) -> FloatArray:
    """Returns how long each joint alone would make each line last [s], shape (n, d).

    The largest of a line's row is its estimate as `estimate_line_durations` gives it; the others say how far from
    critical their joints are.

    Args:
        position: joints at equidistant samples [rad], shape (n, m, d).
        limits: of the d joints.
    """
    blocks = range(0, len(position), ESTIMATE_BLOCK)
    return np.concatenate([_block(position[k : k + ESTIMATE_BLOCK], limits) for k in blocks])


def _block(position: FloatArray, limits: JointLimits) -> FloatArray:
    n, samples, joints = position.shape
    flat = np.moveaxis(position, 1, 0).reshape(samples, -1)
    shapes = len(ESTIMATE_SHAPES.start)
    rates = [
        np.abs(product(operator, flat)).reshape(shapes, -1, n, joints).max(axis=1)
        for operator in estimate_operators(samples)
    ]
    time = np.maximum(
        rates[0] / limits.velocity,
        np.maximum(np.sqrt(rates[1] / limits.acceleration), cbrt(rates[2] / limits.jerk)),
    )
    best = time.max(axis=2).argmin(axis=0)
    return time[best, np.arange(n)]
