"""Changed tools as solids: there once, bolted to their arm, and only while they are on."""

from __future__ import annotations

import dataclasses

import pinocchio as pin
import pytest

from dualarm_cli.collision.solids import cell_solids, pairs_that_must_keep_apart
from dualarm_cli.files.cells.cells import load_cell
from dualarm_cli.model.cell import Held
from dualarm_cli.model.shape import Shape


@pytest.fixture(scope="module")
def cell(tasks_folder):
    """Two grippers for the left arm of an SDA10F, and a part."""
    cell = load_cell(tasks_folder / "14_two_grippers" / "cell.yaml").cell
    return dataclasses.replace(
        cell, parts={"plate": (Shape("sphere", (0.01,), pin.SE3.Identity()),)}
    )


@pytest.fixture(scope="module")
def model(cell):
    """Of its robot."""
    return pin.buildModelFromXML(cell.robot.urdf)


HELD = (
    Held("fingers"),
    Held("fingers", docking=True),
    Held("suction"),
    Held("suction", "plate"),
    Held("fingers", "plate"),
)
EVERYTHING = [("left", one.name) for one in HELD]


def test_a_tool_is_one_solid_and_a_part_one_for_each_tool(cell, model):
    """At the flange, as the cell has it; the part 40 mm farther on at the fingers (140 mm) than at suction (110 mm)."""
    solids = [s for s in cell_solids(cell, model, EVERYTHING) if s.carrier]
    assert [(s.body, s.tool, s.bolted) for s in solids] == [
        ("left_fingers", "fingers", True),
        ("left_suction", "suction", True),
        ("plate", "suction", False),
        ("plate", "fingers", False),
    ]
    flange = model.frames[model.getFrameId(cell.robot.arm("left").flange)].placement
    tool = cell.tool_changes["left"].tools["fingers"].tool
    assert solids[0].pose.isApprox(flange * tool.shapes[0].pose)
    assert solids[3].pose.isApprox(flange * tool.tcp)
    assert [s.label for s in solids] == ["left_fingers", "left_suction", "left plate", "left plate"]


def test_what_is_there_depends_on_what_is_held(cell, model):
    """A tool alone, with its part, and neither without it."""
    solids = [s for s in cell_solids(cell, model, EVERYTHING) if s.carrier]
    for held, there in (
        (Held(), []),
        (Held("fingers"), [0]),
        (Held("suction", docking=True), [1]),
        (Held("suction", "plate"), [1, 2]),
        (Held("fingers", "plate"), [0, 3]),
    ):
        assert [k for k, s in enumerate(solids) if s.is_held(held)] == there


def test_a_tool_may_touch_the_links_that_it_is_bolted_to_a_part_may_not(cell, model):
    """Its own link, and the one before that; what else there is it has to keep from."""
    solids = cell_solids(cell, model, EVERYTHING)
    pairs = pairs_that_must_keep_apart(model, solids, cell)

    def kept_from(body):
        return {
            solids[other].body
            for pair in pairs
            for one, other in ((pair.first, pair.second), (pair.second, pair.first))
            if solids[one].body == body
        }

    links = {s.body for s in solids if s.body.startswith("left_link")}
    bolted = links - kept_from("left_fingers")
    assert bolted
    assert bolted == links - kept_from("left_tool")
    assert bolted & kept_from("plate"), "a part keeps from what a tool may touch"
    assert {"table", "rack", "right_tool"} <= kept_from("left_fingers")
    assert "left_tool" not in kept_from("left_fingers")
