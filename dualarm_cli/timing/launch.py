"""Lines that begin at rest and pass their far end in motion, by a family of speed profiles.

Each profile is the first part of a longer double S from rest to rest. Where acceleration still rises at its end, the
line is left as fast as possible; where it falls, or speed does, the transfer after it has less to change. Our own
family: minimum time from event to event is in general none of its members.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from dualarm_cli.compiled import trajectories
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.records import dataclass
from dualarm_cli.timing.line_profile import path_of, trajectory_of
from dualarm_cli.timing.problem import LineProblem

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
COMPARED = CUTS[5]
"""The cut with which path coordinates are compared."""


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
    """The path coordinate that it shapes, see `timing/line_profile`."""


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


@cache
def _all_cuts(profile: int, coordinate: int) -> tuple[Launch, ...]:
    """Returns one of PROFILES with all CUTS."""
    return tuple(Launch(*PROFILES[profile], cut, coordinate) for cut in CUTS)


def launches(problem: LineProblem) -> Launches:
    """Returns the ways of passing a line's far end, from rest at its first gridpoint: all CUTS of all PROFILES.

    Of each profile the path coordinate is taken in which it is fastest.

    Args:
        problem: the line; its cap on the tool's speed counts.
    """
    n = len(problem.joints)
    coordinate, time, velocity, acceleration = trajectories.launches(
        path_of(problem), np.array(PROFILES), np.array(CUTS), COMPARED
    )
    ways = [
        way
        for profile, along in enumerate(coordinate.tolist())
        for way in _all_cuts(profile, along)
    ]
    rates = (rate.reshape(len(ways), -1)[:, :n] for rate in (velocity, acceleration))
    return Launches(tuple(ways), time.ravel(), *rates)


def solve_launch(problem: LineProblem, launch: Launch) -> Trajectory:
    """Returns the line from rest at its first gridpoint, timed so that it passes its last one in motion.

    Joints pass through the path at the knots on a cubic spline; time is scaled by the spline's own exact extrema, so
    that every limit holds.

    Args:
        problem: the line.
        launch: how it passes its far end.
    """
    shape = launch.constant, launch.cruise, launch.inner, launch.cut
    found = trajectories.launched_line(path_of(problem), shape, launch.coordinate, problem.knots)
    return trajectory_of(problem, found)


def reversed_in_time(trajectory: Trajectory) -> Trajectory:
    """Returns the same way backwards."""
    return Trajectory(
        trajectory.joints,
        (trajectory.time[-1] - trajectory.time)[::-1],
        trajectory.position[::-1],
        -trajectory.velocity[::-1],
        trajectory.acceleration[::-1],
    )
