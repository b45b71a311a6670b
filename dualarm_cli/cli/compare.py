"""`dualarm compare`: methods on the same work, and schedules of the same work."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from dualarm_cli.cli.parts.completion import complete_job, complete_solver
from dualarm_cli.cli.parts.help import HelpCommand, HelpGroup
from dualarm_cli.cli.parts.options import (
    SOLVERS,
    Effort,
    EffortOption,
    SeedOption,
    refuse_plot,
)
from dualarm_cli.cli.parts.output import (
    JsonOption,
    ResultOnlyOption,
    print_json,
    print_message,
    stderr_console,
    stdout_console,
)
from dualarm_cli.cli.parts.result_files import json_bytes, refuse_folder, write_folder
from dualarm_cli.errors import UnknownSolverError, UsageError
from dualarm_cli.report.printable import print_lines, printable

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from dualarm_cli.model.job import Job
    from dualarm_cli.model.schedule import Schedule
    from dualarm_cli.model.settings import PlanSettings
    from dualarm_cli.page.side_by_side import PlanKey
    from dualarm_cli.planning.comparison import Case, Outcome
    from dualarm_cli.report.comparisons import SolverComparison

DOCUMENT, TABLE, FIGURE = "comparison.json", "comparison.csv", "comparison.png"
SOLVERS_PAGE = "comparison.html"
SCHEDULES_DOCUMENT, SCHEDULES_TABLE = "schedules.json", "schedules.csv"
SCHEDULES_PAGE = "schedules.html"

compare_app = typer.Typer(
    name="compare",
    help="Compare methods or schedules on the same work.",
    no_args_is_help=True,
    rich_markup_mode=None,
    cls=HelpGroup,
)
OutOption = Annotated[str | None, typer.Option("--out", help="Folder for the results.")]
ForceOption = Annotated[bool, typer.Option("--force", help="Overwrite earlier results.")]


@compare_app.command("solvers", cls=HelpCommand)
def solvers_command(
    tasks: Annotated[
        list[Path] | None,
        typer.Argument(
            help="Task files (tasks/1). Default: the bundled ones.", autocompletion=complete_job
        ),
    ] = None,
    method: Annotated[
        list[str] | None,
        typer.Option(
            "--method",
            help=f"Method of `plan --platform`: {SOLVERS['method']}; repeatable.",
            autocompletion=complete_solver("method"),
            show_default="all",
        ),
    ] = None,
    redundancy: Annotated[
        list[str] | None,
        typer.Option(
            "--redundancy",
            help=f"Redundancy solver: {SOLVERS['redundancy']}; of paths: {SOLVERS['path follower']}; repeatable.",
            autocompletion=complete_solver("redundancy", "path follower"),
            show_default="all",
        ),
    ] = None,
    timing: Annotated[
        list[str] | None,
        typer.Option(
            "--timing",
            metavar=f"{SOLVERS['timing']}|all",
            help="Timing solver; repeatable.",
            autocompletion=complete_solver("timing"),
            show_default="ruckig",
        ),
    ] = None,
    effort: EffortOption = Effort.normal,
    seed: SeedOption = 0,
    out: OutOption = None,
    plot: Annotated[
        Path | None, typer.Option("--plot", help="Figure to write (.png, .svg, .pdf).")
    ] = None,
    page: Annotated[
        bool,
        typer.Option(
            "--page",
            help="Write comparison.html as well: each method's plan in motion next to the fastest one.",
        ),
    ] = False,
    force: ForceOption = False,
    json_output: JsonOption = False,
    quiet: ResultOnlyOption = False,
) -> None:
    """Plan the same work by every method, and compare the plans.

    The rows have cycle time, share above the bound and planning time; the winner is named.

    --out writes comparison.json, comparison.csv and comparison.png. Wall-clock times are in the JSON's last member and
    the CSV's last column only. Exit code 1 if the verifier fails a plan, 3 if a job has no plan by any method.
    """
    from dualarm_cli.model.settings import PlanSettings
    from dualarm_cli.planning.comparison import job_cases
    from dualarm_cli.stages.methods import METHODS

    for name in set(method or ()) - set(METHODS.names):
        raise UnknownSolverError("method", name, METHODS.names)
    _refuse(out, plot, page, force)
    jobs = _jobs(tasks or [])
    named = (method or (), redundancy or (), timing or ())
    matrices = {name: job_cases(job, *named) for name, job in jobs.items()}
    settings = PlanSettings(effort=effort.value, seed=seed)
    plans: dict[PlanKey, dict[str, Any]] | None = {} if page else None
    document = _compare(jobs, matrices, settings, plans, quiet)
    if plot is not None or out is not None:
        _write(document, plans, out, plot, quiet)
    if json_output:
        print_json(document)
    elif quiet:
        sentences = (section["sentence"] for section in document["comparisons"])
        print_lines(stdout_console(), *sentences)
    else:
        from dualarm_cli.report.comparison.comparison_table import print_solvers

        print_solvers(stdout_console(), document)
    if code := _exit_code(document):
        raise typer.Exit(code)


def _refuse(out: str | None, plot: Path | None, page: bool, force: bool) -> None:
    """Raise before planning if results could not be written."""
    if page:
        refuse_page(out, SOLVERS_PAGE)
    if out is not None:
        refuse_folder(out, (DOCUMENT, TABLE, FIGURE, *([SOLVERS_PAGE] if page else [])), force)
    if plot is not None:
        refuse_plot(plot, force)


def refuse_page(out: str | None, name: str) -> None:
    """Raise if a page has no folder, or this installation cannot build one.

    Args:
        out: the folder.
        name: of the page.

    Raises:
        UsageError: there is no folder.
        PageNotBuiltError: this installation has no code of the page.
    """
    from dualarm_cli.page.page import require_built

    if out is None:
        raise UsageError(f"--page writes {name}: name its folder with --out")
    require_built()


def _jobs(paths: list[Path]) -> dict[str, Job]:
    """Load the jobs by their names; all errors are raised at once."""
    from dualarm_cli.errors import Diagnostic, InputError
    from dualarm_cli.files.source.bundled import bundled_tasks
    from dualarm_cli.files.tasks.tasks import load_job

    names = {str(path): path for path in paths} or bundled_tasks()
    if not names:
        raise UsageError("no bundled task files are installed; name task files")
    jobs: dict[str, Job] = {}
    wrong: list[Diagnostic] = []
    for name, path in names.items():
        try:
            jobs[name] = load_job(path)
        except InputError as error:
            wrong += [finding for finding in error.diagnostics if finding not in wrong]
    if wrong:
        raise InputError(wrong)
    return jobs


def _compare(
    jobs: dict[str, Job],
    matrices: dict[str, list[Case]],
    settings: PlanSettings,
    plans: dict[PlanKey, dict[str, Any]] | None,
    quiet: bool,
) -> SolverComparison:
    """Build the document of all jobs.

    `plans`, if given, gets the data of the plans' pages.
    """
    from functools import partial

    from dualarm_cli.interface import compare_solvers

    console = stderr_console()
    effort = cast("Any", settings.effort)
    run = partial(compare_solvers, jobs, cases=matrices, effort=effort, seed=settings.seed)
    if plans is not None:
        run = partial(run, kept=partial(_kept, plans))
    if quiet or not console.is_terminal:
        return run()
    from rich.markup import escape

    with console.status("comparing") as status:
        return run(progress=lambda text: status.update(escape(text)))


def _kept(
    plans: dict[PlanKey, dict[str, Any]], name: str, job: Job, outcomes: Iterator[Outcome]
) -> Iterator[Outcome]:
    """Yield outcomes, and adds the data of their plans' pages."""
    from dualarm_cli.page.page_data import page_data
    from dualarm_cli.report.comparison.comparison import SOLVERS
    from dualarm_cli.report.report import build_report

    for outcome in outcomes:
        schedule = outcome.schedule
        if schedule is not None:
            key = printable(name), *(getattr(outcome.case, solver) for solver in SOLVERS)
            plans[key] = page_data(schedule, job, build_report(schedule, job))
        yield outcome


