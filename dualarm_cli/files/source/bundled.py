"""Paths of bundled robots, task files and pages of the documentation."""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path

from dualarm_cli.errors import Diagnostic, InputError
from dualarm_cli.files.source.text_source import suggest

CELL_FILE = "cell.yaml"
"""Name of the cell file in the folder of two imported robots."""
ROBOT_FILE = "robot.yaml"
"""Name of the robot file in each robot's folder."""
TASK_FILE = "tasks.yaml"
"""Name of the task file in each job's folder."""
STUDY_FILE = "study.yaml"
"""Name of the study file in a job's folder."""


@cache
def robots_folder() -> Path:
    """Locate the folder with one folder per bundled robot.

    A wheel has it inside the package, a source tree next to the package.
    """
    return _folder("robots")


def _folder(name: str) -> Path:
    package = Path(__file__).resolve().parents[2]
    installed = package / "bundled" / name
    return installed if installed.is_dir() else package.parent / name


def documentation_page(name: str) -> Path:
    """Locate a page of the documentation by its path below `docs`."""
    return _folder("docs") / name


def bundled_robots() -> list[str]:
    """List the names of the bundled robots, sorted."""
    folder = robots_folder()
    if not folder.is_dir():
        return []
    return sorted(entry.name for entry in folder.iterdir() if (entry / ROBOT_FILE).is_file())


def bundled_tasks(file: str = TASK_FILE) -> dict[str, Path]:
    """List the bundled task files, or studies, by job name, sorted."""
    folder = _folder("tasks")
    if not folder.is_dir():
        return {}
    paths = (entry / file for entry in sorted(folder.iterdir()))
    return {path.parent.name: path for path in paths if path.is_file()}


def task_file(path: str | Path, file: str = TASK_FILE) -> tuple[Path, str]:
    """Resolve a path or a bundled job's name to a task file, or study.

    The second result is its name in messages.

    Args:
        path: a path; a bundled job's name where no file has that one.
        file: name of the file in the job's folder.

    Raises:
        InputError: something that looks like a name is neither.
    """
    name = str(path)
    jobs = bundled_tasks(file)
    if name in jobs and not Path(path).is_file():
        return jobs[name], f"tasks/{name}/{file}"
    if name.replace("_", "").isalnum() and not os.path.lexists(path):
        what = "job" if file == TASK_FILE else "study"
        hint = suggest(name, list(jobs), "jobs" if file == TASK_FILE else "studies")
        message = f"there is no such file and no such bundled {what}{hint}"
        raise InputError([Diagnostic(name, 0, 0, "E500", message)])
    return Path(path), name
