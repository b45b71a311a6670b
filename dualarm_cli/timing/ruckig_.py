"""Transfers by ruckig: jerk-limited, time-synchronised, state to state."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from dualarm_cli.errors import DualArmError
from dualarm_cli.geometry.arrays import IntArray
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.timing.composition import hold
from dualarm_cli.timing.phases import Phase, join_joints, joint_trajectory
from dualarm_cli.timing.problem import TransferProblem

LONGEST = 7000.0
"""Longest transfer that ruckig promises to time [s]."""


def solve_transfer(problem: TransferProblem) -> Trajectory:
    """Returns the transfer: least time of the slowest joint, or the minimum duration.

    Intermediate waypoints are never given to ruckig: its community edition would send them to a service on
    the network. The knots are ruckig's own switching times, so that nothing is lost by sampling.

    Raises:
        DualArmError: ruckig finds no trajectory, which is a defect: rest to rest always has one.
    """
    moving = np.flatnonzero(problem.start != problem.goal).astype(np.int64)
    if moving.size == 0:
        return hold(problem.joints, problem.start, problem.minimum_duration)
    duration, profiles = _calculate(problem, moving)
    parts = []
    for k, name in enumerate(problem.joints):
        start, goal = float(problem.start[k]), float(problem.goal[k])
        if start == goal:
            parts.append(hold((name,), problem.start[[k]], duration))
            continue
        profile = profiles[int(np.searchsorted(moving, k))]
        phases = [Phase(d, a, j) for d, a, j in zip(profile.t, profile.a, profile.j, strict=False)]
        parts.append(joint_trajectory(name, start, goal, phases))
    return join_joints(problem.joints, parts, duration)


def _calculate(problem: TransferProblem, moving: IntArray) -> tuple[float, list[Any]]:
    """Returns ruckig's duration [s] and its profile of every moving joint."""
    import ruckig

    limits = problem.limits
    request = ruckig.InputParameter(len(moving))
    rest = [0.0] * len(moving)
    request.current_position = problem.start[moving].tolist()
    request.target_position = problem.goal[moving].tolist()
    request.current_velocity = request.target_velocity = rest
    request.current_acceleration = request.target_acceleration = rest
    request.max_velocity = limits.velocity[moving].tolist()
    request.max_acceleration = limits.acceleration[moving].tolist()
    request.max_jerk = limits.jerk[moving].tolist()
    if problem.minimum_duration > 0.0:
        request.minimum_duration = problem.minimum_duration
    trajectory = ruckig.Trajectory(len(moving))
    try:
        result = ruckig.Ruckig(len(moving)).calculate(request, trajectory)
    except Exception as error:  # ruckig's own error class says everything in twenty lines
        raise _failure(problem, str(error).splitlines()[0]) from None
    if result not in (ruckig.Result.Working, ruckig.Result.Finished):
        raise _failure(problem, str(result))
    if not math.isfinite(trajectory.duration) or trajectory.duration > LONGEST:
        raise _failure(problem, f"a duration of {trajectory.duration} s")
    return trajectory.duration, list(trajectory.profiles[0])


def _failure(problem: TransferProblem, what: str) -> DualArmError:
    return DualArmError(
        f"ruckig gives no transfer for {', '.join(problem.joints)} from {problem.start.tolist()} "
        f"to {problem.goal.tolist()}: {what}"
    )
