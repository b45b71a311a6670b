"""`dualarm verify`: the independent judge of any schedule in our format, and of motions that were driven."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dualarm_cli.cli.parts.logged import (
    DELAY,
    DISTANCE,
    ERROR,
    judged_log,
    refuse_logged,
    tracking_document,
    tracking_limits,
    tracking_tables,
)
from dualarm_cli.cli.parts.options import ReceiverInterpolation
from dualarm_cli.cli.parts.output import JsonOption, QuietOption, print_json, stdout_console
from dualarm_cli.report.printable import printable

if TYPE_CHECKING:
    from dualarm_cli.model.verification import Verification
    from dualarm_cli.verification.driven_motion import DrivenJudgement


def verify_command(
    schedule: Annotated[
        Path,
        typer.Argument(
            help="Folder of a plan, or a schedule file; with --plan a motion that was driven: JointTrajectory or CSV.",
            show_default=False,
        ),
    ],
    tasks: Annotated[
        Path | None,
        typer.Option(
            "--tasks",
            help="Task file of the schedule; its limits, targets and order are then checked.",
            show_default=False,
        ),
    ] = None,
    clearance: Annotated[
        bool | None,
        typer.Option(
            "--clearance/--no-clearance",
            help="Prove that the whole motion is collision-free; the default with --tasks.",
            show_default=False,
        ),
    ] = None,
    plan: Annotated[
        Path | None,
        typer.Option(
            "--plan", help="Plan that a driven motion is compared with.", show_default=False
        ),
    ] = None,
    interpolation: Annotated[
        ReceiverInterpolation,
        typer.Option(
            "--interpolation",
            help="How the robot moved between the samples of a driven motion; cubic needs velocities, quintic also "
            "accelerations.",
        ),
    ] = ReceiverInterpolation.cubic,
    tracking_error: Annotated[
        str,
        typer.Option(
            "--tracking-error",
            metavar="ANGLE",
            help="Allowed error of driven joints without their delay.",
        ),
    ] = ERROR,
    tool_error: Annotated[
        str,
        typer.Option(
            "--tool-error",
            metavar="LENGTH",
            help="Allowed distance of driven tools at events, and of sliding joints.",
        ),
    ] = DISTANCE,
    delay: Annotated[
        str, typer.Option("--delay", metavar="DURATION", help="Allowed delay of driven joints.")
    ] = DELAY,
    as_planned: Annotated[
        bool,
        typer.Option(
            "--unlogged-as-planned",
            help="Take joints that are not in the log as driven as planned; without it such a log fails.",
        ),
    ] = False,
    json_output: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Judge a schedule, also one edited by hand or made elsewhere; or compare what was driven with its plan."""
    from dataclasses import replace

    if plan is not None:
        from dualarm_cli.cli.report import tasks_of
        from dualarm_cli.exporting.schedule_reader import read_schedule

        allowed = tracking_limits(tracking_error, tool_error, delay)
        planned = read_schedule(plan)
        file = tasks or tasks_of(planned, plan if plan.is_dir() else plan.parent)
        proven = clearance is not False
        tracking = judged_log(
            schedule,
            planned,
            file,
            interpolation.value,
            allowed,
            clearance=proven,
            as_planned=as_planned,
        )
        _show_driven(tracking, json_output, quiet)
        return
    refuse_logged(schedule)
    from dualarm_cli.errors import UsageError
    from dualarm_cli.interface import load, verify
    from dualarm_cli.model.verification import exceptions
    from dualarm_cli.report.report import skew_sentence, verification_document

    if clearance and tasks is None:
        raise UsageError(
            "--clearance needs --tasks: obstacles, tools and clearances are in the cell file"
        )
    job = load(tasks) if tasks else None
    judged = verify(schedule, job, clearance=clearance is not False)
    judged = replace(
        judged,
        checks=tuple(replace(check, detail=printable(check.detail)) for check in judged.checks),
    )
    if json_output:
        document = verification_document(judged) or {}
        print_json({"format": "dualarm.verification/1", **document})
    elif not quiet:
        console = stdout_console()
        console.print(_table(judged))
        if judged.clearances:
            console.print(_clearances(judged))
        if job is not None and (skew := skew_sentence(judged, job)):
            console.print(f"skew: {printable(skew)}", soft_wrap=True, markup=False)
        result = f"passed{exceptions(judged.caveats)}" if judged.passed else "FAILED"
        console.print(f"verification: {result}", soft_wrap=True)
    if not judged.passed:
        raise typer.Exit(1)


def _show_driven(tracking: DrivenJudgement, json_output: bool, quiet: bool) -> None:
    """Prints the judgement of a driven motion, and ends with 1 where it failed."""
    from dataclasses import replace

    from dualarm_cli.model.verification import exceptions
    from dualarm_cli.report.report import verification_document

    checks = tracking.verification.checks
    shown = replace(
        tracking.verification,
        checks=tuple(replace(check, detail=printable(check.detail)) for check in checks),
    )
    if json_output:
        document = verification_document(shown) or {}
        print_json(
            {
                "format": "dualarm.verification/1",
                **document,
                "tracking": tracking_document(tracking),
            }
        )
    elif not quiet:
        console = stdout_console()
        for table in (*tracking_tables(tracking), _table(shown)):
            console.print(table)
        if shown.clearances:
            console.print(_clearances(shown))
        result = f"passed{exceptions(shown.caveats)}" if shown.passed else "FAILED"
        console.print(f"driven motion: {result}", soft_wrap=True)
    if not shown.passed:
        raise typer.Exit(1)


def _clearances(judged: Verification) -> Any:
    from rich.markup import escape
    from rich.table import Table

    table = Table(title="least clearance of every stage, proven", title_justify="left")
    for name in ("#", "clearance mm", "required mm", "at s"):
        table.add_column(name, justify="right")
    table.add_column("between")
    for stage in judged.clearances:
        colour = "bold red" if stage.margin < 0.0 else "green"
        table.add_row(
            str(stage.stage + 1),
            f"[{colour}]{stage.clearance * 1e3:.1f}[/]",
            f"{stage.required * 1e3:.1f}",
            f"{stage.time:.3f}",
            escape(" and ".join(stage.bodies)),
        )
    return table


def _table(judged: Verification) -> Any:
    from rich.markup import escape
    from rich.table import Table

    table = Table()
    for name in ("check", "verdict", "measured", "allowed", "unit", "where or why"):
        table.add_column(name, justify="right" if name in ("measured", "allowed") else "left")
    colour = {"passed": "green", "failed": "bold red", "not checked": "yellow"}
    for check in judged.checks:
        table.add_row(
            check.name,
            f"[{colour[check.verdict]}]{check.verdict}[/]",
            "–" if check.measured is None else f"{check.measured:.3g}",
            "–" if check.allowed is None else f"{check.allowed:.3g}",
            check.unit,
            escape(check.detail),
        )
    return table
