"""`dualarm why` as tables and sentences for the terminal."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import groupby
from typing import Any

from rich.markup import escape
from rich.table import Table

from dualarm_cli.report.printable import numbers

MOST_LEVERS = 15
"""Maximum number of levers in the table."""
KINDS = ("transfer", "turn", "approach", "dwell", "retract", "return", "path", "seam", "wait")
"""Kinds of pieces in the order of their columns."""


def shares_table(document: Mapping[str, Any]) -> Table:
    """Build the table of the critical path by kind and group."""
    time = {(row["group"], row["kind"]): row["time"] for row in document["shares"]}
    groups = list(dict.fromkeys(group for group, _ in time))
    total = document["cycle_time"]
    title = f"critical path of {total:.3f} s [s]"
    heads = numbers(*(escape(group or "none") for group in groups), "sum", "%")
    table = Table("", *heads, title=escape(title), title_justify="left")
    for kind in (*KINDS, "sum"):
        cells = [
            sum(t for (g, k), t in time.items() if g == group and kind in (k, "sum"))
            for group in groups
        ]
        if any(cells):
            shown = [f"{cell:.2f}" if cell else "" for cell in (*cells, sum(cells))]
            table.add_row(kind, *shown, f"{100.0 * sum(cells) / total:.1f}")
    return table


def levers_table(document: Mapping[str, Any], every: bool = False) -> Table:
    """Build the table of levers, largest gain first."""
    rows = document["levers"]
    least = 0.0005 * document["cycle_time"]  # shown as 0.1 %
    shown = [row for row in rows if every or row["status"] or (row["estimate"] or 0.0) > least]
    planned = sum(bool(row["status"]) for row in shown[MOST_LEVERS:])
    shown = [
        row for k, row in enumerate(shown) if every or row["status"] or k < MOST_LEVERS - planned
    ]
    kinds = {"estimated": "estimate", "re-planned": "gain"}
    words = [word for word, key in kinds.items() if any(row[key] is not None for row in rows)]
    title = f"levers: {len(shown)} of {len(rows)}; gain {' and '.join(words) or 'unknown'}"
    heads = numbers("estimate s", "gain s", "%", no_wrap=True)
    table = Table("lever", "change", *heads, title=title, title_justify="left")
    for row in shown:
        estimate = _number(row["estimate"], 3, "?")
        gain = _number(row["gain"], 3, "no plan" if row["status"] else "")
        best = row["gain"] if row["gain"] is not None else row["estimate"]
        share = _number(best and 100.0 * best / document["cycle_time"], 1)
        style = "green" if row["gain"] is not None and row["gain"] > 0.0 else ""
        table.add_row(
            escape(row["name"]), escape(row["change"]), estimate, gain, share, style=style
        )
    return table


def _number(value: float | None, digits: int, missing: str = "") -> str:
    """Format a number without a sign before zeros."""
    return missing if value is None else f"{round(value, digits) + 0.0:.{digits}f}"


def combinations_table(document: Mapping[str, Any]) -> Table:
    """Build the table of levers together, each lever on its own line."""
    heads = numbers("cycle s", "gain s", "%", no_wrap=True)
    title = "together, re-planned and verified"
    table = Table("levers", *heads, title=title, title_justify="left")
    levers = document["levers"]
    for row in document["combinations"]:
        names = "\n".join(f"{levers[k]['name']} {levers[k]['change']}" for k in row["levers"])
        share = row["gain"] and 100.0 * row["gain"] / document["cycle_time"]
        cells = _number(row["cycle_time"], 3, "no plan"), _number(row["gain"], 3), _number(share, 1)
        table.add_row(escape(names), *cells)
    return table


def stages_table(document: Mapping[str, Any]) -> Table:
    """Build the table of stages: what decides each, and the slack of the others."""
    table = Table("stage", *numbers("start s"), "decided by", "slack of others ms")
    pieces = document["pieces"]
    chain = [
        pieces[link["piece"]] for link in document["critical_path"] if link["piece"] is not None
    ]
    for stage in sorted({piece["stage"] for piece in pieces}):
        inside = [piece for piece in pieces if piece["stage"] == stage]
        runs = groupby((p for p in chain if p["stage"] == stage), key=lambda p: p["group"])
        decided = [f"{group} {', '.join(p['kind'] for p in run)}" for group, run in runs]
        least: dict[str, float] = {}
        for piece in inside:
            group = piece["group"]
            least[group] = min(piece["slack"], least.get(group, piece["slack"]))
        slack = [f"{g} {1e3 * t:.0f}" for g, t in least.items() if t > 1e-6]
        start = min(piece["start"] for piece in inside)
        table.add_row(str(stage), f"{start:.3f}", "; ".join(decided), ", ".join(slack))
    return table
