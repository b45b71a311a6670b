"""A score as a table for people at a terminal."""

from __future__ import annotations

from collections.abc import Sequence

from rich.markup import escape
from rich.table import Column, Table

from dualarm_cli.report.printable import numbers, one_line
from dualarm_cli.scoring.messages import figure_words, verdict_words
from dualarm_cli.scoring.verdict import Verdict

_COLOURS = {"pass": "green", "improved": "bold green", "new": "yellow"}


def score_table(verdicts: Sequence[Verdict]) -> Table:
    """Returns the table: a row for each case.

    Args:
        verdicts: by name.
    """
    figures = numbers("cycle time s", "change", "gap", "clearance mm")
    table = Table(Column("case", overflow="fold"), *figures, "verdict")
    for verdict in verdicts:
        colour = "yellow" if verdict.caveats else _COLOURS.get(verdict.state, "bold red")
        table.add_row(
            escape(one_line(verdict.case)),
            *figure_words(verdict),
            f"[{colour}]{verdict_words(verdict)}[/]",
        )
    return table
