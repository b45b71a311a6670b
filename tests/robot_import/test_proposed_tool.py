"""The side of a flange on which the tool is, its length and why: links, shapes and fingers decide; a guess is told.

The arm of these tests stands upright with all joints at 0: its wrist's centre is 100 mm below the flange l6, which the
last joint turns about z. All boxes are in the flange's frame.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.errors import InputError
from dualarm_cli.files.robots.mesh_formats import stl_bytes
from dualarm_cli.files.robots.robot_pair import compose_pair
from dualarm_cli.files.robots.robots import load_robot
from dualarm_cli.model.shape import Hull
from dualarm_cli.page.scene import drawn_hands
from dualarm_cli.robot_import.contacts import bare_cell
from dualarm_cli.robot_import.importing import Imported
from dualarm_cli.robot_import.proposed_tool import (
    ProposedTool,
    proposed_tools,
    tool_notes,
    with_tools,
)

Row = Callable[..., str]
Write = Callable[..., Path]
Import = Callable[..., Imported]
Box = tuple[tuple[float, float, float], tuple[float, float, float]]


def link(
    name: str,
    parent: str,
    z: float = 0.0,
    box: Box | None = None,
    joint: str = "",
    rpy: str = "0 0 0",
) -> str:
    """Returns a link at z [m] of its parent, with a box from corner to corner in its own frame."""
    shape = ""
    if box:
        low, high = np.array(box)
        middle, size = (" ".join(f"{v:g}" for v in row) for row in (0.5 * (low + high), high - low))
        shape = f'<collision><origin xyz="{middle}"/><geometry><box size="{size}"/></geometry></collision>'
    kind = "prismatic" if joint else "fixed"
    slide = (
        f'<axis xyz="0 1 0"/><limit lower="0" upper="0.04" velocity="1" effort="1"/>{joint}'
        if joint
        else ""
    )
    return (
        f'<link name="{name}">{shape}</link><joint name="{name}_joint" type="{kind}"><parent link="{parent}"/>'
        f'<child link="{name}"/><origin xyz="0 0 {z}" rpy="{rpy}"/>{slide}</joint>'
    )


def fingers(palm: str, box: Box) -> str:
    """Returns two fingers on a palm, of which the second mimics the first."""
    mimic = '<mimic joint="finger_a_joint" multiplier="-1"/>'
    return link("finger_a", palm, 0.0, box, joint=" ") + link(
        "finger_b", palm, 0.0, box, joint=mimic
    )


def tool_of(found: Imported, folder: Path) -> ProposedTool:
    """Returns the tool of the only arm, of the files that the import writes."""
    for name, content in found.files.items():
        (folder / "out" / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / "out" / name).write_bytes(content)
    [tool] = proposed_tools(bare_cell(load_robot(folder / "out" / "robot.yaml").robot)).values()
    assert tool.note in found.reasons
    assert f"# {tool.note}" in found.files["robot.yaml"].decode()
    return tool


def test_a_hand_behind_the_flange_is_the_tool(
    row: Row, write_rows: Write, import_with: Import, tmp_path: Path
) -> None:
    """Palm and fingers are below the flange, to z = -250 mm: the tool points down there, and no gripper is added."""
    palm = link("palm", "l6", -0.11, ((-0.03, -0.05, -0.06), (0.03, 0.05, 0.0)))
    hand = palm + fingers("palm", ((-0.01, -0.01, -0.14), (0.01, 0.01, -0.05)))
    for flange, end in (("l6", 0.25), ("palm", 0.14)):
        tool = tool_of(
            import_with(write_rows(row("", 0.0), more=hand), tips={"left": flange}), tmp_path
        )
        assert tool.tip == pytest.approx((0.0, 0.0, -end))
        assert np.allclose(tool.tcp.rotation[:, 2], (0.0, 0.0, -1.0))
        assert not tool.tool.shapes
        for part in (f"along -z of {flange} ", "finger_a", f" {1e3 * end:.0f} mm long"):
            assert part in tool.note


def test_a_hand_that_is_only_drawn_decides_too(
    row: Row, write_rows: Write, import_with: Import, tmp_path: Path
) -> None:
    """A visual mesh of a hand without collision shapes: its lowest corner is 290 mm below the flange."""
    corners = np.array(
        [[0.0, 0.0, -0.11], [0.02, 0.0, -0.29], [-0.02, 0.0, -0.29], [0.0, 0.02, -0.2]]
    )
    triangles = np.array([[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]])
    (tmp_path / "hand.stl").write_bytes(stl_bytes(Hull(corners, triangles)))
    visual = '<visual><geometry><mesh filename="hand.stl"/></geometry></visual>'
    more = link("ft_sensor", "l6").replace("</link>", f"{visual}</link>")
    tool = tool_of(import_with(write_rows(row("", 0.0), more=more)), tmp_path)
    assert (tool.axis, tool.length) == ("-z", 0.0)
    assert tool.tip == pytest.approx((0.0, 0.0, -0.29), abs=1e-3)


@pytest.mark.parametrize(
    ("name", "rpy", "axis"),
    [("hand_tcp", "0 0 0", "+z"), ("arm_tip", "0 0 0", "+z"), ("arm_tip", "3.14159265 0 0", "-z")],
)
def test_a_tool_centre_point_gets_no_second_gripper(
    name: str, rpy: str, axis: str, row: Row, write_rows: Write, import_with: Import, tmp_path: Path
) -> None:
    """The flange is between fingers that end 15 mm beyond it; where its z points back, the tool still points out."""
    palm = link("palm", "l6", 0.0, ((-0.03, -0.05, 0.0), (0.03, 0.05, 0.06)))
    hand = palm + fingers("palm", ((-0.01, -0.01, 0.06), (0.01, 0.01, 0.135)))
    found = import_with(write_rows(row("", 0.0), more=hand + link(name, "palm", 0.12, rpy=rpy)))
    tool = tool_of(found, tmp_path)
    assert found.loaded.robot.arms[0].flange == name
    assert (tool.tip, tool.axis, tool.tool.shapes) == ((0.0, 0.0, 0.0), axis, ())
    down = pin.rpy.rpyToMatrix(*map(float, rpy.split())) @ tool.tcp.rotation[:, 2]
    assert np.allclose(down, (0.0, 0.0, 1.0), atol=1e-6)
    assert "within the robot's hand" in tool.note or "by its name" in tool.note


@pytest.mark.parametrize(
    ("frame", "place", "end"),
    [
        ("ee_gripper_link", "0 0 0.07", 0.11),
        ("ee_gripper_link", "0.03 0 0.07", 0.135),
        ("wrist_camera", "0 0 0.07", 0.135),
    ],
)
def test_a_frame_between_the_fingers_is_the_tool_centre_point(
    frame: str,
    place: str,
    end: float,
    row: Row,
    write_rows: Write,
    import_with: Import,
    tmp_path: Path,
) -> None:
    """A bare frame 40 + 70 mm ahead, for the tool by its name; not one beside the axis, or of a camera."""
    palm = link("gripper_link", "l6", 0.0, ((-0.03, -0.05, 0.0), (0.03, 0.05, 0.06)))
    point = link(frame, "ee_arm_link", 0.07).replace("0 0 0.07", place)
    hand = palm + link("ee_arm_link", "gripper_link", 0.04) + point
    hand += fingers("ee_arm_link", ((-0.01, -0.01, 0.02), (0.01, 0.01, 0.095)))
    found = import_with(write_rows(row("", 0.0), more=hand))
    assert found.loaded.robot.arms[0].flange == "gripper_link"
    tool = tool_of(found, tmp_path)
    assert tool.tip == pytest.approx((0.0, 0.0, end))
    assert tool.beyond == pytest.approx(0.135 - end)


def test_a_flange_before_the_tool_centre_point_reaches_to_it(
    row: Row, write_rows: Write, import_with: Import, tmp_path: Path
) -> None:
    """The user names the last link as flange: the hand's own frame is 120 mm beyond it."""
    more = link("palm", "l6") + link("hand_tcp", "palm", 0.12)
    tool = tool_of(import_with(write_rows(row("", 0.0), more=more), tips={"left": "l6"}), tmp_path)
    assert (tool.tip, tool.axis, tool.tool.shapes) == ((0.0, 0.0, 0.12), "+z", ())
    assert "120 mm long: to hand_tcp of the robot's hand" in tool.note


