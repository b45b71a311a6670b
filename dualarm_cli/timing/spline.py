"""Cubic splines from rest to rest: constant jerk between knots, C2, with exact extrema."""

from __future__ import annotations

from dualarm_cli.compiled import trajectories
from dualarm_cli.geometry.arrays import FloatArray


def rest_to_rest_spline(
    time: FloatArray, position: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Compute a C2 cubic spline from rest to rest: position, velocity, acceleration at knots.

    Velocity and acceleration vanish at both ends. These are two conditions more than knots to
    interpolate, so the second knot and the last but one are not interpolated: their positions follow from the
    boundary ([Biagiotti2008] §4.4.4, solved here for the accelerations of all inner knots at once).

    Args:
        time: knots [s], increasing, shape (k,), k at least 5.
        position: values at the knots [rad], shape (k, n).
    """
    return trajectories.cubic_spline(time, position, None, None)


def clamped_spline(
    time: FloatArray, position: FloatArray, first: FloatArray, last: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Compute a C2 cubic spline with given end velocities: position, velocity, acceleration at knots.

    [Biagiotti2008] §4.4.1, solved for the accelerations.

    Args:
        time: knots [s], increasing, shape (k,), k at least 3.
        position: values at the knots [rad], shape (k, n).
        first: velocities at the start [rad/s], shape (n,).
        last: velocities at the end [rad/s], shape (n,).
    """
    return trajectories.cubic_spline(time, position, first, last)


def largest_rates(
    time: FloatArray, velocity: FloatArray, acceleration: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Compute the largest |velocity|, |acceleration| and |jerk| over all intervals, each (n,).

    Args:
        time: knots [s], shape (k,).
        velocity: at the knots [rad/s], shape (k, n).
        acceleration: at the knots [rad/s²], shape (k, n); linear in between. A jump (two knots at one
            time) is no jerk.
    """
    speed, largest, jerk = trajectories.largest_rates(time, velocity, acceleration)
    return speed, largest, jerk
