"""Folders of results that are no schedules: refused early, written file by file, each whole or not at all."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from dualarm_cli.errors import OutputError, UsageError


def refuse_folder(out: str, names: tuple[str, ...], force: bool) -> None:
    """Raise where a folder cannot be made, or holds one of the files already.

    Raises:
        OutputError: with what to do.
        UsageError: an empty name.
    """
    from dualarm_cli.exporting.files import check_writable
    from dualarm_cli.exporting.whole_files import place_in

    if out == "":
        raise UsageError("--out '': name a folder, or leave the option out")
    folder = Path(out)
    # A schedule that is there stays as it is; only our own files would be replaced.
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


def json_bytes(document: dict[str, Any]) -> bytes:
    """Return a document as it is written to a file."""
    text = json.dumps(document, indent=2, allow_nan=False, ensure_ascii=False) + "\n"
    return text.encode("utf-8", "backslashreplace")
