"""Checks of single input files of any kind, without planning."""

from __future__ import annotations

from pathlib import Path

from dualarm_cli.files.calibration.points import Base, load_points, read_base
from dualarm_cli.files.cells.cells import load_cell
from dualarm_cli.files.robots.robots import load_robot
from dualarm_cli.files.source.bundled import task_file
from dualarm_cli.files.source.documents import read_document
from dualarm_cli.files.source.projects import Project
from dualarm_cli.files.studies.studies import load_study
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.cell import Cell
from dualarm_cli.model.job import Job
from dualarm_cli.model.robot import Robot
from dualarm_cli.model.studies.study import Study
from dualarm_cli.model.touches import Touches


def load_file(path: str | Path) -> Robot | Cell | Job | Touches | Base | Study:
    """Read an input file of any kind, given by its `dualarm` key.

    Args:
        path: the file, or the name of a bundled job.

    Raises:
        InputError: everything wrong with it and the files that it names.
    """
    path, name = task_file(path)
    project = Project.of(path)
    document = read_document(project, path, name)
    kind = document.data["dualarm"]
    if kind == "robot/1":
        return load_robot(Path(path)).robot
    if kind == "points/1":
        return load_points(path).touches
    if kind == "base/1":
        return read_base(project, Path(path), str(path))
    if kind == "study/1":
        return load_study(path)
    return load_cell(path).cell if kind == "cell/1" else load_job(path, name)
