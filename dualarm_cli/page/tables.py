"""Tables of HTML pages, with all text from files escaped."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from dataclasses import field
from urllib.parse import quote

from dualarm_cli.records import dataclass
from dualarm_cli.report.printable import printable

STYLE = """\
:root { color-scheme: light dark; font: clamp(14px, min(0.73vw, 1.3vh), 32px)/1.4 system-ui, sans-serif }
:root { --good: #1a7f5a; --warn: #8a5a00; --bad: #c0392b }
@media (prefers-color-scheme: dark) { :root { --good: #6fd3ab; --warn: #e8b84a; --bad: #ff8f80 } }
* { box-sizing: border-box }
.scroll { overflow-x: auto; background:
  linear-gradient(to right, Canvas 50%, transparent) 0 0 / 24px 100% no-repeat local,
  linear-gradient(to left, Canvas 50%, transparent) 100% 0 / 24px 100% no-repeat local,
  linear-gradient(to right, #8888, transparent) 0 0 / 8px 100% no-repeat,
  linear-gradient(to left, #8888, transparent) 100% 0 / 8px 100% no-repeat }
table { border-collapse: collapse; font-variant-numeric: tabular-nums }
caption { text-align: left; font-weight: 600; padding: 6px 0 2px }
th, td { padding: 1px 10px; text-align: left; vertical-align: top; white-space: pre-line }
.number { text-align: right; white-space: nowrap }
.good { color: var(--good); font-weight: 600 }
.warn { color: var(--warn); font-weight: 600 }
.bad { color: var(--bad); font-weight: 600 }
"""
"""Style sheet of pages with tables."""


@dataclass(frozen=True)
class PageCell:
    """Cell of a table."""

    text: str
    """Text, with its line breaks."""
    mark: str = ""
    """`good`, `warn`, `bad`, or empty."""
    links: Mapping[str, str] = field(default_factory=dict)
    """Linked files by their labels, shown after the text."""


@dataclass(frozen=True)
class PageRow:
    """Row of a table."""

    cells: Sequence[PageCell]
    """Cells, one per column."""
    data: Mapping[str, object] = field(default_factory=dict)
    """Values for a script by name."""


@dataclass(frozen=True)
class PageTable:
    """Table of a page."""

    title: str
    """Caption above the table, or empty."""
    columns: Sequence[tuple[str, bool]]
    """Column names, and whether they hold numbers."""
    rows: Sequence[PageRow]
    """Rows from top to bottom."""
    note: str = ""
    """Note below the table, or empty."""


def text_html(text: str) -> str:
    """Escape a text as HTML."""
    return html.escape(printable(text))


def table_html(table: PageTable) -> str:
    """Render a table as HTML."""
    title = f"<caption>{text_html(table.title)}</caption>" if table.title else ""
    head = "".join(f"<th{_class(number)}>{text_html(name)}</th>" for name, number in table.columns)
    rows = "\n".join(_row(row, table.columns) for row in table.rows)
    note = f"<p>{text_html(table.note)}</p>\n" if table.note else ""
    whole = f"{title}\n<thead><tr>{head}</tr></thead>\n<tbody>\n{rows}\n</tbody>"
    return f'<div class="scroll"><table>{whole}</table></div>\n{note}'


def _row(row: PageRow, columns: Sequence[tuple[str, bool]]) -> str:
    data = "".join(f' data-{name}="{text_html(str(v))}"' for name, v in row.data.items())
    pairs = zip(row.cells, columns, strict=True)
    return f"<tr{data}>{''.join(_cell(cell, number) for cell, (_, number) in pairs)}</tr>"


def _cell(cell: PageCell, number: bool) -> str:
    links = [f'<a href="{html.escape(quote(p))}">{text_html(w)}</a>' for w, p in cell.links.items()]
    content = "\n".join([text_html(cell.text), *links] if cell.text else links)
    return f"<td{_class(number, cell.mark)}>{content}</td>"


def _class(number: bool, mark: str = "") -> str:
    names = " ".join(name for name in ("number" if number else "", mark) if name)
    return f' class="{names}"' if names else ""
