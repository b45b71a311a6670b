"""Lines that begin at rest and pass their far end in motion, by a family of speed profiles.

Each profile is the first part of a longer double S from rest to rest. Where acceleration still rises at its end, the
line is left as fast as possible; where it falls, or speed does, the transfer after it has less to change. Our own
family: minimum time from event to event is in general none of its members.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, readonly
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.timing.line_profile import PathCoordinates, path_and_law
from dualarm_cli.timing.problem import LineProblem
from dualarm_cli.timing.shapes import interpolate_samples
from dualarm_cli.timing.spline import largest_rates, launch_spline

PHASES = 7
"""Rising acceleration, constant, falling; constant speed; and the same three with the speed falling."""
PROFILES = (
    (0.0, 0.0, 1.0),
    (0.0, 0.0, 0.6),
    (0.3, 0.0, 1.0),
    (0.3, 0.0, 0.6),
    (0.8, 0.0, 1.0),
    (0.8, 0.0, 0.6),
    (2.0, 0.0, 1.0),
    (5.0, 0.0, 1.0),
    (20.0, 0.0, 1.0),
    (4.0, 4.0, 1.0),
    (1.5, 2.0, 1.0),
    (0.5, 1.0, 1.0),
)
"""Constant, cruise and inner, see `Launch`, of whole profiles; neighbours are alike."""
CUTS = tuple(np.linspace(0.24, 0.92, 12).tolist())
"""Shares of a whole profile's time after which the line is over, rising."""
COMPARED = 5
"""Index of the cut with which path coordinates are compared."""
ROUNDING = 1.0 + 1e-12
"""A hair slower, so that rounding cannot push a joint over its limit."""
BETWEEN = 16
"""So many instants between ends of phases are looked at in the whole time."""
COORDINATES = 2
"""So many of the path coordinates are tried; the others are too rough where the speed is greatest at the end."""
PARTS = 3
"""Least number of knots' intervals in the first phase: its first two knots belong to the boundary."""
SHORTEST = 0.3
"""Length of a phase that gets no knot of its own, in the mean distance of knots."""


@dataclass(frozen=True)
class Launch:
    """One way of passing a line's far end in motion: as the first part of a longer line from rest to rest."""

    constant: float
    """Length of the whole profile's phases of constant acceleration, in those of its first one."""
    cruise: float
    """Length of its phase of constant speed, in those of its first one's ramp."""
    inner: float
    """Jerk before and after constant speed, in that of its first phase."""
    cut: float
    """Share of its time after which the line is over."""
    coordinate: int
    """The path coordinate that it shapes, see `PathCoordinates`."""


@dataclass(frozen=True)
class Launches:
    """Ways of passing the far end of one line, g of them; estimates that exact motions come near to."""

    ways: tuple[Launch, ...]
    """What each is."""
    time: FloatArray
    """How long each takes from rest to the far end [s], shape (g,)."""
    velocity: FloatArray
    """Joints' velocities there [rad/s], shape (g, n)."""
    acceleration: FloatArray
    """Joints' accelerations there [rad/s²], shape (g, n)."""