def _write(
    document: Mapping[str, Any],
    plans: dict[PlanKey, dict[str, Any]] | None,
    out: str | None,
    plot: Path | None,
    quiet: bool,
) -> None:
    """Write the folder and the requested figure, and report it unless quiet."""
    say: Callable[[str], None] = (lambda _: None) if quiet else print_message
    from dualarm_cli.errors import MissingDependencyError
    from dualarm_cli.exporting.whole_files import write_file
    from dualarm_cli.report.comparison.comparison_table import comparison_csv
    from dualarm_cli.report.figures.comparison_figure import draw_comparison

    if plot is not None:
        kind = plot.suffix.lower().lstrip(".")
        write_file(plot, draw_comparison(document, kind), force=True)
        say(f"written: {plot}")
    if out is None:
        return
    files = {TABLE: comparison_csv(document)}
    try:
        files[FIGURE] = draw_comparison(document, "png")
    except MissingDependencyError as error:
        say(f"{FIGURE} is not drawn: {error}")
    if plans is not None:
        from dualarm_cli.page.side_by_side import solvers_page

        files[SOLVERS_PAGE] = solvers_page(document, plans)
    write_folder(out, files | {DOCUMENT: json_bytes(document)})
    say(f"written: {out}")


def _exit_code(document: Mapping[str, Any]) -> int:
    """Compute the exit code: 1 failed verification, 3 job without plan, 2 unsupported job."""
    sections = [{row["status"] for row in section["rows"]} for section in document["comparisons"]]
    if any("failed" in statuses for statuses in sections):
        return 1
    if any("verified" not in statuses and "infeasible" in statuses for statuses in sections):
        return 3
    return 2 if all(statuses == {"not served"} for statuses in sections) else 0


