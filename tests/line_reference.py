"""The method of lines and launches written out in numpy, against which the compiled functions are compared.

Shapes, coordinates and search are as timing/line_profile.py and timing/launch.py describe them; splines are scipy's.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from scipy.interpolate import CubicSpline

from dualarm_cli.timing.launch import COMPARED, CUTS, PROFILES
from dualarm_cli.timing.shapes import Shapes, symmetric_grid

NORM = 8
LEAST_SLOWNESS = 0.02
STENCIL = 8
TIE = 1e-12
"""Shapes whose times differ by a smaller share are equally good: the first counts."""
HANDICAP = np.array([1.0, 1.0, 1.005])
SEARCH_RAMPS = np.array([0.5, 0.42, 0.34, 0.25, 0.17, 0.1])
SEARCH_JERKS = np.array([0.5, 0.35, 0.2, 0.08])
BETWEEN = 16


def interpolate_samples(values, share):
    """Returns a path at shares of its length, by local polynomials of seventh degree, shape (k, n).

    Args:
        values: the path at equidistant samples, shape (m, n), m at least 8.
        share: places in [0, 1], shape (k,).
    """
    last = len(values) - 1
    place = share * last
    first = np.clip(place.astype(int) - (STENCIL // 2 - 1), 0, last + 1 - STENCIL)
    nodes = np.arange(STENCIL)
    # Of each node the product over all others.
    others = ~np.eye(STENCIL, dtype=bool)
    gaps = np.broadcast_to((place - first)[:, None, None] - nodes, (len(place), STENCIL, STENCIL))
    basis = np.prod(gaps, axis=2, where=others)
    basis /= np.prod(nodes[:, None] - nodes, axis=1, where=others)
    found = (basis[:, None] @ values[first[:, None] + nodes])[:, 0]
    found[share == 0.0] = values[0]
    found[share == 1.0] = values[-1]
    return found


@dataclass(frozen=True)
class PathCoordinates:
    """c coordinates of one path: share of the length at m equidistant values of each, and three derivatives there."""

    law: object
    share: np.ndarray
    """Shape (c, m)."""
    rates: np.ndarray
    """Shape (c, 3, m, n)."""

    @classmethod
    def measure(cls, position, law):
        """Returns all coordinates of a path of joints (m, n) [rad] under the joints' limits."""
        share = shares(position, law)
        q = np.stack([interpolate_samples(position, one) for one in share])
        q[0] = position
        return cls(law, share, differences(len(position)) @ q[:, None])

    def least_time(self, profile, coordinate):
        """Returns how long profiles (4, g, k) of way 1 in time 1 must take, shape (g,), along coordinates (g,)."""
        way, sd, sdd, sddd = profile[..., None]
        at = (way[..., 0] * (self.share.shape[1] - 1) + 0.5).astype(int)
        first, second, third = np.moveaxis(self.rates, 1, 0)[:, coordinate[:, None], at]
        v = first * sd / self.law.velocity
        a = (first * sdd + second * sd**2) / self.law.acceleration
        j = (first * sddd + 3.0 * second * sd * sdd + third * sd**3) / self.law.jerk
        v, a, j = (np.abs(rate).max(axis=(1, 2)) for rate in (v, a, j))
        return np.maximum(v, np.maximum(np.sqrt(a), np.cbrt(j)))

    def scaled_time(self, shapes, coordinate, per_phase=3):
        """Returns how long each shape must take, shape (g,)."""
        return self.least_time(np.stack(shapes.within_phases(per_phase)), coordinate)


def shares(position, law):
    """Returns the share of the length at equidistant values of every coordinate, shape (3, m)."""
    m = len(position)
    first, second, third = np.abs(differences(m) @ position)
    way = first.mean(axis=0)
    weight = law.per_joint(way) ** 3 / np.where(way > 0.0, way, 1.0)
    deciding = ((first * weight) ** NORM).sum(axis=1)
    steady = (
        (first / law.velocity) ** NORM
        + (second / law.acceleration) ** (NORM / 2)
        + (third / law.jerk) ** (NORM / 3)
    ).sum(axis=1)
    grid = np.linspace(0.0, 1.0, m)
    share = np.tile(grid, (3, 1))
    for k, power in enumerate((deciding, steady), start=1):
        slope = np.maximum((power / power.max()) ** (1.0 / NORM), LEAST_SLOWNESS)
        coordinate = np.append(0.0, np.cumsum((slope[1:] + slope[:-1]) / 2.0))
        slope *= (m - 1) / coordinate[-1]
        coordinate /= coordinate[-1]
        near = np.interp(grid, coordinate, grid)
        found = interpolate_samples(np.column_stack([coordinate, slope]), near)
        step = (found[:, 0] - grid) / np.maximum(found[:, 1], LEAST_SLOWNESS)
        share[k] = np.clip(near - step, 0.0, 1.0)
        share[k, [0, -1]] = 0.0, 1.0
    return share


