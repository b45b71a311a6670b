"""`dualarm score`: many cells planned, compared with a baseline; for CI."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dualarm_cli.cli.parts.evaluating import evaluators, open_store, say_unkept
from dualarm_cli.cli.parts.options import (
    Blend,
    BlendOption,
    Effort,
    EffortOption,
    PlatformOption,
    RedundancyOption,
    SeedOption,
    TimingOption,
    read_duration,
)
from dualarm_cli.cli.parts.output import (
    JsonOption,
    ResultOnlyOption,
    print_json,
    print_message,
    stdout_console,
)
from dualarm_cli.cli.parts.plan_pages import PagesOption, refuse_pages, write_pages
from dualarm_cli.cli.parts.score_options import (
    BaselineOption,
    CacheOption,
    CasesArgument,
    GithubOption,
    JobsOption,
    JunitOption,
    MarkdownOption,
    NoCacheOption,
    RegressionOption,
    SchedulerOption,
    SubsetOption,
    TimeoutOption,
    UpdateOption,
    read_regression,
    refuse_combinations,
)
from dualarm_cli.errors import UsageError
from dualarm_cli.report.printable import print_lines

if TYPE_CHECKING:
    from dualarm_cli.evaluation.answers import Run
    from dualarm_cli.evaluation.request import Request
    from dualarm_cli.evaluation.store import Store
    from dualarm_cli.model.studies.evaluation import Evaluation
    from dualarm_cli.scoring.baseline import Baseline
    from dualarm_cli.scoring.verdict import Verdict


def score_command(
    tasks: CasesArgument,
    baseline: BaselineOption = None,
    max_regression: RegressionOption = None,
    update_baseline: UpdateOption = False,
    subset: SubsetOption = False,
    platform: PlatformOption = None,
    redundancy: RedundancyOption = None,
    timing: TimingOption = "ruckig",
    blend: BlendOption = Blend.lines,
    effort: EffortOption = Effort.normal,
    seed: SeedOption = 0,
    jobs: JobsOption = None,
    timeout: TimeoutOption = None,
    scheduler: SchedulerOption = None,
    cache: CacheOption = None,
    no_cache: NoCacheOption = False,
    junit: JunitOption = None,
    markdown: MarkdownOption = None,
    github: GithubOption = False,
    pages: PagesOption = None,
    force: Annotated[
        bool, typer.Option("--force", help="Overwrite files that are no earlier results.")
    ] = False,
    json_output: JsonOption = False,
    quiet: ResultOnlyOption = False,
) -> None:
    """Plan many cells and compare them with a baseline and their budgets, for CI.

    Exit code 1 if a cycle time rose more than allowed, a case is missing, misses its budget, fails its verification
    or takes too long; 3 if one has no feasible plan, 2 if a file is wrong, 4 if one ended in a bug; the most severe
    of these in the order 4, 2, 3, 1. The other cases are planned anyway.
    """
    from dualarm_cli.cli.parts.score_files import refuse_report, refuse_same_file, write_reports
    from dualarm_cli.evaluation.request import Request, other_machine
    from dualarm_cli.scoring import junit as junit_format
    from dualarm_cli.scoring import markdown as markdown_format
    from dualarm_cli.scoring.baseline import find_cases
    from dualarm_cli.scoring.gate import judge_all

    refuse_combinations(
        baseline=baseline,
        regression=max_regression,
        update=update_baseline,
        subset=subset,
        jobs=jobs,
        scheduler=scheduler,
        cache=cache,
        no_cache=no_cache,
    )
    allowed, limit = read_regression(max_regression), read_duration("--timeout", timeout)
    refuse_same_file({"--baseline": baseline, "--junit": junit, "--markdown": markdown})
    refuse_report("--junit", junit, junit_format.MARK, force)
    refuse_report("--markdown", markdown, markdown_format.MARK.encode(), force)
    refuse_pages(pages, force)
    requests = [
        Request.of(
            case,
            platform=platform,
            redundancy=redundancy,
            timing=timing,
            blend=blend.value,
            effort=effort.value,
            seed=seed,
            page=pages is not None,
        )
        for case in find_cases(tasks)
    ]
    settings = requests[0].settings
    former = _former(baseline, settings, update_baseline, subset, force)
    if former is not None and not update_baseline:
        requests = _with_limits(requests, former, allowed)
    store = open_store(cache, no_cache)
    with evaluators(jobs, scheduler, limit) as run:
        evaluations = _evaluate(requests, run, store, quiet)
    verdicts = judge_all(
        evaluations,
        None if former is None else former.cases,
        math.inf if update_baseline else allowed,
        subset=subset or update_baseline,
        elsewhere="" if former is None else other_machine(former.made_on),
    )
    if any(verdict.state == "regressed" for verdict in verdicts):
        from dualarm_cli.cli.parts.score_levers import with_levers

        verdicts = with_levers(verdicts, requests)
    # A baseline that is replaced or missing is not compared with.
    compared = baseline if former is not None and not update_baseline else None
    write_reports(verdicts, allowed, compared is not None, junit, markdown, github)
    if pages is not None:
        _write_pages(pages, verdicts, allowed, compared is not None, quiet)
    if update_baseline and baseline is not None:
        paths = {request.case: request.path for request in requests}
        _update(baseline, verdicts, former if subset else None, settings, paths, quiet)
    # Printed last: where something cannot be written, that is the one document on stdout.
    _tell(verdicts, settings, allowed, compared, github, json_output, quiet)
    _end(verdicts)


def _with_limits(requests: list[Request], former: Baseline, allowed: float) -> list[Request]:
    """Ask for the schedules of regressions, from which their levers are estimated."""
    from dualarm_cli.scoring.gate import FLOOR

    times = {case: recorded.cycle_time for case, recorded in former.cases.items()}
    return [
        replace(request, above=time + max(FLOOR, allowed * time))
        if (time := times.get(request.case)) is not None
        else request
        for request in requests
    ]


def _former(
    path: Path | None, settings: dict[str, object], update: bool, subset: bool, force: bool
) -> Baseline | None:
    """Read the baseline to compare with, or None.

    Raises:
        InputError: it cannot be used.
        UsageError: it was planned by other settings, so that it cannot be compared.
    """
    from dualarm_cli.cli.parts.score_files import read_former

    if path is None:
        return None
    former = read_former(path, update, force)
    if former is None or dict(former.settings) == settings:
        return former
    if update and not subset:
        return None
    differences = ", ".join(
        f"{name} {former.settings.get(name, 'not stated')} there, {settings.get(name, 'not stated')} here"
        for name in dict.fromkeys([*settings, *former.settings])
        if former.settings.get(name) != settings.get(name)
    )
    raise UsageError(
        f"--baseline {path}: was made with other settings ({differences}); use the same settings, or --update-baseline"
    )


def _evaluate(
    requests: list[Request], run: Run, store: Store | None, quiet: bool
) -> dict[str, Evaluation]:
    """Evaluate all cases; `run` plans those that the store does not have."""
    from dualarm_cli.cli.parts.score_files import score_progress
    from dualarm_cli.evaluation.answers import answers

    def checked(batch: Sequence[Request]) -> Iterator[tuple[int, Evaluation]]:
        doubted = False
        for index, evaluation in run(batch):
            if evaluation.status == "bad_input" and not doubted:
                doubted = True
                _refuse_settings(batch[index])
            yield index, evaluation

    evaluations: dict[str, Evaluation] = {}
    cached = 0
    with score_progress(len(requests), quiet) as report:
        for answer in answers(requests, checked, store):
            evaluations[requests[answer.index].case] = answer.evaluation
            cached += answer.from_store
            report(answer.evaluation, answer.from_store)
    if store is not None and not quiet:
        print_message(f"unchanged and not planned again: {cached} of {len(requests)}")
    say_unkept(store)
    return evaluations


def _refuse_settings(request: Request) -> None:
    """Raise if a named solver does not exist, once for all cases.

    It is checked only after a failure, because methods take a second to load.
    """
    from dualarm_cli.evaluation.evaluate import settings_of

    settings_of(request)


def _tell(
    verdicts: list[Verdict],
    settings: dict[str, object],
    allowed: float,
    baseline: Path | None,
    github: bool,
    json_output: bool,
    quiet: bool,
) -> None:
    """Print the result; failures go to stderr if stdout has no table."""
    from dualarm_cli.scoring.document import score_document
    from dualarm_cli.scoring.markdown import github_commands
    from dualarm_cli.scoring.messages import counted, reason_lines

    if github:
        for line in github_commands(verdicts, os.environ.get("GITHUB_WORKSPACE")):
            print_message(line)
    if json_output:
        name = None if baseline is None else str(baseline)
        print_json(score_document(verdicts, settings, allowed, name))
    elif quiet:
        print_lines(stdout_console(), counted(verdicts))
    else:
        _print(verdicts, allowed, baseline is not None)
    if json_output or quiet:
        for verdict in verdicts:
            for line in reason_lines(verdict) if verdict.failed else ():
                print_message(line)


def _print(verdicts: list[Verdict], allowed: float, compared: bool) -> None:
    from dualarm_cli.scoring.messages import (
        advice,
        caveat_lines,
        counted,
        reason_lines,
        rule_words,
        score_table,
    )

    console = stdout_console()
    console.print(score_table(verdicts))
    lines = [line for verdict in verdicts for line in reason_lines(verdict)]
    lines += caveat_lines(verdicts)
    compared &= any(verdict.state not in ("pass", "new") for verdict in verdicts)
    lines += [counted(verdicts) + (f"; {rule_words(allowed)}" if compared else "")]
    print_lines(console, *lines, *advice(verdicts))


def _write_pages(
    folder: Path, verdicts: list[Verdict], allowed: float, compared: bool, quiet: bool
) -> None:
    """Write the pages of all cases with a plan, and their index."""
    from dualarm_cli.page.index_page import page_names
    from dualarm_cli.scoring.index import score_index

    shown = {v.case: v.evaluation.page for v in verdicts if v.evaluation and v.evaluation.page}
    names = dict(zip(shown, page_names(shown), strict=True))
    plans = {names[case]: (case, page) for case, page in shown.items()}
    write_pages(folder, score_index(verdicts, names, allowed, compared), plans, quiet)


def _update(
    path: Path,
    verdicts: list[Verdict],
    former: Baseline | None,
    settings: dict[str, object],
    paths: dict[str, str],
    quiet: bool,
) -> None:
    from dualarm_cli.cli.parts.score_files import write_baseline

    if write_baseline(path, verdicts, former, settings, paths):
        if not quiet:
            print_message(f"written: {path}")
    else:
        what = "stays as it is" if path.exists() else "is not written"
        print_message(f"{path} {what}: cases without a plan cannot be compared; correct them first")


def _end(verdicts: list[Verdict]) -> None:
    """End the process with the exit code of the most severe case."""
    from dualarm_cli.scoring.verdict import exit_code

    if code := exit_code(verdicts):
        raise typer.Exit(code)
