"""Place in a file, for messages."""

from __future__ import annotations

from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class Place:
    """A place in a file."""

    file: str
    """File as the user names it."""
    line: int
    """Line, from 1."""
    column: int
    """Column, from 1."""

    @property
    def order(self) -> tuple[str, int, int]:
        """Sort key by file, line and column."""
        return self.file, self.line, self.column

    def __str__(self) -> str:
        """Returns `file:line:column`."""
        return f"{self.file}:{self.line}:{self.column}"


NOWHERE = Place("", 0, 0)
"""Of what stands in no file."""