def differences(samples):
    """Returns operators from equidistant samples on [0, 1] to three derivatives, (3, m, m)."""
    once = np.gradient(np.eye(samples), 1.0 / (samples - 1), axis=0, edge_order=2)
    return np.stack([once, once @ once, once @ once @ once])


def first_least(times):
    """Returns the first of the least times, as an index; rounding makes no difference."""
    return int(np.flatnonzero(times <= times.min() * (1.0 + TIE))[0])


def taken(shapes, index):
    """Returns one of some shapes."""
    return Shapes(*(getattr(shapes, field.name)[[index]] for field in fields(Shapes)))


def best_shape(paths):
    """Returns the index of the best coordinate and the best shape along it."""
    grid = symmetric_grid(SEARCH_RAMPS, SEARCH_JERKS)
    best = np.inf, 0, None
    for coordinate, handicap in enumerate(HANDICAP):
        times = paths.scaled_time(grid, np.full(len(grid.start), coordinate))
        index = first_least(times)
        if times[index] < 1.05 * best[0] / handicap:
            shape, time = varied(paths, coordinate, taken(grid, index), times[index])
            if time * handicap < best[0] * (1.0 - TIE):
                best = time * handicap, coordinate, shape
    return best[1:]


def varied(paths, coordinate, shape, time):
    """Returns the best variation of a shape and its time: each that is shorter is varied further."""
    random = 1
    for k in range(8):
        steps = np.empty((48, 6))
        for place in np.ndindex(steps.shape):
            random = (random * 1664525 + 1013904223) % 2**32
            steps[place] = (random >> 16) % 3 - 1
        tried = 0
        while tried < len(steps):
            change = np.array([1.4, 2.5, 2.5] * 2) ** (0.5**k * steps[tried:])
            now = np.array([getattr(shape, field.name)[0] for field in fields(Shapes)])
            parts = np.clip(now * change, 0.02, 0.9).T
            for pair, full in (([0, 3], 0.98), ([1, 2], 0.95), ([4, 5], 0.95)):
                both = parts[pair].sum(axis=0)
                parts[pair] /= np.where(both > full, both, 1.0)
            shapes = Shapes(*parts)
            times = paths.scaled_time(shapes, np.full(len(change), coordinate))
            shorter = np.flatnonzero(times < time * (1.0 - TIE))
            if not len(shorter):
                break
            shape, time = taken(shapes, shorter[0]), times[shorter[0]]
            tried += int(shorter[0]) + 1
    return shape, time


def way_of(shape, time):
    """Returns the way of one shape at instants (k,) in [0, 1]."""
    edges, state = shape.breakpoints()[0], shape.phases()[:, 0]
    phase = (time[:, None] >= edges[1:7]).sum(axis=1)
    return np.clip(advanced(state[:, phase], time - edges[phase])[0], 0.0, 1.0)


def rest_line(position, law, count):
    """Returns knot times [s] and positions [rad] of a line from rest to rest."""
    paths = PathCoordinates.measure(position, law)
    coordinate, shape = best_shape(paths)
    edges = shape.breakpoints()[0]
    edges = edges[np.append(True, np.diff(edges) > 1e-6)]
    edges[-1] = 1.0
    parts = np.maximum(1, np.ceil(np.diff(edges) * count).astype(int))
    parts[[0, -1]] = np.maximum(3, parts[[0, -1]])
    pieces = [
        np.linspace(low, high, n, endpoint=False)
        for low, high, n in zip(edges[:-1], edges[1:], parts, strict=True)
    ]
    time = np.append(np.concatenate(pieces), 1.0)
    place = interpolate_samples(paths.share[coordinate][:, None], way_of(shape, time))[:, 0]
    return timed(time, interpolate_samples(position, np.clip(place, 0.0, 1.0)), law, None)


