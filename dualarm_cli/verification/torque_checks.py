"""Check of the joints' torques on paths that ask for it."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from dualarm_cli.model.cell import Cell
from dualarm_cli.model.job import Job
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.model.verification import Check
from dualarm_cli.verification import tolerances as tol
from dualarm_cli.verification.motion_checks import not_checked
from dualarm_cli.verification.tool_checks import Worst, dense_times

NAME = "path_torque"
"""The check."""


def check_torques(schedule: Schedule, job: Job | None) -> Check:
    """Checks that torques, also of an arm that stands, stay within the URDF's limits on paths that ask for it.

    By the recursive Newton-Euler algorithm, each tool's mass at its tool centre point.

    Args:
        schedule: with finite numbers and rising times.
        job: cell and tasks; without them nothing is known of paths.
    """
    asked = (
        {} if job is None else {t.id: t for t in job.tasks if t.path is not None and t.path.torque}
    )
    if job is None or not asked:
        return not_checked(NAME, "no path is to keep the joints' torques within limits")
    model = _model(job.cell)
    names = list(model.names)[1:]
    columns = [schedule.trajectory.joints.index(name) for name in names]
    data, worst = model.createData(), Worst()
    for segment in schedule.segments:
        if segment.kind != "path" or segment.task not in asked or segment.end <= segment.start:
            continue
        time = dense_times(schedule.trajectory.time, segment.start, segment.end)
        motion = [rate[:, columns] for rate in schedule.trajectory.at(time)]
        for k, (q, v, a) in enumerate(zip(*motion, strict=True)):
            share = np.abs(pin.rnea(model, data, q, v, a)) / model.upperEffortLimit
            joint = int(np.argmax(share))
            where = f"{names[joint]} on {segment.task} at {time[k]:.3f} s"
            worst.add(float(share[joint]), where)
    return worst.judge(
        NAME, 1.0 + tol.TORQUE_SLACK, "share of the limit", "no segment of kind path"
    )


def _model(cell: Cell) -> pin.Model:
    """Returns the robot with its tools' masses, gravity as it is where the robot stands."""
    model = pin.buildModelFromXML(cell.robot.urdf)
    model.gravity.linear = cell.base.rotation.T @ model.gravity.linear
    for arm in cell.robot.arms:
        tool = cell.tools[arm.name]
        frame = model.frames[model.getFrameId(arm.flange, pin.FrameType.BODY)]
        if tool.mass > 0.0:
            point = pin.Inertia(tool.mass, np.zeros(3), np.zeros((3, 3)))
            model.appendBodyToJoint(frame.parentJoint, point, frame.placement * tool.tcp)
    return model
