"""`dualarm why`: what decides the cycle time of a plan, and which changes would shorten it."""

from __future__ import annotations

import json
import os
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dualarm_cli.cli.parts.evaluating import evaluators, open_store, progress_bar, say_unkept
from dualarm_cli.cli.parts.options import PlanTasksOption, read_duration
from dualarm_cli.cli.parts.output import (
    DetailsOption,
    JsonOption,
    ResultOnlyOption,
    print_json,
    print_message,
    stdout_console,
)
from dualarm_cli.cli.parts.score_options import CacheOption, JobsOption, NoCacheOption
from dualarm_cli.cli.report import PAGE, tasks_of
from dualarm_cli.errors import OutputError, UsageError
from dualarm_cli.report.printable import print_lines

if TYPE_CHECKING:
    from dualarm_cli.levers.estimates import Estimate
    from dualarm_cli.levers.replanning import Replanned
    from dualarm_cli.model.job import Job
    from dualarm_cli.model.schedule import Schedule


def why_command(
    plan: Annotated[Path, typer.Argument(help="Folder of a plan, or a schedule file.")],
    tasks: PlanTasksOption = None,
    budget: Annotated[
        str | None,
        typer.Option(
            "--budget",
            metavar="DURATION",
            help="Time in which levers are re-planned (30, '2 min'), largest first; 0: estimates only.",
            show_default="two plans, chosen by the estimates",
        ),
    ] = None,
    apply: Annotated[
        str | None,
        typer.Option(
            "--apply",
            metavar="DIR",
            help="Folder for a copy of the job's files with the levers that help most, or that meet the budget.",
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite earlier files.")] = False,
    jobs: JobsOption = None,
    cache: CacheOption = None,
    no_cache: NoCacheOption = False,
    json_output: JsonOption = False,
    details: DetailsOption = False,
    quiet: ResultOnlyOption = False,
) -> None:
    """Explain a plan's cycle time: critical path, slack, and levers with what they gain.

    Gains of all levers are estimated from the plan; the largest are re-planned and verified, also together.
    """
    if apply is not None and os.path.lexists(apply) and not force:
        raise OutputError(f"--apply {apply}: exists; add --force to write into it, or name another")
    seconds = 0.0 if budget in ("0", "0 s") else read_duration("--budget", budget)
    schedule, job, file, estimates = _estimated(plan, tasks)
    replanned: list[Replanned] = []
    if seconds != 0.0:
        store = open_store(cache, no_cache)
        until = None if seconds is None else monotonic() + seconds
        with evaluators(jobs, None, None, until) as run:
            replanned = _replanned(schedule, job, file, estimates, (run, store, until), quiet)
        say_unkept(store)
    document = why_of(schedule, job, file, estimates, replanned)
    if json_output:
        print_json(document)
    elif quiet:
        print_lines(stdout_console(), *document["sentences"][-1:])
    else:
        _print(document, details)
    write_why(plan if plan.is_dir() else plan.parent, document)
    if apply is not None:
        required = None if job.budget is None else job.budget.cycle_time
        _apply(Path(apply), file, replanned, required, quiet or json_output)


def _estimated(plan: Path, tasks: Path | None) -> tuple[Schedule, Job, Path, list[Estimate]]:
    """Read a plan, its job and its task file, and estimate its levers.

    Raises:
        UsageError: the plan is of another job, or does not state its settings.
    """
    from dualarm_cli.exporting.schedule_reader import read_schedule
    from dualarm_cli.files.source.bundled import task_file
    from dualarm_cli.interface import load
    from dualarm_cli.levers.estimates import estimated_levers
    from dualarm_cli.model.settings import PlanSettings
    from dualarm_cli.verification.as_done import is_change
    from dualarm_cli.verification.robot_checks import check_robot

    schedule = read_schedule(plan)
    if not PlanSettings().as_dict().keys() <= schedule.provenance.settings.keys():
        raise UsageError(
            f"{plan}: does not state the settings of its plan; plan the job again with dualarm"
        )
    file = tasks_of(schedule, plan) if tasks is None else task_file(tasks)[0]
    job = load(file)
    if (robot := check_robot(schedule, job)).verdict == "failed":
        raise UsageError(f"{plan}: is of another robot than {file}: {robot.detail}")
    stops = job.stops_by_key()
    for event in schedule.events:
        key = event.arm, event.task, event.action
        if key not in stops and not is_change(event, job):
            absent = f"{event.task} ({event.action}) of the {event.arm} arm"
            raise UsageError(
                f"{plan}: is of another job than {file}, which lacks {absent}; name its own: --tasks"
            )
    return schedule, job, file, estimated_levers(schedule, job, file)


def _apply(
    folder: Path, tasks: Path, replanned: list[Replanned], required: float | None, quiet: bool
) -> None:
    """Write a copy of a job's files with the best levers, and show the difference."""
    from dualarm_cli.exporting.whole_files import replace_all
    from dualarm_cli.levers.applying import applied
    from dualarm_cli.levers.document import best_set
    from dualarm_cli.levers.replanning import merged

    best = best_set(replanned, required)
    if best is None:
        raise UsageError(f"--apply {folder}: no re-planned lever gains time; give --budget '5 min'")
    files = applied(tasks, merged(best.levers))
    replace_all(folder, {name: [content] for name, content in files.contents.items()})
    if not quiet:
        print_lines(stdout_console(), *files.difference.splitlines())
        print_message(f"written: {folder}; plan it: dualarm plan {folder / files.tasks}")


def why_of(
    schedule: Schedule, job: Job, file: Path, estimates: list[Estimate], replanned: list[Replanned]
) -> dict[str, Any]:
    """Compose the document of a plan, with stops of sliders."""
    from dualarm_cli.levers.document import why_document
    from dualarm_cli.levers.stops import estimated_stops
    from dualarm_cli.report.printable import printable

    stops = estimated_stops(schedule, job, file, estimates)
    document: dict[str, Any] = printable(
        why_document(schedule, job, file.as_posix(), estimates, replanned, stops)
    )
    return document


def write_why(folder: Path, document: dict[str, Any]) -> None:
    """Write the document into the folder of a plan, and its levers into the page."""
    from dualarm_cli.exporting.whole_files import replace_all
    from dualarm_cli.page.what_helps import WHY, page_with_levers

    page = page_with_levers(folder / PAGE, document)
    text = json.dumps(document, indent=1, allow_nan=False, ensure_ascii=False) + "\n"
    replace_all(folder, {WHY: [text.encode()]} | ({PAGE: [page]} if page is not None else {}))


def estimates_of(folder: Path, tasks: Path) -> list[str]:
    """Write the document of a plan that was just made, with estimates alone; return its sentences."""
    document = why_of(*_estimated(folder, tasks), [])
    write_why(folder, document)
    return list(document["sentences"])


def _replanned(
    schedule: Schedule,
    job: Job,
    file: Path,
    estimates: list[Estimate],
    means: tuple[Any, Any, float | None],
    quiet: bool,
) -> list[Replanned]:
    """Plan the largest levers anew, until an instant of the clock if one is given.

    A message says how many plans ended unfinished then.
    """
    from dualarm_cli.background import usable_cores
    from dualarm_cli.evaluation.request import case_name
    from dualarm_cli.levers.replanning import Replanner, replan, request_of

    run, store, until = means
    request = request_of(schedule, file, case_name(file))
    required = None if job.budget is None else job.budget.cycle_time
    with progress_bar("planning", 0, quiet) as show:
        tell = (lambda done, words: None) if show is None else show
        replanner = Replanner(schedule, request, run, store, until, usable_cores(), tell)
        replan(replanner, estimates, required)
    if replanner.cut:
        count = "1 plan was" if replanner.cut == 1 else f"{replanner.cut} plans were"
        print_message(
            f"note: {count} cut off as the time of --budget was over; give more for its results"
        )
    return replanner.results


def _print(document: dict[str, Any], details: bool) -> None:
    from dualarm_cli.report.comparison.why_table import (
        combinations_table,
        levers_table,
        shares_table,
        stages_table,
    )

    console = stdout_console()
    console.width = min(console.width, 80)  # names of joints and frames go to a second line
    if details:
        console.print(stages_table(document))
    console.print(shares_table(document))
    levers = levers_table(document, details)
    if levers.row_count:
        console.print(levers)
    if document["combinations"]:
        console.print(combinations_table(document))
    print_lines(console, *document["sentences"])