def _phases(profiles: FloatArray, cut: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Returns lengths, which sum up to 1, and jerks up to a factor of the phases of profiles, (g, 7) each.

    Args:
        profiles: constant, cruise and inner of each, see `Launch`, shape (g, 3).
        cut: shares of their time, shape (g,).
    """
    constant, cruise, inner = profiles.T
    one, none = np.ones_like(cut), np.zeros_like(cut)
    ramp = [one, constant, one / inner]
    lengths = np.stack([*ramp, cruise * (1.0 + constant + one / inner), *ramp[::-1]], axis=1)
    beyond = np.cumsum(lengths, axis=1) - cut[:, None] * lengths.sum(axis=1, keepdims=True)
    kept = np.clip(lengths - beyond, 0.0, lengths)
    jerks = np.stack([one, none, -inner, none, -inner, none, one], axis=1)
    return kept / kept.sum(axis=1, keepdims=True), jerks


def _profile(lengths: FloatArray, jerks: FloatArray, share: FloatArray) -> FloatArray:
    """Returns way, speed, acceleration and jerk of profiles of way 1 in time 1, shape (4, g, 7, k).

    Args:
        lengths: of the phases, shape (g, 7).
        jerks: of the phases, up to a factor, shape (g, 7).
        share: instants in each phase, as shares of it, rising from 0 to 1, shape (k,).
    """
    state = np.zeros((3, len(lengths), 1))
    found = np.zeros((4, len(lengths), PHASES, len(share)))
    for k in range(PHASES):
        dt, jerk = lengths[:, k, None] * share, jerks[:, k, None]
        s, v, a = state
        found[0, :, k] = s + dt * (v + dt * (a / 2.0 + dt * jerk / 6.0))
        found[1, :, k] = v + dt * (a + dt * jerk / 2.0)
        found[2, :, k] = a + dt * jerk
        # A phase of no length has no jerk.
        found[3, :, k] = jerk * (lengths[:, k, None] > 0.0)
        state = found[:3, :, k, -1:]
    scaled: FloatArray = found / found[0, :, -1, -1][:, None, None]
    return scaled


@lru_cache(maxsize=1)
def _instants() -> FloatArray:
    """Returns way, speed, acceleration and jerk of all profiles with all cuts where limits are compared, (4, g, m).

    These are both ends of each phase and instants between them, the longer the phase the more.
    """
    profiles = np.repeat(np.array(PROFILES), len(CUTS), axis=0)
    lengths, jerks = _phases(profiles, np.tile(CUTS, len(PROFILES)))
    found = _profile(lengths, jerks, np.linspace(0.0, 1.0, BETWEEN + 1))
    rows = []
    for k, counts in enumerate((lengths * BETWEEN).astype(np.int64).tolist()):
        at = [
            (phase, x)
            for phase, count in enumerate(counts)
            if lengths[k, phase] > 0.0
            for x in np.linspace(0, BETWEEN, 2 + count).round().astype(np.int64).tolist()
        ]
        rows.append(found[:, k, *np.array(at).T])
    most = max(row.shape[1] for row in rows)
    return readonly(
        np.stack([np.pad(row, ((0, 0), (0, most - row.shape[1])), "edge") for row in rows], axis=1)
    )


def launches(problem: LineProblem) -> Launches:
    """Returns the ways of passing a line's far end, from rest at its first gridpoint: all CUTS of all PROFILES.

    Of each profile the path coordinate is taken in which it is fastest.

    Args:
        problem: the line; its cap on the tool's speed counts.
    """
    position, law = path_and_law(problem)
    paths = PathCoordinates.measure(position, law)
    instants = _instants()
    many = len(CUTS)
    compared = instants[:, COMPARED::many]
    times = [paths.least_time(compared, np.full(len(PROFILES), c)) for c in range(COORDINATES)]
    coordinate = np.repeat(np.argmin(times, axis=0), many)
    time = paths.least_time(instants, coordinate) * ROUNDING
    speed, gain = instants[1][:, -1:], instants[2][:, -1:]
    # The rates of acceleration are shares of its limit, and a limit may be infinite for the tool's way alone.
    n = len(problem.joints)
    first, second = (paths.rates[coordinate, -1, k, :n] * law.acceleration[:n] for k in (0, 1))
    ways = [
        Launch(*profile, cut, int(coordinate[k * many]))
        for k, profile in enumerate(PROFILES)
        for cut in CUTS
    ]
    return Launches(
        tuple(ways),
        time,
        first * speed / time[:, None],
        (second * speed**2 + first * gain) / time[:, None] ** 2,
    )


def solve_launch(problem: LineProblem, launch: Launch) -> Trajectory:
    """Returns the line from rest at its first gridpoint, timed so that it passes its last one in motion.

    Joints pass through the path at the knots on a cubic spline; time is scaled by the spline's own exact extrema, so
    that every limit holds.

    Args:
        problem: the line.
        launch: how it passes its far end.
    """
    n = len(problem.joints)
    position, law = path_and_law(problem)
    paths = PathCoordinates.measure(position, law)
    profile = np.array([[launch.constant, launch.cruise, launch.inner]])
    phases = _phases(profile, np.array([launch.cut]))
    time, way = _knots(*phases, problem.knots)
    place = np.clip(interpolate_samples(paths.share[launch.coordinate][:, None], way)[:, 0], 0, 1)
    end = _profile(*phases, np.ones(1))[1, 0, -1, 0]
    last = paths.rates[launch.coordinate, -1, 0] * law.acceleration * end
    q, v, a = launch_spline(time, interpolate_samples(position, place), last)
    speed, acceleration, jerk = largest_rates(time, v, a)
    factor = max(
        float((speed / law.velocity).max()),
        float(np.sqrt((acceleration / law.acceleration).max())),
        float(np.cbrt((jerk / law.jerk).max())),
    )
    factor *= ROUNDING
    return Trajectory(
        problem.joints, time * factor, q[:, :n], v[:, :n] / factor, a[:, :n] / factor**2
    )


def _knots(lengths: FloatArray, jerks: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
    """Returns about `count` knots in [0, 1], ends of all phases but very short ones among them, and the way at each.

    Knots that are much nearer to each other than others would let the spline swing.
    """
    time, way = [np.zeros(1)], [np.zeros(1)]
    begin = 0.0
    for k, length in enumerate(lengths[0].tolist()):
        if length * count > SHORTEST:
            parts = max(1 if k else PARTS, round(length * count))
            share = np.linspace(0.0, 1.0, 1 + parts)
            time.append(begin + length * share[1:])
            way.append(_profile(lengths, jerks, share)[0, 0, k, 1:])
        begin += length
    knots, ways = np.concatenate(time), np.clip(np.concatenate(way), 0.0, 1.0)
    knots[-1] = ways[-1] = 1.0
    return knots, ways


def reversed_in_time(trajectory: Trajectory) -> Trajectory:
    """Returns the same way backwards."""
    return Trajectory(
        trajectory.joints,
        (trajectory.time[-1] - trajectory.time)[::-1],
        trajectory.position[::-1],
        -trajectory.velocity[::-1],
        trajectory.acceleration[::-1],
    )
