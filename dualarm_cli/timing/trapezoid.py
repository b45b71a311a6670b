"""Transfers by synchronised trapezoids in closed form, for joints without a jerk limit."""

from __future__ import annotations

import numpy as np

from dualarm_cli.model.robot import JointLimits
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.timing.composition import hold
from dualarm_cli.timing.phases import Phase, join_joints, joint_trajectory
from dualarm_cli.timing.problem import TransferProblem
from dualarm_cli.timing.rest_to_rest import RestToRest


def why_unsupported(limits: JointLimits) -> str | None:
    """Returns why joints with such limits need jerk-limited timing, or None."""
    limited = [
        joint for joint, jerk in zip(limits.joints, limits.jerk, strict=True) if np.isfinite(jerk)
    ]
    if not limited:
        return None
    return (
        f"{len(limited)} joints have jerk limits ({', '.join(limited[:3])}...), which it does not keep; "
        "use --timing ruckig"
    )


def solve_transfer(problem: TransferProblem) -> Trajectory:
    """Returns the transfer: every joint keeps its full acceleration and cruises as slowly as it may.

    In a time T a joint with acceleration a covers d with the cruising speed
    v = (a T - sqrt(a² T² - 4 a d)) / 2, the smaller root of v T - v²/a = d.
    """
    distance = problem.goal - problem.start
    limits = problem.limits
    law = RestToRest(limits.velocity, limits.acceleration, np.full_like(limits.velocity, np.inf))
    duration = max(float(law.duration(distance)), problem.minimum_duration)
    if not distance.any():
        return hold(problem.joints, problem.start, duration)
    parts = []
    for k, name in enumerate(problem.joints):
        d, a = abs(float(distance[k])), float(limits.acceleration[k])
        start, goal = float(problem.start[k]), float(problem.goal[k])
        if d == 0.0:
            parts.append(hold((name,), problem.start[[k]], duration))
            continue
        root = np.sqrt(max(0.0, (a * duration) ** 2 - 4.0 * a * d))
        # The product of both roots is a d: no digits are lost for slow joints.
        speed = 2.0 * a * d / (a * duration + root)
        ramp, sign = float(speed) / a, np.sign(goal - start)
        cruise = max(0.0, duration - 2.0 * ramp)
        phases = [
            Phase(ramp, sign * a, 0.0),
            Phase(cruise, 0.0, 0.0),
            Phase(ramp, -sign * a, 0.0),
        ]
        parts.append(joint_trajectory(name, start, goal, phases))
    return join_joints(problem.joints, parts, duration)
