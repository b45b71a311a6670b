"""Bundled robots and task files: where they are, in an installed package and in a source tree."""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path

from dualarm_cli.errors import Diagnostic, InputError
from dualarm_cli.files.source.text_source import suggest

ROBOT_FILE = "robot.yaml"
"""Name of the robot file in each robot's folder."""
TASK_FILE = "tasks.yaml"
"""Name of the task file in each job's folder."""


@cache
def robots_folder() -> Path:
    """Return the folder with one folder per bundled robot.

    A wheel carries it inside the package; a source tree has it beside the package.
    """
    return _folder("robots")


def _folder(name: str) -> Path:
    package = Path(__file__).resolve().parents[2]
    installed = package / "bundled" / name
    return installed if installed.is_dir() else package.parent / name


def bundled_robots() -> list[str]:
    """Return the names of the bundled robots, sorted."""
    folder = robots_folder()
    if not folder.is_dir():
        return []
    return sorted(entry.name for entry in folder.iterdir() if (entry / ROBOT_FILE).is_file())


def bundled_tasks() -> dict[str, Path]:
    """Return the bundled task files by the names of their folders, sorted: the reference work of comparisons."""
    folder = _folder("tasks")
    if not folder.is_dir():
        return {}
    found = (entry / TASK_FILE for entry in sorted(folder.iterdir()))
    return {path.parent.name: path for path in found if path.is_file()}


def task_file(path: str | Path) -> tuple[Path, str]:
    """Return the task file that a path or the name of a bundled job means, and what messages call it.

    Args:
        path: a path; a bundled job's name where no file has that one.

    Raises:
        InputError: something that looks like a name is neither.
    """
    name = str(path)
    known = bundled_tasks()
    if name in known and not Path(path).is_file():
        return known[name], f"tasks/{name}/{TASK_FILE}"
    if name.replace("_", "").isalnum() and not os.path.lexists(path):
        message = (
            f"there is no such file and no such bundled job{suggest(name, list(known), 'jobs')}"
        )
        raise InputError([Diagnostic(name, 0, 0, "E500", message)])
    return Path(path), name
