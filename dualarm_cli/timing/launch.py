"""Lines that begin at rest and pass their far end in motion, by a family of speed profiles."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray, readonly
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.timing.line_profile import PathCoordinates, path_and_law
from dualarm_cli.timing.problem import LineProblem
from dualarm_cli.timing.shapes import interpolate_samples
from dualarm_cli.timing.spline import largest_rates, launch_spline

PHASES = 7
"""Rising acceleration, constant, falling; constant speed; and the same three with the speed falling."""
RAMPS = (1.0, 0.8, 0.6, 0.45, 0.3, 0.2)
"""Shares of the time in which the speed rises, where the line ends at constant speed."""
JERKS = (0.5, 0.3, 0.12)
"""Shares of such a ramp in which the acceleration rises; it falls in as much."""
CONSTANT = (0.0, 1.0, 3.0, 8.0)
"""Lengths of the phase of constant acceleration, in those of the rise, where the line ends while the speed rises."""
FALLEN = (0.0, 0.33, 0.66)
"""Shares of the acceleration that is gone again at such an end."""
SPEEDS = (0.75, 0.5, 0.25)
"""Speeds at the end, as shares of the greatest, where it falls before the end."""
RISES = (0.55, 0.45, 0.3)
"""Shares of the time in which it rises then."""
SLOWER = (1.0, 1.25)
"""Factors of the least time by which each profile is slowed."""
PER_PHASE = 4
"""Instants per phase at which limits are looked at."""
PARTS = 3
"""Least number of knots' intervals in a phase: the first two knots belong to the boundary."""


@dataclass(frozen=True)
class Launch:
    """One way of passing a line's far end in motion."""

    shape: int
    """Which of the profiles of `_phases`."""
    coordinate: int
    """The path coordinate that it shapes, see `PathCoordinates`."""
    slower: float
    """Factor of the least time in which that keeps all limits."""


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


@lru_cache(maxsize=1)
def _phases() -> tuple[FloatArray, FloatArray]:
    """Returns lengths, which sum up to 1, and jerks of the phases of all profiles, shape (g, 7) each."""
    rows = []
    for ramp in RAMPS:
        for jerk in JERKS:
            rows.append((_ramp(ramp, jerk), 1.0 - ramp, (0.0, 0.0, 0.0), 0.0))
    for fallen in FALLEN:
        for constant in CONSTANT:
            rise = 1.0 / (1.0 + constant + fallen)
            rows.append(((rise, constant * rise, fallen * rise), 0.0, (0.0, 0.0, 0.0), 0.0))
    for ramp in RISES:
        for end in SPEEDS:
            fall = min(1.0 - ramp, ramp * np.sqrt(1.0 - end))
            for jerk in JERKS[:2]:
                first, last = _ramp(ramp, jerk), _ramp(fall, jerk)
                # A ramp gains its jerk times its first phase times first and second one.
                gained = (1.0 - end) * first[0] * (first[0] + first[1])
                lost = gained / (last[0] * (last[0] + last[1]))
                rows.append((first, 1.0 - ramp - fall, last, lost))
    lengths = np.array([(*first, cruise, *last) for first, cruise, last, _ in rows])
    jerks = np.array([(1.0, 0.0, -1.0, 0.0, -lost, 0.0, lost) for *_, lost in rows])
    return readonly(lengths), readonly(jerks)


def _ramp(share: float, jerk: float) -> tuple[float, float, float]:
    """Returns the three phases of a ramp that takes a share of the time, each jerk phase a share of the ramp."""
    return share * jerk, share * (1.0 - 2.0 * jerk), share * jerk


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
        found[3, :, k] = jerk
        state = found[:3, :, k, -1:]
    scaled: FloatArray = found / found[0, :, -1, -1][:, None, None]
    return scaled


@lru_cache(maxsize=1)
def _instants() -> FloatArray:
    """Returns way, speed, acceleration and jerk of all profiles where limits are looked at, (4, g, m)."""
    found = _profile(*_phases(), np.linspace(0.0, 1.0, PER_PHASE))
    return readonly(found.reshape(4, found.shape[1], -1))


def launches(problem: LineProblem) -> Launches:
    """Returns the ways of passing a line's far end, from rest at its first gridpoint.

    Of each profile the path coordinate is taken in which it is fastest; each is slowed by the factors SLOWER. Our own
    family: minimum time from event to event is in general none of its members.

    Args:
        problem: the line; its cap on the tool's speed counts.
    """
    position, law = path_and_law(problem)
    paths = PathCoordinates.measure(position, law)
    instants = _instants()
    shapes, coordinates = instants.shape[1], len(paths.share)
    times = np.stack([paths.least_time(instants, np.full(shapes, c)) for c in range(coordinates)])
    best: IntArray = times.argmin(axis=0)
    rows = np.arange(shapes)
    time = times[best, rows]
    speed, gain = instants[1][:, -1:], instants[2][:, -1:]
    # The rates of acceleration are shares of its limit, and a limit may be infinite for the tool's way alone.
    n = len(problem.joints)
    first, second = (paths.rates[best, -1, k, :n] * law.acceleration[:n] for k in (0, 1))
    velocity = first * speed / time[:, None]
    acceleration = (second * speed**2 + first * gain) / time[:, None] ** 2
    factors = np.repeat(SLOWER, shapes)
    ways = [
        Launch(int(shape), int(best[shape]), float(factor))
        for factor in SLOWER
        for shape in rows.tolist()
    ]
    many = len(SLOWER)
    return Launches(
        tuple(ways),
        np.tile(time, many) * factors,
        np.tile(velocity, (many, 1)) / factors[:, None],
        np.tile(acceleration, (many, 1)) / factors[:, None] ** 2,
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
    lengths, jerks = (rows[[launch.shape]] for rows in _phases())
    time, way = _knots(lengths, jerks, problem.knots)
    place = np.clip(interpolate_samples(paths.share[launch.coordinate][:, None], way)[:, 0], 0, 1)
    end = _profile(lengths, jerks, np.ones(1))[1, 0, -1, 0]
    last = paths.rates[launch.coordinate, -1, 0] * law.acceleration * end
    q, v, a = launch_spline(time, interpolate_samples(position, place), last)
    speed, acceleration, jerk = largest_rates(time, v, a)
    factor = max(
        float((speed / law.velocity).max()),
        float(np.sqrt((acceleration / law.acceleration).max())),
        float(np.cbrt((jerk / law.jerk).max())),
    )
    # A hair slower, so that rounding cannot push a joint over its limit.
    factor *= launch.slower * (1.0 + 1e-12)
    return Trajectory(
        problem.joints, time * factor, q[:, :n], v[:, :n] / factor, a[:, :n] / factor**2
    )


def _knots(lengths: FloatArray, jerks: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
    """Returns at least `count` knots in [0, 1], every end of a phase among them, and the way at each."""
    time, way = [np.zeros(1)], [np.zeros(1)]
    begin = 0.0
    for k, length in enumerate(lengths[0].tolist()):
        if length > 0.0:
            share = np.linspace(0.0, 1.0, 1 + max(PARTS, int(np.ceil(length * count))))
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
