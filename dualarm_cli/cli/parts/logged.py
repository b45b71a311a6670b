"""`dualarm verify LOG --plan PLAN`: what a controller logged, compared with the plan."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from dualarm_cli.errors import UsageError

if TYPE_CHECKING:
    from dualarm_cli.files.source.quantities import Dimension
    from dualarm_cli.geometry.interpolation import Interpolation
    from dualarm_cli.model.schedule import Schedule
    from dualarm_cli.verification.driven_motion import (
        DrivenJudgement,
        EventTracking,
        TrackingLimits,
    )

TABLES = (".csv", ".yaml", ".yml")
"""Suffixes of files that are no schedules."""
ERROR, DISTANCE, DELAY = "0.1 deg", "1 mm", "2 ms"
"""What a driven motion may be off by default."""


def refuse_logged(path: Path) -> None:
    """Raises where a file is no schedule but a motion, which is judged together with its plan.

    Raises:
        UsageError: with what to do.
    """
    logged = path.suffix.lower() in TABLES
    if path.suffix.lower() == ".json" and path.is_file():
        with path.open("rb") as file:
            logged = b'"joint_names"' in file.read(4096)
    if logged:
        raise UsageError(
            f"{path} is no schedule but a motion; name the plan that it is compared with: --plan PLAN"
        )


def judged_log(
    path: Path,
    schedule: Schedule,
    tasks: Path,
    between: Interpolation,
    allowed: TrackingLimits,
    *,
    clearance: bool,
    as_planned: bool,
) -> DrivenJudgement:
    """Returns the judgement of a motion.

    Args:
        path: of its file.
        schedule: the plan.
        tasks: task file of the plan.
        between: the interpolation.
        allowed: what the motion may be off.
        clearance: whether it is proven.
        as_planned: whether joints that were not logged count as driven as planned.

    Raises:
        InputError: a file cannot be read.
        UsageError: the interpolation needs what the file does not have, or the plan's numbers are not usable.
    """
    from dualarm_cli.files.logged_motion import read_logged_motion
    from dualarm_cli.files.tasks.tasks import load_job
    from dualarm_cli.verification import verify
    from dualarm_cli.verification.driven_motion import judge_driven
    from dualarm_cli.verification.robot_checks import unusable

    job = load_job(tasks)
    if wrong := unusable(schedule, job, verify(schedule, job).failures):
        raise UsageError(f"--plan: is no plan to compare with: {wrong.detail}")
    logged = read_logged_motion(path, schedule.trajectory.joints)
    try:
        return judge_driven(
            schedule, job, logged, between, allowed, clearance=clearance, as_planned=as_planned
        )
    except ValueError as error:
        raise UsageError(
            f"{path}: {error}, which the file does not have; name --interpolation linear"
        ) from None


def tracking_limits(error: str, distance: str, delay: str) -> TrackingLimits:
    """Returns what the options allow.

    Raises:
        UsageError: one is no angle, length or time above 0.
    """
    from dualarm_cli.files.source.quantities import ANGLE, LENGTH, TIME
    from dualarm_cli.verification.driven_motion import TrackingLimits

    return TrackingLimits(
        _positive("--tracking-error", error, ANGLE),
        _positive("--tool-error", distance, LENGTH),
        _positive("--delay", delay, TIME),
    )


def _positive(option: str, text: str, dimension: Dimension) -> float:
    from dualarm_cli.files.source.quantities import QuantityError, parse_quantity

    try:
        value = parse_quantity(text, dimension)
    except QuantityError as error:
        raise UsageError(f"{option}: {error}") from error
    if value <= 0.0:
        raise UsageError(f"{option} {text}: must be above 0 {dimension.unit}")
    return value


def tracking_document(tracking: DrivenJudgement) -> dict[str, Any]:
    """Returns the member `tracking` of the JSON document."""
    return {
        "delay": tracking.delay,
        "joints": {
            row.joint: {
                "delay": row.delay,
                "error": row.error,
                "time": row.time,
                "offset": row.offset,
                "error_as_logged": row.as_logged,
            }
            for row in tracking.joints
        },
        "events": [
            {
                "time": row.event.time,
                "arm": row.event.arm,
                "task": row.event.task,
                "action": row.event.action,
                "distance": row.distance,
                "angle": row.angle,
                "distance_as_logged": row.as_logged,
            }
            for row in tracking.events
        ],
    }


def tracking_tables(tracking: DrivenJudgement) -> list[Any]:
    """Returns a row for each joint, and one for each event."""
    from math import degrees

    from rich.markup import escape
    from rich.table import Table

    joints = Table(title="joints, compared with the plan", title_justify="left")
    joints.add_column("joint")
    for name in ("delay ms", "error without delay", "at s", "mean", "error as logged", "unit"):
        joints.add_column(name, justify="left" if name == "unit" else "right")
    for row in tracking.joints:
        error, mean, logged = (
            value * 1e3 if row.slides else degrees(value)
            for value in (row.error, row.offset, row.as_logged)
        )
        joints.add_row(
            escape(row.joint),
            "–" if row.delay is None else f"{round(row.delay * 1e3, 1) + 0.0:.1f}",
            f"{error:.3f}",
            f"{row.time:.3f}",
            f"{round(mean, 3) + 0.0:.3f}",
            f"{logged:.3f}",
            "mm" if row.slides else "deg",
        )
    title = f"tools at events, without the common delay of {round(tracking.delay * 1e3, 1) + 0.0:.1f} ms"
    return [joints, _event_table(title, tracking.events)]


def _event_table(title: str, rows: tuple[EventTracking, ...]) -> Any:
    from math import degrees

    from rich.markup import escape
    from rich.table import Table

    events = Table(title=title, title_justify="left")
    for name in ("at s", "off mm", "turned deg", "off as logged mm"):
        events.add_column(name, justify="right")
    for name in ("arm", "task", "action"):
        events.add_column(name)
    for row in rows:
        event = row.event
        numbers = (row.distance * 1e3, degrees(row.angle), row.as_logged * 1e3)
        words = (event.arm, event.task, event.action)
        events.add_row(
            f"{event.time:.3f}", *(f"{x:.3f}" for x in numbers), *(escape(w) for w in words)
        )
    return events
