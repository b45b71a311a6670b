"""Tools and part in a hand-over, by hand: boxes along the tools' common axis."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.collision.lying import too_near
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.cell import Cell, Tool
from dualarm_cli.model.lines import LineDirection
from dualarm_cli.model.part_flow import Handover
from dualarm_cli.model.shape import Shape

HALF = 0.02
"""Half the length of the part along the axis, about the giving tool's point [m]."""


def box(z: float, length: float) -> Shape:
    """A box of 20 mm about z at the axis."""
    return Shape("box", (0.02, 0.02, length), pin.SE3(np.eye(3), np.array([0.0, 0.0, z])))


@pytest.fixture(scope="module")
def cell(tasks_folder) -> Cell:
    """Tools that end 10 mm before their points, 100 mm from the flanges; a part of 40 mm about the giver's."""
    cell = load_job(tasks_folder / "04_packing" / "tasks.yaml").cell
    tool = Tool(pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.1])), shapes=(box(0.05, 0.08),))
    return replace(
        cell,
        tools={"left": tool, "right": tool},
        parts={"bar": (box(0.0, 2 * HALF),)},
        clearance=0.003,
        clearances=(),
        allowed_contacts=(),
    )


def met(apart: float) -> Handover:
    """The taking tool against the giving one, its point farther along the giver's z."""
    grip = pin.SE3(pin.utils.rotate("x", np.pi), np.array([0.0, 0.0, apart]))
    return Handover("left", "right", grip)


def found(cell: Cell, apart: float, approach: float, retract: float, part: str = "bar") -> list:
    """What is too near: first word of where, bodies, margin in mm."""
    drawn = [LineDirection().back(np.eye(3), length) for length in (approach, retract)]
    rows = too_near(cell, met(apart), part, f"{part}@flip", *drawn)
    return [(row.where, row.bodies, round(row.margin * 1000, 3)) for row in rows]


AT, BEGINS, ENDS = (
    "at the grip",
    "where the right arm's approach begins",
    "where the left arm's retract ends",
)


def test_nothing_is_too_near_where_all_are_apart(cell: Cell) -> None:
    """Tools 20 mm apart at the grip; 40 mm back is 30 mm from the part's end."""
    assert found(cell, 0.0, 0.04, 0.04) == []


def test_each_place_is_looked_at_with_its_own_bodies(cell: Cell) -> None:
    """The part ends 20 mm from the tool's point: 12 mm back it is 2 mm from a tool, 1 mm less than is required."""
    tools = ("left_tool", "right_tool")
    # Tools 20 mm less 18 mm apart at the grip; 12 and 40 mm more at the ends of the lines.
    assert found(cell, -0.018, 0.06, 0.06) == [(AT, tools, -1.0)]
    assert found(cell, 0.0, 0.012, 0.04) == [(BEGINS, ("bar", "right_tool"), -1.0)]
    assert found(cell, 0.0, 0.04, 0.012) == [(ENDS, ("left_tool", "bar@flip"), -1.0)]
    # Without a part the tools alone.
    assert found(cell, 0.0, 0.0, 0.0, "") == []
    assert found(cell, -0.018, 0.0, 0.0, "") == [(w, tools, -1.0) for w in (AT, BEGINS, ENDS)]


def test_what_the_cell_says_of_a_pair_counts(cell: Cell) -> None:
    """5 mm for one pair alone; what may touch is not looked at."""
    special = replace(cell, clearances=(("right_tool", "bar", 0.005), ("a", "b", 9.0)))
    assert found(special, 0.0, 0.012, 0.012) == [
        (BEGINS, ("bar", "right_tool"), -3.0),
        (ENDS, ("left_tool", "bar@flip"), -1.0),
    ]
    allowed = replace(cell, allowed_contacts=(("right_tool", "bar"), ("a", "left_tool")))
    assert found(allowed, 0.0, 0.012, 0.012) == [(ENDS, ("left_tool", "bar@flip"), -1.0)]


def test_the_nearest_solid_of_each_body_counts(cell: Cell) -> None:
    """A second box behind each tool's own changes nothing, whichever comes first."""
    for order in (1, -1):
        shapes = (box(0.05, 0.08), box(-0.1, 0.02))[::order]
        tools = {arm: replace(tool, shapes=shapes) for arm, tool in cell.tools.items()}
        rows = found(replace(cell, tools=tools), -0.018, 0.06, 0.06)
        assert rows == [(AT, ("left_tool", "right_tool"), -1.0)]


def test_exactly_what_is_required_is_enough(cell: Cell) -> None:
    """20 mm between the tools: not too near for 19.999 mm, too near for 20.001 mm."""
    assert found(replace(cell, clearance=0.019999), 0.0, 0.5, 0.5) == []
    assert [row[0] for row in found(replace(cell, clearance=0.020001), 0.0, 0.5, 0.5)] == [AT]
