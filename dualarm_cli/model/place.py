"""Place in a file, for messages."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import PurePosixPath

from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class Place:
    """A place in a file."""

    file: str
    """Location in a file."""
    line: int
    """Line, from 1."""
    column: int
    """Column, from 1."""

    @property
    def order(self) -> tuple[str, int, int]:
        """Sort key by file, line and column."""
        return self.file, self.line, self.column

    def __str__(self) -> str:
        """Return `file:line:column`."""
        return f"{self.file}:{self.line}:{self.column}"


NOWHERE = Place("", 0, 0)
"""Place of data that no file contains."""


def tasks_name(inputs: Iterable[str]) -> str:
    """Name a job by its task file, or by the folder of `tasks.yaml`.

    Args:
        inputs: names of the files that were read, the task file first.

    Returns:
        The name, empty for a job without files.
    """
    name = PurePosixPath(next(iter(inputs), ""))
    return name.parent.name if name.stem == "tasks" else name.stem
