"""Faults of an input file of any kind."""

from __future__ import annotations

from pathlib import Path

from dualarm_cli.errors import Diagnostic, InputError
from dualarm_cli.files.checking import load_file


def check_file(path: str | Path) -> list[Diagnostic]:
    """List everything wrong with a file and the files that it names."""
    try:
        load_file(path)
    except InputError as error:
        return error.diagnostics
    return []
