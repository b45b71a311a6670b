"""Launches: speed profiles of lines that begin at rest and end in motion.

Each profile is the first part of a longer double S from rest to rest. If acceleration still rises at its end, the line
ends as fast as possible; if acceleration or speed falls, the following transfer has less to change. The family is ours:
minimum-time profiles are in general not among its members.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from dualarm_cli.compiled import trajectories
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.motion.trajectory import Trajectory
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
"""Phase ratios of whole profiles, see `Launch`; neighbours are similar."""
CUTS = tuple(np.linspace(0.24, 0.92, 12).tolist())
"""Fractions of a whole profile's time at which the line ends, rising."""
COMPARED = CUTS[5]
"""Cut at which path coordinates are compared."""


@dataclass(frozen=True)
class Launch:
    """Speed profile of a line that ends in motion: the first part of a double S."""

    constant: float
    """Duration of constant acceleration, relative to the first phase."""
    cruise: float
    """Duration of constant speed, relative to the first ramp."""
    inner: float
    """Jerk before and after constant speed, relative to the first phase."""
    cut: float
    """Fraction of the profile's time at which the line ends."""
    coordinate: int
    """Path coordinate that follows the profile, see `timing/line_profile`."""


@dataclass(frozen=True)
class Launches:
    """Launches of one line, g of them, with estimated times and end states."""

    launches: tuple[Launch, ...]
    """Parameters of each launch."""
    time: FloatArray
    """Time from rest to the line's end [s], shape (g,)."""
    velocity: FloatArray
    """Joint velocities at the line's end [rad/s], shape (g, n)."""
    acceleration: FloatArray
    """Joint accelerations at the line's end [rad/s²], shape (g, n)."""


@cache
def _all_cuts(profile: int, coordinate: int) -> tuple[Launch, ...]:
    """Combine a profile with all CUTS."""
    return tuple(Launch(*PROFILES[profile], cut, coordinate) for cut in CUTS)


def launches(problem: LineProblem) -> Launches:
    """Estimate all launches of a line, from rest at its first gridpoint.

    They are all CUTS of all PROFILES. Each profile uses the path coordinate in which it is fastest.

    Args:
        problem: the line; its limit of tool speed is kept.
    """
    n = len(problem.joints)
    coordinate, time, velocity, acceleration = trajectories.launches(
        path_of(problem), np.array(PROFILES), np.array(CUTS), COMPARED
    )
    members = [
        member
        for profile, along in enumerate(coordinate.tolist())
        for member in _all_cuts(profile, along)
    ]
    rates = (rate.reshape(len(members), -1)[:, :n] for rate in (velocity, acceleration))
    return Launches(tuple(members), time.ravel(), *rates)


def solve_launch(problem: LineProblem, launch: Launch) -> Trajectory:
    """Time a line from rest at its first gridpoint with a given launch.

    Joints pass through the path at the knots on a cubic spline; time is scaled by the spline's own exact extrema, so
    that every limit holds.

    Args:
        problem: the line.
        launch: speed profile with which the line ends.
    """
    shape = launch.constant, launch.cruise, launch.inner, launch.cut
    knots = trajectories.launched_line(path_of(problem), shape, launch.coordinate, problem.knots)
    return trajectory_of(problem, knots)


def reversed_in_time(trajectory: Trajectory) -> Trajectory:
    """Reverse a trajectory in time."""
    return Trajectory(
        trajectory.joints,
        (trajectory.time[-1] - trajectory.time)[::-1],
        trajectory.position[::-1],
        -trajectory.velocity[::-1],
        trajectory.acceleration[::-1],
    )
