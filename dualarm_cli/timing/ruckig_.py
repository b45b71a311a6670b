"""Transfers by ruckig: jerk-limited, time-synchronised, state to state."""

from __future__ import annotations

from typing import Any

import numpy as np

from dualarm_cli.geometry.arrays import IntArray
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.timing import double_s
from dualarm_cli.timing.composition import hold
from dualarm_cli.timing.double_s import PHASES, Phases, transfer_trajectory
from dualarm_cli.timing.problem import TransferProblem
from dualarm_cli.timing.rest_to_rest import RestToRest

SAME_DURATION = 1e-9
"""Relative difference up to which ruckig's duration is the closed form's."""
SAME_POSITION = 1e-10
"""How far from its goal a joint of ruckig's may end [rad]; it promises 1e-8."""
SAME_LIMIT = 1e-10
"""Share by which ruckig's acceleration may exceed its limit by rounding; now and then it is 6e-9."""
SHORTEST_PHASE = 1e-6
"""Phases that are not longer [s] make a profile unusable: knots a nanosecond apart become one."""


def solve_transfer(problem: TransferProblem) -> Trajectory:
    """Returns the transfer: least time of the slowest joint, or the minimum duration.

    Intermediate waypoints are never given to ruckig: its community edition would send them to a service on
    the network. The knots are ruckig's own switching times, so that nothing is lost by sampling.

    Joints keep their full acceleration and jerk and cruise more slowly. Where that makes a phase as short as
    rounding (a way of 1e-12 rad in a second), or ruckig exceeds a limit or fails, which it does now
    and then where a joint has to take a thousand seconds, the joint's closed form is slowed down instead.
    """
    limits = problem.limits
    moving = np.flatnonzero(problem.start != problem.goal).astype(np.int64)
    if moving.size == 0:
        return hold(problem.joints, problem.start, problem.minimum_duration)
    law = RestToRest(limits.velocity, limits.acceleration, limits.jerk)
    duration = max(float(law.duration(problem.goal - problem.start)), problem.minimum_duration)
    phases = double_s.fastest_phases(problem.goal - problem.start, law).slowed(duration)
    rows = {name: np.array(getattr(phases, name)) for name in ("duration", "acceleration", "jerk")}
    for joint, profile in _calculate(problem, moving, duration).items():
        rows["duration"][joint] = profile.t
        rows["acceleration"][joint] = profile.a[:PHASES]
        rows["jerk"][joint] = profile.j
    return transfer_trajectory(problem, Phases(**rows), duration)


def _calculate(problem: TransferProblem, moving: IntArray, duration: float) -> dict[int, Any]:
    """Returns ruckig's usable profiles by joint, if they take the duration [s], else nothing."""
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
    except (ruckig.RuckigError, ValueError):
        # ValueError: result codes that its Python binding does not know.
        return {}
    if result not in (ruckig.Result.Working, ruckig.Result.Finished):
        return {}
    if not abs(trajectory.duration - duration) <= SAME_DURATION * duration:
        return {}
    return {
        k: profile
        for k, profile in zip(moving.tolist(), trajectory.profiles[0], strict=True)
        if all(t == 0.0 or t > SHORTEST_PHASE for t in profile.t)
        and abs(profile.p[-1] - problem.goal[k]) <= SAME_POSITION
        and max(map(abs, profile.a)) <= limits.acceleration[k] * (1.0 + SAME_LIMIT)
    }
