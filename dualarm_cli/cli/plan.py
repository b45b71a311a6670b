"""`dualarm plan`: verified joint schedule and report from cell and tasks."""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dualarm_cli.cli.parts.completion import complete_job
from dualarm_cli.cli.parts.options import (
    COLUMNS,
    Blend,
    BlendOption,
    ColumnsOption,
    Effort,
    EffortOption,
    PlatformOption,
    RedundancyOption,
    SeedOption,
    TimeLimitOption,
    TimingOption,
    read_duration,
    refuse_plot,
)
from dualarm_cli.cli.parts.output import (
    STDOUT,
    JsonOption,
    ResultOnlyOption,
    print_json,
    print_message,
    print_sentences,
    refuse_two_documents,
    stderr_console,
    text_console,
    write_out,
)
from dualarm_cli.cli.report import PAGE, OpenOption, show_page
from dualarm_cli.errors import Diagnostic, InputError, UsageError
from dualarm_cli.model.place import tasks_name
from dualarm_cli.notes import Note, NoteTable
from dualarm_cli.report.printable import print_lines

if TYPE_CHECKING:
    from dualarm_cli.interface import Plan
    from dualarm_cli.kinds.drawing import Draw
    from dualarm_cli.model.job import Job
    from dualarm_cli.model.settings import PlanSettings

_note = NoteTable(
    "rate",
    reduced="schedule.csv: {rate:g} rows per second rather than {requested:g}, as at most {rows:,} rows are "
    "written",
)
StagesOption = Annotated[
    int,
    typer.Option(
        "--details",
        "-v",
        count=True,
        show_default=False,
        help="Print stages, waits, bound and notes; -vv: every stage of a long plan.",
    ),
]
MAX_ROWS = 1_000_000
"""Maximum number of rows in the CSV file: about a gigabyte for fifteen joints."""
PRELOADED = ("dualarm_cli.interface", "dualarm_cli.page.page", "ruckig", "highspy")
"""Modules of nearly every plan, besides those of kinds of work."""
STOP_LASTS = 30.0
"""Upper bound on the time of a stop with its transfer [s].

It estimates the length of jobs in advance.
"""


