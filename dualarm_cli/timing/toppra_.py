"""Lines by toppra: time-optimal along the path, for joints without a jerk limit."""

from __future__ import annotations

import os
import tempfile

import numpy as np

from dualarm_cli.errors import DualArmError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.timing.problem import LineProblem

GRIDPOINTS = 160
"""Gridpoints along the path; each becomes a knot."""


def solve_line(problem: LineProblem) -> Trajectory:
    """Returns the line timed by [Pham2018], then made to keep every limit between its gridpoints too.

    The path is parametrised by its length in joint space, never by [0, 1], on which toppra fails. Between
    gridpoints the path acceleration is constant; the joints there are cubics with the exact positions and
    velocities of both ends, so that accelerations jump at gridpoints only. At last time is stretched by the cubics' own
    extrema, about a thousandth.

    Raises:
        DualArmError: toppra finds no profile.
    """
    time, q, v = _gridpoints(problem)
    dt = np.diff(time)[:, None]
    # Cubic Hermite: accelerations at the start and the end of each interval.
    slope = np.diff(q, axis=0) / dt
    first = (6.0 * slope - 4.0 * v[:-1] - 2.0 * v[1:]) / dt
    second = (-6.0 * slope + 2.0 * v[:-1] + 4.0 * v[1:]) / dt
    rest = np.zeros((1, q.shape[1]))
    twice = np.repeat(np.arange(len(time)), 2)
    acceleration = np.empty((2 * len(time), q.shape[1]))
    acceleration[0::2] = np.vstack([rest, second])
    acceleration[1::2] = np.vstack([first, rest])
    factor = _stretch(problem, time, v, first, second)
    return Trajectory(
        problem.joints, time[twice] * factor, q[twice], v[twice] / factor, acceleration / factor**2
    )


def _stretch(
    problem: LineProblem, time: FloatArray, v: FloatArray, first: FloatArray, second: FloatArray
) -> float:
    """Returns the factor by which time must be stretched for every limit to hold, at least 1."""
    a = np.maximum(np.abs(first), np.abs(second)).max(axis=0)
    turns = first * second < 0
    jerk = (second - first) / np.diff(time)[:, None]
    inside = np.where(turns, v[:-1] - first**2 / np.where(turns, 2.0 * jerk, 1.0), 0.0)
    speed = np.maximum(np.abs(v).max(axis=0), np.abs(inside).max(axis=0))
    factor = max(
        1.0,
        float((speed / problem.limits.velocity).max()),
        float(np.sqrt((a / problem.limits.acceleration).max())),
    )
    if problem.tool_speed is not None:
        grid = np.linspace(0.0, problem.length[-1], len(problem.length))
        rate = np.gradient(problem.position, grid, axis=0)
        joint = int(np.argmax(np.abs(rate).min(axis=0)))
        along = np.interp(np.linspace(0, 1, len(v)), np.linspace(0, 1, len(rate)), rate[:, joint])
        factor = max(factor, float(np.abs(v[:, joint] / along).max()) / problem.tool_speed)
    return factor * (1.0 + 1e-12)


def _gridpoints(problem: LineProblem) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns times, positions and velocities at toppra's gridpoints."""
    # toppra loads matplotlib for its plots: no window, and no cache where HOME cannot be written.
    os.environ.setdefault("MPLBACKEND", "Agg")
    if not os.access(os.environ.get("HOME", "/nonexistent"), os.W_OK):
        os.environ.setdefault("MPLCONFIGDIR", tempfile.gettempdir())
    import toppra
    from toppra import algorithm, constraint

    step = np.linalg.norm(np.diff(problem.position, axis=0), axis=1)
    s = np.concatenate([[0.0], np.cumsum(step)])
    path = toppra.SplineInterpolator(s, problem.position)
    constraints = [
        constraint.JointVelocityConstraint(_both_ways(_path_velocity(problem))),
        constraint.JointAccelerationConstraint(_both_ways(problem.limits.acceleration)),
    ]
    grid = np.linspace(0.0, s[-1], GRIDPOINTS + 1)
    solver = algorithm.TOPPRA(constraints, path, gridpoints=grid, solver_wrapper="seidel")
    _, speed, _ = solver.compute_parameterization(0, 0)
    if speed is None or not np.isfinite(speed).all() or (speed[1:-1] <= 0).any():
        raise DualArmError("toppra finds no profile for a line; use --timing ruckig")
    time = np.concatenate([[0.0], np.cumsum(2.0 * np.diff(grid) / (speed[:-1] + speed[1:]))])
    q = np.asarray(path(grid), dtype=np.float64)
    q[0], q[-1] = problem.position[0], problem.position[-1]
    return time, q, np.asarray(path(grid, 1), dtype=np.float64) * speed[:, None]


def _path_velocity(problem: LineProblem) -> FloatArray:
    """Returns joint speed limits, lowered so that a tool-speed cap holds where it binds most."""
    if problem.tool_speed is None:
        return problem.limits.velocity
    rate = np.abs(np.gradient(problem.position, problem.length, axis=0)).max(axis=0)
    return np.minimum(problem.limits.velocity, np.maximum(rate * problem.tool_speed, 1e-9))


def _both_ways(limit: FloatArray) -> FloatArray:
    return np.column_stack([-limit, limit])
