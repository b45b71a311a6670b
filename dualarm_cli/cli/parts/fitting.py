"""Tables on consoles of any width, without cut-off text or constant columns."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.box import SIMPLE_HEAD
from rich.measure import Measurement
from rich.table import Column, Table
from rich.text import Text

if TYPE_CHECKING:
    from rich.console import Console

UNLIMITED = 10_000
"""Width without limit [characters]."""
NOTHING = ("", "–")
"""Texts of empty cells."""


def fitted(table: Table, console: Console) -> Table:
    """Fit a table to a console; constant columns move below it.

    Columns with the same words in every row are removed. Where the table is too wide, heads get several lines, then
    numbers that are the same go, the last column first. If need be, words move to the next line, or the lines between
    columns go.
    """
    same = _same_in_all_rows(table)
    out = [k for k, text in same.items() if text in NOTHING or not _is_number(table.columns[k])]
    shown = _without(table, out)
    if _fits(shown, console):
        return shown
    for column in filter(_is_number, table.columns):
        column.header = str(column.header).replace(" ", "\n")
        column.no_wrap = True
    for k in [None, *sorted(set(same) - set(out), reverse=True)]:
        out += [] if k is None else [k]
        shown = _without(table, out)
        if _fits(shown, console):
            return shown
    between = len(shown.columns) - 1
    if not _fits_without_lines(shown, console) and _share_room(
        shown, console.width - 3 * between - 4
    ):
        return shown
    shown.box, shown.show_edge, shown.padding = SIMPLE_HEAD, False, 0
    _share_room(shown, console.width - between)
    return shown


def _is_number(column: Column) -> bool:
    return column.justify == "right"


def _same_in_all_rows(table: Table) -> dict[int, str]:
    """Find the text of constant columns, by index; the first column names the rows."""
    if table.row_count < 2:
        return {}
    texts = {k: {str(cell) for cell in column.cells} for k, column in enumerate(table.columns)}
    return {k: next(iter(values)) for k, values in texts.items() if k and len(values) == 1}


def _without(table: Table, out: list[int]) -> Table:
    """Remove columns from a table and list their constant values below it."""
    if not out:
        return table
    kept = [column for k, column in enumerate(table.columns) if k not in out]
    new = Table(title=table.title, title_justify=table.title_justify, caption_justify="left")
    constants = [(table.columns[k].header, next(iter(table.columns[k].cells))) for k in sorted(out)]
    constants = [
        (str(head).replace("\n", " "), text) for head, text in constants if text not in NOTHING
    ]
    if constants:
        new.caption = f"in every row: {', '.join(f'{head} {text}' for head, text in constants)}"
    for column in kept:
        new.add_column(
            column.header, justify=column.justify, style=column.style, no_wrap=column.no_wrap
        )
        new.columns[-1].overflow = column.overflow
    for k, row in enumerate(table.rows):
        cells = [list(column.cells)[k] for column in kept]
        new.add_row(*cells, style=row.style, end_section=row.end_section)
    return new


def _fits(table: Table, console: Console) -> bool:
    """Check whether a table fits the console."""
    options = console.options.update(width=UNLIMITED)
    return Measurement.get(console, options, table).maximum <= console.width


def _fits_without_lines(table: Table, console: Console) -> bool:
    """Check whether a table fits with only spaces between its columns."""
    widths = [max(map(_length, _lines(column))) for column in table.columns]
    return sum(widths) + len(widths) - 1 <= console.width


def _share_room(table: Table, room: int) -> bool:
    """Distribute the width left by numbers to columns of words.

    Returns whether no word is folded.

    Args:
        table: whose columns get their widths.
        room: for what stands in the columns [characters].
    """
    need: list[tuple[int, int, Column]] = []
    for column in table.columns:
        lines = _lines(column)
        longest = max(map(_length, lines))
        if _is_number(column):
            room -= longest
            continue
        word = max((_length(word) for line in lines for word in line.split()), default=1)
        column.no_wrap, column.overflow = False, "fold"
        need.append((longest, word, column))
        room -= word
    if room < 0:
        return False
    for longest, word, column in sorted(need, key=lambda entry: entry[0] - entry[1]):
        column.width = word + min(longest - word, room)
        room -= column.width - word
    return True


def _lines(column: Column) -> list[str]:
    """List the displayed lines of a column's head and cells."""
    texts = [Text.from_markup(str(text)).plain for text in (column.header, *column.cells)]
    return [line for text in texts for line in text.split("\n")]


def _length(text: str) -> int:
    return Text(text).cell_len
