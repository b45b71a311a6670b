"""The papers' two scenarios as problems of the followers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinds.path.context import PathClock, PathContext
from dualarm_cli.kinds.path.following import PathProblem
from dualarm_cli.kinds.path.starts import path_starts
from dualarm_cli.kinematics.cell_model import CellModel

Scenario = tuple[PathContext, PathProblem]


def scenario(path: Path, gentle: float = 2.0) -> Scenario:
    """The first path of a task file from its best start."""
    job = load_job(path)
    context = PathContext.of(CellModel.from_cell(job.cell), job)
    work = job.tasks[0].path
    assert work is not None
    home = np.array(job.cell.robot.postures["home"])
    start = path_starts(context, work, home, 0).configurations[0]
    return context, context.problem(work, start, PathClock.of(work, 1.0, gentle))


@pytest.fixture(scope="session")
def choi(tasks_folder: Path) -> Scenario:
    """[Choi2020]: the circles of both hands."""
    return scenario(tasks_folder / "papers" / "choi_circles" / "tasks.yaml")


@pytest.fixture(scope="session")
def zhang(tasks_folder: Path) -> Scenario:
    """[Zhang2024]: both arms turn one part."""
    return scenario(tasks_folder / "papers" / "zhang_turn" / "tasks.yaml")


@pytest.fixture(scope="session")
def coarser() -> Callable[[PathProblem, int], PathProblem]:
    """Returns a problem with every so many-th instant, for quicker tests."""

    def every(problem: PathProblem, stride: int) -> PathProblem:
        return replace(
            problem,
            step=problem.step * stride,
            R=problem.R[::stride],
            p=problem.p[::stride],
            share=problem.share[::stride],
            pace=problem.pace[::stride],
        )

    return every
