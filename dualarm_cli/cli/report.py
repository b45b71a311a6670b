"""`dualarm report`: the page of a plan that exists."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dualarm_cli.cli.parts.output import QuietOption, print_message
from dualarm_cli.errors import UsageError

if TYPE_CHECKING:
    from dualarm_cli.model.job import Job
    from dualarm_cli.model.schedule import Schedule

PAGE = "report.html"
"""Name of the page beside a schedule."""


def report_command(
    plan: Annotated[
        Path, typer.Argument(help="Folder of a plan, or a schedule file.", show_default=False)
    ],
    tasks: Annotated[
        Path | None,
        typer.Option(
            "--tasks",
            help="Task file of the plan; by default the one that it was made of, if it is found unchanged.",
            show_default=False,
        ),
    ] = None,
    open_page: Annotated[bool, typer.Option("--open", help="Show it in the browser.")] = False,
    quiet: QuietOption = False,
) -> None:
    """Write the page of a plan: report.html, in which the cell moves. The plan is verified anew."""
    from dataclasses import replace

    from dualarm_cli.exporting.schedule_reader import read_schedule
    from dualarm_cli.files.tasks.tasks import load_job
    from dualarm_cli.report.report import build_report
    from dualarm_cli.verification import verify

    schedule = read_schedule(plan)
    folder = plan if plan.is_dir() else plan.parent
    file = tasks if tasks is not None else tasks_of(schedule, folder)
    job = load_job(file)
    schedule = replace(schedule, verification=verify(schedule, job, clearance=True))
    page = write_page(folder, schedule, job, build_report(schedule, job))
    if not quiet:
        print_message(f"written: {page}")
    if open_page:
        import webbrowser

        webbrowser.open(page.absolute().as_uri())
    assert schedule.verification is not None
    if not schedule.verification.passed:
        failed = [c.name for c in schedule.verification.checks if c.verdict == "failed"]
        print_message(f"verification: FAILED: {', '.join(failed)}; `dualarm verify` tells more")
        raise typer.Exit(1)


def write_page(folder: Path, schedule: Schedule, job: Job, report: dict[str, Any]) -> Path:
    """Writes the page beside a schedule, and returns its path.

    Raises:
        OutputError: it cannot be written.
        PageNotBuiltError: this installation has no code of the page.
    """
    from dualarm_cli.exporting.whole_files import write_file
    from dualarm_cli.page.page import page_html
    from dualarm_cli.page.page_data import page_data

    page = folder / PAGE
    write_file(page, page_html(page_data(schedule, job, report)), force=True)
    return page


def tasks_of(schedule: Schedule, folder: Path) -> Path:
    """Returns the task file that a schedule was made of.

    It is looked for by its name within the project, here, above and around the plan, and among the bundled jobs.

    Raises:
        UsageError: it is not there, or has been changed since.
    """
    from dualarm_cli.files.source.bundled import bundled_tasks

    name, digest = next(iter(schedule.provenance.inputs.items()), ("", ""))
    here, there = Path.cwd(), folder.absolute()
    places = (here, *here.parents, there, *there.parents)
    found = [place / name for place in places if name and (place / name).is_file()]
    for file in (*found, *bundled_tasks().values()):
        if hashlib.sha256(file.read_bytes()).hexdigest() == digest:
            return file
    why = f"{found[0]} has changed since" if found else f"there is no {name or 'task file'} here"
    raise UsageError(f"the task file of the plan is not found: {why}; name it with --tasks")
