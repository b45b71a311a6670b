"""Check of the speed of the tools in the world."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.model.verification import Check
from dualarm_cli.verification import tolerances as tol
from dualarm_cli.verification.motion_checks import judge, not_checked
from dualarm_cli.verification.tool_model import ToolModel

STEP = 1e-3
"""Spacing of the instants at which tool speeds are measured [s]."""
HALF = 1e-5
"""Half-width of the central difference that measures them [s]."""
BLOCK = 10_000
"""Instants measured at once, so that long motions need no more memory than short ones."""
LONGEST = 7_200.0
"""Longest motion that is measured [s]."""


def check_tool_speed(schedule: Schedule, cap: float | None, model: ToolModel) -> Check:
    """Checks the cap on the speed of every tool centre point in the world, at 1 kHz and all knots.

    Args:
        schedule: what is judged.
        cap: largest speed [m/s], or None where there is none.
        model: forward kinematics of the schedule's robot.
    """
    if cap is None:
        return not_checked("tool_speed", "no cap is set")
    allowed = cap * (1.0 + tol.TOOL_SPEED_SLACK)
    trajectory = schedule.trajectory
    if trajectory.duration > LONGEST:
        where = f"a motion of {trajectory.duration:g} s cannot be measured, {LONGEST:g} s can"
        return judge("tool_speed", np.inf, allowed, "m/s", where)
    # Where acceleration jumps, the fastest instant is a knot.
    uniform = np.arange(trajectory.time[0], trajectory.time[-1], STEP)
    times = np.union1d(uniform, trajectory.time)
    worst, where = 0.0, "everywhere"
    for block in np.array_split(times, len(times) // BLOCK + 1):
        for arm, speed in _speeds(schedule, model, block).items():
            k = int(np.argmax(speed))
            if not speed[k] <= worst:
                worst, where = float(speed[k]), f"{arm} tool at {block[k]:.3f} s"
    return judge("tool_speed", worst, allowed, "m/s", where)


def _speeds(schedule: Schedule, model: ToolModel, times: FloatArray) -> dict[str, FloatArray]:
    """Returns the speed of every tool at some times [m/s], by central differences."""
    trajectory = schedule.trajectory
    # At the ends of the motion the window is cut short.
    before, after = (
        np.clip(times + shift, trajectory.time[0], trajectory.time[-1]) for shift in (-HALF, HALF)
    )
    width = after - before
    earlier, later = trajectory.at(before)[0], trajectory.at(after)[0]
    speeds = {}
    for arm in schedule.robot.arms:
        way = np.linalg.norm(model.poses(arm, later)[1] - model.poses(arm, earlier)[1], axis=1)
        speeds[arm] = np.divide(way, width, out=np.zeros_like(width), where=width > 0)
    return speeds