@pytest.mark.parametrize(
    ("parent", "group", "hand", "end"),
    [
        ("l6", '<link name="palm"/><link name="grasp"/>', "grasp", 0.15),
        ("grasp", "", "grasp", 0.15),
        ("l6", '<joint name="palm_joint"/>', "palm", 0.11),
        ("l6", "", "l6", 0.0),
        ("l6", '<chain base_link="base" tip_link="l6"/>', "", None),
    ],
)
def test_an_end_effector_of_the_srdf_is_the_hand(
    parent: str,
    group: str,
    hand: str,
    end: float | None,
    row: Row,
    write_rows: Write,
    import_with: Import,
    tmp_path: Path,
) -> None:
    """A palm 110 mm and a grasp 150 mm beyond the flange, without shapes; a group that is the arm is no hand."""
    more = link("palm", "l6", 0.11) + link("grasp", "palm", 0.04)
    srdf = (
        f'<end_effector name="e" parent_link="{parent}" group="g"/><group name="g">{group}</group>'
    )
    urdf = write_rows(row("", 0.0, shape=""), more=more)
    found = import_with(urdf, srdf, tips={"left": "l6"})
    tool = tool_of(found, tmp_path)
    assert found.loaded.robot.arms[0].hand == hand
    if end is None:
        assert (tool.length, len(tool.tool.shapes)) == (pytest.approx(tool.tip[2]), 1)
    else:
        assert (tool.tip, tool.axis, tool.tool.shapes) == ((0.0, 0.0, end), "+z", ())
        assert f" {1e3 * end:.0f} mm long: " in tool.note


