"""CSV tables of a schedule: samples, events, and joint positions at every target."""

from __future__ import annotations

import csv
import io
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial

import numpy as np
import pinocchio as pin

from dualarm_cli.compiled import decimals
from dualarm_cli.exporting.files import EVENTS, SAMPLES, TARGETS
from dualarm_cli.formats.request import Column, ExportRequest, FileParts
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.job import StopKey
from dualarm_cli.model.motion.trajectory import SAME_TIME
from dualarm_cli.model.schedule import Event, Schedule, Segment
from dualarm_cli.verification.as_done import events_by_stage
from dualarm_cli.verification.measuring.tool_model import ToolModel

DECIMALS: Mapping[Column, int] = {"position": 9, "velocity": 7, "acceleration": 5}
"""Decimals of [rad], [rad/s] and [rad/s²].

Differences of positions rounded to 1e-9 rad show no more at about 100 samples per second.
"""
PLACE = 9
"""Decimals of times [s], distances [m] and quaternions."""
BLOCK = 10_000
"""Number of rows written at once."""
FORMULA = ("=", "+", "-", "@", "\t")
"""First characters that make a spreadsheet evaluate a cell."""
SAME_SAMPLE = 1e-9
"""Time after the end at which a sample still counts as the end [s]."""
POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
"""Columns of a pose in the world: position [m], unit quaternion."""
ZEROS = re.compile(r"\.?0+(?=[,\n])")
"""Superfluous trailing zeros of decimal numbers."""


def files(request: ExportRequest) -> Mapping[str, Iterable[bytes]]:
    """Build the three tables, with samples at the request's rate: [s], [rad], [m]."""
    schedule = request.schedule
    return {
        SAMPLES: FileParts(partial(samples_table, schedule, request.rate, request.columns)),
        EVENTS: [events_table(schedule)],
        TARGETS: [targets_table(schedule)],
    }


def samples_table(schedule: Schedule, rate: float, columns: Sequence[Column]) -> Iterator[bytes]:
    """Yield a row every 1 / rate seconds, in blocks: time and requested quantities.

    The last row is the first at or after the end; all joints stand there as at the end.

    Args:
        schedule: what is sampled.
        rate: samples per second [1/s].
        columns: of DECIMALS.
    """
    motion = schedule.trajectory
    start, end = float(motion.time[0]), float(motion.time[-1])
    count = int(np.ceil((end - start - SAME_SAMPLE) * rate)) + 1
    header = ["time", *(f"{_safe(name)}_{what}" for name in motion.joints for what in columns)]
    yield ",".join(header).encode() + b"\n"
    digits = [PLACE, *(DECIMALS[what] for _ in motion.joints for what in columns)]
    # In blocks, because Python numbers take ten times the memory of the array.
    for k in range(0, max(count, 1), BLOCK):
        time = start + np.arange(k, min(k + BLOCK, max(count, 1))) / rate
        rates = dict(zip(DECIMALS, motion.clamped(time), strict=True))
        over = time > end + SAME_SAMPLE
        rates["velocity"][over] = rates["acceleration"][over] = 0.0
        values = np.stack([rates[what] for what in columns], axis=2).reshape(len(time), -1)
        yield table_text(np.column_stack([time, values]), digits)


def events_table(schedule: Schedule) -> bytes:
    """Build the table of events: action, stage, signal, tool pose, grasp and width.

    Stages count from 1; a cell is empty for an event outside all stages, and for a width that is not known.
    """
    stages = _stages(schedule)
    header = ["time", "dwell", "arm", "task", "action", "stage", "signal", "frame"]
    rows = []
    for event in schedule.events:
        words = event.arm, event.task, event.action, stages.get(id(event), ""), event.signal
        times = _numbers(event.time, event.dwell)
        grip = _safe(event.grasp), *(_numbers(event.width) if event.width else [""])
        rows.append([*times, *map(_safe, (*words, event.frame)), *_pose(event.pose), *grip])
    return _table([*header, *POSE, "grasp", "width"], rows)


