"""The page of `dualarm compare solvers`: what each method came to, and the plans in motion beside the best one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dualarm_cli.model.verification import exceptions
from dualarm_cli.page.side_by_side import side_by_side
from dualarm_cli.page.tables import PageCell, PageRow, PageTable
from dualarm_cli.report.comparison.comparison import (
    SHOWN,
    SOLVERS,
    row_namer,
    section_title,
    varied_solvers,
)

TITLE, HINT = "Methods compared", "A click on a method shows its plan beside the fastest one."
_MARKS = {"verified": "good", "failed": "bad", "infeasible": "bad", "not served": ""}

PlanKey = tuple[str, ...]
"""Task file and what tells a row of it from the others (SOLVERS)."""


def plan_key(tasks: str, row: Mapping[str, Any]) -> PlanKey:
    """Returns what the data of a row's plan are found by.

    Args:
        tasks: what the task file is called.
        row: of the document.
    """
    return tasks, *(row[key] for key in SOLVERS)


def solvers_page(document: Mapping[str, Any], plans: Mapping[PlanKey, Mapping[str, Any]]) -> bytes:
    """Returns one HTML file with all plans of a comparison.

    Args:
        document: of `dualarm compare solvers`.
        plans: data of their pages (`page_data`).

    Raises:
        PageNotBuiltError: this installation has no code of the page.
    """
    shown: list[dict[str, Any]] = []
    tables = []
    first: list[int] = []
    for section in document["comparisons"]:
        places: dict[int, int] = {}
        called = row_namer(section["rows"])
        for k, row in enumerate(section["rows"]):
            data = plans.get(plan_key(section["tasks"], row))
            if data is not None:
                places[k] = len(shown)
                shown.append({**data, "title": f"{data['title']}: {called(row)}"})
        tables.append(_table(section, places))
        first = first or list(places.values())[:2]
    return side_by_side(TITLE, HINT, tables, shown, first)


def _table(section: dict[str, Any], places: Mapping[int, int]) -> PageTable:
    """Returns the table of one task file.

    Args:
        section: of the document.
        places: where the plans of its rows are, by the number of the row; the best one's comes first.
    """
    rows, varied = section["rows"], varied_solvers(section["rows"])
    title = section_title(section, section["tasks"])
    if section["lower_bound"] is not None:
        title += f", lower bound {section['lower_bound']:.3f} s"
    names = [(name, False) for name in ("method", *varied)]
    numbers = [(n, True) for n in ("cycle s", "loss s", "loss", "to the bound", "clearance mm")]
    best = min((row["cycle_time"] for row in rows if row["status"] == "verified"), default=None)
    found = []
    for k, row in enumerate(rows):
        cells = [PageCell(row[key]) for key in ("method", *varied)]
        cells += [PageCell(text) for text in _figures(row, best)]
        plan = row["status"] + (f": {row['reason']}" if row["reason"] else "")
        mark = "warn" if row["status"] == "verified" and row["caveats"] else _MARKS[row["status"]]
        cells.append(PageCell(plan + exceptions(row["caveats"]), mark))
        data = {"plan": places[k], "beside": min(places.values())} if k in places else {}
        found.append(PageRow(cells, data))
    columns = [*names, *numbers, ("plan", False)]
    return PageTable(title, columns, found, note=section["sentence"])


def _figures(row: Mapping[str, Any], best: float | None) -> list[str]:
    """Returns a row's numbers as they are read: cycle time, loss against the best one, gap, clearance."""
    time, clearance = row["cycle_time"], row["clearance"]
    if time is None:
        return ["–"] * 5
    loss, share = "–", "–"
    if best is not None and abs(time - best) < SHOWN:
        loss, share = "0.000", "0.0%"
    elif best is not None:
        loss = f"{time - best:+.3f}".replace("-", "−")
        share = f"{time / best - 1.0:+.1%}".replace("-", "−") if best > 0.0 else "–"
    return [
        f"{time:.3f}",
        loss,
        share,
        "–" if row["gap"] is None else f"{row['gap']:.1%}",
        "–" if clearance is None else f"{clearance * 1e3:.1f}",
    ]
