"""`dualarm sweep`: layout studies: cells with varied parameters, planned, ranked and explained."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dualarm_cli.cli.parts.evaluating import evaluators, open_store, progress_bar, say_unkept
from dualarm_cli.cli.parts.options import Effort, read_duration
from dualarm_cli.cli.parts.output import (
    JsonOption,
    ResultOnlyOption,
    print_json,
    print_message,
    stdout_console,
)
from dualarm_cli.cli.parts.plan_pages import PagesOption, refuse_pages, write_pages
from dualarm_cli.cli.parts.result_files import json_bytes, refuse_folder, write_folder
from dualarm_cli.cli.parts.score_options import (
    CacheOption,
    JobsOption,
    NoCacheOption,
    SchedulerOption,
    TimeoutOption,
    refuse_combinations,
)
from dualarm_cli.errors import OutputError, UsageError
from dualarm_cli.report.printable import print_lines

if TYPE_CHECKING:
    from dualarm_cli.evaluation.answers import Run
    from dualarm_cli.evaluation.request import Request
    from dualarm_cli.evaluation.store import Store
    from dualarm_cli.model.studies.study import Point, Study
    from dualarm_cli.studies.rows import StudyRow
    from dualarm_cli.studies.search import Desk, Progress


@contextmanager
def _study_progress(total: int, quiet: bool) -> Iterator[Callable[[Progress], None]]:
    """Yield a function that reports every finished point.

    Args:
        total: number of points.
        quiet: whether to show nothing.
    """
    with progress_bar("planning", total, quiet) as show:

        def report(progress: Progress) -> None:
            cached = [f"{progress.from_store} cached"] if progress.from_store else []
            time = None if progress.best is None else progress.best.figures["cycle_time"]
            best = [] if time is None else [f"best {time:.3f} s"]
            if show is not None:
                show(progress.done, ", ".join([*best, *cached]))

        yield report


DOCUMENT, TABLE, PARETO, EFFECTS = "study.json", "table.csv", "pareto.png", "sensitivity.png"
FILES = (DOCUMENT, TABLE, PARETO, EFFECTS)


def refuse_results(out: str | None, csv: Path | None, force: bool) -> None:
    """Raise before planning if results could not be written."""
    if out is not None:
        refuse_folder(out, FILES, force)
    if csv is None:
        return
    if csv.is_dir():
        raise OutputError(f"--csv {csv}: is a folder; name a file")
    if not csv.parent.is_dir():
        raise OutputError(f"--csv {csv}: there is no folder {csv.parent}")
    if csv.exists() and not force:
        raise OutputError(f"--csv {csv}: already exists; add --force to replace it")


def refuse_inputs(out: str | None, csv: Path | None, inputs: Iterable[str]) -> None:
    """Raise if a result would replace an input of the study or another result.

    This holds with --force, too.
    """
    read = {os.path.realpath(name) for name in inputs}
    results = {os.path.realpath(Path(out) / name): name for name in FILES} if out else {}
    named = [(f"--out {out}: its {name}", path) for path, name in results.items()]
    if csv is not None:
        named.append((f"--csv {csv}:", os.path.realpath(csv)))
        if results.get(named[-1][1], TABLE) != TABLE:
            raise UsageError(f"--csv {csv}: is a file of --out {out} as well; name another")
    for what, path in named:
        if path in read:
            raise UsageError(f"{what} is an input of the study; name another file")


def write_results(
    document: dict[str, Any], table: bytes, out: str | None, csv: Path | None, quiet: bool
) -> None:
    """Write the requested files, and report it unless quiet.

    Args:
        document: of a study, or of draws.
        table: its rows as CSV.
        out: folder, or None.
        csv: file of the table alone, or None.
        quiet: whether to say nothing.
    """
    from dualarm_cli.exporting.whole_files import write_file

    if csv is not None:
        write_file(csv, table, force=True)
        _say(f"written: {csv}", quiet)
    if out is None:
        return
    files = {TABLE: table} | (_figures(document, quiet) if "objectives" in document else {})
    for name in {PARETO, EFFECTS} - set(files):
        # A figure of an earlier study would contradict this one.
        (Path(out) / name).unlink(missing_ok=True)
    write_folder(out, files | {DOCUMENT: json_bytes(document)})
    _say(f"written: {out}", quiet)


def _figures(document: dict[str, Any], quiet: bool) -> dict[str, bytes]:
    """Draw the figures of a study, and report missing ones unless quiet."""
    from dualarm_cli.errors import MissingDependencyError
    from dualarm_cli.report.figures.study_figure import draw_pareto, draw_sensitivity

    files: dict[str, bytes] = {}
    try:
        if not document["counts"]["planned"]:
            _say(f"{PARETO} and {EFFECTS} are not drawn: no point has a plan", quiet)
        else:
            files[EFFECTS] = draw_sensitivity(document, "png")
            if len(document["objectives"]) > 1:
                files[PARETO] = draw_pareto(document, "png")
            else:
                _say(f"{PARETO} is not drawn: it needs two objectives", quiet)
    except MissingDependencyError as error:
        _say(f"{PARETO} and {EFFECTS} are not drawn: {error}", quiet)
    return files


def _say(text: str, quiet: bool) -> None:
    if not quiet:
        print_message(text)


DEFAULT_BUDGET = 40
"""Default number of points of --optimise."""
DEFAULT_BEST = 10
"""Default number of points with a page."""


def sweep_command(
    study: Annotated[
        Path,
        typer.Argument(
            help="Study file (study/1), or the name of a bundled job with one; with --perturb a task file, or the name "
            "of any bundled job."
        ),
    ],
    optimise: Annotated[
        bool,
        typer.Option(
            "--optimise",
            help="Search for good points instead of planning all of them (extra `optimise`).",
        ),
    ] = False,
    budget: Annotated[
        int | None,
        typer.Option(
            "--budget",
            min=1,
            max=100_000,
            help="Maximum number of points of --optimise.",
            show_default=str(DEFAULT_BUDGET),
        ),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(
            "--seed",
            min=0,
            max=2**32 - 1,
            help="Seed of --optimise and --perturb.",
            show_default="0",
        ),
    ] = None,
    perturb: Annotated[
        int | None,
        typer.Option(
            "--perturb",
            min=1,
            max=100_000,
            metavar="N",
            help="Plan N draws of what varies in a task file: poses with `varies` and times of dwells.",
        ),
    ] = None,
    effort: Annotated[
        Effort | None,
        typer.Option("--effort", help="Effort of the plans of --perturb.", show_default="normal"),
    ] = None,
    jobs: JobsOption = None,
    scheduler: SchedulerOption = None,
    timeout: TimeoutOption = None,
    cache: CacheOption = None,
    no_cache: NoCacheOption = False,
    csv: Annotated[Path | None, typer.Option("--csv", help="All rows as a CSV file.")] = None,
    out: Annotated[
        str | None,
        typer.Option(
            "--out", help="Folder for study.json, table.csv, pareto.png and sensitivity.png."
        ),
    ] = None,
    pages: PagesOption = None,
    best: Annotated[
        int | None,
        typer.Option(
            "--best",
            min=1,
            max=1000,
            metavar="N",
            help="Points whose plans --pages shows, the Pareto set first. They are planned once more for it.",
            show_default=str(DEFAULT_BEST),
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite earlier results.")] = False,
    json_output: JsonOption = False,
    quiet: ResultOnlyOption = False,
) -> None:
    """Plan a cell's tasks over ranges of its parameters: best layouts, trade-offs, sensitivities.

    With --perturb it plans draws of one job, and shows the distribution of its cycle time.

    Finished plans are cached: an interrupted run continues. Points without a plan do not stop
    others. Exit code 4 after an internal error, 2 after a bad input, 3 if no point has a plan, 1 if the
    verifier fails a plan.
    """
    from dualarm_cli.evaluation.request import Request
    from dualarm_cli.files.source.text_source import recorded_reads
    from dualarm_cli.files.studies.studies import load_study
    from dualarm_cli.report.comparison.study_table import study_csv
    from dualarm_cli.report.printable import printable
    from dualarm_cli.studies.document import study_document
    from dualarm_cli.studies.requests import check_settings
    from dualarm_cli.studies.search import Desk
    from dualarm_cli.studies.sweep import points_of

    if perturb is not None:
        _refuse_beside_perturb(optimise, budget, pages)
    most = _search_budget(optimise, budget, None if perturb else seed)
    limit = read_duration("--timeout", timeout)
    refuse_combinations(
        jobs=jobs,
        scheduler=scheduler,
        cache=cache,
        no_cache=no_cache,
    )
    if best is not None and pages is None:
        raise UsageError(f"--best {best}: goes with --pages DIR only")
    refuse_results(out, csv, force)
    store = open_store(cache, no_cache)
    if perturb is not None:
        base = Request.of(study, effort=effort or "normal", draw_seed=seed or 0)
        with evaluators(jobs, scheduler, limit) as run:
            document = _draws(base, perturb, run, store, (out, csv, quiet))
        _finish(document, store, json_output, quiet)
        return
    if effort is not None:
        raise UsageError(f"--effort {effort}: goes with --perturb only; studies have `settings`")
    refuse_pages(pages, force)
    with recorded_reads() as read:
        loaded = load_study(study)
    refuse_inputs(out, csv, read)
    check_settings(loaded)
    if most is not None and loaded.sampling is not None and not quiet:
        print_message("note: with --optimise the study's `sample:` is not used")
    points, method = points_of(loaded, most, seed or 0)
    with evaluators(jobs, scheduler, limit) as run:
        desk = Desk(run, store)
        rows, reference = _carry_out(loaded, points, method, desk, quiet)
        document = printable(study_document(loaded, rows, reference, method))
        write_results(document, study_csv(document), out, csv, quiet)
        if pages is not None:
            shown = [reference, *_best_rows(document, rows, best or DEFAULT_BEST)]
            _write_pages(document, loaded, shown, desk, pages, quiet)
    _finish(document, store, json_output, quiet)


def _finish(document: dict[str, Any], store: Store | None, json_output: bool, quiet: bool) -> None:
    """Print the result, and leave with its exit code."""
    from dualarm_cli.report.comparison.perturbation_table import (
        perturbation_sentences,
        result_sentence,
    )
    from dualarm_cli.report.comparison.study_table import result_line

    say_unkept(store)
    of_study = "objectives" in document
    if json_output:
        print_json(document)
    elif quiet:
        print_lines(stdout_console(), (result_line if of_study else result_sentence)(document))
    elif of_study:
        _print(document)
    else:
        print_lines(stdout_console(), *perturbation_sentences(document))
    if code := exit_code(document):
        raise typer.Exit(code)


def _refuse_beside_perturb(optimise: bool, budget: int | None, pages: Path | None) -> None:
    """Raise for options of studies; --perturb plans one job."""
    for option, given in (("--optimise", optimise), ("--budget", budget), ("--pages", pages)):
        if given:
            raise UsageError(f"{option} does not go with --perturb, which plans one job; keep one")


def _draws(
    base: Request,
    draws: int,
    run: Run,
    store: Store | None,
    results: tuple[str | None, Path | None, bool],
) -> dict[str, Any]:
    """Plan draws of a job, write the requested files, and return the document.

    Args:
        base: request of the job.
        draws: number of draws.
        run: runner of requests that the store lacks.
        store: store of earlier plans, or None.
        results: folder and CSV file or None, and whether to say nothing.
    """
    from dualarm_cli.files.source.text_source import recorded_reads
    from dualarm_cli.files.tasks.tasks import load_job
    from dualarm_cli.report.comparison.perturbation_table import perturbation_csv
    from dualarm_cli.report.printable import printable
    from dualarm_cli.studies.perturbation import perturbation

    out, csv, quiet = results
    with recorded_reads() as read:
        job = load_job(base.path, base.case)
    refuse_inputs(out, csv, read)
    with progress_bar("planning", draws + 1, quiet) as show:

        def tell(done: int, cached: int) -> None:
            if show is not None:
                show(done, f"{cached} cached" if cached else "")

        document: dict[str, Any] = printable(perturbation(base, job, draws, run, store, tell))
    write_results(document, perturbation_csv(document), out, csv, quiet)
    return document


def _search_budget(optimise: bool, budget: int | None, seed: int | None) -> int | None:
    """Read the budget of the search, None for all points.

    Raises:
        UsageError: an option that goes with --optimise only.
        MissingDependencyError: optuna is not installed.
    """
    from dualarm_cli.studies.search import require_optuna

    if not optimise:
        for name, value in (("--budget", budget), ("--seed", seed)):
            if value is not None:
                raise UsageError(f"{name} {value}: goes with --optimise only")
        return None
    require_optuna()
    return DEFAULT_BUDGET if budget is None else budget


def _carry_out(
    study: Study,
    points: list[Point] | None,
    method: dict[str, Any],
    desk: Desk,
    quiet: bool,
) -> tuple[list[StudyRow], StudyRow]:
    """Plan all points and the unchanged files; return their rows and report progress."""
    from dualarm_cli.studies.sweep import evaluated_points

    total = method["budget"] if points is None else len(points)
    try:
        with _study_progress(total, quiet) as desk.tell:
            rows, reference = evaluated_points(study, points, method, desk)
    except KeyboardInterrupt:
        if not quiet and desk.store is not None:
            print_message(
                f"{_plans(desk)}; finished plans are cached in {desk.store.folder}: run the same command to continue"
            )
        raise
    if not quiet:
        print_message(_plans(desk))
    return rows, reference


def _best_rows(document: dict[str, Any], rows: list[StudyRow], count: int) -> list[StudyRow]:
    """Select the rows of the best planned points, the Pareto set first."""
    planned = [row["point"] for row in document["rows"] if row["rank"] is not None]
    places = {row.number: row for row in rows}
    return [places[number] for number in planned[:count]]


def _write_pages(
    document: dict[str, Any],
    study: Study,
    rows: list[StudyRow],
    desk: Desk,
    folder: Path,
    quiet: bool,
) -> None:
    """Plan points again, and write their pages with an index of all points."""
    from dualarm_cli.page.index_page import page_names, page_title, study_index

    before = desk.planned
    with _study_progress(len(rows) * len(study.tasks), quiet) as desk.tell:
        data = desk.pages(study, rows)
    if desk.planned > before and not quiet:
        print_message(f"{desk.planned - before} planned once more for their pages")
    ranks = {row["point"]: f"rank {row['rank']}" for row in document["rows"]}
    keys = sorted(data)
    jobs = [f" {job.name}" if len(study.tasks) > 1 else "" for job in study.tasks]
    called = [ranks.get(number, "as it is") + jobs[k] for number, k in keys]
    names = dict(zip(keys, page_names(called), strict=True))
    plans = {names[key]: (page_title(document, *key), data[key]) for key in keys}
    write_pages(folder, study_index(document, names), plans, quiet)


def _plans(desk: Desk) -> str:
    cached = f", {desk.from_store} cached" if desk.from_store else ""
    return f"{desk.planned} job{'s' * (desk.planned != 1)} planned{cached}"


def _print(document: dict[str, Any]) -> None:
    from dualarm_cli.report.comparison.study_table import (
        SENSITIVITY_WORDS,
        rows_table,
        sensitivity_sentences,
        sensitivity_table,
        sentences,
    )

    console = stdout_console()
    planned = document["counts"]["planned"] > 0
    if planned:
        console.print(rows_table(document))
    print_lines(console, *sentences(document))
    if planned:
        console.print(sensitivity_table(document))
        print_lines(console, SENSITIVITY_WORDS, *sensitivity_sentences(document))


def exit_code(document: dict[str, Any]) -> int:
    """Compute the exit code: the most severe of 4, 2, 3, 1, 0.

    4 if this program failed at a point, 2 if the input of one was bad, 3 if none has a plan, 1 if the verifier fails
    one. Points without a plan among others that have one are a result.
    """
    counts = document["counts"]
    if counts.get("internal_error") or counts.get("crashed"):
        return 4
    if counts.get("bad_input"):
        return 2
    if not counts["planned"] and not counts.get("fails_verification"):
        return 3
    return 1 if counts.get("fails_verification") else 0