def timed(time, q, law, last):
    """Returns times and positions of a spline through knots, scaled to the limits, from rest to rest or to a velocity.

    Knots next to an end at rest give way: scipy's spline of given velocities at the ends has accelerations there that
    are linear in those knots' positions, and they are to be none.
    """
    free, ends = ([1, len(time) - 2], [0, -1]) if last is None else ([1], [0])
    none = np.zeros(q.shape[1])

    def spline(position):
        return CubicSpline(time, position, bc_type=((1, none), (1, none if last is None else last)))

    q = q.copy()
    q[free] = q[ends]
    off = spline(q)(time[ends], 2)
    columns = []
    for row in free:
        moved = q.copy()
        moved[row] += 1.0
        columns.append((spline(moved)(time[ends], 2) - off)[:, 0])
    q[free] -= np.linalg.solve(np.array(columns).T, off)
    v, a = spline(q)(time, 1), spline(q)(time, 2)
    jerk = np.diff(a, axis=0) / np.diff(time)[:, None]
    turns = a[:-1] * a[1:] < 0.0
    inside = np.where(turns, v[:-1] - a[:-1] ** 2 / np.where(turns, 2.0 * jerk, 1.0), 0.0)
    factor = max(
        (np.abs(np.vstack([v, inside])) / law.velocity).max(),
        np.sqrt((np.abs(a) / law.acceleration).max()),
        np.cbrt((np.abs(jerk) / law.jerk).max()),
    )
    return time * factor, q


def advanced(state, dt):
    """Returns states (4, ...) after dt of constant jerk."""
    s, v, a, j = state
    return np.stack(
        [
            s + dt * (v + dt * (a / 2.0 + dt * j / 6.0)),
            v + dt * (a + dt * j / 2.0),
            a + dt * j,
            j + 0.0 * dt,
        ]
    )


def phases(profile, cut):
    """Returns lengths, which sum up to 1, and way, speed, acceleration, jerk at the starts of phases and at the end.

    Args:
        profile: constant, cruise and inner.
        cut: share of the time after which it is over.
    """
    constant, cruise, inner = profile
    ramp = [1.0, constant, 1.0 / inner]
    whole = np.array([*ramp, cruise * sum(ramp), *ramp[::-1]])
    begin = np.append(0.0, np.cumsum(whole)[:-1])
    lengths = np.clip(cut * whole.sum() - begin, 0.0, whole)
    lengths /= lengths.sum()
    state, states = np.zeros(3), []
    for length, jerk in zip(lengths, [1.0, 0.0, -inner, 0.0, -inner, 0.0, 1.0], strict=True):
        states.append([*state, jerk if length > 0.0 else 0.0])
        state = advanced(states[-1], length)[:3]
    return lengths, np.array([*states, [*state, 0.0]]) / state[0]


def launches(position, law):
    """Returns coordinates (p,), times (p, c), velocities and accelerations (p, c, n) at the far end."""
    paths = PathCoordinates.measure(position, law)
    found = [], [], [], []
    for profile in PROFILES:
        times = [launch_time(paths, profile, COMPARED, c) for c in (0, 1)]
        along = first_least(np.array(times))
        found[0].append(along)
        for cut in CUTS:
            _, speed, gain, _ = phases(profile, cut)[1][-1]
            time = launch_time(paths, profile, cut, along)
            first, second = paths.rates[along, :2, -1]
            found[1].append(time)
            found[2].append(first * speed / time)
            found[3].append((second * speed**2 + first * gain) / time**2)
    shape = len(PROFILES), len(CUTS)
    rates = (np.array(rate).reshape(*shape, -1) for rate in found[2:])
    return np.array(found[0]), np.array(found[1]).reshape(shape), *rates


def launch_time(paths, profile, cut, coordinate):
    """Returns how long a profile must take along a coordinate."""
    lengths, states = phases(profile, cut)
    instants = []
    for length, state in zip(lengths, states[:-1], strict=True):
        if length > 0.0:
            share = np.linspace(0, BETWEEN, 2 + int(length * BETWEEN)).round() / BETWEEN
            instants.append(advanced(state[:, None], length * share))
    instants = np.concatenate(instants, axis=1)[:, None]
    instants[0] = np.clip(instants[0], 0.0, 1.0)
    return paths.least_time(instants, np.array([coordinate]))[0]


def launched_line(position, law, launch, count):
    """Returns knot times [s] and positions [rad] of a line that passes its far end in motion."""
    paths = PathCoordinates.measure(position, law)
    lengths, states = phases((launch.constant, launch.cruise, launch.inner), launch.cut)
    time, way = [0.0], [0.0]
    for k, (length, state) in enumerate(zip(lengths, states[:-1], strict=True)):
        if length * count > 0.3:
            parts = max(1 if k else 3, round(length * count))
            dt = length * np.arange(1, parts + 1) / parts
            time += (lengths[:k].sum() + dt).tolist()
            way += advanced(state[:, None], dt)[0].tolist()
    time[-1] = way[-1] = 1.0
    way = np.clip(way, 0.0, 1.0)
    place = interpolate_samples(paths.share[launch.coordinate][:, None], way)[:, 0]
    q = interpolate_samples(position, np.clip(place, 0.0, 1.0))
    return timed(np.array(time), q, law, paths.rates[launch.coordinate, 0, -1] * states[-1][1])
