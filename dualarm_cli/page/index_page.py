"""An index of many plans: one HTML file with tables whose rows lead to the pages beside it; it has no script."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import replace

from dualarm_cli.page.tables import STYLE, PageCell, PageRow, PageTable, table_html, text_html

INDEX, FOLDER = "index.html", "plans"
"""Name of the index, and of the folder beside it with the pages of the plans."""
MARK = b"<!doctype html>\n<!-- dualarm index -->\n"
"""What an index begins with that was written here."""
NOTHING = "–"
"""What stands where there is nothing to say."""
LONGEST_NAME = 80
"""Most characters of a page's name, its ending not counted."""
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
main {{ margin-top: 12px; overflow-x: auto }}
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
    """Returns an index.

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
    """Returns a table without the columns in which nothing stands."""
    kept = [
        k
        for k in range(len(table.columns))
        if any(row.cells[k].links or row.cells[k].text not in ("", NOTHING) for row in table.rows)
    ]
    rows = [PageRow([row.cells[k] for k in kept], row.data) for row in table.rows]
    return replace(table, columns=[table.columns[k] for k in kept], rows=rows)


def page_names(names: Iterable[str]) -> list[str]:
    """Returns names of files for what has a name, in the same order and all different.

    Case does not tell them apart: the folder may be unpacked where it does not.

    Args:
        names: such as those of task files.
    """
    found: dict[str, None] = {}
    for name in names:
        plain = re.sub(r"[^A-Za-z0-9]+", "-", name.removesuffix("/tasks.yaml")).strip("-")
        plain = plain.lower()[-LONGEST_NAME:].strip("-") or "plan"
        k, new = 1, plain
        while new in found:
            k, new = k + 1, f"{plain}-{k + 1}"
        found[new] = None
    return [f"{name}.html" for name in found]


def verified_cell(status: str, caveats: Sequence[str]) -> PageCell:
    """Returns whether the verifier passes a plan, as a cell.

    Args:
        status: of its evaluation.
        caveats: sentences on what its pass leaves open.
    """
    if status == "planned":
        return PageCell("not fully", "warn") if caveats else PageCell("yes", "good")
    return PageCell("no", "bad") if status == "fails_verification" else PageCell(NOTHING)
