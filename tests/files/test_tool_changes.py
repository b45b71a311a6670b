# ruff: noqa: E501 (tables of exact messages, one a line)
"""Tools that arms change: what cell and task files say of them, where they are wrong, and targets as the arm sees them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.files.cells.cells import load_cell
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.job import ANY

Change = Callable[..., None]
Messages = Callable[[Callable[[], object]], list[str]]
CHANGES = """\
tool_changes:
  left:
    start: gripper
    time: 1.5 s
    approach: 80 mm
    retract: 70 mm
    tools:
      gripper: {tcp: {xyz: [0, 0, 150 mm]}, mass: 0.8 kg, shapes: [{sphere: 20 mm, xyz: [0, 0, 130 mm]}], stand: {in: bin, xyz: [0.1, 0, 0]}}
      suction: {tcp: {xyz: [10 mm, 0, 90 mm], rpy: [0, 0, 90 deg]}, stand: {xyz: [0.2, 0.5, 0.9], rpy: [180 deg, 0, 0]}}
clearance: 10 mm"""
DEFAULT = ("retract: 60 mm,", "retract: 60 mm, tool: gripper,")


@pytest.fixture
def changing(project: Path, change: Change) -> Path:
    """The tiny project, whose left arm changes tools."""
    change("cell.yaml", "clearance: 10 mm", CHANGES)
    return project


def test_tools_and_stands_are_read(changing: Path) -> None:
    """SI units, flange frames, a stand in a named frame: the bin is turned by 90 deg, its x is the world's y."""
    [(arm, own)] = load_cell("cell.yaml").cell.tool_changes.items()
    assert arm == "left"
    assert (own.start, own.time, own.approach, own.retract) == ("gripper", 1.5, 0.08, 0.07)
    assert list(own.tools) == ["gripper", "suction"]
    gripper = own.tools["gripper"]
    np.testing.assert_allclose(gripper.tool.tcp.translation, [0.0, 0.0, 0.15])
    assert gripper.tool.inertia.mass == 0.8
    np.testing.assert_allclose(gripper.stand.translation, [0.4, 0.2, 0.7], atol=1e-15)
    assert f"{own.place}".startswith("cell.yaml:12:")