def plan_command(
    tasks: Annotated[
        Path,
        typer.Argument(
            help="Task file (tasks/1), or the name of a bundled job.", autocompletion=complete_job
        ),
    ],
    out: Annotated[
        str | None,
        typer.Option(
            "--out",
            help="Folder for the results; default ./JOB-plan, JOB being the task file, or the folder of tasks.yaml; "
            "- prints schedule.json only, on stdout.",
        ),
    ] = None,
    platform: PlatformOption = None,
    redundancy: RedundancyOption = None,
    timing: TimingOption = "ruckig",
    blend: BlendOption = Blend.lines,
    effort: EffortOption = Effort.normal,
    time_limit: TimeLimitOption = None,
    rate: Annotated[
        float | None,
        typer.Option("--rate", help="Samples per second of schedule.csv.", show_default="250"),
    ] = None,
    columns: ColumnsOption = COLUMNS,
    seed: SeedOption = 0,
    plot: Annotated[
        Path | None,
        typer.Option(
            "--plot",
            help="Gantt chart to write (.png, .svg, .pdf); of paths and seams also FILE_paths, FILE_seams.",
        ),
    ] = None,
    page: Annotated[
        bool, typer.Option("--page/--no-page", help="Write report.html, in which the cell moves.")
    ] = True,
    open_page: OpenOption = False,
    watch: Annotated[
        bool,
        typer.Option(
            "--watch",
            help="Plan again when a file of the job changes; a local server shows the newest page.",
        ),
    ] = False,
    why: Annotated[
        bool,
        typer.Option(
            "--why", help="Estimate levers as well, as `dualarm why --budget 0`; the page has them."
        ),
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Overwrite earlier results.")] = False,
    json_output: JsonOption = False,
    details: StagesOption = 0,
    quiet: ResultOnlyOption = False,
) -> None:
    """Plan a cell's tasks: verified joint schedule and throughput report.

    Exit code 1 if the verifier fails the plan, or if it misses the task file's budget; its files are written.
    """
    options = locals().copy()
    from dualarm_cli.formats.request import check_rate, columns_named

    if rate is not None:
        check_rate(rate, "--rate")
    chosen = columns_named(columns.split(","), "--columns")
    limit = read_duration("--time-limit", time_limit)
    if out == "":
        raise UsageError("--out '': name a folder, or leave the option out")
    refuse_two_documents(out, json_output)
    folder = Path(out) if out else Path(f"{_job_name(tasks)}-plan")
    if out != STDOUT:
        refuse_existing(folder, force)
    if plot is not None:
        refuse_plot(plot, force)
    shows = "--watch" if watch else "--open" if open_page else ""
    without = {"--out -": out == STDOUT, "--json": json_output and watch, "--no-page": not page}
    if why and out == STDOUT:
        raise UsageError("--why writes into the folder of the plan: it does not go with --out -")
    for option in (option for option, given in without.items() if given and shows):
        raise UsageError(f"{shows} shows the page of the plan: it does not go with {option}")
    if watch:
        again = {"watch": False, "open_page": False, "force": True}
        from dualarm_cli.cli.parts.while_planning import keep_planning

        keep_planning(tasks, folder / PAGE, partial(plan_command, **options | again), open_page)
        return
    job = _read(tasks)
    from dualarm_cli.background import allow_workers, usable_cores
    from dualarm_cli.exporting.files import URDF
    from dualarm_cli.exporting.schedule_json import to_json
    from dualarm_cli.exporting.whole_files import write_file
    from dualarm_cli.interface import RATE
    from dualarm_cli.model.settings import PlanSettings
    from dualarm_cli.page.page import PageNotBuiltError
    from dualarm_cli.planning.redundancy_choice import with_redundancy

    figures = figures_of(plot, job) if plot is not None else {}
    for file in figures:
        refuse_plot(file, force)
    if rate is not None:
        refuse_rate(job, rate)
    settings = PlanSettings(
        timing=timing, blend=blend.value, effort=effort.value, seed=seed, time_limit=limit
    )
    settings = with_redundancy(settings.naming(platform=platform), redundancy)
    plan = _plan_watched(job, settings, quiet)
    rate, notes = served_rate(plan.cycle_time, rate or RATE)
    schedule = replace(plan.schedule, notes=(*plan.schedule.notes, *notes))
    plan = replace(plan, schedule=schedule)
    if out == STDOUT:
        write_out(Path(out), to_json(schedule, URDF, {}), force)
    else:
        try:
            with allow_workers(usable_cores() > 1):
                plan.write(folder, rate=rate, columns=chosen, page=page, force=force)
        except PageNotBuiltError as error:
            # The plan is complete without it.
            print_message(f"no {PAGE}: {error}")
        if why:
            from dualarm_cli.cli.why import estimates_of

            sentences = estimates_of(folder, tasks)[-1:]
            if sentences and not (quiet or json_output):
                print_message(sentences[0])
    for file, draw in figures.items():
        write_file(file, draw(schedule, job, file.suffix.lower().lstrip(".")), force=True)
    report: dict[str, Any] = {**plan.report}
    if json_output:
        print_json(report)
    elif not quiet:
        _print(report, out, details)
    if out != STDOUT and not json_output:
        last = _short_result(plan, folder)
        last = last if quiet else _file_line(report, folder, page, details)
        print_sentences(out, last)
    if open_page:
        show_page(folder / PAGE)
    if not plan.verified or not plan.keeps_budget:
        raise typer.Exit(1)


def _job_name(tasks: Path) -> str:
    """Name a job before it is read, by its task file or the folder of `tasks.yaml`."""
    return tasks_name([tasks.resolve().as_posix()]) or tasks.stem


def figures_of(plot: Path, job: Job) -> dict[Path, Draw]:
    """List a job's figures by file: the Gantt chart and those of its kinds of work."""
    from dualarm_cli.kinds import of_kinds
    from dualarm_cli.report.figures.gantt_figure import draw_gantt

    figures: dict[Path, Draw] = {plot: draw_gantt}
    for kind in of_kinds("figures"):
        if kind.shows(job):
            figures[plot.with_stem(f"{plot.stem}_{kind.name}")] = kind.draw
    return figures


def refuse_rate(job: Job, rate: float) -> None:
    """Raise before planning if even the fastest possible plan has too many rows."""
    from dualarm_cli.bound.job_bound import job_bound

    most = MAX_ROWS / rate
    if most > STOP_LASTS * sum(max(1, len(task.stops)) for task in job.tasks):
        return
    least = job_bound(job, "quick", "lines").value or 0.0
    if most < least < math.inf:
        raise UsageError(
            f"--rate {rate:g}: schedule.csv would have at least {least * rate:,.0f} rows, as no plan is faster than "
            f"{least:,.1f} s; at most {MAX_ROWS:,} are written: ask for at most {math.floor(MAX_ROWS / least)} Hz"
        )


def served_rate(duration: float, rate: float) -> tuple[float, list[Note]]:
    """Limit the rate of the CSV [Hz], with a note if it is reduced."""
    if duration * rate <= MAX_ROWS:
        return rate, []
    less = MAX_ROWS / duration
    less = math.floor(less) if less >= 1.0 else less
    return less, [_note("reduced", rate=less, requested=rate, rows=MAX_ROWS)]


def refuse_existing(folder: Path, force: bool) -> None:
    """Raise before planning if results could not be written."""
    from dualarm_cli.exporting.files import check_writable

    check_writable(folder, force)


def _read(tasks: Path) -> Job:
    """Read the job of a task file, in a worker process if possible.

    Raises:
        InputError: all that is wrong with the files.
    """
    from dualarm_cli.background import BackgroundCall, allow_workers, usable_cores
    from dualarm_cli.kinds import of_kinds

    # Both processes need it, so load it once before the fork.
    import_module("dualarm_cli.model.job")

    def read() -> Job | list[Diagnostic]:
        from dualarm_cli.files.tasks.tasks import load_job

        try:
            return load_job(tasks)
        except InputError as error:
            return error.diagnostics

    # Of several plans in one process only the first one has something to import.
    apart = usable_cores() > 1 and PRELOADED[0] not in sys.modules
    with allow_workers(apart), BackgroundCall(read) as reading:
        if apart:
            for name in PRELOADED:
                import_module(name)
            for name in ("planning", "checks"):
                of_kinds(name)
        job_or_errors = reading.result()
    if isinstance(job_or_errors, list):
        raise InputError(job_or_errors)
    return job_or_errors


def _plan_watched(job: Job, settings: PlanSettings, quiet: bool) -> Plan:
    """Plan a job with progress on the terminal; Ctrl-C keeps the best plan so far."""
    from contextlib import AbstractContextManager, nullcontext

    from dualarm_cli.background import allow_workers, usable_cores
    from dualarm_cli.cli.parts.while_planning import Interrupts, StatusLine, lines_of_progress
    from dualarm_cli.interface import planned
    from dualarm_cli.orders.watch import Watch

    watch = Watch(limit=settings.time_limit)
    shown: AbstractContextManager[object] = nullcontext()
    if not quiet:
        status = StatusLine(watch, "planning")
        # Rich is loaded only where a terminal shows something.
        is_terminal = sys.stderr.isatty()
        shown = stderr_console().status(status) if is_terminal else lines_of_progress(status)
    with (
        shown,
        Interrupts(watch, quiet=quiet),
        allow_workers(usable_cores() > 1),
    ):
        return planned(job, settings, watch)


def _print(report: dict[str, Any], out: str | None, details: int) -> None:
    """Print the result, after table and sentences if requested."""
    from dualarm_cli.report.console import result_lines, shown_stages, stage_table, summary_lines

    if not details:
        print_sentences(out, *result_lines(report))
        return
    console = text_console(out)
    shown, count = shown_stages(report, every=details > 1), len(report["stages"])
    console.print(stage_table(report, shown))
    if len(shown) < count:
        print_lines(
            console, f"these are the first, the longest and the last of {count} stages: -vv has all"
        )
    print_lines(console, *summary_lines(report))


def _file_line(report: dict[str, Any], folder: Path, page: bool, details: int) -> str:
    """Name the file to open, and what is left out without details."""
    from dualarm_cli.report.console import detail_notes

    file = folder / PAGE
    line = f"open {file}" if page and file.is_file() else f"written: {folder}"
    if details:
        return line
    count = len(detail_notes(report))
    notes = f", {count} note{'s' * (count != 1)}" if count else ""
    return f"{line}; stages, waits, bound{notes}: add -v"


def _short_result(plan: Plan, folder: Path) -> str:
    """Compose the only line of `--quiet`."""
    verdict = "passed" if plan.verified else "FAILED"
    missed = "" if plan.keeps_budget else ", budget MISSED"
    open_checks = ", not fully checked" if plan.caveats else ""
    return f"{plan.cycle_time:.3f} s, verification: {verdict}{open_checks}{missed}: {folder}"
