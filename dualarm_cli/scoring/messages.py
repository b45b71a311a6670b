"""Figures, sentences and terminal table of a score."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from dualarm_cli.model.verification import exceptions
from dualarm_cli.report.printable import numbers, one_line, printable
from dualarm_cli.scoring.gate import FLOOR
from dualarm_cli.scoring.verdict import STATES, Verdict, words

if TYPE_CHECKING:
    from rich.table import Table

NOTHING = "–"
_COLOURS = {"pass": "green", "improved": "bold green", "new": "yellow"}


def figure_words(verdict: Verdict) -> tuple[str, str, str, str]:
    """Format a case's cycle time, change, share above the bound and least clearance."""
    plan, change = verdict.evaluation, verdict.change
    time, gap, clearance = (
        (None, None, None) if plan is None else (plan.cycle_time, plan.gap, plan.clearance)
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
    """List the caveats of passed cases as printable sentences, cases with equal ones together."""
    cases: dict[str, list[str]] = {}
    for verdict in verdicts:
        if verdict.caveats:
            cases.setdefault(exceptions(verdict.caveats), []).append(one_line(verdict.case))
    shown: list[str] = printable(
        [f"{', '.join(names)}: verified{text}" for text, names in cases.items()]
    )
    return shown


def reason_lines(verdict: Verdict) -> list[str]:
    """List the reasons of a case's state as printable sentences."""
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
    """Count the cases of each state, most severe first."""
    states = [verdict.state for verdict in verdicts]
    counts = [f"{states.count(s)} {words(s)}" for s in STATES if s in states]
    word = "case" if len(verdicts) == 1 else "cases"
    if open_cases := sum(bool(verdict.caveats) for verdict in verdicts):
        counts.append(f"of these {open_cases} not fully checked")
    return f"{len(verdicts)} {word}: {', '.join(counts)}"


def rule_words(max_regression: float) -> str:
    """Format the allowed regression."""
    return f"allowed: {max_regression * 100:g} % longer than the baseline, and {FLOOR * 1e3:g} ms"


def advice(verdicts: Sequence[Verdict]) -> list[str]:
    """List advice on improved and new cases."""
    states = [verdict.state for verdict in verdicts]
    lines = []
    if better := states.count("improved"):
        lines.append(
            f"{better} improved: store it with --update-baseline, or a later loss is not detected"
        )
    if new := states.count("new"):
        lines.append(f"{new} new: --update-baseline takes {'it' if new == 1 else 'them'} in")
    return lines


def score_table(verdicts: Sequence[Verdict]) -> Table:
    """Build the table of a score for the terminal: a row for each case.

    Args:
        verdicts: by name.
    """
    from rich.markup import escape
    from rich.table import Column, Table

    figures = numbers("cycle time s", "change", "above bound", "clearance mm")
    table = Table(Column("case", overflow="fold"), *figures, "verdict")
    for verdict in verdicts:
        colour = "yellow" if verdict.caveats else _COLOURS.get(verdict.state, "bold red")
        table.add_row(
            escape(one_line(verdict.case)),
            *figure_words(verdict),
            f"[{colour}]{verdict_words(verdict)}[/]",
        )
    return table
