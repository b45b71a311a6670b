"""Everything that the page shows, as one JSON document."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pinocchio as pin

from dualarm_cli.exporting.schedule_json import event_row, segment_row, stage_row
from dualarm_cli.model.job import Job
from dualarm_cli.model.schedule import Schedule, ScheduleRobot
from dualarm_cli.page.clearance_curve import clearance_curves
from dualarm_cli.page.packed import joint_knots, packed
from dualarm_cli.page.scene import DrawnHulls, bodies, placed, solids, tcp
from dualarm_cli.page.things import things, while_they_are_there
from dualarm_cli.report.report import plan_title
from dualarm_cli.verification.as_done import job_as_done


def page_data(schedule: Schedule, job: Job, report: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the page's data (format `dualarm.page/1`): the schedule itself, the cell, the report.

    Args:
        schedule: a verified one.
        job: what it does.
        report: of the two (`build_report`).
    """
    return without_report(schedule, job) | {"report": dict(report)}


def without_report(schedule: Schedule, job: Job) -> dict[str, Any]:
    """Returns all of the page's data but the report, which takes as long to make; see `page_data`."""
    done = job_as_done(schedule, job)
    model = pin.buildModelFromXML(job.cell.robot.urdf)
    hulls = DrawnHulls()
    tcps = {arm.name: tcp(model, job.cell, arm.name) for arm in job.cell.robot.arms}
    seen = solids(model, job.cell, hulls)
    moved = while_they_are_there(things(schedule, done, hulls), schedule, done)
    return {
        "format": "dualarm.page/1",
        "title": plan_title(schedule),
        "robot": job.cell.robot.name,
        "version": schedule.provenance.version,
        "duration": schedule.duration,
        "closes": job.returns,
        "joints": _joints(schedule),
        "bodies": bodies(model, job.cell.robot, job.cell.base),
        "solids": seen,
        "hulls": hulls.rows,
        "tcps": {arm: {"body": body} | placed(pose) for arm, (body, pose) in tcps.items()},
        "things": moved,
        "conveyors": _conveyors(done),
        "segments": [segment_row(segment) for segment in schedule.segments],
        "events": [event_row(event) for event in schedule.events],
        "stages": [stage_row(stage) for stage in schedule.stages],
        "clearances": clearance_curves(schedule, done),
    }


def _joints(schedule: Schedule) -> list[dict[str, Any]]:
    """Returns the joints with their limits and their motion, in the order of the robot's joints."""
    robot: ScheduleRobot = schedule.robot
    groups = dict.fromkeys(robot.platform, "platform")
    groups |= {joint: name for name, arm in robot.arms.items() for joint in arm.joints}
    model = pin.buildModelFromXML(robot.urdf)
    sliding = {n for n, j in zip(model.names, model.joints, strict=True) if "P" in j.shortname()}
    found = []
    limits = robot.limits
    for k, name in enumerate(limits.joints):
        knots = joint_knots(schedule.motion, name)
        names = ("time", "position", "velocity", "acceleration")
        found.append(
            {
                "name": name,
                "group": groups[name],
                "slides": name in sliding,
                "limits": {
                    "lower": _finite(limits.lower[k]),
                    "upper": _finite(limits.upper[k]),
                    "velocity": _finite(limits.velocity[k]),
                    "acceleration": _finite(limits.acceleration[k]),
                    "jerk": _finite(limits.jerk[k]),
                    "source": limits.source[k],
                },
                "knots": {n: packed(row, "f64") for n, row in zip(names, knots, strict=True)},
            }
        )
    return found


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _conveyors(job: Job) -> list[dict[str, Any]]:
    """Returns the conveyors with the stretch on which they are served, as their targets tell it."""
    found = []
    for name, conveyor in job.cell.conveyors.items():
        along = conveyor.velocity / conveyor.speed
        ends = []
        for task in job.tasks:
            for stop in task.stops:
                if stop.belt is not None and stop.belt.conveyor.name == name:
                    pose, belt = stop.belt.moved(stop.target.pose, stop.belt.passes)  # type: ignore[union-attr]
                    ends += [pose.translation, pose.translation + belt.within * along]
        if not ends:
            continue
        points = np.array(ends)
        middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
        reach = (points - middle) @ along
        side = np.cross([0.0, 0.0, 1.0], along)
        x = np.column_stack([along, side / np.linalg.norm(side), [0.0, 0.0, 1.0]])
        centre = middle + 0.5 * (reach.max() + reach.min()) * along
        centre[2] = points[:, 2].min()
        found.append(
            {
                "name": name,
                "length": float(np.ptp(reach)) + 2 * BELT_MARGIN,
                "width": BELT_WIDTH + float(np.ptp((points - middle) @ x[:, 1])),
                "velocity": conveyor.velocity.tolist(),
            }
            | placed(pin.SE3(x, centre))
        )
    return found


BELT_MARGIN, BELT_WIDTH = 0.3, 0.2
"""How a belt is drawn whose cell file says only how fast it is: beyond what is served, and across [m]."""
