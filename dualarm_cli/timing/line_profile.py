"""Lines: a jerk-limited double-S profile along the path, as fast as every joint's limits allow."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.timing.composition import hold
from dualarm_cli.timing.problem import LineProblem
from dualarm_cli.timing.rest_to_rest import RestToRest
from dualarm_cli.timing.shapes import (
    Shapes,
    differentiation_matrix,
    interpolate_samples,
    lagrange_basis,
    symmetric_grid,
)
from dualarm_cli.timing.spline import largest_rates, rest_to_rest_spline

COORDINATES = 3
"""Path length, slowness of the deciding joint, and slowness by what each place allows."""
NORM = 8
"""Norm over the joints: high, so that the slowest decides; even, so that it stays smooth."""
LEAST_SLOWNESS = 0.02
"""Floor of the slowness, as a share of its largest: where no joint moves a coordinate still rises."""


@dataclass(frozen=True)
class PathCoordinates:
    """c coordinates of one path, and what the joints do per unit of each of them.

    A joint that alone decides moves fastest if its own angle follows a double S. So a good coordinate rises with
    the deciding joint's angle rather than with the path length: each joint's speed along the path is weighted
    by the joint's own least time over its whole way, and the NORM-norm over the joints is the slope of the second
    coordinate. The third rises by the least time that velocity, acceleration and jerk limits allow each bit
    of the path at a steady pace, which matters where the path bends sharply in joint space. Our own derivation.
    """

    share: FloatArray
    """Share of the path length at m equidistant values of each coordinate, shape (c, m)."""
    speed: FloatArray
    """Largest |q'| / velocity limit over the joints, shape (c, m)."""
    rates: FloatArray
    """q', q'' over the acceleration limit and q', 3 q'', q''' over the jerk limit, (c, m, 5, n)."""

    @classmethod
    def measure(cls, position: FloatArray, law: RestToRest) -> PathCoordinates:
        """Returns all COORDINATES of a path.

        Args:
            position: joints at equidistant gridpoints [rad], shape (m, n), m at least 8.
            law: the joints' limits.
        """
        limits = (law.velocity.tobytes(), law.acceleration.tobytes(), law.jerk.tobytes())
        return _measured(position.tobytes(), len(position), limits)

    @classmethod
    def _of(cls, position: FloatArray, law: RestToRest) -> PathCoordinates:
        m, n = position.shape
        share = _shares(position, law)
        q = np.empty((len(share), m, n))
        q[0] = position
        q[1:] = interpolate_samples(position, share[1:].ravel()).reshape(-1, m, n)
        first, second, third = np.moveaxis(_differences(m) @ q[:, None], 1, 0)
        a, j = law.acceleration, law.jerk
        rates = np.stack([first / a, second / a, first / j, 3.0 * second / j, third / j], axis=2)
        return cls(share, np.abs(first / law.velocity).max(axis=2), rates)

    def scaled_time(self, shapes: Shapes, coordinate: IntArray, per_phase: int) -> FloatArray:
        """Returns how long each shape must take for every limit to hold [s], shape (g,).

        Args:
            shapes: g shapes.
            coordinate: index of the coordinate each of them shapes, shape (g,).
            per_phase: instants per phase that are looked at.
        """
        return self.least_time(np.stack(shapes.within_phases(per_phase)), coordinate)

    def least_time(self, profile: FloatArray, coordinate: IntArray) -> FloatArray:
        """Returns how long profiles of way 1 in time 1 must take for every limit to hold [s], shape (g,).

        Args:
            profile: way, speed, acceleration and jerk at m instants of each, shape (4, g, m).
            coordinate: index of the coordinate each of them shapes, shape (g,).
        """
        way, sd, sdd, sddd = profile
        last = self.share.shape[1] - 1
        at = coordinate[:, None], (way * last + 0.5).astype(np.int64)
        velocity = (self.speed[at] * sd).max(axis=1)
        rates = self.rates[at]
        factors = np.stack([sdd, sd**2, sddd, sd * sdd, sd**3], axis=2)[..., None]
        rates *= factors
        acceleration = np.abs(rates[:, :, 0] + rates[:, :, 1]).max(axis=(1, 2))
        jerk = np.abs(rates[:, :, 2] + rates[:, :, 3] + rates[:, :, 4]).max(axis=(1, 2))
        time: FloatArray = np.maximum(velocity, np.maximum(np.sqrt(acceleration), np.cbrt(jerk)))
        return time


@lru_cache(maxsize=64)
def _measured(position: bytes, samples: int, limits: tuple[bytes, ...]) -> PathCoordinates:
    """Returns a path's coordinates. Ways of passing its end are compared, and soon after the best one is timed."""
    path = np.frombuffer(position).reshape(samples, -1)
    return PathCoordinates._of(path, RestToRest(*(np.frombuffer(one) for one in limits)))


