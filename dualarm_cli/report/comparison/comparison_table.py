"""`dualarm compare solvers` as tables for the terminal and as CSV."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from io import StringIO
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Column, Table

from dualarm_cli.kinds import of_kinds
from dualarm_cli.model.verification import exceptions
from dualarm_cli.report.comparison.comparison import (
    SOLVERS,
    row_namer,
    section_title,
    varied_solvers,
)
from dualarm_cli.report.printable import numbers, print_lines

COLOURS = {"verified": "green", "failed": "bold red", "infeasible": "yellow", "not served": "dim"}
OPEN = "yellow"
"""Colour of a verified plan whose collisions are not fully checked."""
FORMULA = ("=", "+", "-", "@", "\t", "\r")
"""First characters of spreadsheet formulas."""


def print_solvers(console: Console, document: Mapping[str, Any]) -> None:
    """Print the tables, reasons and result of all jobs."""
    clock = document["wall_clock"]
    for section in document["comparisons"]:
        mine, clock = clock[: len(section["rows"])], clock[len(section["rows"]) :]
        console.print(comparison_table(section, mine))
        for kind in of_kinds("measures"):
            if (table := kind.table(section)) is not None:
                console.print(table)
        print_lines(console, *reason_lines(section), section["sentence"])


def comparison_table(section: dict[str, Any], clock: list[dict[str, Any]]) -> Table:
    """Build the table of one task file.

    Args:
        section: one member of the document's `comparisons`.
        clock: the same rows' wall-clock times.
    """
    rows = section["rows"]
    varied = varied_solvers(rows)
    title = section_title(section, section["tasks"])
    if section["lower_bound"] is not None:
        title += f", lower bound {section['lower_bound']:.3f} s"
    slides = any(row["platform_slides"] for row in rows)
    platform = "platform mm" if slides else "platform °"
    figures = ("cycle s", "parts/h", "above bound", "planning s", "clear mm", "elbows °", platform)
    table = Table(
        *(Column(name, no_wrap=True) for name in ("method", *varied)),
        *numbers(*figures, no_wrap=True),
        Column("plan", no_wrap=True),
        title=escape(title),
        title_justify="left",
    )
    for row, timed in zip(rows, clock, strict=True):
        colour = OPEN if row["status"] == "verified" and row["caveats"] else COLOURS[row["status"]]
        table.add_row(
            *(row[key] for key in ("method", *varied)),
            _number(row["cycle_time"], 3),
            _number(row["parts_per_hour"] if section["parts"] else None, 0),
            "–" if row["gap"] is None else f"{row['gap']:.1%}",
            _number(timed["planning_time"], 2),
            "–" if row["clearance"] is None else f"{row['clearance'] * 1e3:.1f}",
            _degrees(row["elbow_imbalance"], 1),
            _millimetres(row["platform_travel"]) if slides else _degrees(row["platform_travel"], 0),
            f"[{colour}]{row['status']}[/]",
        )
    return table


def reason_lines(section: dict[str, Any]) -> list[str]:
    """List the reasons of missing verified plans, grouped by reason, and the caveats.

    Args:
        section: one member of the document's `comparisons`.
    """
    called = row_namer(section["rows"])
    grouped: dict[tuple[str, str], list[str]] = {}
    for row in section["rows"]:
        if row["reason"]:
            grouped.setdefault((row["status"], row["reason"]), []).append(called(row))
    lines = [f"{', '.join(names)}: {status}: {why}" for (status, why), names in grouped.items()]
    good = [row for row in section["rows"] if row["status"] == "verified"]
    caveats = dict.fromkeys(caveat for row in good for caveat in row["caveats"])
    return [*lines, *(f"plans verified{exceptions([caveat])}" for caveat in caveats)]


def comparison_csv(document: Mapping[str, Any]) -> bytes:
    """Write all rows as CSV [s, rad], wall-clock planning time last.

    No other column has wall-clock times.

    The travel of a platform that slides is in m.

    Args:
        document: of `dualarm compare solvers`.
    """
    sections = document["comparisons"]
    groups = {g: None for s in sections for r in s["rows"] for g in r["deciding_time"] or {}}
    names = (
        ["tasks", *SOLVERS, "status", "cycle_time", "parts_per_hour"]
        + ["lower_bound", "gap", "grid_gap", "clearance", "clearance_cost"]
        + ["elbow_imbalance", "platform_travel"]
        + [f"time_{group}" for group in groups]
        + ["caveats", "reason", "planning_time"]
    )
    timed = iter(document["wall_clock"])
    table = [names]
    for section in sections:
        for row in section["rows"]:
            cells = {"tasks": section["tasks"], "lower_bound": section["lower_bound"], **row}
            cells |= {f"time_{g}": (row["deciding_time"] or {}).get(g) for g in groups}
            cells["caveats"] = "; ".join(row["caveats"])
            cells["planning_time"] = next(timed)["planning_time"]
            table.append([cell_text(cells[name]) for name in names])
    return csv_bytes(table)


def csv_bytes(table: list[list[str]]) -> bytes:
    """Write rows of texts as CSV, with newline line ends."""
    text = StringIO()
    csv.writer(text, lineterminator="\n").writerows(table)
    return text.getvalue().encode("utf-8", "backslashreplace")


def cell_text(value: Any) -> str:
    """Format a cell: exact numbers, empty for None, never a formula."""
    if value is None:
        return ""
    if isinstance(value, str):
        return f"'{value}" if value.startswith(FORMULA) else value
    return repr(value)


def _number(value: float | None, digits: int) -> str:
    return "–" if value is None else f"{value:.{digits}f}"


def _millimetres(value: float | None) -> str:
    return _number(None if value is None else 1e3 * value, 0)


def _degrees(value: float | None, digits: int) -> str:
    return _number(None if value is None else math.degrees(value), digits)
