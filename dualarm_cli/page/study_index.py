"""A layout study as an index: one HTML page with a row for each point, of which the best ones lead to their plans."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from dualarm_cli.model.study import OBJECTIVES, Objective
from dualarm_cli.page.index_page import FOLDER, index_page, verified_cell
from dualarm_cli.page.tables import PageCell, PageRow, PageTable
from dualarm_cli.report.comparison.study_table import (
    STATUS_WORDS,
    most_time,
    objective_head,
    one_line_reason,
    parameter_label,
    point_text,
    sentences,
    value_text,
)

AS_IT_IS = -1
"""What stands for the number of a point for the files as they are."""


def study_index(document: Mapping[str, Any], pages: Mapping[tuple[int, int], str]) -> bytes:
    """Returns the index.

    Args:
        document: of `dualarm sweep`.
        pages: names of the plans' pages, by the number of the point and that of the task file.
    """
    named = [OBJECTIVES[entry["name"]] for entry in document["objectives"]]
    objectives = [*named, *(one for one in OBJECTIVES.values() if one not in named)]
    columns = [
        ("rank", True),
        ("plan", False),
        *([("Pareto", False)] if len(named) > 1 else []),
        *((parameter_label(one), one["numeric"]) for one in document["parameters"]),
        *((objective_head(one), True) for one in objectives),
        ("bound s", True),
        ("verified", False),
        ("most time", False),
        ("why not", False),
    ]
    reference: dict[str, Any] = {
        "rank": None,
        "point": AS_IT_IS,
        "values": {},
        "pareto": False,
        "reasons": [],
    }
    rows = [reference | document["reference"], *document["rows"]]
    found = [
        PageRow(_cells(document, row, objectives, _links(document, row, pages))) for row in rows
    ]
    shown = sum(row["point"] in {number for number, _ in pages} for row in document["rows"])
    lines = [*sentences(document, every=True), f"plans to watch: of the best {shown} points"]
    return index_page(document["study"], lines, [PageTable("", columns, found)])


def page_title(document: Mapping[str, Any], point: int, job: int) -> str:
    """Returns what a point's plan is called.

    Args:
        document: of `dualarm sweep`.
        point: number of the point, AS_IT_IS for the files as they are.
        job: number of the task file.
    """
    name = document["study"]
    if len(document["tasks"]) > 1:
        name += f", {document['tasks'][job]}"
    if point == AS_IT_IS:
        return f"as it is: {name}"
    row = next(row for row in document["rows"] if row["point"] == point)
    return f"{point_text(document, row)}: {name}"


def _links(
    document: Mapping[str, Any], row: Mapping[str, Any], pages: Mapping[tuple[int, int], str]
) -> dict[str, str]:
    """Returns the pages of a row's plans, by the names of their task files where there are several."""
    jobs = document["tasks"]
    paths = {k: pages.get((row["point"], k)) for k in range(len(jobs))}
    many = len(jobs) > 1
    return {
        jobs[k] if many else "watch": f"{FOLDER}/{path}"
        for k, path in paths.items()
        if path is not None
    }


def _cells(
    document: Mapping[str, Any],
    row: Mapping[str, Any],
    objectives: Sequence[Objective],
    links: Mapping[str, str],
) -> list[PageCell]:
    """Returns a row's cells, in the order of the columns."""
    jobs, status = row["jobs"], row["status"]
    bounds = [job["lower_bound"] for job in jobs]
    bound = "–" if None in bounds else f"{sum(bounds):.3f}"
    planned = status == "planned"
    caveats = list(dict.fromkeys(text for job in jobs for text in job["caveats"] if planned))
    as_it_is = row["point"] == AS_IT_IS
    values = [row["values"].get(one["name"], "") for one in document["parameters"]]
    rank = "as it is" if as_it_is else str(row["rank"] or "–")
    return [
        PageCell(rank),
        PageCell("", links=links),
        *([PageCell("*" if row["pareto"] else "")] if len(document["objectives"]) > 1 else []),
        *(PageCell(value_text(value)) for value in values),
        *(PageCell(one.shown(row[one.name])) for one in objectives),
        PageCell(bound if planned else "–"),
        verified_cell(status, caveats) if planned else PageCell(STATUS_WORDS[status], "bad"),
        PageCell(most_time(jobs) if planned else "–"),
        PageCell(one_line_reason("; ".join([*row["reasons"], *caveats]))),
    ]
