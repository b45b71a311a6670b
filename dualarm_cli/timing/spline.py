"""Cubic splines from rest to rest: constant jerk between knots, C2, with exact extrema."""

from __future__ import annotations

from dualarm_cli.compiled import trajectories
from dualarm_cli.geometry.arrays import FloatArray


def rest_to_rest_spline(
    time: FloatArray, position: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns positions, velocities, accelerations at the knots of a C2 cubic spline.

    The spline stands still at both ends, acceleration included. That takes two conditions more than knots to
    interpolate, so the second knot and the last but one give way: their positions follow from the
    boundary ([Biagiotti2008] §4.4.4, solved here for the accelerations of all inner knots at once).

    Args:
        time: knots [s], increasing, shape (k,), k at least 5.
        position: what to interpolate [rad], shape (k, n).
    """
    return trajectories.cubic_spline(time, position, None, None)


def clamped_spline(
    time: FloatArray, position: FloatArray, first: FloatArray, last: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns positions, velocities, accelerations at the knots of a C2 cubic spline with given end velocities.

    [Biagiotti2008] §4.4.1, solved for the accelerations.

    Args:
        time: knots [s], increasing, shape (k,), k at least 3.
        position: what to interpolate [rad], shape (k, n).
        first: velocities at the start [rad/s], shape (n,).
        last: velocities at the end [rad/s], shape (n,).
    """
    return trajectories.cubic_spline(time, position, first, last)


def largest_rates(
    time: FloatArray, velocity: FloatArray, acceleration: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns the largest |velocity|, |acceleration|, |jerk| between all knots, each (n,).

    Args:
        time: knots [s], shape (k,).
        velocity: at the knots [rad/s], shape (k, n).
        acceleration: at the knots [rad/s²], shape (k, n); linear in between. A jump, two knots at one
            time, is no jerk.
    """
    speed, largest, jerk = trajectories.largest_rates(time, velocity, acceleration)
    return speed, largest, jerk
