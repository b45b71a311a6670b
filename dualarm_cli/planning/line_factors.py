"""How much longer lines last when limits change: along the same joint paths, with the best shape for each."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.timing.interpolation import differentiation_matrix, lagrange_basis
from dualarm_cli.timing.shapes import symmetric_grid
from dualarm_cli.timing.spline import largest_rates

SAMPLES = 9
"""Samples of each path."""
SAME_TIME = 1e-9
"""Instants nearer than this are one [s]."""
INSTANTS = 96
"""Instants per line from which its path is read off the trajectory."""
PER_PHASE = 2
"""Instants per phase of a shape at which the joints' rates are looked at."""
SHAPES = symmetric_grid(
    np.array([0.5, 0.42, 0.34, 0.25, 0.17]), np.array([0.5, 0.4, 0.3, 0.22, 0.15, 0.1, 0.06])
)
"""Double-S shapes of which each line takes the fastest."""


def line_factors(
    trajectory: Trajectory,
    spans: FloatArray,
    limits: JointLimits,
    acceleration: FloatArray,
    jerk: FloatArray,
) -> FloatArray:
    """Returns the durations of lines under changed limits as multiples of those under the limits, (v, k).

    A line's time is that of the fastest double-S shape along the path, whose coordinate is the length in joint space
    with every joint measured by its speed limit. Only the ratio of two such times is used, so that what the coordinate
    costs cancels out. The ratio is kept to what is possible: a line need never take longer than its own profile does
    when it is played at the pace that keeps the changed limits, and limits c times as high change a time by the factor
    c^-1/2 (acceleration) or c^-1/3 (jerk) at most. Our own derivation.

    Args:
        trajectory: the motion that holds the lines.
        spans: when each line begins and ends [s], shape (k, 2).
        limits: of the joints that move along the lines.
        acceleration: v sets of factors on the acceleration limits, shape (v, n).
        jerk: factors on the jerk limits, shape (v, n).
    """
    columns = [trajectory.joints.index(joint) for joint in limits.joints]
    slower = np.concatenate([np.ones_like(jerk), acceleration**-0.5, np.cbrt(1.0 / jerk)], axis=1)
    least = _shape_times(_paths(trajectory, spans, columns, limits.velocity), limits)
    own = _own_times(trajectory, spans, columns, limits)
    before = least.max(axis=2).min(axis=0)
    # Whatever changes, the line's own profile could be played slower or faster by this much.
    bound = _slowest(own[None], slower)
    factors = np.minimum(_slowest(least, slower) / np.where(before > 0.0, before, np.inf), bound)
    extreme = np.concatenate([slower, np.ones((len(slower), 1))], axis=1)
    return np.clip(factors, extreme.min(axis=1)[:, None], extreme.max(axis=1)[:, None])


def _slowest(times: FloatArray, slower: FloatArray) -> FloatArray:
    """Returns each line's time with the fastest of its shapes when demands are slowed, shape (v, k).

    Args:
        times: what each demand asks for with each shape [s], shape (g, k, d).
        slower: factors on the demands, shape (v, d).
    """
    first = times.argmax(axis=2)
    two = np.partition(times, -2, axis=2)[:, :, -2:]
    found = np.empty((len(slower), times.shape[1]))
    for row, factor in enumerate(slower):
        changed = np.flatnonzero(factor != 1.0)
        if len(changed) == 1:
            # The slowest of all others is the slowest, unless that is the one that changes.
            others = np.where(first == changed[0], two[:, :, 0], two[:, :, 1])
            slowest = np.maximum(others, times[:, :, changed[0]] * factor[changed[0]])
        else:
            slowest = (times * factor).max(axis=2)
        found[row] = slowest.min(axis=0)
    return found