@compare_app.command("schedules", cls=HelpCommand)
def schedules_command(
    a: Annotated[
        Path,
        typer.Argument(
            metavar="A", help="Folder of a plan, or a schedule file.", show_default=False
        ),
    ],
    b: Annotated[Path, typer.Argument(metavar="B", help="The plan to compare it with.")],
    out: OutOption = None,
    page: Annotated[
        bool,
        typer.Option(
            "--page", help="Write schedules.html as well: both plans in motion, synchronised."
        ),
    ] = False,
    force: ForceOption = False,
    json_output: JsonOption = False,
    quiet: ResultOnlyOption = False,
) -> None:
    """Compare two schedules stage by stage: which became slower, and by which joint.

    Schedules of other programs are read too. --out writes schedules.json and schedules.csv. A slower schedule is a
    result, not a failure: the exit code is 0.
    """
    from dualarm_cli.exporting.schedule_reader import read_schedule
    from dualarm_cli.interface import compare
    from dualarm_cli.report.comparison.schedule_comparison_table import (
        print_schedules,
        schedules_csv,
    )

    if page:
        refuse_page(out, SCHEDULES_PAGE)
    if out is not None:
        names = (SCHEDULES_TABLE, SCHEDULES_DOCUMENT, *((SCHEDULES_PAGE,) if page else ()))
        refuse_folder(out, names, force)
    plans = (read_schedule(a), read_schedule(b))
    document = compare(*plans, (str(a), str(b)))
    if out is not None:
        files = {SCHEDULES_TABLE: schedules_csv(document)}
        if page:
            files[SCHEDULES_PAGE] = _page_of_both(plans, (a, b), document)
        write_folder(out, files | {SCHEDULES_DOCUMENT: json_bytes(document)})
        if not quiet:
            print_message(f"written: {out}")
    if json_output:
        print_json(document)
    else:
        print_schedules(stdout_console(), document, quiet)


def _page_of_both(
    plans: tuple[Schedule, Schedule], paths: tuple[Path, Path], document: Mapping[str, Any]
) -> bytes:
    """Build the page of two synchronised plans, each verified with its task file."""
    from dualarm_cli.cli.report import tasks_of
    from dualarm_cli.interface import Plan, load
    from dualarm_cli.page.page_data import page_data
    from dualarm_cli.page.side_by_side import ComparedStage, side_by_side, stages_table
    from dualarm_cli.report.comparison.schedule_comparison_table import cause_text

    shown = []
    for side, schedule, path in zip("AB", plans, paths, strict=True):
        job = load(tasks_of(schedule, path))
        plan = Plan.judged(job, schedule)
        data = page_data(plan.schedule, job, plan.report)
        shown.append(data | {"title": f"{side}: {data['title']}"})
    rows = []
    for row in document["stages"]:
        numbers = [row[side] for side in ("a", "b")]
        starts = [
            plan.stages[number - 1].start if number is not None else 0.0
            for plan, number in zip(plans, numbers, strict=True)
        ]
        lengths = [row[f"{side}_duration"] for side in ("a", "b")]
        rows.append(
            ComparedStage(
                numbers=(_number(numbers[0]), _number(numbers[1])),
                starts=(starts[0], starts[1]),
                work=", ".join(row["work"]) or "(return)",
                lengths=(_length(lengths[0]), _length(lengths[1])),
                difference=row["difference"],
                cause=cause_text(row),
            )
        )
    title = f"{paths[0]} and {paths[1]}"
    return side_by_side(title, document["sentence"], [stages_table(rows)], shown, (0, 1))


def _number(value: int | None) -> str:
    return "–" if value is None else str(value)


def _length(value: float | None) -> str:
    return "–" if value is None else f"{value:.3f}"
