"""Text from input files, made safe for display."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.table import Column


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


def numbers(*headings: str, no_wrap: bool = False) -> list[Column]:
    """Make the columns of a table that hold numbers, flush right."""
    from rich.table import Column

    return [Column(heading, justify="right", no_wrap=no_wrap) for heading in headings]


def one_line(text: str) -> str:
    """Escape text for display within a line, including line ends."""
    shown: str = printable(text)
    return shown.replace("\n", "\\n")
