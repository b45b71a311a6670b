"""Straight lines of the tool: exact inverse kinematics, timed, then measured for straightness."""

from __future__ import annotations

import numpy as np

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.planning.stage_plan import ArmStop
from dualarm_cli.redundancy import StopProblem
from dualarm_cli.redundancy.candidates import line_path
from dualarm_cli.timing import TimingSolver
from dualarm_cli.timing.problem import LineProblem

LINE_TOLERANCE = 5e-5
"""How far the tool may leave its line [m] and its orientation [rad]: half of what is verified."""
PATH_SAMPLES = 65
"""Exact inverse kinematics along a line."""
KNOTS = (24, 48, 96, 192, 384)
"""Numbers of knots that are tried until the tool stays within the tolerance."""
CHECKS_PER_KNOT = 4
"""Instants per interval at which straightness is measured."""


def solve_line(
    arm_stop: ArmStop,
    line: str,
    limits: JointLimits,
    tool_speed: float | None,
    timing: TimingSolver,
) -> Trajectory:
    """Returns the timed motion of one arm along its approach or retract.

    Args:
        arm_stop: the arm's stop.
        line: `approach` or `retract`.
        limits: of the arm's joints.
        tool_speed: cap on the speed along the line [m/s], or None.
        timing: how lines are timed.

    Raises:
        InfeasibleError: the tool cannot be kept within the tolerance.
    """
    q, length = line_path(arm_stop.problem, arm_stop.posture, line, PATH_SAMPLES)
    for knots in KNOTS:
        trajectory = timing.line(LineProblem(limits.joints, q, length, limits, tool_speed, knots))
        distance, angle = line_deviation(arm_stop.problem, q, trajectory)
        if max(distance, angle) <= LINE_TOLERANCE:
            return trajectory
    raise InfeasibleError(
        f"{arm_stop.stop.place}: task '{arm_stop.task.id}': the {line} line is left by "
        f"{distance * 1000:.3f} mm and {angle:.2e} rad, more than {LINE_TOLERANCE * 1000} mm; "
        "the arm passes too close to a singularity"
    )


def line_deviation(
    problem: StopProblem, q: FloatArray, trajectory: Trajectory
) -> tuple[float, float]:
    """Returns how far the tool leaves its line: distance [m] and angle [rad].

    Args:
        problem: the stop the line belongs to.
        q: exact joints along the line [rad], shape (m, 7); the ends are what matters.
        trajectory: the motion to be judged.
    """
    share = np.arange(CHECKS_PER_KNOT) / CHECKS_PER_KNOT
    times = (trajectory.time[:-1, None] + np.diff(trajectory.time)[:, None] * share).ravel()
    R_end, p_end = problem.arm.forward(np.stack([q[0], q[-1]]))
    tip_in_flange = -problem.R_tool_flange.T @ problem.p_tool_flange
    ends = p_end + R_end @ tip_in_flange
    R, p = problem.arm.forward(trajectory.at(times)[0])
    tip = p + R @ tip_in_flange
    direction = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    offset = tip - ends[0]
    beside = offset - (offset @ direction)[:, None] * direction
    # |R - R0| in the Frobenius norm is 2 sqrt(2) sin(angle/2); no loss of digits near zero.
    gap = np.linalg.norm(R - R_end[0], axis=(1, 2)) / (2.0 * np.sqrt(2.0))
    angle = 2.0 * np.arcsin(np.clip(gap, 0.0, 1.0))
    return float(np.linalg.norm(beside, axis=1).max()), float(angle.max())
