"""`dualarm compare schedules` for people and for spreadsheets."""

from __future__ import annotations

import math
from typing import Any

from rich.markup import escape
from rich.table import Column, Table

from dualarm_cli.report.comparison.comparison_table import cell_text, csv_bytes
from dualarm_cli.report.comparison.schedule_comparison import SAME
from dualarm_cli.report.printable import numbers

NAMED = 3
"""How many of those to blame the sentence names."""
CAUSES = {
    "displacement": "way",
    "limits": "limits",
    "timing": "timing",
    "time": "",
}


def schedules_table(document: dict[str, Any]) -> Table:
    """Return the table of stages: how long before and after, and what is to blame.

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


def schedules_sentence(document: dict[str, Any]) -> str:
    """Return one sentence: which is faster by how much, in how many stages, and what is to blame.

    Args:
        document: of `dualarm compare schedules`.
    """
    a, b = document["a"]["duration"], document["b"]["duration"]
    if document["identical"]:
        return f"A and B are identical: {a:.3f} s"
    both = [row for row in document["stages"] if None not in (row["a"], row["b"])]
    changes = [row["difference"] for row in both]
    slower, faster = sum(c > SAME for c in changes), sum(c < -SAME for c in changes)
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
    for side, other in (("A", "b"), ("B", "a")):
        alone = sum(row[other] is None for row in document["stages"])
        text += f", {alone} only in {side}" if alone else ""
    named = [
        f"{entry['name']} ({_signed(entry['difference'])} s in {entry['stages']})"
        for entry in _along(document)[:NAMED]
    ]
    return f"{text}; most of it: {', '.join(named)}" if named else text


def _along(document: dict[str, Any]) -> list[dict[str, Any]]:
    """Return what is to blame for the whole difference: only what goes the same way, unless there is none."""
    whole = document["difference"]
    if abs(whole) <= SAME:
        return list(document["blamed"])
    return [entry for entry in document["blamed"] if entry["difference"] * whole > 0.0]


def schedules_csv(document: dict[str, Any]) -> bytes:
    """Return the stages as CSV; s, rad (m for joints that slide).

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
        found = row["blame"] or {}
        table.append(
            [cell_text(cells[name]) for name in plain]
            + [cell_text(found.get(name)) for name in blamed]
        )
    return csv_bytes(table)


def cause_text(row: dict[str, Any]) -> str:
    """Return what is to blame in a row of a comparison, or what keeps it from being compared."""
    if row["match"] not in ("same work", "other work beside it"):
        return str(row["match"])
    found = row["blame"]
    if found is None:
        return "–"
    name = f"{found['joint'] or ''} {found['part']}".strip()
    if not found["joint"]:
        name = f"{found['arm']} {found['part']}"
    return name if row["match"] == "same work" else f"{name} ({row['match']})"


def _change(found: dict[str, Any] | None) -> str:
    """Return what changed: the joint's way where that is why, the part's time otherwise."""
    if found is None:
        return ""
    ways = found["a_displacement"], found["b_displacement"]
    times = f"{found['a_time']:.3f} s → {found['b_time']:.3f} s"
    if found["cause"] == "displacement" and None not in ways:
        if found["slides"]:
            return " → ".join(f"{1e3 * way:.1f} mm" for way in ways)
        return " → ".join(f"{math.degrees(way):.1f}°" for way in ways)
    why = CAUSES[found["cause"]]
    return f"{times} ({why})" if why else times


def _seconds(value: float | None) -> str:
    return "–" if value is None else f"{value:.3f}"


def _signed(value: float) -> str:
    return "0.000" if abs(value) < 0.0005 else f"{value:+.3f}".replace("-", "−")
