"""`dualarm verify`: independent verification of schedules, and of recorded motions.

`dualarm verify LOG --plan PLAN` compares a recorded motion with its plan.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dualarm_cli.cli.parts.options import ReceiverInterpolation, read_positive
from dualarm_cli.cli.parts.output import (
    DetailsOption,
    JsonOption,
    ResultOnlyOption,
    print_json,
    print_message,
    stdout_console,
)
from dualarm_cli.errors import UsageError
from dualarm_cli.report.printable import numbers, print_lines, printable

if TYPE_CHECKING:
    from dualarm_cli.geometry.interpolation import Interpolation
    from dualarm_cli.model.job import Job
    from dualarm_cli.model.schedule import Schedule
    from dualarm_cli.model.verification import Check, Verification
    from dualarm_cli.verification.recorded_motion import (
        EventTracking,
        RecordedJudgement,
        TrackingLimits,
    )


def refuse_logged(path: Path) -> None:
    """Refuse a logged motion that was given in place of a schedule.

    A motion is judged together with its plan.

    Raises:
        UsageError: with what to do.
    """
    suffix, start = path.suffix.lower(), b""
    if path.is_file():
        with path.open("rb") as file:
            start = file.read(4096)
    is_yaml = suffix in (".yaml", ".yml")
    if is_yaml and b"dualarm:" in start:
        raise UsageError(f"{path} is an input file, not a schedule; plan it, and name the plan")
    if suffix == ".csv" or is_yaml or (suffix == ".json" and b'"joint_names"' in start):
        raise UsageError(f"{path} is a motion, not a schedule; name its plan: --plan PLAN")


def judged_log(
    path: Path,
    schedule: Schedule,
    tasks: Path,
    between: Interpolation,
    allowed: TrackingLimits,
    *,
    as_planned: bool,
) -> RecordedJudgement:
    """Judge a logged motion against its plan.

    Args:
        path: of its file.
        schedule: the plan.
        tasks: task file of the plan.
        between: the interpolation.
        allowed: what the motion may be off, and whether clearance is proven.
        as_planned: whether joints missing in the log count as moved as planned.

    Raises:
        InputError: a file cannot be read.
        UsageError: the interpolation needs what the file does not have, or the plan's numbers are not usable.
    """
    from dualarm_cli.files.logged_motion import read_logged_motion
    from dualarm_cli.files.tasks.tasks import load_job
    from dualarm_cli.verification import verify
    from dualarm_cli.verification.recorded_motion import judge_recorded
    from dualarm_cli.verification.robot_checks import unusable

    job = load_job(tasks)
    if wrong := unusable(schedule, job, verify(schedule, job).failures):
        raise UsageError(f"--plan: is no plan to compare with: {wrong.detail}")
    logged = read_logged_motion(path, schedule.trajectory.joints)
    try:
        return judge_recorded(schedule, job, logged, between, allowed, as_planned=as_planned)
    except ValueError as error:
        raise UsageError(
            f"{path}: {error}, which the file does not have; name --interpolation linear"
        ) from None


def tracking_limits(error: str, distance: str, delay: str) -> TrackingLimits:
    """Parse the options that limit how far a motion may be off.

    Raises:
        UsageError: one is no angle, length or time above 0.
    """
    from dualarm_cli.files.source.quantities import ANGLE, LENGTH, TIME
    from dualarm_cli.verification.recorded_motion import TrackingLimits

    return TrackingLimits(
        read_positive("--tracking-error", error, ANGLE),
        read_positive("--tool-error", distance, LENGTH),
        read_positive("--delay", delay, TIME),
    )


def tracking_document(tracking: RecordedJudgement) -> dict[str, Any]:
    """Build the member `tracking` of the JSON document."""
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


def tracking_tables(tracking: RecordedJudgement) -> list[Any]:
    """Build the tables of tracking errors: one of joints, one of events."""
    from math import degrees

    from rich.markup import escape
    from rich.table import Table

    figures = numbers("delay ms", "error without delay", "at s", "mean", "error as logged")
    title = "joints, compared with the plan"
    joints = Table("joint", *figures, "unit", title=title, title_justify="left")
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

    figures = numbers("at s", "off mm", "turned deg", "off as logged mm")
    events = Table(*figures, "arm", "task", "action", title=title, title_justify="left")
    for row in rows:
        event = row.event
        off = (row.distance * 1e3, degrees(row.angle), row.as_logged * 1e3)
        words = (event.arm, event.task, event.action)
        events.add_row(f"{event.time:.3f}", *(f"{x:.3f}" for x in off), *(escape(w) for w in words))
    return events


def verify_command(
    schedule: Annotated[
        Path,
        typer.Argument(
            help="Folder of a plan, or a schedule file; with --plan a recorded motion: JointTrajectory or CSV."
        ),
    ],
    tasks: Annotated[
        Path | None,
        typer.Option(
            "--tasks",
            help="Task file of the schedule, for limits, targets and order; default: its original.",
        ),
    ] = None,
    clearance: Annotated[
        bool | None,
        typer.Option(
            "--clearance/--no-clearance",
            help="Prove that the whole motion is collision-free; the default with a task file.",
        ),
    ] = None,
    plan: Annotated[
        Path | None, typer.Option("--plan", help="Plan of the recorded motion.")
    ] = None,
    interpolation: Annotated[
        ReceiverInterpolation,
        typer.Option(
            "--interpolation",
            help="Interpolation between the samples of a recorded motion; cubic needs velocities, quintic also "
            "accelerations.",
        ),
    ] = ReceiverInterpolation.cubic,
    tracking_error: Annotated[
        str,
        typer.Option(
            "--tracking-error",
            metavar="ANGLE",
            help="Allowed tracking error of joints without their delay.",
        ),
    ] = "0.1 deg",
    tool_error: Annotated[
        str,
        typer.Option(
            "--tool-error",
            metavar="LENGTH",
            help="Allowed tracking error of tools at events, and of prismatic joints.",
        ),
    ] = "1 mm",
    delay: Annotated[
        str, typer.Option("--delay", metavar="DURATION", help="Allowed delay of joints.")
    ] = "2 ms",
    as_planned: Annotated[
        bool,
        typer.Option(
            "--unlogged-as-planned",
            help="Assume that joints missing in the log moved as planned; without it such a log fails.",
        ),
    ] = False,
    json_output: JsonOption = False,
    details: DetailsOption = False,
    quiet: ResultOnlyOption = False,
) -> None:
    """Verify a schedule of any origin, or compare a recorded motion with its plan."""
    if plan is not None:
        from dualarm_cli.cli.report import tasks_of
        from dualarm_cli.exporting.schedule_reader import read_schedule

        allowed = tracking_limits(tracking_error, tool_error, delay)
        planned = read_schedule(plan)
        file = tasks or tasks_of(planned, plan)
        allowed = replace(allowed, clearance=clearance is not False)
        tracking = judged_log(
            schedule, planned, file, interpolation.value, allowed, as_planned=as_planned
        )
        _show(tracking.verification, json_output, quiet, details, tracking)
        return
    refuse_logged(schedule)
    from dualarm_cli.interface import verify
    from dualarm_cli.report.report import skew_sentence

    job = _job_of(schedule, tasks, needed=bool(clearance), quiet=quiet)
    judged = verify(schedule, job, clearance=clearance is not False)
    skew = None if job is None else skew_sentence(judged, job)
    _show(judged, json_output, quiet, details, skew=skew)


def _job_of(path: Path, tasks: Path | None, *, needed: bool, quiet: bool) -> Job | None:
    """Load the job of a schedule; None if its task file is not found.

    Args:
        path: of the schedule.
        tasks: its task file; None searches for the original.
        needed: whether the schedule cannot be verified without it.
        quiet: whether a missing task file is not reported.

    Raises:
        UsageError: the job is needed, and its task file is not found.
    """
    from dualarm_cli.cli.report import tasks_of
    from dualarm_cli.exporting.schedule_reader import read_schedule
    from dualarm_cli.interface import load

    try:
        file = tasks or tasks_of(read_schedule(path), path)
    except UsageError as error:
        if needed:
            raise UsageError(
                f"--clearance needs obstacles, tools and clearances: {error}"
            ) from None
        if not quiet:
            print_message(str(error))
        return None
    return load(file)


def _show(
    judged: Verification,
    json_output: bool,
    quiet: bool,
    details: bool,
    tracking: RecordedJudgement | None = None,
    skew: str | None = None,
) -> None:
    """Print a judgement, and end with 1 where it failed.

    Args:
        judged: all checks.
        json_output: whether it is printed as JSON.
        quiet: whether only the verdict is printed.
        details: whether all checks are printed.
        tracking: tracking of a recorded motion; None for a schedule.
        skew: sentence on tolerated delays.
    """
    from dualarm_cli.model.verification import exceptions
    from dualarm_cli.report.report import verification_document
    from dualarm_cli.verification.measuring.criteria import CRITERIA

    checks = tuple(replace(check, detail=printable(check.detail)) for check in judged.checks)
    judged = replace(judged, checks=checks)
    if json_output:
        document = {"format": "dualarm.verification/1", **(verification_document(judged) or {})}
        members = {} if tracking is None else {"tracking": tracking_document(tracking)}
        print_json(document | members)
    else:
        console = stdout_console()
        if details and not quiet:
            for table in (*([] if tracking is None else tracking_tables(tracking)), _table(checks)):
                console.print(table)
            if judged.clearances:
                console.print(_clearances(judged))
            if skew:
                print_lines(console, f"skew: {printable(skew)}")
        elif not quiet:
            if judged.failures:
                console.print(_table(judged.failures))
            if count := sum(check.verdict == "not checked" for check in checks):
                print_lines(console, f"{count} checks do not apply or need more input: add -v")
        passed = [check.name for check in checks if check.verdict == "passed"]
        # Those of `plan` alone are counted, so that both commands say the same number.
        added = [name for name in passed if name in CRITERIA["Files and budget"]]
        counted = f"{len(passed) - len(added)} checks" + (f" and {', '.join(added)}" * bool(added))
        failed = ", ".join(check.name for check in judged.failures)
        result = f"passed ({counted}){exceptions(judged.caveats)}"
        what = "verification" if tracking is None else "recorded motion"
        print_lines(console, f"{what}: {result if judged.passed else f'FAILED: {failed}'}")
    if not judged.passed:
        raise typer.Exit(1)


def _clearances(judged: Verification) -> Any:
    from rich.markup import escape
    from rich.table import Table

    title = "least clearance of every stage, proven"
    figures = numbers("#", "clearance mm", "required mm", "at s")
    table = Table(*figures, "between", title=title, title_justify="left")
    for stage in judged.clearances:
        colour = "bold red" if stage.margin < 0.0 else "green"
        table.add_row(
            str(stage.stage + 1),
            f"[{colour}]{stage.clearance * 1e3:.1f}[/]",
            f"{stage.required * 1e3:.1f}",
            f"{stage.time:.3f}",
            escape(" and ".join(stage.bodies)) + " (near links)" * stage.near,
        )
    return table


def _table(checks: tuple[Check, ...]) -> Any:
    from rich.markup import escape
    from rich.table import Table

    figures = numbers("measured", "allowed")
    table = Table("check", "verdict", *figures, "unit", "where or why")
    colour = {"passed": "green", "failed": "bold red", "not checked": "yellow"}
    for check in checks:
        table.add_row(
            check.name,
            f"[{colour[check.verdict]}]{check.verdict}[/]",
            "–" if check.measured is None else f"{check.measured:.3g}",
            "–" if check.allowed is None else f"{check.allowed:.3g}",
            check.unit,
            escape(check.detail),
        )
    return table