def test_the_last_link_as_hand_may_touch_what_it_holds(
    row: Row, write_rows: Write, import_with: Import
) -> None:
    """Without links beyond it, the link that the robot file names is the hand; nothing is without its name."""
    urdf = write_rows(row("", 0.0))
    srdf = '<end_effector name="e" parent_link="l6" group="none"/>'
    for text, links in ((srdf, ("l6",)), ("", ())):
        assert import_with(urdf, text).loaded.robot.hands["left"] == links


def test_a_hand_of_the_robot_file_is_checked(
    row: Row, write_rows: Write, import_with: Import, tmp_path: Path
) -> None:
    found = import_with(write_rows(row("", 0.0), more=link("palm", "l6")))
    for name, content in found.files.items():
        (tmp_path / name).write_bytes(content)
    path = tmp_path / "robot.yaml"
    text = path.read_text()
    for hand, message in (
        ("plam", "no link 'plam', did you mean 'palm'?"),
        ("l5", "link 'l5' does not move with flange 'palm'; name a link fixed to it"),
    ):
        path.write_text(text.replace("flange: palm", f"flange: palm, hand: {hand}"))
        with pytest.raises(InputError, match=re.escape(message)):
            load_robot(path)
    path.write_text(text.replace("flange: palm", "flange: palm, hand: l6"))
    single = load_robot(path).robot
    pair = compose_pair(single, pin.SE3.Identity(), single, pin.SE3.Identity())
    assert [arm.hand for arm in pair.arms] == ["left_l6", "right_l6"]


@pytest.mark.parametrize("shape", ["", "below"])
def test_a_bare_flange_gets_a_gripper_and_a_guess_is_told(
    shape: str, row: Row, write_rows: Write, import_with: Import, tmp_path: Path
) -> None:
    """The flange is the wrist's centre: without shapes + is a guess, with the last link below it the tool is there."""
    head, tail = row("", 0.0, shape="").rsplit('xyz="0 0 0.1"', 1)
    text = f'{head}xyz="0 0 0"{tail}'
    if shape:
        box = '<collision><origin xyz="0 0 -0.02"/><geometry><sphere radius="0.01"/></geometry></collision>'
        text = text.replace('<link name="l6"></link>', f'<link name="l6">{box}</link>')
    tool = tool_of(import_with(write_rows(text)), tmp_path)
    assert tool.axis == ("-z" if shape else "+z")
    assert ("guessed" in tool.note) is (not shape)
    assert tool.length > 0.05
    assert len(tool.tool.shapes) == 1


def test_the_tools_of_a_cell_are_described():
    """A proposed tool has its reason, another one its frame: along -y of the flange, 50 mm, by hand."""
    cell, tools = with_tools(bare_cell(load_robot("yumi").robot))
    assert tool_notes(cell) == [tools["left"].note, tools["right"].note]
    tcp = pin.SE3(pin.rpy.rpyToMatrix(np.pi / 2, 0.0, 0.0), np.array([0.0, -0.05, 0.0]))
    changed = replace(cell, tools=cell.tools | {"left": replace(cell.tools["left"], tcp=tcp)})
    left, right = tool_notes(changed)
    assert left.startswith(f"left tool: along -y of {cell.robot.arms[0].flange}, 50 mm long")
    assert right == tools["right"].note


def test_pages_know_the_hands_that_they_need_not_draw(
    row: Row, write_rows: Write, import_with: Import
) -> None:
    """A palm is the hand, unless the cell mounts a tool with shapes; a bare flange gets an assumed gripper."""
    palm = link("palm", "l6", 0.0, ((-0.03, -0.05, 0.0), (0.03, 0.05, 0.1)))
    robot = import_with(
        write_rows(
            row("left_", 0.3), row("right_", -0.3, shape=""), more=palm.replace("l6", "left_l6")
        )
    )
    cell, tools = with_tools(bare_cell(robot.loaded.robot))
    model = pin.buildModelFromXML(cell.robot.urdf)
    assert drawn_hands(model, cell) == ["left"]
    capped = replace(cell, tools={**cell.tools, "left": cell.tools["right"]})
    assert drawn_hands(model, capped) == []
    assert tools["right"].tool.shapes
