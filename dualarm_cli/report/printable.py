"""Text for display: input made safe, sentences wrapped at spaces and coloured."""

from __future__ import annotations

from html import escape
from importlib import import_module
from io import StringIO
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Column

STYLES = (
    (r"(?<=: )passed\b(?!.*, except that)", "green"),
    (r"(?<=: )passed\b(?=.*, except that)|, except that .*|(?<=; )assumed: .*", "yellow"),
    (r"^(warning|note):", "yellow"),
    (r"^error(\[E\d+\])?:|\b(FAILED|MISSED)\b.*", "bold red"),
)
"""Colours of parts of sentences, by pattern."""


def printable(value: Any) -> Any:
    """Escape text that would control a terminal or is not valid.

    Args:
        value: JSON-ready; its names may come from input files.
    """
    if isinstance(value, str):
        return "".join(
            c if c.isprintable() or c == "\n" else c.encode("unicode_escape").decode("ascii")
            for c in value
        )
    if isinstance(value, dict):
        return {printable(key): printable(entry) for key, entry in value.items()}
    return [printable(entry) for entry in value] if isinstance(value, list) else value


class PrintedComparison(dict[str, Any]):
    """Document of a comparison, JSON-ready, which prints as its tables."""

    def __str__(self) -> str:
        """Format as the command prints it."""
        from rich.console import Console

        # Tables are a room above: they are imported when one is printed.
        name = "schedule_comparison_table" if "stages" in self else "comparison_table"
        tables = import_module(f"dualarm_cli.report.comparison.{name}")
        show = tables.print_schedules if "stages" in self else tables.print_solvers
        text = StringIO()
        show(Console(file=text, width=200, highlight=False, color_system=None), self)
        return text.getvalue().rstrip("\n")

    def _repr_html_(self) -> str:
        return f"<pre>{escape(str(self))}</pre>"


def numbers(*headings: str, no_wrap: bool = False) -> list[Column]:
    """Make the columns of a table that hold numbers, flush right."""
    from rich.table import Column

    return [Column(heading, justify="right", no_wrap=no_wrap) for heading in headings]


def one_line(text: str) -> str:
    """Escape text for display within a line, including line ends."""
    shown: str = printable(text)
    return shown.replace("\n", "\\n")


def print_lines(console: Console, *texts: str) -> None:
    """Print sentences; on a terminal they wrap at spaces, and verdicts have colours.

    Indented lines, such as lines of source files, keep their shape.
    """
    from rich.text import Text

    for line in "\n".join(texts).split("\n"):
        text = Text(line)
        for pattern, style in STYLES:
            text.highlight_regex(pattern, style)
        console.print(text, soft_wrap=line.startswith(" ") or not console.is_terminal)
