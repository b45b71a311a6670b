"""Index of many plans: an HTML table with links to plan pages.

It is a single file without scripts.

A layout study becomes an index with a row for each point; the best points link to their plans.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from dualarm_cli.model.studies.study import OBJECTIVES, Objective
from dualarm_cli.page.tables import STYLE, PageCell, PageRow, PageTable, table_html, text_html
from dualarm_cli.report.comparison.study_table import (
    STATUS_WORDS,
    figure_text,
    most_time,
    objective_head,
    one_line_reason,
    parameter_label,
    point_text,
    sentences,
    value_text,
)

INDEX, FOLDER = "index.html", "plans"
"""File name of the index, and name of the folder with the plans' pages."""
MARK = b"<!doctype html>\n<!-- dualarm index -->\n"
"""First bytes of an index that this package wrote."""
NOTHING = "–"
"""Text of a table cell without a value."""
MAX_NAME_LENGTH = 80
"""Maximum number of characters in a page's name, without its extension."""
_POLICY = "default-src 'none'; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'"
_PAGE = """<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>
{style}body {{ margin: 0 auto; padding: 16px 24px; max-width: 120rem }}
h1 {{ font-size: 22px; margin: 4px 0 }}
p {{ margin: 4px 0 }}
td:last-child {{ min-width: 20rem }}
main {{ margin-top: 12px }}
td, th {{ border-bottom: 1px solid #8884; padding: 3px 10px; overflow-wrap: break-word }}
th {{ position: sticky; top: 0; background: Canvas; white-space: nowrap }}
table {{ margin-bottom: 16px }}
</style>
</head>
<body>
<h1>{title}</h1>
{lines}<main>
{tables}</main>
</body>
</html>
"""


def index_page(title: str, lines: Sequence[str], tables: Sequence[PageTable]) -> bytes:
    """Build an index page.

    Args:
        title: of the page.
        lines: sentences above the tables.
        tables: their cells lead to pages in FOLDER.
    """
    words = {
        "title": text_html(title),
        "policy": _POLICY,
        "style": STYLE,
        "lines": "".join(f"<p>{text_html(line)}</p>\n" for line in lines),
        "tables": "".join(table_html(_without_empty(table)) for table in tables),
    }
    return MARK + _PAGE.format(**words).encode("utf-8", "backslashreplace")


def _without_empty(table: PageTable) -> PageTable:
    """Drop the columns without any value."""
    columns = [
        k
        for k in range(len(table.columns))
        if any(row.cells[k].links or row.cells[k].text not in ("", NOTHING) for row in table.rows)
    ]
    rows = [PageRow([row.cells[k] for k in columns], row.data) for row in table.rows]
    return replace(table, columns=[table.columns[k] for k in columns], rows=rows)


def page_names(names: Iterable[str]) -> list[str]:
    """Compose a distinct file name for each given name, in the same order.

    The names differ in more than case, because some file systems ignore case.

    Args:
        names: such as those of task files.
    """
    files: dict[str, None] = {}
    for name in names:
        plain = re.sub(r"[^A-Za-z0-9]+", "-", name.removesuffix("/tasks.yaml")).strip("-")
        plain = plain.lower()[-MAX_NAME_LENGTH:].strip("-") or "plan"
        k, new = 1, plain
        while new in files:
            k, new = k + 1, f"{plain}-{k + 1}"
        files[new] = None
    return [f"{name}.html" for name in files]


def verified_cell(status: str, caveats: Sequence[str]) -> PageCell:
    """Build the cell on the verification status of a plan.

    Args:
        status: of its evaluation.
        caveats: sentences on what its pass leaves open.
    """
    if status == "planned":
        return PageCell("not fully", "warn") if caveats else PageCell("yes", "good")
    return PageCell("no", "bad") if status == "fails_verification" else PageCell(NOTHING)


AS_IT_IS = -1
"""Point number of the unchanged files."""


def study_index(document: Mapping[str, Any], pages: Mapping[tuple[int, int], str]) -> bytes:
    """Build the index page of a study.

    Args:
        document: of `dualarm sweep`.
        pages: names of the plans' pages, by the number of the point and that of the task file.
    """
    named = [OBJECTIVES[entry["name"]] for entry in document["objectives"]]
    objectives = [*named, *(item for item in OBJECTIVES.values() if item not in named)]
    columns = [
        ("rank", True),
        ("plan", False),
        *([("Pareto", False)] if len(named) > 1 else []),
        *((parameter_label(item), item["numeric"]) for item in document["parameters"]),
        *((objective_head(item), True) for item in objectives),
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
    page_rows = [
        PageRow(_cells(document, row, objectives, _links(document, row, pages))) for row in rows
    ]
    shown = sum(row["point"] in {number for number, _ in pages} for row in document["rows"])
    lines = [*sentences(document, every=True), f"plans to watch: of the best {shown} points"]
    return index_page(document["study"], lines, [PageTable("", columns, page_rows)])


def page_title(document: Mapping[str, Any], point: int, job: int) -> str:
    """Compose the title of a point's plan.

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
    """Collect the links to the pages of a row's plans by their labels.

    The labels are the names of the task files if there are several, else `watch`.
    """
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
    """Build the cells of a row in the order of the columns."""
    jobs, status = row["jobs"], row["status"]
    bounds = [job["lower_bound"] for job in jobs]
    bound = "–" if None in bounds else f"{sum(bounds):.3f}"
    planned = status == "planned"
    caveats = list(dict.fromkeys(text for job in jobs for text in job["caveats"] if planned))
    as_it_is = row["point"] == AS_IT_IS
    values = [row["values"].get(item["name"], "") for item in document["parameters"]]
    rank = "as it is" if as_it_is else str(row["rank"] or "–")
    return [
        PageCell(rank),
        PageCell("", links=links),
        *([PageCell("*" if row["pareto"] else "")] if len(document["objectives"]) > 1 else []),
        *(PageCell(value_text(value)) for value in values),
        *(PageCell(figure_text(item, row)) for item in objectives),
        PageCell(bound if planned else "–"),
        verified_cell(status, caveats) if planned else PageCell(STATUS_WORDS[status], "bad"),
        PageCell(most_time(jobs) if planned else "–"),
        PageCell(one_line_reason("; ".join([*row["reasons"], *caveats]))),
    ]
