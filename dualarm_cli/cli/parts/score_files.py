"""Files that `dualarm score` writes: atomic, and never over files of other programs.

Progress is a bar on a terminal, otherwise a line for each finished case, on stderr.

How far a score has come: a bar on a terminal, otherwise a line for each case that is done; on stderr.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

from dualarm_cli.cli.parts.evaluating import progress_bar
from dualarm_cli.cli.parts.output import print_message
from dualarm_cli.errors import Diagnostic, InputError, OutputError, UsageError
from dualarm_cli.model.studies.evaluation import Evaluation
from dualarm_cli.report.printable import one_line

if TYPE_CHECKING:
    from dualarm_cli.scoring.baseline import Baseline
    from dualarm_cli.scoring.verdict import Verdict


def refuse_report(option: str, path: Path | None, mark: bytes, force: bool) -> None:
    """Raise before planning if a report cannot be written, or would replace a file.

    Args:
        option: its option.
        path: the file, or None.
        mark: first bytes of our reports, which may be replaced.
        force: whether anything may be replaced.

    Raises:
        OutputError: with what to do.
    """
    if path is None:
        return
    if path.is_dir():
        raise OutputError(f"{option} {path}: is a folder; name a file")
    if path.exists() and not path.is_file():
        raise OutputError(f"{option} {path}: is a device or a pipe; name a file")
    if not path.parent.is_dir():
        raise OutputError(f"{option} {path}: there is no folder {path.parent}")
    if not os.access(path.parent, os.W_OK | os.X_OK):
        raise OutputError(f"{option} {path}: no permission to write in {path.parent}")
    if force or not path.exists():
        return
    try:
        with path.open("rb") as file:
            begin = file.read(len(mark))
    except OSError as error:
        raise OutputError(f"{option} {path}: cannot be read: {error.strerror}") from None
    if begin not in (mark, b""):
        raise OutputError(
            f"{option} {path}: already exists and is not a report of an earlier score; add --force to replace it"
        )


def refuse_same_file(named: Mapping[str, Path | None]) -> None:
    """Raise if two options name the same file.

    Args:
        named: files by option, or None.

    Raises:
        UsageError: with both.
    """
    seen: dict[str, str] = {}
    for option, path in named.items():
        if path is not None:
            first = seen.setdefault(os.path.realpath(path), option)
            if first != option:
                raise UsageError(f"{option} {path}: is also the file of {first}; name another")


def read_former(path: Path, update: bool, force: bool) -> Baseline | None:
    """Read the baseline to compare with; None if it is to be created.

    Raises:
        InputError: it is missing or damaged, and no new one was requested.
    """
    from dualarm_cli.scoring.baseline import read_baseline

    if update:
        refuse_report("--baseline", path, b"", force=True)
        if not path.exists():
            return None
    elif not path.exists():
        text = "there is no such file; --update-baseline writes it"
        raise InputError([Diagnostic(str(path), 0, 0, "E500", text)])
    try:
        return read_baseline(path)
    except InputError:
        if update and force:
            return None
        raise


def write_reports(
    verdicts: Sequence[Verdict],
    max_regression: float,
    compared: bool,
    junit: Path | None,
    markdown: Path | None,
    github: bool,
) -> None:
    """Write the requested reports, and GitHub's summary of the step.

    Raises:
        OutputError: one cannot be written.
    """
    from dualarm_cli.exporting.whole_files import write_file
    from dualarm_cli.scoring.markdown import markdown_text

    if junit is not None:
        from dualarm_cli.scoring.junit import junit_bytes

        write_file(junit, junit_bytes(verdicts), force=True)
    summary = os.environ.get("GITHUB_STEP_SUMMARY") if github else None
    if markdown is None and not summary:
        return
    text = markdown_text(verdicts, max_regression, compared).encode("utf-8", "backslashreplace")
    if markdown is not None:
        write_file(markdown, text, force=True)
    if summary:
        try:
            with Path(summary).open("ab") as file:
                file.write(text + b"\n")
        except OSError as error:
            raise OutputError(
                f"GITHUB_STEP_SUMMARY {summary}: cannot be written: {error.strerror}"
            ) from None


def write_baseline(
    path: Path,
    verdicts: Sequence[Verdict],
    former: Baseline | None,
    settings: dict[str, object],
    paths: Mapping[str, str],
) -> bool:
    """Write the new baseline, unless a case has no plan.

    Args:
        path: its file.
        verdicts: verdicts on its cases.
        former: baseline whose other cases stay in it, or None.
        settings: settings of planning.
        paths: task files by case.

    Returns:
        Whether it was written.

    Raises:
        OutputError: it cannot be written.
    """
    from dualarm_cli.cli.parts.score_levers import numbers_of
    from dualarm_cli.evaluation.request import machine
    from dualarm_cli.exporting.whole_files import write_file
    from dualarm_cli.scoring.baseline import Recorded, baseline_bytes

    cases = dict(former.cases) if former is not None else {}
    for verdict in verdicts:
        if verdict.evaluation is None or not verdict.evaluation.has_plan:
            return False
        cases[verdict.case] = Recorded.of(verdict.evaluation, numbers_of(paths[verdict.case]))
    write_file(path, baseline_bytes(settings, cases, machine()), force=True)
    return True


@contextmanager
def score_progress(cases: int, quiet: bool) -> Iterator[Callable[[Evaluation, bool], None]]:
    """Yield a function that reports each finished case, cached or not.

    Args:
        cases: number of cases.
        quiet: whether to say nothing.
    """
    done = count(1)
    with progress_bar("scoring", cases, quiet) as show:

        def report(evaluation: Evaluation, cached: bool) -> None:
            number, name, time = next(done), one_line(evaluation.case), evaluation.cycle_time
            if show is not None:
                show(number, name)
            elif not quiet:
                figure = "" if time is None else f", {time:.3f} s"
                what = f"{evaluation.status.replace('_', ' ')}{figure}"
                print_message(f"[{number}/{cases}] {name}: {what}{' (unchanged)' * cached}")

        yield report
