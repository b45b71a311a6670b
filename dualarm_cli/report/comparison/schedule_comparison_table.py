"""`dualarm compare schedules` as tables for the terminal and as CSV."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Column, Table

from dualarm_cli.report.comparison.comparison_table import cell_text, csv_bytes
from dualarm_cli.report.comparison.schedule_comparison import SAME
from dualarm_cli.report.printable import numbers, print_lines

NAMED = 3
"""Number of causes in the sentence."""
CAUSES = {
    "displacement": "displacement",
    "limits": "limits",
    "timing": "timing",
    "time": "",
}


def print_schedules(console: Console, document: Mapping[str, Any], quiet: bool = False) -> None:
    """Print the table of stages, the result and notes; only the result if `quiet`."""
    if not document["identical"] and not quiet:
        console.print(schedules_table(document))
    notes = [] if quiet else [f"note: {note}" for note in document["notes"]]
    print_lines(console, document["sentence"], *notes)


def schedules_table(document: Mapping[str, Any]) -> Table:
    """Build the table of stages: durations before and after, and causes.

    Args:
        document: of `dualarm compare schedules`.
    """
    table = Table(
        *numbers("A", "B", no_wrap=True),
        "work",
        *numbers("A s", "B s", "B − A s", no_wrap=True),
        *(Column(name, no_wrap=True) for name in ("cause", "A → B")),
        title="stages of A and B",
        title_justify="left",
    )
    for row in document["stages"]:
        change = row["difference"]
        colour = "red" if change > SAME else "green" if change < -SAME else "dim"
        table.add_row(
            *("–" if row[side] is None else str(row[side]) for side in ("a", "b")),
            escape(", ".join(row["work"]) or "(return)"),
            *(_seconds(row[f"{side}_duration"]) for side in ("a", "b")),
            f"[{colour}]{_signed(change)}[/]",
            escape(cause_text(row)),
            _change(row["blame"]),
        )
    return table


def schedules_sentence(document: Mapping[str, Any]) -> str:
    """Compose one sentence: the faster schedule, its lead, the number of stages, the causes.

    Args:
        document: of `dualarm compare schedules`.
    """
    a, b = document["a"]["duration"], document["b"]["duration"]
    if document["identical"]:
        return f"A and B are identical: {a:.3f} s"
    both = [row for row in document["stages"] if None not in (row["a"], row["b"])]
    # As the table shows them: what it rounds to 0.000 s is neither slower nor faster.
    changes = [round(row["difference"], 3) for row in both]
    slower, faster = sum(c > 0.0 for c in changes), sum(c < 0.0 for c in changes)
    if abs(document["difference"]) <= SAME:
        text = f"A and B are equally long with {a:.3f} s"
        if not slower and not faster:
            return f"{text}, stage by stage, though their motions differ"
    else:
        word = "slower" if b > a else "faster"
        text = f"B is {abs(b - a):.3f} s"
        if document["relative"] is not None:
            text += f" ({abs(document['relative']):.1%})"
        text += f" {word} than A ({a:.3f} s → {b:.3f} s)"
    text += f": {slower} of {len(changes)} stages slower, {faster} faster"
    for side, other_side in (("A", "b"), ("B", "a")):
        alone = sum(row[other_side] is None for row in document["stages"])
        text += f", {alone} only in {side}" if alone else ""
    named = [
        f"{entry['name']} ({_signed(entry['difference'])} s in {entry['stages']})"
        for entry in _along(document)[:NAMED]
    ]
    return f"{text}; most of it: {', '.join(named)}" if named else text


def _along(document: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Select the causes that act in the direction of the total difference, or all."""
    whole = document["difference"]
    if abs(whole) <= SAME:
        return list(document["blamed"])
    return [entry for entry in document["blamed"] if entry["difference"] * whole > 0.0]


def schedules_csv(document: Mapping[str, Any]) -> bytes:
    """Write the stages as CSV; s, rad (m for joints that slide).

    Args:
        document: of `dualarm compare schedules`.
    """
    plain = ["a", "b", "work", "match", "a_duration", "b_duration", "difference"]
    plain += ["a_bottleneck", "b_bottleneck"]
    blamed = ["part", "arm", "joint", "cause", "a_time", "b_time"]
    blamed += ["a_displacement", "b_displacement"]
    table = [[*plain, *blamed]]
    for row in document["stages"]:
        cells = {**row, "work": ", ".join(row["work"]) or "(return)"}
        cause = row["blame"] or {}
        table.append(
            [cell_text(cells[name]) for name in plain]
            + [cell_text(cause.get(name)) for name in blamed]
        )
    return csv_bytes(table)


def cause_text(row: dict[str, Any]) -> str:
    """Describe the cause of a row, or what prevents its comparison."""
    if row["match"] not in ("same work", "different simultaneous work"):
        return str(row["match"])
    cause = row["blame"]
    if cause is None:
        return "–"
    name = f"{cause['joint'] or ''} {cause['part']}".strip()
    if not cause["joint"]:
        name = f"{cause['arm']} {cause['part']}"
    return name if row["match"] == "same work" else f"{name} ({row['match']})"


def _change(cause: dict[str, Any] | None) -> str:
    """Format the change of displacement if it is the cause, else of time."""
    if cause is None:
        return ""
    displacements = cause["a_displacement"], cause["b_displacement"]
    times = f"{cause['a_time']:.3f} s → {cause['b_time']:.3f} s"
    if cause["cause"] == "displacement" and None not in displacements:
        if cause["slides"]:
            return " → ".join(f"{1e3 * displacement:.1f} mm" for displacement in displacements)
        return " → ".join(f"{math.degrees(displacement):.1f}°" for displacement in displacements)
    why = CAUSES[cause["cause"]]
    return f"{times} ({why})" if why else times


def _seconds(value: float | None) -> str:
    return "–" if value is None else f"{value:.3f}"


def _signed(value: float) -> str:
    return "0.000" if abs(value) < 0.0005 else f"{value:+.3f}".replace("-", "−")
