"""`dualarm verify`: the independent judge of any schedule in our format."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dualarm_cli.cli.parts.output import JsonOption, QuietOption, print_json, stdout_console
from dualarm_cli.report.printable import printable

if TYPE_CHECKING:
    from dualarm_cli.model.job import Job
    from dualarm_cli.model.schedule import Schedule
    from dualarm_cli.model.verification import Check, Verification


def verify_command(
    schedule: Annotated[
        Path, typer.Argument(help="Folder of a plan, or a schedule file.", show_default=False)
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
    json_output: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Judge a schedule, also one edited by hand or made elsewhere."""
    from dataclasses import replace

    from dualarm_cli.errors import UsageError
    from dualarm_cli.exporting.schedule_reader import read_schedule
    from dualarm_cli.files.tasks.tasks import load_job
    from dualarm_cli.report.console import unproven
    from dualarm_cli.report.report import verification_document
    from dualarm_cli.verification import verify

    found = read_schedule(schedule)
    if clearance and tasks is None:
        raise UsageError(
            "--clearance needs --tasks: obstacles, tools and clearances are in the cell file"
        )
    job = load_job(tasks) if tasks else None
    judged = verify(found, job, clearance=clearance is not False and job is not None)
    checks = (*judged.checks, *_budget_checks(found, job, judged), *_file_checks(schedule, found))
    judged = replace(
        judged, checks=tuple(replace(check, detail=printable(check.detail)) for check in checks)
    )
    if json_output:
        document = verification_document(judged) or {}
        print_json({"format": "dualarm.verification/1", **document})
    elif not quiet:
        console = stdout_console()
        console.print(_table(judged))
        if judged.clearances:
            console.print(_clearances(judged))
        rows = (verification_document(judged) or {})["checks"]
        result = f"passed{unproven(rows)}" if judged.passed else "FAILED"
        console.print(f"verification: {result}", soft_wrap=True)
    if not judged.passed:
        raise typer.Exit(1)


def _budget_checks(schedule: Schedule, job: Job | None, judged: Verification) -> list[Check]:
    """Checks the task file's budget, where it has one and the numbers are usable."""
    from dataclasses import replace

    from dualarm_cli.model.verification import Check
    from dualarm_cli.verification.budget_checks import judge_budget

    usable = all(check.name not in ("finite", "time") for check in judged.failures)
    if job is None or job.budget is None or not usable:
        return []
    checks = []
    for line in judge_budget(replace(schedule, verification=judged), job):
        proven = line.measured is not None
        verdict: Any = "passed" if line.kept else "failed" if proven else "not checked"
        unit = "s" if line.name == "cycle_time" else "m"
        checks.append(
            Check(f"budget_{line.name}", verdict, line.measured, line.allowed, unit, str(line))
        )
    return checks


def _file_checks(path: Path, schedule: Schedule) -> list[Check]:
    """Checks what only the file says: its length and the files it was written with."""
    from dualarm_cli.exporting.schedule_reader import torn_files
    from dualarm_cli.model.verification import Check

    checks = []
    stated = schedule.extra.get("duration")
    if isinstance(stated, int | float):
        off = abs(float(stated) - schedule.duration)
        verdict: Any = "passed" if off <= 1e-9 else "failed"
        where = f"stated {stated:g} s, trajectory {schedule.duration:g} s"
        checks.append(Check("duration", verdict, off, 1e-9, "s", where))
    if "files" in schedule.extra:
        torn = torn_files(path, schedule)
        verdict = "failed" if torn else "passed"
        where = "; ".join(torn) or "as written"
        checks.append(Check("files", verdict, float(len(torn)), 0.0, "", where))
    return checks


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
