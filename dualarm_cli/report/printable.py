"""Text from somebody's files, made fit to be shown."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.table import Column


def printable(value: Any) -> Any:
    """Return a document in which text that would steer a terminal, or is no text at all, is spelt out.

    Args:
        value: JSON-ready; names in it may come from somebody's files.
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
    """Return text fit to be shown within a line: a name with a line end in it would begin one of its own."""
    shown: str = printable(text)
    return shown.replace("\n", "\\n")
