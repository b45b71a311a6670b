"""Lines: the fastest jerk-limited double-S profile along the path under joint limits.

A joint that alone limits the line moves fastest if its own angle follows a double S. A good path coordinate therefore
rises with the angle of the limiting joint instead of the path length. Three coordinates are tried. The first is the
path length. For the second, each joint's speed along the path is weighted by the joint's own minimum time over its
whole distance. Its slope is the 8-norm over the joints: high, so that the slowest joint dominates; even, so that it
stays smooth. The third rises by the minimum time that velocity, acceleration and jerk limits allow each interval of the
path at a steady speed. It is best where the path bends sharply in joint space. The derivation is ours.

The search is compiled (`compiled/src/paths.c`, `rest_lines.c`).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from dualarm_cli.compiled import trajectories
from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.geometry.elementary import cbrt
from dualarm_cli.geometry.products import product
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.timing.composition import hold
from dualarm_cli.timing.problem import LineProblem
from dualarm_cli.timing.shapes import symmetric_grid

SPEED_MARGIN = 1e-4
"""Fraction of a tool-speed limit that is kept free for errors of the spline."""
UNLIMITED = 1e9
"""Acceleration and jerk limit of the tool that stands for infinity, per m/s."""
ESTIMATE_SHAPES = symmetric_grid(np.array([0.5, 0.4, 0.3]), np.array([0.5, 0.3]))
"""Shapes from which the duration of many lines is estimated."""
ESTIMATE_BLOCK = 48
"""Lines per matrix product, few enough for a single-threaded product.

On a busy machine starting threads would take a hundred times as long as the product.
"""
DISTINCT_BLOCK = 64
"""Lines per matrix product with distinct instants only."""
SAME_RATE = 1e-12
"""Relative difference below which rows of an operator are equal."""


def solve_line(problem: LineProblem) -> Trajectory:
    """Time a line with constant jerk between knots, within every limit.

    Double-S shapes are tried along the path coordinates. Each is scaled in time until velocity, acceleration and jerk
    of every joint keep their limits; the fastest is chosen. Along every coordinate symmetric shapes are first, then
    variations of the best one, with jerk phases of different lengths: each may have another limiting joint. The joints
    pass through the path at the knots on a cubic spline, and time is scaled again by the spline's own exact extrema. A
    limit of tool speed is a velocity limit of one more joint, the path length. The method is ours; it is about a
    percent slower than the optimum over all profiles.

    A line without joint motion takes no time.
    """
    if problem.tool_speed is None and (problem.position == problem.position[0]).all():
        return hold(problem.joints, problem.position[0], 0.0)
    return trajectory_of(problem, trajectories.rest_line(path_of(problem), problem.knots))


def estimate_line_durations(
    position: FloatArray, length: FloatArray, limits: JointLimits
) -> FloatArray:
    """Estimate the durations of lines [s], shape (n,).

    The shortest of a few fixed shapes, from the path's derivatives at its samples. The exact line is a few percent
    faster or slower.

    Args:
        position: joints at equidistant samples [rad], shape (n, m, d).
        length: path length at the samples [m], shape (m,); only their number is used.
        limits: limits of the d joints.
    """
    joints_first = np.ascontiguousarray(position.transpose(1, 2, 0))
    lines = range(0, len(position), DISTINCT_BLOCK)
    return np.concatenate(
        [_estimate_block(joints_first[:, :, k : k + DISTINCT_BLOCK], limits) for k in lines]
    )


def _estimate_block(position: FloatArray, limits: JointLimits) -> FloatArray:
    """Estimate the durations of a block of lines [s], shape (n,), from samples (m, d, n)."""
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
    """Select the distinct rows of the `estimate_operators`, and each shape's first row.

    Adjacent phases share a state, phases without length are one instant, and at rest nothing moves: more than half of
    the rows are redundant.
    """
    return tuple(_distinct(operator) for operator in estimate_operators(samples))


def _distinct(operator: FloatArray) -> tuple[FloatArray, IntArray]:
    distinct: list[FloatArray] = []
    first = []
    for rows in operator.reshape(len(ESTIMATE_SHAPES.start), -1, operator.shape[1]):
        first.append(len(distinct))
        size = np.abs(rows).max()
        for row in rows:
            earlier = [np.zeros(len(row)), *distinct[first[-1] :]]
            if min(np.abs(row - known_row).max() for known_row in earlier) > SAME_RATE * size:
                distinct.append(row)
    return np.array(distinct), np.array(first, dtype=np.int64)


@lru_cache(maxsize=8)
def estimate_operators(samples: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Build matrices from path samples to q', q'', q''' in unit time, at every instant."""
    return ESTIMATE_SHAPES.path_rates(2, np.linspace(0.0, 1.0, samples))


def path_of(problem: LineProblem) -> trajectories.Path:
    """Build the path with its limits; limited tool speed adds a joint."""
    joint_limits = problem.limits
    limits = joint_limits.velocity, joint_limits.acceleration, joint_limits.jerk
    if problem.tool_speed is None:
        return trajectories.Path.of(problem.position, limits)
    cap = problem.tool_speed * (1.0 - SPEED_MARGIN)
    tool_limits = cap, UNLIMITED * cap, np.square(UNLIMITED) * cap
    return trajectories.Path.of(
        np.column_stack([problem.position, problem.length]),
        [np.append(limit, extra) for limit, extra in zip(limits, tool_limits, strict=True)],
    )


def trajectory_of(problem: LineProblem, knots: trajectories.Knots) -> Trajectory:
    """Build the trajectory of a line's joints from its knots, without the path length."""
    time, *rows = knots
    return Trajectory(problem.joints, time, *(row[:, : len(problem.joints)] for row in rows))


def joint_line_durations(position: FloatArray, limits: JointLimits) -> FloatArray:
    """Estimate the duration of each line by each joint alone [s], shape (n, d).

    The largest of a line's row is the estimate of `estimate_line_durations`; the others show how far from
    critical their joints are.

    Args:
        position: joints at equidistant samples [rad], shape (n, m, d).
        limits: limits of the d joints.
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