def _shares(position: FloatArray, law: RestToRest) -> FloatArray:
    """Returns the share of the length at equidistant values of every coordinate, shape (c, m)."""
    m = len(position)
    first, second, third = np.abs(_differences(m) @ position)
    way = first.mean(axis=0)
    weight = law.per_joint(way) ** 3 / np.where(way > 0.0, way, 1.0)
    deciding = ((first * weight) ** NORM).sum(axis=1)
    # Velocity, acceleration and jerk of a steady pace p are q' p, q'' p², q''' p³.
    steady = (
        (first / law.velocity) ** NORM
        + (second / law.acceleration) ** (NORM / 2)
        + (third / law.jerk) ** (NORM / 3)
    ).sum(axis=1)
    grid = np.linspace(0.0, 1.0, m)
    share = np.tile(grid, (COORDINATES, 1))
    for k, power in enumerate((deciding, steady), start=1):
        slope = np.maximum((power / power.max()) ** (1.0 / NORM), LEAST_SLOWNESS)
        coordinate = np.zeros(m)
        np.cumsum((slope[1:] + slope[:-1]) / 2.0, out=coordinate[1:])
        slope *= (m - 1) / coordinate[-1]
        coordinate /= coordinate[-1]
        share[k] = _inverse(coordinate, slope, grid)
    return share


def _inverse(coordinate: FloatArray, slope: FloatArray, grid: FloatArray) -> FloatArray:
    """Returns where a rising coordinate takes equidistant values, as smooth as the coordinate."""
    both = np.column_stack([coordinate, slope])
    near: FloatArray = np.interp(grid, coordinate, grid)
    # One Newton step from linear interpolation leaves about 1e-9; only smoothness matters here.
    found = interpolate_samples(both, near)
    share: FloatArray = np.clip(
        near - (found[:, 0] - grid) / np.maximum(found[:, 1], LEAST_SLOWNESS), 0.0, 1.0
    )
    share[0], share[-1] = 0.0, 1.0
    return share


@lru_cache(maxsize=8)
def _differences(samples: int) -> FloatArray:
    """Returns operators from equidistant samples on [0, 1] to three derivatives, (3, m, m)."""
    step = 1.0 / (samples - 1)
    once: FloatArray = np.asarray(np.gradient(np.eye(samples), step, axis=0, edge_order=2))
    return np.stack([once, once @ once, once @ once @ once])


