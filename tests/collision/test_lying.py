"""How far parts reach into obstacles where they are picked and placed: by hand."""

from __future__ import annotations

import dataclasses

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.collision import lying
from dualarm_cli.collision.quick_test import OVERLAP
from dualarm_cli.collision.solids import WORLD, shape_solid
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.cell import Cell, Obstacle
from dualarm_cli.model.dwell import Dwell
from dualarm_cli.model.job import PoseTarget, Stop
from dualarm_cli.model.place import NOWHERE
from dualarm_cli.model.shape import Shape

DOWN = pin.rpy.rpyToMatrix(np.pi, 0.0, 0.0)
CUBE = (Shape("box", (0.1, 0.1, 0.1), pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.05]))),)
"""Held at the middle of one side: it ends 0.1 m in front of the tool."""


def box(name: str, sides: tuple[float, float, float], at: tuple[float, float, float]) -> Obstacle:
    return Obstacle(name, Shape("box", sides, pin.SE3(np.eye(3), np.array(at))))


@pytest.fixture(scope="module")
def cell(tasks_folder) -> Cell:
    """A table whose top is at 0.7 m, and a beam above it, at 0.95 to 1.0 m, beside the tool's line."""
    cell = load_job(tasks_folder / "04_packing" / "tasks.yaml").cell
    table = box("table", (1.0, 1.0, 0.1), (0.5, 0.0, 0.65))
    beam = box("beam", (0.1, 0.1, 0.05), (0.5, 0.098, 0.975))
    return dataclasses.replace(cell, obstacles=(table, beam), allowed_contacts=())


def reaches(cell: Cell, height: float, line: float, part: str = "cube") -> tuple[float, str]:
    """What is told of the cube with the tool at a height over the table, pointing down."""
    tool = pin.SE3(DOWN, np.array([0.5, 0.0, height]))
    solids = tuple(shape_solid(part, WORLD, pin.SE3.Identity(), shape) for shape in CUBE)
    stop = Stop("place", PoseTarget(tool), line, 0.0, Dwell(0.0), NOWHERE)
    [found] = lying.reaches(
        cell, lying.HeldBody(part, part, solids, stop.lines[:1], rests=True), stop
    )
    return found


def test_a_part_at_its_target_reaches_into_the_table(cell):
    """30 mm too low it is 30 mm deep, and that is the deepest of the line; above it nothing is told."""
    assert reaches(cell, 0.77, 0.0) == (pytest.approx(0.03, abs=1e-6), "table")
    assert reaches(cell, 0.77, 0.08) == (pytest.approx(0.03, abs=1e-6), "table")
    assert reaches(cell, 0.8 + 1e-4, 0.0) == (OVERLAP, "")
    assert reaches(cell, 0.8 + 1e-4, 0.08) == (OVERLAP, "")


def test_the_line_runs_against_the_tool_s_axis(cell):
    """Straight up past the beam, into which the cube reaches 2 mm from the side: only lines that get there."""
    assert reaches(cell, 0.81, 0.12) == (OVERLAP, "")
    depth, into = reaches(cell, 0.81, 0.32)
    assert (depth, into) == (pytest.approx(0.002, abs=1e-6), "beam")


def test_allowed_contacts_are_not_looked_at(cell):
    """Only the named pair."""
    allowed = dataclasses.replace(cell, allowed_contacts=(("table", "cube"),))
    assert reaches(allowed, 0.77, 0.0) == (OVERLAP, "")
    assert reaches(allowed, 0.77, 0.0, "other")[1] == "table"
