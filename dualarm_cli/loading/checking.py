"""Checks of single files, whatever they are, with nothing planned."""

from __future__ import annotations

from pathlib import Path

from dualarm_cli.errors import Diagnostic, InputError
from dualarm_cli.loading.cells import load_cell
from dualarm_cli.loading.documents import read_document
from dualarm_cli.loading.projects import Project
from dualarm_cli.loading.robots import load_robot
from dualarm_cli.loading.tasks import load_job
from dualarm_cli.model.cell import Cell
from dualarm_cli.model.job import Job
from dualarm_cli.model.robot import Robot


def load_file(path: str | Path) -> Robot | Cell | Job:
    """Returns what a robot, cell or task file describes, told apart by its `dualarm` key.

    Args:
        path: the file.

    Raises:
        InputError: everything wrong with it and the files that it names.
    """
    document = read_document(Project.of(Path(path)), Path(path), str(path))
    kind = document.data["dualarm"]
    if kind == "robot/1":
        return load_robot(Path(path)).robot
    return load_cell(path).cell if kind == "cell/1" else load_job(path)


def check_file(path: str | Path) -> list[Diagnostic]:
    """Returns everything wrong with a robot, cell or task file and the files that it names.

    Args:
        path: the file.
    """
    try:
        load_file(path)
    except InputError as error:
        return error.diagnostics
    return []
