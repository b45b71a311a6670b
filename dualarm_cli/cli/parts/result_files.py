"""Folders of results other than schedules: refused early, with every file written atomically."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dualarm_cli.errors import OutputError, UsageError


def refuse_folder(out: str, names: tuple[str, ...], force: bool) -> None:
    """Raise if a folder cannot be made, or has one of the files already.

    Raises:
        OutputError: with what to do.
        UsageError: an empty name.
    """
    from dualarm_cli.exporting.files import check_writable
    from dualarm_cli.exporting.whole_files import place_in

    if out == "":
        raise UsageError("--out '': name a folder, or leave the option out")
    folder = Path(out)
    # An existing schedule stays unchanged; only our own files would be replaced.
    check_writable(folder, force=True)
    for name in names:
        if place_in(folder, name).exists() and not force:
            raise OutputError(
                f"--out {folder}: already holds {name}; add --force to replace it, or name another"
            )


def write_folder(out: str, files: dict[str, bytes]) -> None:
    """Write files into a folder in their order, each whole or not.

    Raises:
        OutputError: the folder or a file cannot be made.
    """
    from dualarm_cli.exporting.whole_files import replace_all

    replace_all(Path(out), {name: [content] for name, content in files.items()})


def json_bytes(document: Mapping[str, Any]) -> bytes:
    """Encode a document as the content of a file."""
    text = json.dumps(document, indent=2, allow_nan=False, ensure_ascii=False) + "\n"
    return text.encode("utf-8", "backslashreplace")