def test_no_tool_may_be_on_at_the_start(changing: Path, change: Change) -> None:
    """`none` is no tool's name."""
    change("cell.yaml", "start: gripper", "start: none")
    cell = load_cell("cell.yaml").cell
    assert cell.start_tool("left") == ""
    assert cell.start_tool("right") == ""
    assert cell.tool_names("left") == ("", "gripper", "suction")
    assert cell.tool_names("right") == ("",)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("start: gripper", "start: griper", "cell.yaml:12:12: E300 there is no tool 'griper', did you mean 'gripper'?"),
        ("    start: gripper\n", "", "E202"),
        ("  left:\n    start", "  rigth:\n    start", "E201 unknown key 'rigth', did you mean 'right'?"),
        ("      gripper: {tcp", "      none: {tcp", "'none' means that no tool is mounted"),
        ("xyz: [0.2, 0.5, 0.9]", "xyz: [0.4, 0.2, 0.7]", "the stands of 'gripper' and 'suction' are at the same place"),
        ("stand: {in: bin", "stand: {in: bon", "the cell has no frame 'bon', did you mean 'bin'?"),
        ("stand: {in: bin, xyz: [0.1, 0, 0]}", "stand: {rpy: [0, 0, 0]}", "the stand has no position; give its xyz"),
        ("rpy: [0, 0, 90 deg]}, stand", "rpy: [2 deg, 0, 90 deg]}, stand", "leans by 2 deg from that of the permanent tool"),
        ("clearance: 10 mm", "clearance: 10 mm\nlimits: {tool_speed: 0.25 m/s}", "E310 a cap on the tools' speed"),
        ("clearance: 10 mm", "clearance: 10 mm\nparts: {gripper: {shapes: [{sphere: 1 mm}]}}", "'gripper' is also the name of a part"),
        ("clearance: 10 mm", "clearance: 10 mm\nparts: {left_suction: {shapes: [{sphere: 1 mm}]}}", "'left_suction' is already the name of a"),
        ("time: 1.5 s", "time: -1 s", "E200"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_tools_has_its_place(
    changing: Path, change: Change, messages: Messages, old: str, new: str, expected: str
) -> None:
    """In the cell file; all with their lines."""
    change("cell.yaml", old, new)
    found = messages(lambda: load_cell("cell.yaml"))
    assert any(expected in message for message in found), found
    assert all(message.startswith("cell.yaml:") for message in found)


def test_a_changed_tool_is_a_body_with_a_name(changing: Path, change: Change) -> None:
    """For contacts and clearances of its own."""
    change(
        "cell.yaml",
        "clearance: 10 mm",
        "clearance: 10 mm\nallowed_contacts: [[left_gripper, table]]",
    )
    assert load_cell("cell.yaml").cell.allowed_contacts == (("left_gripper", "table"),)


def test_targets_are_told_in_the_arms_own_frame(changing: Path, change: Change) -> None:
    """By hand: tcp 120 mm, gripper 150 mm: the own frame is 30 mm behind; suction is beside it, turned by 90 deg.

    At the pick the bin (0.4, 0.1, 0.7) has its slot at (0.4, 0.2, 0.7), the target is 50 mm above, pointing down:
    behind is above. Of suction: its frame in the own one is at (10, 0, -30) mm, turned by 90 deg about z; the own one
    seen from there is at (0, 10, 30) mm.
    """
    change("tasks.yaml", *DEFAULT)
    pick, place = (stop.target.pose for stop in load_job("tasks.yaml").tasks[0].stops)
    np.testing.assert_allclose(pick.translation, [0.4, 0.2, 0.78], atol=1e-12)
    np.testing.assert_allclose(place.translation, [0.2, 0.5, 0.77], atol=1e-12)
    change(
        "tasks.yaml", "tool: gripper", "tool: suction", ", free: yaw}", "}", ", symmetry: 2}", "}"
    )
    _, place = (stop.target.pose for stop in load_job("tasks.yaml").tasks[0].stops)
    np.testing.assert_allclose(place.translation, [0.2, 0.51, 0.83], atol=1e-12)
    np.testing.assert_allclose(place.rotation, pin.utils.rotate("z", -np.pi / 2.0), atol=1e-12)


def test_the_tool_is_where_the_file_has_the_target(changing: Path, change: Change) -> None:
    """T_world_own T_own_tool is the target, for both tools, and joint targets stay as they are."""
    change(
        "tasks.yaml",
        *DEFAULT,
        ", free: yaw}",
        "}",
        ", symmetry: 2}",
        "}",
        "arm: right",
        "arm: left",
    )
    plain = pin.SE3(np.eye(3), np.array([0.2, 0.5, 0.8]))
    for tool, other in (("gripper", "suction"), ("suction", "none"), ("none", "none")):
        job = load_job("tasks.yaml")
        assert [task.tool for task in job.tasks] == ["" if tool == "none" else tool] * 2
        T_own_tool = job.cell.T_own_tool("left", job.tasks[0].tool)
        assert (job.tasks[0].stops[1].target.pose * T_own_tool).isApprox(plain)
        np.testing.assert_array_equal(
            job.tasks[1].stops[0].target.configurations, [[0.5, -np.pi / 2]]
        )
        change("tasks.yaml", f"tool: {tool}", f"tool: {other}")


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("id: b", "id: b", "tasks.yaml:8:5: E202 task 'a' names no tool"),
        ("retract: 60 mm,", "retract: 60 mm, tool: sucton,", "tasks.yaml:6:51: E300 the left arm has no tool 'sucton', did you mean 'suction'?"),
        ("id: a", "id: a\n    tool: saw", "tasks.yaml:9:11: E300 the left arm has no tool 'saw'"),
        ("retract: 60 mm,", "retract: 60 mm, tool: suction,", "tasks.yaml:10:74: E300 turns about the z axis of tool 'suction' are free here"),
        ("id: b", "id: b\n    tool: gripper", "right changes no tools; remove 'tool'"),
        ("arm: right\n    move: {joints: [0.5, -90 deg]}", "path: {arm: right, speed: 100 mm/s, through: [{xyz: [1, 0, 0]}, {xyz: [1, 1, 0]}]}", "E310 'path' does not go with a cell that has tool_changes"),
        ("id: b", "id: take gripper (a)", "tasks.yaml:12:9: E300 'take gripper (a)' is the name of a visit to a stand"),
        ("start: bent", "start: bent\nlimits: {tool_speed: 0.2 m/s}", "E310 a cap on the tools' speed"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_tasks_has_its_place(
    changing: Path, change: Change, messages: Messages, old: str, new: str, expected: str
) -> None:
    """Missing, unknown, not for this arm, not for these freedoms."""
    change("tasks.yaml", old, new)
    found = messages(lambda: load_job("tasks.yaml"))
    assert any(expected in message for message in found), found


def test_without_tools_to_change_no_task_has_one(
    project: Path, change: Change, messages: Messages
) -> None:
    """Nothing is silently ignored: neither a task's tool nor the default."""
    change("tasks.yaml", "id: a", "id: a\n    tool: gripper")
    assert (
        "the cell has no tool_changes; remove 'tool'" in messages(lambda: load_job("tasks.yaml"))[0]
    )
    change("tasks.yaml", "\n    tool: gripper", "", *DEFAULT)
    [message] = messages(lambda: load_job("tasks.yaml"))
    assert message == "tasks.yaml:6:51: E300 the cell has no tool_changes; remove 'tool'"


def test_a_task_of_any_arm_is_that_arms_which_has_its_tool(changing: Path, change: Change) -> None:
    """Only the left one; without a tool it is either's."""
    change("tasks.yaml", *DEFAULT, "order: given", "order: optimise", "arm: left", "arm: any")
    assert load_job("tasks.yaml").tasks[0].arm == "left"
    change("tasks.yaml", "tool: gripper", "tool: none")
    assert load_job("tasks.yaml").tasks[0].arm == ANY


def test_a_tool_of_both_arms_has_to_be_the_same_on_both(
    changing: Path, change: Change, messages: Messages
) -> None:
    """As each arm's own tool sees it: the right one has none, its flange is its frame, 30 mm behind is 120 mm away."""
    right = """\
  right:
    start: none
    tools:
      gripper: {tcp: {xyz: [0, 0, 120 mm]}, stand: {xyz: [0.2, -0.5, 0.9]}}
clearance: 10 mm"""
    change("cell.yaml", "clearance: 10 mm", right)
    change("tasks.yaml", *DEFAULT, "order: given", "order: optimise", "arm: left", "arm: any")
    assert (
        "tool 'gripper' is not the same on both arms" in messages(lambda: load_job("tasks.yaml"))[0]
    )
    change("cell.yaml", "120 mm]}, stand", "30 mm]}, stand")
    job = load_job("tasks.yaml")
    assert job.tasks[0].arm == ANY
    assert job.cell.T_own_tool("right", "gripper").isApprox(job.cell.T_own_tool("left", "gripper"))
