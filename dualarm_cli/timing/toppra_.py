"""Lines by toppra: time-optimal along the path, for joints without jerk limits."""

from __future__ import annotations

import os
import tempfile
from typing import Any

import numpy as np

from dualarm_cli.errors import DualArmError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.products import norm
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.timing.composition import hold
from dualarm_cli.timing.problem import LineProblem
from dualarm_cli.timing.spline import largest_rates

GRIDPOINTS = 160
"""Minimum number of gridpoints along the path; each becomes a knot."""
FREE_ACCELERATION = 1e4
"""Acceleration limit of the path length that stands for infinity, per largest joint limit."""


def solve_line(problem: LineProblem) -> Trajectory:
    """Time a line by [Pham2018], corrected to keep every limit between gridpoints.

    The path is parametrised by its length, scaled to the joints' length: toppra fails on [0, 1]. The length is one
    joint more, whose velocity limit is the cap on the tool's speed. Between gridpoints the joints are cubics with the
    exact positions and velocities of both ends, so that accelerations jump at gridpoints only. Finally time
    is stretched by the cubics' own extrema, about a thousandth. A line without joint motion takes no time.

    Raises:
        DualArmError: toppra finds no profile.
    """
    joint_length = float(norm(np.diff(problem.position, axis=0), axis=1).sum())
    if joint_length == 0.0 and problem.tool_speed is None:
        return hold(problem.joints, problem.position[0], 0.0)
    # Without joint motion but with a limit of tool speed, any scale works.
    total = joint_length or 1.0
    time, q, v, speed = _gridpoints(problem, total)
    dt = np.diff(time)[:, None]
    # Cubic Hermite: accelerations at the start and the end of each interval.
    slope = np.diff(q, axis=0) / dt
    first = (6.0 * slope - 4.0 * v[:-1] - 2.0 * v[1:]) / dt
    second = (-6.0 * slope + 2.0 * v[:-1] + 4.0 * v[1:]) / dt
    rest = np.zeros((1, q.shape[1]))
    twice = np.repeat(np.arange(len(time)), 2)
    a = np.empty((2 * len(time), q.shape[1]))
    a[0::2], a[1::2] = np.vstack([rest, second]), np.vstack([first, rest])
    factor = _stretch(problem, largest_rates(time[twice], v[twice], a), speed / total)
    return Trajectory(
        problem.joints, time[twice] * factor, q[twice], v[twice] / factor, a / np.square(factor)
    )


def _stretch(
    problem: LineProblem, rates: tuple[FloatArray, FloatArray, FloatArray], speed: FloatArray
) -> float:
    """Compute the factor by which time must be stretched to keep every limit.

    Args:
        problem: the line.
        rates: largest velocity, acceleration and jerk of each joint.
        speed: speed along the path at the gridpoints, in path lengths a second.
    """
    factor = max(
        1.0,
        float((rates[0] / problem.limits.velocity).max()),
        float(np.sqrt((rates[1] / problem.limits.acceleration).max())),
    )
    if problem.tool_speed is not None:
        factor = max(factor, float(speed.max() * problem.length[-1]) / problem.tool_speed)
    return factor * (1.0 + 1e-12)


def _gridpoints(
    problem: LineProblem, total: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Compute times, positions, velocities and path speeds at toppra's gridpoints.

    Args:
        problem: the line.
        total: scaled path length.
    """
    toppra = _import_toppra()
    position, velocity = problem.position, problem.limits.velocity
    acceleration = problem.limits.acceleration
    s = np.linspace(0.0, total, len(position))
    if problem.tool_speed is not None:
        position = np.column_stack([position, s])
        velocity = np.append(velocity, problem.tool_speed * total / problem.length[-1])
        acceleration = np.append(acceleration, FREE_ACCELERATION * acceleration.max())
    path = toppra.SplineInterpolator(s, position)
    constraints = [
        toppra.constraint.JointVelocityConstraint(np.column_stack([-velocity, velocity])),
        toppra.constraint.JointAccelerationConstraint(
            np.column_stack([-acceleration, acceleration])
        ),
    ]
    grid = np.linspace(0.0, total, max(GRIDPOINTS, problem.knots) + 1)
    solver = toppra.algorithm.TOPPRA(constraints, path, gridpoints=grid, solver_wrapper="seidel")
    _, speed, _ = solver.compute_parameterization(0, 0)
    if speed is None or not np.isfinite(speed).all() or (speed[1:-1] <= 0).any():
        raise DualArmError(
            f"toppra finds no profile for the line from {problem.position[0].tolist()} to "
            f"{problem.position[-1].tolist()} of {', '.join(problem.joints)}; use timing ruckig"
        )
    time = np.concatenate([[0.0], np.cumsum(2.0 * np.diff(grid) / (speed[:-1] + speed[1:]))])
    n = len(problem.joints)
    q = np.array(path(grid)[:, :n], dtype=np.float64)
    q[0], q[-1] = problem.position[0], problem.position[-1]
    v = np.asarray(path(grid, 1)[:, :n], dtype=np.float64) * speed[:, None]
    return time, q, v, np.asarray(speed, dtype=np.float64)


def _import_toppra() -> Any:
    """Import toppra without a plot window or a cache in HOME; it loads matplotlib."""
    os.environ.setdefault("MPLBACKEND", "Agg")
    if not os.access(os.environ.get("HOME", "/nonexistent"), os.W_OK):
        os.environ.setdefault("MPLCONFIGDIR", tempfile.gettempdir())
    import toppra
    import toppra.algorithm
    import toppra.constraint

    return toppra
