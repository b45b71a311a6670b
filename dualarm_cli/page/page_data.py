"""Data of a plan's page, as one JSON document.

They include the least clearances over time, with the pair of bodies that is nearest to its required clearance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from dualarm_cli.collision.solids import are_near, geometry_model
from dualarm_cli.exporting.schedule_json import event_row, segment_row, stage_row
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, distinct
from dualarm_cli.model.job import Job
from dualarm_cli.model.schedule import Schedule, ScheduleRobot
from dualarm_cli.page.carried_objects import carried_objects, clip_to_lifetimes
from dualarm_cli.page.packed import joint_knots, packed
from dualarm_cli.page.scene import (
    DrawnHulls,
    bodies,
    drawn_hands,
    flange,
    placed,
    solids,
    tcp,
    visuals,
)
from dualarm_cli.records import dataclass
from dualarm_cli.report.critical_path import critical_path
from dualarm_cli.report.report import plan_title
from dualarm_cli.report.torques import has_torques
from dualarm_cli.robot_import.proposed_tool import tool_notes
from dualarm_cli.verification.as_done import job_as_done
from dualarm_cli.verification.clearance_checks import watched_pairs
from dualarm_cli.verification.lying_bodies import ExecutedJob
from dualarm_cli.verification.measuring.line_spans import LineSpan, line_spans
from dualarm_cli.verification.measuring.tool_model import ToolModel
from dualarm_cli.verification.torque_checks import InverseDynamics, torque_samples


def page_data(schedule: Schedule, job: Job, report: Mapping[str, Any]) -> dict[str, Any]:
    """Compose the page's data (format `dualarm.page/1`): schedule, cell and report.

    Args:
        schedule: a verified one.
        job: what it does.
        report: of the two (`build_report`).
    """
    return without_report(schedule, job) | {"report": dict(report)}


def without_report(schedule: Schedule, job: Job) -> dict[str, Any]:
    """Compose the page's data without the report; see `page_data`.

    The report takes as long to build as all other data.
    """
    done = job_as_done(schedule, job)
    model = pin.buildModelFromXML(job.cell.robot.urdf)
    hulls = DrawnHulls()
    tcps = {arm.name: tcp(model, job.cell, arm.name) for arm in job.cell.robot.arms}
    hands = drawn_hands(model, job.cell)
    seen = solids(model, job.cell, hulls)
    tools = ToolModel(schedule)
    spans = line_spans(schedule, done, tools)
    motion = ExecutedJob(schedule, done, spans, tools)
    moved = clip_to_lifetimes(carried_objects(schedule, done, hulls), motion)
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
        "visuals": visuals(model, job.cell.robot, hulls),
        "hulls": hulls.rows,
        "tcps": {
            arm: {"body": body, "hand": arm in hands} | placed(pose)
            for arm, (body, pose) in tcps.items()
        },
        "flanges": {arm: placed(flange(model, job.cell.robot, arm).placement) for arm in tcps},
        "tools": list(tool_notes(job.cell)),
        "frames": {name: placed(pose) for name, pose in job.cell.frames.items()},
        "objects": moved,
        "conveyors": _conveyors(done),
        "segments": [segment_row(segment) for segment in schedule.segments],
        "events": [event_row(event) for event in schedule.events],
        "stages": [stage_row(stage) for stage in schedule.stages],
        "pieces": _pieces(schedule),
        "clearances": clearance_curves(schedule, done, spans),
        "torques": torque_curves(schedule, done),
    }


def _joints(schedule: Schedule) -> list[dict[str, Any]]:
    """List the joints with their limits and motion, in the robot's order."""
    robot: ScheduleRobot = schedule.robot
    groups = dict.fromkeys(robot.platform, "platform")
    groups |= {joint: name for name, arm in robot.arms.items() for joint in arm.joints}
    model = pin.buildModelFromXML(robot.urdf)
    sliding = {n for n, j in zip(model.names, model.joints, strict=True) if "P" in j.shortname()}
    joints = []
    limits = robot.limits
    for k, name in enumerate(limits.joints):
        knots = joint_knots(schedule.motion, name)
        names = ("time", "position", "velocity", "acceleration")
        joints.append(
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
    return joints


def _pieces(schedule: Schedule) -> list[dict[str, Any]]:
    """List the pieces of the schedule with their slack, by segment; -1 for the platform."""
    return [
        {
            "segment": piece.segment,
            "stage": piece.stage,
            "length": round(piece.length, 6),
            "slack": round(piece.slack, 6),
        }
        for piece in critical_path(schedule).pieces
    ]


def torque_curves(schedule: Schedule, job: Job) -> dict[str, Any] | None:
    """Sample the torques of all joints over a motion, for curves.

    None without efforts or masses.

    Args:
        schedule: a verified one.
        job: as it was done (`job_as_done`).
    """
    if not has_torques(job):
        return None
    samples = list(torque_samples(InverseDynamics(job.cell), schedule, job))
    if not samples:  # a motion without length
        return None
    time = np.concatenate([part.time for part in samples])
    torque = np.vstack([part.torque for part in samples])[np.argsort(time, kind="stable")]
    rows = np.arange(0, len(time), max(len(time) // PAGE.most, 1))
    rows = distinct(np.concatenate([rows, torque.argmax(axis=0), torque.argmin(axis=0)]))
    columns = [job.cell.robot.joints.index(name) for name in schedule.robot.limits.joints]
    return {
        "time": packed(np.sort(time)[rows], "f64"),
        "values": [packed(torque[rows, k], "f32") for k in columns],
        "efforts": [float(job.cell.robot.torques.effort[k]) for k in columns],
    }


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _conveyors(job: Job) -> list[dict[str, Any]]:
    """List the conveyors with the stretch between the first and the last target."""
    belts = []
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
        belts.append(
            {
                "name": name,
                "length": float(np.ptp(reach)) + 2 * PAGE.belt_margin,
                "width": PAGE.belt_width + float(np.ptp((points - middle) @ x[:, 1])),
                "velocity": conveyor.velocity.tolist(),
            }
            | placed(pin.SE3(x, centre))
        )
    return belts


@dataclass(frozen=True)
class PageSettings:
    """Settings of a page's sampling and drawing."""

    belt_margin: float = 0.3
    """Length of a drawn belt beyond its targets at either end [m]."""
    belt_width: float = 0.2
    """Width of a drawn belt, in addition to the spread of its targets [m]."""
    per_stage: int = 20
    """Number of sampled instants per stage."""
    fewest: int = 200
    """Minimum number of sampled instants of a motion."""
    most: int = 3000
    """Maximum number of sampled instants of a motion."""


PAGE = PageSettings()


def clearance_curves(
    schedule: Schedule, job: Job, spans: Sequence[LineSpan]
) -> list[dict[str, Any]]:
    """Sample the least clearance over a motion, as curves of the page.

    One curve covers all pairs except those of near links (`are_near`), which have their own curve. Permitted contacts
    are left out on their lines. The curves prove nothing: the verifier also checks the motion between the samples.

    Args:
        schedule: a verified one.
        job: as it was done (`job_as_done`).
        spans: of its stops (`line_spans`).

    Returns:
        The curves that have pairs: two, one or none.
    """
    watched = watched_pairs(schedule, job, spans)
    model, solids, pairs, windows = watched.model, watched.solids, watched.pairs, watched.windows
    proven = schedule.verification.clearances if schedule.verification is not None else ()
    nearest = {name for stage in proven for name in stage.bodies}
    # Most waiting or lying parts are never the nearest body.
    selected = [
        k
        for k, pair in enumerate(pairs)
        if pair.required >= 0.0 and solids[pair.second].lying in {"", *nearest}
    ]
    if not selected:
        return []
    times = _instants(schedule)
    places = list(dict.fromkeys((pairs[k].first, pairs[k].second) for k in selected))
    column = {place: number for number, place in enumerate(places)}
    columns = np.array([column[pairs[k].first, pairs[k].second] for k in selected])
    required = np.array([pairs[k].required for k in selected])
    counts = np.array([_during(windows[k], times) for k in selected])
    near = np.array(
        [are_near(model, solids[pairs[k].first], solids[pairs[k].second]) for k in selected]
    )
    names = [[solids[i].label for i in (pairs[k].first, pairs[k].second)] for k in selected]
    geometry = geometry_model(solids, places)
    geometry_data, data = pin.GeometryData(geometry), model.createData()
    # Wrapped once: pinocchio fills the same result objects at each instant.
    results = list(geometry_data.distanceResults)
    order = [watched.trajectory.joints.index(name) for name in model.names[1:]]
    curves = [("clearance", ~near), ("near links", near)]
    samples = {name: _Samples() for name, members in curves if members.any()}
    for row, q in enumerate(watched.trajectory.clamped(times)[0][:, order]):
        pin.computeDistances(model, data, geometry, geometry_data, q)
        distances = np.array([result.min_distance for result in results])
        for name, members in curves:
            margins = np.where(counts[:, row] & members, distances[columns] - required, np.inf)
            least = int(np.argmin(margins))
            if np.isfinite(margins[least]):
                result = results[int(columns[least])]
                samples[name].add(times[row], least, result, job.cell.base)
    return [
        {"name": name} | item.packed(names, required) for name, item in samples.items() if item.time
    ]


class _Samples:
    """Samples of one clearance curve."""

    def __init__(self) -> None:
        """Start without samples."""
        self.time: list[float] = []
        self.pair: list[int] = []
        self.distance: list[float] = []
        self.points: list[FloatArray] = []

    def add(self, time: float, pair: int, result: Any, base: pin.SE3) -> None:
        """Add the pair with the least margin at a time [s]."""
        self.time.append(time)
        self.pair.append(pair)
        self.distance.append(result.min_distance)
        ends = (base.act(result.getNearestPoint1()), base.act(result.getNearestPoint2()))
        self.points.append(np.concatenate(ends))

    def packed(self, names: list[list[str]], required: FloatArray) -> dict[str, Any]:
        """Pack the samples for the page, with the pairs that occur in them."""
        used, pair = np.unique(self.pair, return_inverse=True)
        return {
            "time": packed(self.time, "f64"),
            "distance": packed(self.distance, "f32"),
            "pair": packed(pair, "u32"),
            "points": packed(self.points, "f32"),
            "pairs": [names[k] for k in used],
            "required": [float(required[k]) for k in used],
        }


def _instants(schedule: Schedule) -> FloatArray:
    """Select the instants at which clearances are sampled [s].

    They are evenly spaced over the motion, together with those of the least clearances.
    """
    time = schedule.trajectory.time
    count = int(np.clip(PAGE.per_stage * len(schedule.stages), PAGE.fewest, PAGE.most))
    even = np.linspace(float(time[0]), float(time[-1]), count)
    proven = schedule.verification.clearances if schedule.verification is not None else ()
    return distinct(np.concatenate([even, [stage.time for stage in proven]]))


def _during(windows: Any, times: FloatArray) -> BoolArray:
    """Mark the times at which a pair is checked, shape (n,)."""
    if windows is None:
        return np.ones(len(times), dtype=np.bool_)
    inside = np.zeros(len(times), dtype=np.bool_)
    for start, end in windows:
        inside |= (start <= times) & (times <= end)
    return inside