def _own_times(
    trajectory: Trajectory, spans: FloatArray, columns: list[int], limits: JointLimits
) -> FloatArray:
    """Returns what each demand asks of a line's own profile, as shares of the line's time, shape (k, 3 n)."""
    own = np.empty((len(spans), 3 * len(columns)))
    for k, (start, end) in enumerate(spans):
        low, high = np.searchsorted(trajectory.time, (start - SAME_TIME, end + SAME_TIME))
        inside = slice(int(low), max(int(high), int(low) + 2))
        time, v, a = (
            trajectory.time[inside],
            trajectory.velocity[inside, columns],
            trajectory.acceleration[inside, columns],
        )
        speed, acceleration, jerk = largest_rates(time, v, a)
        own[k] = np.concatenate(
            [
                speed / limits.velocity,
                np.sqrt(acceleration / limits.acceleration),
                np.cbrt(jerk / limits.jerk),
            ]
        )
    return own


def _paths(
    trajectory: Trajectory, spans: FloatArray, columns: list[int], scale: FloatArray
) -> FloatArray:
    """Returns joints at the path's sample nodes [rad], shape (k, SAMPLES, n)."""
    # Dense where the motion starts and ends slowly, so that the path is resolved alike everywhere.
    share = (1.0 - np.cos(np.linspace(0.0, np.pi, INSTANTS))) / 2.0
    time = spans[:, :1] + share * (spans[:, 1:] - spans[:, :1])
    q = trajectory.at(time.ravel())[0][:, columns].reshape(*time.shape, len(columns))
    step = np.linalg.norm(np.diff(q, axis=1) / scale, axis=2)
    way = np.concatenate([np.zeros((len(q), 1)), np.cumsum(step, axis=1)], axis=1)
    nodes = _nodes()
    return np.stack([_read_off(q[k], way[k], nodes) for k in range(len(q))])


def _read_off(q: FloatArray, way: FloatArray, nodes: FloatArray) -> FloatArray:
    """Returns joints at shares of one path's length, linear between its instants."""
    at = nodes * way[-1]
    index = np.clip(np.searchsorted(way, at, side="right") - 1, 0, len(way) - 2)
    gap = way[index + 1] - way[index]
    part = np.divide(at - way[index], gap, out=np.zeros_like(at), where=gap > 0.0)[:, None]
    found: FloatArray = (1.0 - part) * q[index] + part * q[index + 1]
    return found


def _nodes() -> FloatArray:
    """Returns Chebyshev's extrema on [0, 1]: interpolation there does not swing at the ends."""
    return (1.0 - np.cos(np.pi * np.arange(SAMPLES) / (SAMPLES - 1))) / 2.0


def _shape_times(path: FloatArray, limits: JointLimits) -> FloatArray:
    """Returns the times that velocity, acceleration and jerk of each joint ask for, shape (g, k, 3 n)."""
    k, m, n = path.shape
    flat = np.moveaxis(path, 1, 0).reshape(m, -1)
    rates = [
        np.abs(operator @ flat).reshape(len(SHAPES.start), -1, k, n).max(axis=1)
        for operator in _operators()
    ]
    return np.concatenate(
        [
            rates[0] / limits.velocity,
            np.sqrt(rates[1] / limits.acceleration),
            np.cbrt(rates[2] / limits.jerk),
        ],
        axis=2,
    )


@lru_cache(maxsize=1)
def _operators() -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns matrices from path samples to q', q'', q''' in unit time at all instants of all shapes."""
    s, sd, sdd, sddd = (values.ravel() for values in SHAPES.within_phases(PER_PHASE))
    nodes = _nodes()
    D = differentiation_matrix(nodes)
    at = lagrange_basis(nodes, s)
    first, second, third = at @ D, at @ D @ D, at @ D @ D @ D
    sd, sdd, sddd = sd[:, None], sdd[:, None], sddd[:, None]
    return (
        sd * first,
        sdd * first + sd**2 * second,
        sddd * first + 3.0 * sd * sdd * second + sd**3 * third,
    )