SAMPLES_PER_PHASE = 3
"""Instants per phase at which shapes are compared."""
ROUNDS = 3
"""Rounds in which the best shape is varied, each half as wide."""
HANDICAP = np.array([1.0, 1.0, 1.005])
"""What a coordinate's time counts: the third is rougher, so its few samples flatter it."""
VARIATION = np.array([1.4, 1.4, 2.5, 2.5])
"""Factors by which start ramp, end ramp and their jerk phases are varied in the first round."""
SHORTEST_RAMP = 0.02
"""Least share of the time that a ramp may take."""
SHORTEST_JERK = 0.02
"""Least share of a ramp that each of its jerk phases may take."""
SPEED_MARGIN = 1e-4
"""Share of a tool-speed cap kept free, since the spline follows the path only nearly."""
UNLIMITED = 1e9
"""Acceleration and jerk limit of the tool, per m/s of its cap: no demand on it."""
SEARCH_RAMPS = np.array([0.5, 0.42, 0.34, 0.25, 0.17, 0.1])
SEARCH_JERKS = np.array([0.5, 0.35, 0.2, 0.08])
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

    Of a family of double-S shapes along several coordinates of the path the one is taken whose time, scaled
    until velocity, acceleration and jerk of every joint hold, is least. The joints then pass through the path at
    the knots on a cubic spline, and time is scaled once more by the spline's own exact extrema. A cap on the tool's
    speed is a velocity limit on one joint more, the path length. Our own method; it is not time-optimal among all
    profiles (a few percent slower).

    A line on which no joint moves takes no time.
    """
    n = len(problem.joints)
    position, law = path_and_law(problem)
    if np.ptp(position, axis=0).max() == 0.0:
        return hold(problem.joints, problem.position[0], 0.0)
    share, shape = _best_shape(position, law)
    time = _knots(shape, problem.knots)
    way = np.clip(shape.at(time[None])[0][0], 0.0, 1.0)
    place = np.clip(interpolate_samples(share[:, None], way)[:, 0], 0.0, 1.0)
    q, v, a = rest_to_rest_spline(time, interpolate_samples(position, place))
    speed, acceleration, jerk = largest_rates(time, v, a)
    factor = max(
        float((speed / law.velocity).max()),
        float(np.sqrt((acceleration / law.acceleration).max())),
        float(np.cbrt((jerk / law.jerk).max())),
    )
    # A hair slower, so that rounding cannot push a joint over its limit.
    factor *= 1.0 + 1e-12
    return Trajectory(
        problem.joints, time * factor, q[:, :n], v[:, :n] / factor, a[:, :n] / factor**2
    )


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
        rate = operator @ (position / scale[:, None]).reshape(samples, -1)
        np.abs(rate, out=rate)
        largest = rate.reshape(-1, joints, n).max(axis=1)
        rates.append(np.maximum.reduceat(largest, first, axis=0))
    time = np.maximum(rates[0], np.maximum(np.sqrt(rates[1]), np.cbrt(rates[2])))
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
    s, sd, sdd, sddd = (values.ravel() for values in ESTIMATE_SHAPES.within_phases(2))
    nodes = np.linspace(0.0, 1.0, samples)
    D = differentiation_matrix(nodes)
    at = lagrange_basis(nodes, s)
    first, second, third = at @ D, at @ D @ D, at @ D @ D @ D
    sd, sdd, sddd = sd[:, None], sdd[:, None], sddd[:, None]
    return (
        sd * first,
        sdd * first + sd**2 * second,
        sddd * first + 3.0 * sd * sdd * second + sd**3 * third,
    )


def path_and_law(problem: LineProblem) -> tuple[FloatArray, RestToRest]:
    """Returns path and limits, with the path length as one more joint where its speed is capped."""
    limits = problem.limits
    if problem.tool_speed is None:
        return problem.position, RestToRest(limits.velocity, limits.acceleration, limits.jerk)
    cap = problem.tool_speed * (1.0 - SPEED_MARGIN)
    return np.column_stack([problem.position, problem.length]), RestToRest(
        np.append(limits.velocity, cap),
        np.append(limits.acceleration, UNLIMITED * cap),
        np.append(limits.jerk, UNLIMITED**2 * cap),
    )


def _best_shape(position: FloatArray, law: RestToRest) -> tuple[FloatArray, Shapes]:
    """Returns share of the path by its best coordinate, shape (m,), and that coordinate's shape.

    First every coordinate with a grid of symmetric shapes, then variations of the best one's four shares.
    """
    paths = PathCoordinates.measure(position, law)
    c, g = COORDINATES, len(SEARCH_SHAPES.start)
    times = paths.scaled_time(ALL_SEARCH_SHAPES, np.repeat(np.arange(c), g), SAMPLES_PER_PHASE)
    coordinate, index = divmod(int(np.argmin(times * np.repeat(HANDICAP, g))), g)
    best = SEARCH_SHAPES.take(index)
    for k in range(ROUNDS):
        shapes = _vary(best, 0.5**k)
        same = np.full(len(shapes.start), coordinate)
        best = shapes.take(int(np.argmin(paths.scaled_time(shapes, same, SAMPLES_PER_PHASE))))
    return paths.share[coordinate], best


def _vary(best: Shapes, width: float) -> Shapes:
    """Returns the shape itself and variations of its shares, by up to VARIATION at width 1."""
    change = VARIATION ** (width * _VARIATIONS)
    start = np.clip(best.start * change[:, 0], SHORTEST_RAMP, 0.9)
    end = np.clip(best.end * change[:, 1], SHORTEST_RAMP, 0.9)
    too_long = np.maximum(start + end, 1.0)
    return Shapes(
        start / too_long,
        np.clip(best.start_jerk * change[:, 2], SHORTEST_JERK, 0.5),
        end / too_long,
        np.clip(best.end_jerk * change[:, 3], SHORTEST_JERK, 0.5),
    )


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


def _variations() -> FloatArray:
    """Returns no change, each share alone up and down, both ramps together, and their jerks."""
    one = np.eye(4)
    pairs = np.array([[1, 1, 0, 0], [1, -1, 0, 0], [0, 0, 1, 1], [1, 1, 1, 1], [1, 1, -1, -1]])
    steps = np.vstack([one, pairs])
    return np.vstack([np.zeros((1, 4)), steps, -steps])


_VARIATIONS = _variations()
SEARCH_SHAPES = symmetric_grid(SEARCH_RAMPS, SEARCH_JERKS)
"""The shapes that are tried first."""
ALL_SEARCH_SHAPES = SEARCH_SHAPES.take(np.tile(np.arange(len(SEARCH_SHAPES.start)), COORDINATES))
"""The same for every coordinate, one coordinate after the other."""


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
        np.abs(operator @ flat).reshape(shapes, -1, n, joints).max(axis=1)
        for operator in estimate_operators(samples)
    ]
    time = np.maximum(
        rates[0] / limits.velocity,
        np.maximum(np.sqrt(rates[1] / limits.acceleration), np.cbrt(rates[2] / limits.jerk)),
    )
    best = time.max(axis=2).argmin(axis=0)
    return time[best, np.arange(n)]
