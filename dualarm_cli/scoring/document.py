"""A score as one JSON document; nothing in it depends on the clock or on what was known already.

A score as a table for people at a terminal.

Figures and sentences that all formats of a score have in common.

A score as an index: one HTML page with a row for each case, which leads to the page of its plan.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

from rich.markup import escape
from rich.table import Table

from dualarm_cli.model.verification import exceptions
from dualarm_cli.page.index_page import FOLDER, index_page, verified_cell
from dualarm_cli.page.tables import PageCell, PageRow, PageTable
from dualarm_cli.report.printable import one_line, printable
from dualarm_cli.scoring.gate import FLOOR
from dualarm_cli.scoring.verdict import STATES, Verdict, exit_code, words

FORMAT = "dualarm.score/1"


def score_document(
    verdicts: Sequence[Verdict],
    settings: Mapping[str, Any],
    max_regression: float,
    baseline: str | None,
) -> dict[str, Any]:
    """Returns the document of a score.

    Args:
        verdicts: by name.
        settings: what was planned by.
        max_regression: by what share a cycle time might be longer.
        baseline: name of the baseline's file; None where there is none.
    """
    states = [verdict.state for verdict in verdicts]
    code = exit_code(verdicts)
    document: dict[str, Any] = printable(
        {
            "format": FORMAT,
            "passed": code == 0,
            "exit_code": code,
            "settings": dict(settings),
            "baseline": baseline,
            "max_regression": max_regression,
            "floor": FLOOR,
            "counts": {state: states.count(state) for state in STATES},  # type: ignore[arg-type]
            "cases": [_row(verdict) for verdict in verdicts],
        }
    )
    return document


def _row(verdict: Verdict) -> dict[str, Any]:
    found, before = verdict.evaluation, verdict.before
    figures: dict[str, Any] = dict.fromkeys(
        ("cycle_time", "lower_bound", "gap", "clearance", "required_clearance", "travel")
    )
    if found is not None:
        figures = {name: getattr(found, name) for name in figures}
    return {
        "case": verdict.case,
        "state": verdict.state,
        **figures,
        "baseline_cycle_time": None if before is None else before.cycle_time,
        "change": verdict.change,
        "limiting": {} if found is None else dict(found.limiting),
        "budgets": [] if found is None else [asdict(line) for line in found.budgets],
        "reasons": [asdict(reason) for reason in verdict.reasons],
        "caveats": list(verdict.caveats),
    }


_COLOURS = {"pass": "green", "improved": "bold green", "new": "yellow"}


def score_table(verdicts: Sequence[Verdict]) -> Table:
    """Returns the table: a row for each case.

    Args:
        verdicts: by name.
    """
    table = Table()
    table.add_column("case", overflow="fold")
    for name in ("cycle time s", "change", "gap", "clearance mm"):
        table.add_column(name, justify="right")
    table.add_column("verdict")
    for verdict in verdicts:
        colour = "yellow" if verdict.caveats else _COLOURS.get(verdict.state, "bold red")
        table.add_row(
            escape(one_line(verdict.case)),
            *figure_words(verdict),
            f"[{colour}]{verdict_words(verdict)}[/]",
        )
    return table


NOTHING = "–"


def figure_words(verdict: Verdict) -> tuple[str, str, str, str]:
    """Write a case's cycle time, change, gap and least clearance."""
    found, change = verdict.evaluation, verdict.change
    time, gap, clearance = (
        (None, None, None) if found is None else (found.cycle_time, found.gap, found.clearance)
    )
    same = "0.0 %" if change is None or abs(change) < 5e-4 else f"{change * 100:+.1f} %"
    return (
        NOTHING if time is None else f"{time:.3f}",
        NOTHING if change is None else same,
        NOTHING if gap is None else f"{gap * 100:.1f} %",
        NOTHING if clearance is None else f"{clearance * 1e3:.1f}",
    )


def verdict_words(verdict: Verdict) -> str:
    """Name the state of a case, with a remark on caveats."""
    return words(verdict.state) + (", not fully checked" if verdict.caveats else "")


