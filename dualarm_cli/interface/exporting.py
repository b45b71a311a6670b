"""Plans in formats of other programs, as a function of Python.

`dualarm export` calls it.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from dualarm_cli.errors import OutputError, UsageError, did_you_mean
from dualarm_cli.exporting.whole_files import place_in, replace_all
from dualarm_cli.formats import FORMATS, FormatName
from dualarm_cli.formats import export as files_of
from dualarm_cli.formats.request import (
    COLUMNS,
    Column,
    ExportLoss,
    ExportRequest,
    PlatformController,
    check_rate,
    columns_named,
)
from dualarm_cli.formats.sampling import JointLoss
from dualarm_cli.geometry.interpolation import INTERPOLATIONS, Interpolation
from dualarm_cli.interface import Plan, schedule_of
from dualarm_cli.model.job import Job
from dualarm_cli.model.schedule import Schedule, ScheduleRobot
from dualarm_cli.model.verification import Verification
from dualarm_cli.records import dataclass
from dualarm_cli.verification import verify
from dualarm_cli.verification.robot_checks import unusable

EXPORT_REPORT = "export.json"
"""File that lists the exported files and the losses."""


@dataclass(frozen=True)
class Export:
    """Files of a plan in a format, with the loss of motion between samples."""

    files: Mapping[str, Iterable[bytes]]
    """Contents in parts, by file name."""
    document: dict[str, Any]
    """Content of `export.json`: files, and loss of each joint [SI units]."""
    loss: ExportLoss | None
    """Loss of motion between samples; None for formats without motion."""
    verification: Verification
    """Verification of the exported schedule."""
    sliding: frozenset[str]
    """Names of the prismatic joints."""

    def __repr__(self) -> str:
        """Describe the export in a line."""
        count = len(self.files)
        return f"<Export to {self.document['to']}: {count} {'file' if count == 1 else 'files'}>"

    def write(self, folder: str | Path, *, force: bool = False) -> Path:
        """Write the files and `export.json`, all or none; returns the folder.

        Raises:
            OutputError: a file exists already, or cannot be written.
        """
        folder = Path(folder)
        for name in (*self.files, EXPORT_REPORT):
            if not force and place_in(folder, name).exists():
                raise OutputError(f"{folder}: already holds {name}; pass force=True to replace it")
        text = json.dumps(self.document, indent=2, allow_nan=False, ensure_ascii=False) + "\n"
        listed = [text.encode("utf-8", "backslashreplace")]
        replace_all(folder, {**self.files, EXPORT_REPORT: listed})
        return folder


def export(
    plan: Plan | Schedule | str | Path,
    to: FormatName,
    *,
    job: Job | None = None,
    rate: float = 100.0,
    interpolation: Interpolation = "cubic",
    platform: PlatformController = "own",
    columns: Sequence[Column] = COLUMNS,
    uniform: bool = False,
) -> Export:
    """Build the files of a plan in another program's format; `Export.write` writes them.

    A plan that fails verification is exported as well: check `Export.verification`.

    Args:
        plan: plan, schedule, or path of a plan's folder or schedule file.
        to: format: ros2, mcap, csv, npz, parquet, perfetto or gltf.
        job: cell and tasks, which mcap and gltf need; a `Plan` brings its own.
        rate: samples per second [Hz].
        interpolation: interpolation of the receiver between points of a JointTrajectory.
        platform: controller of the platform: own, both, left or right.
        columns: columns of each joint in a CSV: position, velocity, acceleration.
        uniform: whether points of a JointTrajectory are at the rate only, not at the schedule's knots.

    Raises:
        InputError: the file cannot be read.
        MissingDependencyError: a library of the extra `export` is not installed.
        UsageError: unknown format, a value that is not allowed, or a plan that the format cannot hold.
    """
    if to not in FORMATS:
        guess = did_you_mean(to, list(FORMATS)) or ";"
        raise UsageError(f"there is no format {to!r}{guess} formats are {', '.join(FORMATS)}")
    if interpolation not in INTERPOLATIONS:
        allowed = ", ".join(INTERPOLATIONS)
        raise UsageError(f"interpolation {interpolation!r}: choose one of {allowed}")
    check_rate(rate)
    job = plan.job if isinstance(plan, Plan) and job is None else job
    schedule = schedule_of(plan, "plan", job)
    shown = "plan" if isinstance(plan, Plan | Schedule) else str(plan)
    if platform not in ("own", "both", *schedule.robot.arms):
        arms = ", ".join(schedule.robot.arms)
        raise UsageError(f"platform {platform}: the robot has no such arm: {arms}")
    judged = verify(schedule, job)
    if wrong := unusable(schedule, job, judged.failures):
        raise UsageError(f"{shown}: cannot be exported: {wrong.detail}")
    if job is not None:
        schedule = replace(schedule, robot=ScheduleRobot.of_job(job))
    request = ExportRequest(
        schedule, job, rate, interpolation, platform, columns_named(columns), uniform
    )
    form = FORMATS[to]
    if reason := form.why_unsupported(request):
        raise UsageError(f"{shown}: cannot be exported to {to}: {reason}")
    files = files_of(to, request)
    loss = ExportLoss.of(form.motion, request) if form.motion else None
    document: dict[str, Any] = {"format": "dualarm.export/1", "to": to, "files": list(files)}
    if loss is not None:
        document |= {"rate": rate, "interpolation": loss.interpolation}
        document["trajectories"] = {
            group: {
                "samples": count,
                "joints": {row.joint: _row(row) for row in loss.joints[group]},
            }
            for group, count in loss.samples.items()
        }
    return Export(files, document, loss, judged, schedule.robot.sliding)


def _row(row: JointLoss) -> dict[str, Any]:
    return {
        "deviation": row.deviation,
        "time": row.time,
        "velocity_share": row.velocity,
        "acceleration_share": row.acceleration,
        "jerk_share": row.jerk,
        "beyond_position": row.beyond,
        "within_limits": row.within_limits,
    }