def targets_table(schedule: Schedule) -> bytes:
    """Build the table for robot programs: starts of lines, targets and ends of retracts.

    Each row has the pose of the arm's tool, the platform's joints, and the arm's joints as `j1`, `j2`, ….
    """
    robot, stages, model = schedule.robot, _stages(schedule), ToolModel(schedule)
    motion, rows = schedule.trajectory, []
    widest = max((len(arm.joints) for arm in robot.arms.values()), default=0)
    lines = defaultdict[StopKey, list[Segment]](list)
    for part in schedule.segments:
        if part.kind in ("approach", "retract"):
            lines[part.arm, part.task, part.action].append(part)
    points = [
        (event, *point)
        for event in schedule.events
        for point in _points(event, lines[event.arm, event.task, event.action])
    ]
    positions = motion.clamped(np.array([time for _, _, time in points]))[0]
    for (event, point, time), position in zip(points, positions, strict=True):
        pose = event.pose if point == "target" else model.pose(event.arm, position)
        words = event.arm, event.task, event.action, point
        names = [*robot.platform, *robot.arms[event.arm].joints]
        joints = _numbers(*(position[motion.joints.index(name)] for name in names))
        joints += [""] * (len(robot.platform) + widest - len(names))
        stage = stages.get(id(event), "")
        rows.append([stage, *_numbers(time), *map(_safe, words), *_pose(pose), *joints])
    header = ["stage", "time", "arm", "task", "action", "point"]
    numbered = [f"j{k + 1}" for k in range(widest)]
    return _table([*header, *POSE, *map(_safe, robot.platform), *numbered], rows)


def _points(event: Event, lines: Sequence[Segment]) -> list[tuple[str, float]]:
    """Select a stop's approach start, target and retract end, with their times [s]."""
    before = [
        line.start
        for line in lines
        if line.kind == "approach" and line.end <= event.time + SAME_TIME
    ]
    behind = [
        line.end
        for line in lines
        if line.kind == "retract" and line.start >= event.time - SAME_TIME
    ]
    stop_points = [("approach", max(before))] if before else []
    stop_points.append(("target", event.time))
    return stop_points + ([("retract", min(behind))] if behind else [])


def _stages(schedule: Schedule) -> dict[int, str]:
    """Return the number of each event's stage, from 1, by the event's identity."""
    return {
        id(event): str(number)
        for number, events in enumerate(events_by_stage(schedule), 1)
        for event in events
    }


def _pose(pose: pin.SE3) -> list[str]:
    turn = pin.Quaternion(pose.rotation).coeffs()
    return _numbers(*pose.translation, *turn)


def _numbers(*values: float) -> list[str]:
    """Format numbers for table cells without trailing zeros."""
    # Rounded first, so that there is no -0.
    texts = [f"{round(float(value), PLACE) + 0.0:.{PLACE}f}" for value in values]
    return [text.rstrip("0").rstrip(".") for text in texts]


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> bytes:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerows([header, *rows])
    return text.getvalue().encode("utf-8", "backslashreplace")


def _safe(text: str) -> str:
    """Escape a name against spreadsheet formulas and the need for quotes."""
    plain = "".join("_" if c in ',"\r\n' else c for c in text)
    return f"'{plain}" if plain.startswith(FORMULA) else plain


def table_text(rows: FloatArray, digits: Sequence[int]) -> bytes:
    """Format numbers as comma-separated lines without trailing zeros and -0.

    Args:
        rows: the numbers, shape (m, n).
        digits: decimals of each column, from 1 to `decimals.PLACES`, shape (n,).
    """
    if (np.abs(rows) <= decimals.LARGEST).all():
        return decimals.table_text(rows, digits)
    # Very large numbers and NaN occur in schedules that the verifier refuses.
    row = ",".join(f"%.{count}f" for count in digits) + "\n"
    # Rounded first, so that there is no -0.
    rounded = np.column_stack(
        [np.round(column, count) + 0.0 for column, count in zip(rows.T, digits, strict=True)]
    )
    return ZEROS.sub("", "".join(row % tuple(values) for values in rounded.tolist())).encode()