def caveat_lines(verdicts: Sequence[Verdict]) -> list[str]:
    """List the caveats of passes, one printable sentence for each case."""
    shown: list[str] = printable(
        [f"{one_line(v.case)}: verified{exceptions(v.caveats)}" for v in verdicts if v.caveats]
    )
    return shown


def reason_lines(verdict: Verdict) -> list[str]:
    """Returns why a case is not simply a pass, one sentence each, fit to be shown on a terminal."""
    lines = []
    for reason in verdict.reasons:
        placed = replace(reason, file=one_line(reason.file))
        if reason.file == verdict.case:
            lines.append(str(replace(placed, message=f"{words(verdict.state)}: {reason.message}")))
        else:
            lines.append(f"{one_line(verdict.case)}: {words(verdict.state)}: {placed}")
    shown: list[str] = printable(lines)
    return shown


def counted(verdicts: Sequence[Verdict]) -> str:
    """Returns how many cases there are of each state, most severe first."""
    states = [verdict.state for verdict in verdicts]
    counts = [f"{states.count(s)} {words(s)}" for s in STATES if s in states]
    word = "case" if len(verdicts) == 1 else "cases"
    if open_cases := sum(bool(verdict.caveats) for verdict in verdicts):
        counts.append(f"of these {open_cases} not fully checked")
    return f"{len(verdicts)} {word}: {', '.join(counts)}"


def rule_words(max_regression: float) -> str:
    """Returns what is allowed."""
    return f"allowed: {max_regression * 100:g} % longer than the baseline, and {FLOOR * 1e3:g} ms"


def advice(verdicts: Sequence[Verdict]) -> list[str]:
    """Returns what to do about what did not fail, but is not as recorded."""
    states = [verdict.state for verdict in verdicts]
    lines = []
    if better := states.count("improved"):
        lines.append(
            f"{better} improved: store it with --update-baseline, or a later loss is not detected"
        )
    if new := states.count("new"):
        lines.append(f"{new} new: --update-baseline takes {'it' if new == 1 else 'them'} in")
    return lines


_COLUMNS = (
    ("case", False),
    ("verdict", False),
    ("cycle s", True),
    ("baseline s", True),
    ("change", True),
    ("bound s", True),
    ("gap", True),
    ("clearance mm", True),
    ("verified", False),
    ("why", False),
)


def score_index(
    verdicts: Sequence[Verdict], pages: Mapping[str, str], max_regression: float, compared: bool
) -> bytes:
    """Returns the index.

    Args:
        verdicts: by name.
        pages: names of the plans' pages, by case; cases without a plan have none.
        max_regression: by what share a cycle time might be longer.
        compared: whether there is a baseline.
    """
    lines = [counted(verdicts), *([rule_words(max_regression)] if compared else [])]
    rows = [_case_row(verdict, pages.get(verdict.case)) for verdict in verdicts]
    return index_page("Score", [*lines, *advice(verdicts)], [PageTable("", _COLUMNS, rows)])


def _case_row(verdict: Verdict, page: str | None) -> PageRow:
    found, before = verdict.evaluation, verdict.before
    case = verdict.case
    name = PageCell(case) if page is None else PageCell("", links={case: f"{FOLDER}/{page}"})
    bound = None if found is None else found.lower_bound
    time, change, gap, clearance = figure_words(verdict)
    mark = "bad" if verdict.failed else "warn" if verdict.caveats else "good"
    return PageRow(
        [
            name,
            PageCell(verdict_words(verdict), mark),
            PageCell(time),
            PageCell(NOTHING if before is None else f"{before.cycle_time:.3f}"),
            PageCell(change),
            PageCell(NOTHING if bound is None else f"{bound:.3f}"),
            PageCell(gap),
            PageCell(clearance),
            verified_cell("" if found is None else found.status, verdict.caveats),
            PageCell("\n".join([*map(str, verdict.reasons), *verdict.caveats])),
        ]
    )
