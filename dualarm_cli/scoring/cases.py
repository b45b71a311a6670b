"""Which task files are scored: names, patterns and folders."""

from __future__ import annotations

import glob
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

from dualarm_cli.errors import UsageError
from dualarm_cli.evaluation.request import case_name
from dualarm_cli.files.source.text_source import MAX_FILE_BYTES, quote

_TASKS = re.compile(
    rb"""^(?:\xef\xbb\xbf)?[\s{]*(['"]?)dualarm\1\s*:\s*['"]?tasks/""", re.MULTILINE
)
"""The key that tells a task file; quoted and between braces it is the same YAML."""


def find_cases(patterns: Sequence[str]) -> list[str]:
    """Returns the names of the task files that patterns mean, each once, sorted.

    A name of a file is that file, whatever is in it; of a folder all task files in it and below. Anything else is a
    pattern, in which `**` stands for any folders; where it matches folders and no file, it means these. Hidden files
    and folders are named by name only.

    Args:
        patterns: as the user wrote them; the shell may have left patterns to us.

    Raises:
        UsageError: one that nothing goes by: a case that is missing must not pass.
    """
    found: dict[str, None] = {}
    for pattern in patterns:
        names = _matches(pattern)
        if not names:
            folder = bool(pattern) and Path(pattern).is_dir()
            what = "has no task files (tasks/1)" if folder else "does not exist and matches no file"
            raise UsageError(f"{quote(pattern)} {what}: there is nothing to score")
        found |= dict.fromkeys(case_name(name) for name in names)
    return sorted(found)


def _matches(pattern: str) -> list[str]:
    if not pattern or "\0" in pattern:
        return []
    path = Path(pattern)
    if path.is_dir():
        return _tasks_in(pattern)
    # The name comes first: it may have brackets in it.
    if os.path.lexists(path) or not glob.has_magic(pattern):
        return [pattern]
    names = glob.glob(pattern, recursive=True)  # noqa: PTH207
    files = [name for name in names if not Path(name).is_dir()]
    return files or [task for folder in names for task in _tasks_in(folder)]


def _tasks_in(folder: str) -> list[str]:
    """Returns the task files of a folder, found by their `dualarm` key.

    Raises:
        UsageError: it cannot be looked into, nor can a folder in it.
    """

    def unread(error: OSError) -> NoReturn:
        raise UsageError(
            f"{quote(error.filename)} cannot be searched for task files: {error.strerror}"
        )

    found = []
    for place, folders, files in os.walk(folder, onerror=unread):
        folders[:] = [name for name in folders if not name.startswith(".")]
        for name in files:
            path = Path(place) / name
            if not name.startswith(".") and path.suffix in (".yaml", ".yml") and _is_tasks(path):
                found.append(str(path))
    return found


def _is_tasks(path: Path) -> bool:
    try:
        if not path.is_file():
            return False
        with path.open("rb") as file:
            return _TASKS.search(file.read(MAX_FILE_BYTES)) is not None
    except OSError:
        return True  # what cannot be read is not passed over in silence
