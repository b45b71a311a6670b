# ruff: noqa: E501 (tables of exact messages, one a line)
"""Grasps in cell and task files: the tool's targets, the part as held, and every mistake at its place."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.job import Job, PoseTarget, Stop, Task

Change = Callable[..., None]
Messages = Callable[..., list[str]]

PARTS = """\
parts:
  block:
    mass: 2 kg
    center_of_mass: [10 mm, 0, 0]
    shapes: [{box: [40 mm, 60 mm, 80 mm], xyz: [0, 0, 40 mm]}]
    grasps:
      top:  {xyz: [0, 0, 80 mm], rpy: [180 deg, 0, 0], symmetry: 2, approach: 50 mm}
      side: {xyz: [20 mm, 0, 40 mm], rpy: [0, -90 deg, 0], retract: 20 mm}
  plain: {shapes: [{sphere: 10 mm}]}
clearances: [{between: [block, table], clearance: 5 mm}]
clearance:"""
TASK = """\
dualarm: tasks/1
cell: cell.yaml
start: bent
defaults: {approach: 80 mm, retract: 60 mm}
tasks:
  - id: a
    arm: left
    part: block
    pick: {at: bin, xyz: [0, 0, 0]}
    place: {xyz: [0.2, 0.5, 0.7]}
"""


@pytest.fixture
def block(project: Path, change: Change) -> Path:
    """The tiny project with a part that two grasps hold."""
    (project / "tasks.yaml").write_text(TASK)
    change("cell.yaml", "clearance:", PARTS)
    return project


def by_name() -> dict[str, Task]:
    """The only task by each of its grasps."""
    [task] = load_job("tasks.yaml").tasks
    return {t.grasp.name: t for t in task.grasps or (task,) if t.grasp is not None}


def pose(stop: Stop) -> pin.SE3:
    """The pose of a stop."""
    assert isinstance(stop.target, PoseTarget)
    return stop.target.pose


def test_the_tool_goes_to_the_pose_of_the_part_times_that_of_the_grasp(block: Path) -> None:
    """Hand arithmetic: the bin is at (0.4, 0.1, 0.7), turned by 90° about z, so that its x is the world's y."""
    tasks = by_name()
    assert list(tasks) == ["top", "side"]
    pick, place = tasks["top"].stops
    assert pose(pick).translation == pytest.approx([0.4, 0.1, 0.78])
    assert pose(pick).rotation[:, 2] == pytest.approx([0, 0, -1], abs=1e-12)
    assert pose(place).translation == pytest.approx([0.2, 0.5, 0.78])
    pick, place = tasks["side"].stops
    assert pose(pick).translation == pytest.approx([0.4, 0.12, 0.74])
    # The tool looks along -x of the part.
    assert pose(pick).rotation[:, 2] == pytest.approx([0, -1, 0], abs=1e-12)
    assert pose(place).translation == pytest.approx([0.22, 0.5, 0.74])
    lines = {name: {(s.approach, s.retract) for s in t.stops} for name, t in tasks.items()}
    assert lines == {"top": {(0.05, 0.06)}, "side": {(0.08, 0.02)}}


def test_the_part_is_the_same_body_in_the_world_however_it_is_held(block: Path) -> None:
    """A corner, the centre of mass and the rules of its body at the pick, from either grasp."""
    job = load_job("tasks.yaml")
    for name, task in by_name().items():
        assert task.part == f"block@{name}"
        [solid] = job.cell.parts[task.part]
        tool = pose(task.stops[0])
        corner = tool.act(solid.pose.act(np.array([0.02, 0.03, 0.04])))
        # Part's (20, 30, 80) mm: x of the part is y of the world, y is -x.
        assert corner == pytest.approx([0.4 - 0.03, 0.1 + 0.02, 0.78])
        inertia = job.cell.part_inertias[task.part]
        assert inertia.mass == pytest.approx(2.0)
        assert tool.act(inertia.lever) == pytest.approx([0.4, 0.11, 0.7])
        assert (task.part, "table", 0.005) in job.cell.clearances


def test_a_task_names_its_grasps(block: Path, change: Change) -> None:
    """One grasp is decided; of several the first is the task's own until the planner chooses."""
    change("tasks.yaml", "part: block", "part: block\n    grasp: side")
    [task] = load_job("tasks.yaml").tasks
    assert task.grasps == () and task.grasp is not None and task.grasp.name == "side"
    change("tasks.yaml", "grasp: side", "grasp: [side, top]")
    job = load_job("tasks.yaml")
    assert job.chooses_grasps and [t.part for t in job.tasks[0].grasps] == [
        "block@side",
        "block@top",
    ]
    decided = job.with_grasps({"a": "top"})
    assert not decided.chooses_grasps and decided.tasks[0].part == "block@top"


def test_turns_of_target_and_grasp_add_up(block: Path, change: Change) -> None:
    """A place with three equal turns and a grasp with two have six; a free one has all."""
    change(
        "tasks.yaml", "part: block", "part: block\n    grasp: top", "0.7]}", "0.7], symmetry: 3}"
    )
    pick, place = load_job("tasks.yaml").tasks[0].stops
    targets = pick.target, place.target
    assert [t.symmetry for t in targets if isinstance(t, PoseTarget)] == [2, 6]
    change("cell.yaml", "symmetry: 2", "free: yaw")
    for stop in load_job("tasks.yaml").tasks[0].stops:
        assert isinstance(stop.target, PoseTarget) and stop.target.free_yaw


def test_a_symmetric_part_is_gripped_from_every_side(block: Path, change: Change) -> None:
    """Four quarter turns of a grasp off the axis; one on the axis has four equal turns itself, with its own two."""
    change("cell.yaml", "    mass: 2 kg", "    symmetry: 4\n    mass: 2 kg")
    tasks = by_name()
    assert list(tasks) == ["top", "side", "side/90 deg", "side/180 deg", "side/270 deg"]
    top = tasks["top"].stops[0].target
    assert isinstance(top, PoseTarget) and top.symmetry == 4
    # The tool of `side` is 20 mm along x of the part and looks along -x; the bin is turned by 90 degrees.
    around = {name: pose(tasks[name].stops[0]) for name in list(tasks)[1:]}
    assert around["side"].translation == pytest.approx([0.4, 0.12, 0.74])
    assert around["side/90 deg"].translation == pytest.approx([0.38, 0.1, 0.74])
    assert around["side/180 deg"].translation == pytest.approx([0.4, 0.08, 0.74])
    assert around["side/270 deg"].rotation[:, 2] == pytest.approx([-1, 0, 0], abs=1e-12)
    change("tasks.yaml", "part: block", "part: block\n    grasp: side")
    assert list(by_name()) == list(tasks)[1:]


def test_a_tool_may_tilt_and_grip_within_an_area(block: Path, change: Change) -> None:
    """By hand in the tool's frame: its z axis leans by 30° in four directions; corners of 40 mm by 20 mm."""
    change("cell.yaml", "symmetry: 2,", "free: {tilt: 30 deg, area: [40 mm, 20 mm]},")
    change("tasks.yaml", "part: block", "part: block\n    grasp: top")
    tasks = by_name()
    stated = pose(tasks["top"].stops[0])
    offsets = {name: stated.inverse() * pose(task.stops[0]) for name, task in tasks.items()}
    leans = {
        "top/tilt +x": [0, -0.5, np.sqrt(0.75)],
        "top/tilt -x": [0, 0.5, np.sqrt(0.75)],
        "top/tilt +y": [0.5, 0, np.sqrt(0.75)],
        "top/tilt -y": [-0.5, 0, np.sqrt(0.75)],
    }
    for name, lean in leans.items():
        assert offsets[name].rotation[:, 2] == pytest.approx(lean)
        assert offsets[name].translation == pytest.approx(np.zeros(3))
    corners = [o for name, o in offsets.items() if "/area" in name]
    assert {tuple(np.round(o.translation, 9)) for o in corners} == {
        (x, y, 0.0) for x in (-0.02, 0.02) for y in (-0.01, 0.01)
    }
    assert len(tasks) == 9
    for task in tasks.values():
        pick, place = map(pose, task.stops)
        # The part goes to where the file has it, whatever the tool does.
        moved = place * pick.inverse()
        assert moved.act(np.array([0.4, 0.1, 0.7])) == pytest.approx([0.2, 0.5, 0.7])


def test_lines_of_the_task_come_before_those_of_the_grasp(block: Path, change: Change) -> None:
    """Then those of the grasp, then the defaults."""
    change("tasks.yaml", "part: block", "part: block\n    approach: 10 mm")
    assert {s.approach for t in by_name().values() for s in t.stops} == {0.01}


def test_signals_are_those_of_the_task_by_every_grasp(block: Path, change: Change) -> None:
    """The planner may choose any of them."""
    change("tasks.yaml", "part: block", "part: block\n    signals: {grip: vacuum}")
    assert [s.signal for t in by_name().values() for s in t.stops] == ["vacuum", "", "vacuum", ""]


def test_a_part_without_grasps_keeps_the_pose_of_the_tool(block: Path, change: Change) -> None:
    """As in files without the key."""
    change("tasks.yaml", "part: block", "part: plain")
    job: Job = load_job("tasks.yaml")
    assert pose(job.tasks[0].stops[0]).translation == pytest.approx([0.4, 0.1, 0.7])
    assert job.tasks[0].grasp is None and job.tasks[0].part == "plain"


@pytest.mark.parametrize(
    ("file", "changes", "expected"),
    [
        ("tasks.yaml", ("part: block", "part: block\n    grasp: tip"), "tasks.yaml:9:12: E300 the part has no grasp 'tip', did you mean 'top'? Grasps: top, side"),
        ("tasks.yaml", ("part: block", "part: block\n    grasp: [top, top]"), "tasks.yaml:9:18: E300 'top' is in the list already; remove it"),
        ("tasks.yaml", ("part: block", "part: block\n    grasp: []"), "tasks.yaml:9:12: E200 a list of 0 is too short; at least 1 are needed"),
        ("tasks.yaml", ("part: block", "part: block\n    grasps: top"), "tasks.yaml:9:5: E201 unknown key 'grasps', did you mean 'grasp'? Allowed: id, arm, after, not_before, not_after, pick, place, move, path, coordinate, handover, tool, speed, acceleration, tool_speed, tilt, part, grasp, touches, leaves, approach, retract, straight, blend, dwell, signals"),
        ("tasks.yaml", ("part: block", "part: plain\n    grasp: top"), "tasks.yaml:9:12: E300 part 'plain' has no grasps; name them in the cell file, or remove 'grasp'"),
        ("tasks.yaml", ("    part: block\n", "    grasp: top\n"), "tasks.yaml:8:12: E300 the task carries no part; name them in the cell file, or remove 'grasp'"),
        ("tasks.yaml", ("pick: {at: bin, xyz: [0, 0, 0]}", "pick: {joints: [0, 0]}"), "tasks.yaml:9:20: E300 the part has grasps, so its targets are poses of the part, which joint positions do not give; give xyz, with rpy or quat"),
        ("tasks.yaml", ("0.7]}", "0.7], free: yaw}"), "tasks.yaml:10:41: E300 it turns the part about its z axis, which is not the tool's in grasp 'side'; remove 'free', or that grasp from the task, or give the part `symmetry`"),
        ("tasks.yaml", ("    place:", "    handover: {xyz: [0.3, 0, 1], grip: {xyz: [0, 0, 0.1]}}\n    place:"), "tasks.yaml:10:40: E300 part 'block' has grasps, from which the grip follows; remove 'grip'"),
        ("cell.yaml", ("symmetry: 2", "symmetry: 2, free: yaw"), "cell.yaml:16:56: E200 a part that is round looks the same at every turn; keep 'free'"),
        ("cell.yaml", ("    mass: 2 kg", "    symmetry: 30\n    mass: 2 kg"), "cell.yaml:12:5: E300 part 'block' has 31 grasps with their turns, tilts and areas; at most 24: lower 'symmetry', or remove grasps or their 'free'"),
        ("cell.yaml", ("plain: {", "plain: {symmetry: 2, "), "cell.yaml:18:11: E200 it repeats grasps; name 'grasps', or remove it"),
        ("cell.yaml", ("symmetry: 2", "free: {tilt: 90 deg}"), "cell.yaml:16:69: E200 '90 deg': angle must be at most 60 deg"),
        ("cell.yaml", ("symmetry: 2", "free: {area: 20 mm}"), "cell.yaml:16:69: E200 must be a list, such as [a, b], not '20 mm'"),
        ("cell.yaml", ("symmetry: 2", "symmetry: 0"), "cell.yaml:16:66: E200 0 must be at least 1"),
        ("cell.yaml", ("symmetry: 2", "free: tilt"), "cell.yaml:16:62: E200 'tilt' is not allowed; allowed: yaw"),
        ("cell.yaml", ("approach: 50 mm", "approach: -1 mm"), "cell.yaml:16:79: E200 '-1 mm': length must be at least 0"),
        ("cell.yaml", ("approach: 50 mm", "in: bin"), "cell.yaml:16:69: E201 unknown key 'in'; allowed: xyz, rpy, quat, free, symmetry, approach, retract, width"),
        ("cell.yaml", ("mass: 800 g", "opening: [60 mm, 0]"), "cell.yaml:4:38: E200 [60 mm, 0 mm]: give the least distance first, then the greatest"),
        ("cell.yaml", ("symmetry: 2", "free: {tilt: 9 deg}", "side:", "top/tilt +x:"), "cell.yaml:17:7: E300 'top/tilt +x' is a turn, tilt or area of another grasp as well; rename one of them"),
        ("cell.yaml", ("mass: 800 g", "opening: [0, 40]"), "cell.yaml:4:51: E200 40 without a unit is m, and more than 1 m; did you mean '40 mm'?"),
    ],
)  # fmt: skip
def test_every_mistake_is_told_at_its_place(
    block: Path,
    change: Change,
    messages: Messages,
    file: str,
    changes: tuple[str, ...],
    expected: str,
) -> None:
    """One mistake, one message."""
    change(file, *changes)
    assert messages(lambda: load_job("tasks.yaml")) == [expected]


def test_arms_take_the_grasps_that_their_tools_open_to(
    block: Path, change: Change, messages: Messages
) -> None:
    """Widths of 40 and 60 mm against tools that open from 0 to 50 and from 50 to 90 mm."""
    change("cell.yaml", "    mass: 2 kg", "    width: 60 mm\n    mass: 2 kg")
    change("cell.yaml", "retract: 20 mm", "retract: 20 mm, width: 40 mm")
    change("cell.yaml", "mass: 800 g}", "opening: [0, 50 mm]}\n  right: {opening: [50 mm, 90 mm]}")
    left = by_name()
    assert list(left) == ["side"] and load_job("tasks.yaml").cell.width("block@side@2") == 0.04
    change("tasks.yaml", "arm: left", "arm: right")
    assert list(by_name()) == ["top"]
    change("tasks.yaml", "arm: right", "arm: any")
    job = load_job("tasks.yaml")
    assert job.tasks[0].arm == "any"
    assert {name: job.with_grasps({"a": name}).tasks[0].arm for name in by_name()} == {
        "top": "right",
        "side": "left",
    }
    change("tasks.yaml", "part: block", "part: block\n    grasp: top")
    assert load_job("tasks.yaml").tasks[0].arm == "right"
    change("tasks.yaml", "arm: any", "arm: left")
    assert messages(lambda: load_job("tasks.yaml")) == [
        "tasks.yaml:6:5: E300 part 'block' is 60 mm wide in grasp 'top', but the left tool opens from 0 to 50 mm: "
        "allow another grasp, arm or tool, or correct 'width' or 'opening' in the cell file"
    ]
    # A part without grasps, handed over: the taking tool does not open to it.
    change("cell.yaml", "plain: {", "plain: {width: 45 mm, ")
    change("tasks.yaml", "part: block\n    grasp: top", "part: plain")
    assert load_job("tasks.yaml").cell.width("plain@a") == 0.045
    change(
        "tasks.yaml",
        "    place:",
        "    handover: {xyz: [0.3, 0, 1], grip: {xyz: [0, 0, 0.1]}}\n    place:",
    )
    [message] = messages(lambda: load_job("tasks.yaml"))
    assert "part 'plain' is 45 mm wide, but the right tool opens from 50 to 90 mm" in message


FREE = """\
dualarm: tasks/1
cell: cell.yaml
start: bent
tasks:
  - id: a
    arm: left
    part: plain
    pick: {at: bin, xyz: [0, 0, 0], free: {turn: yaw, tilt: 30 deg}}
    place: {xyz: [0.2, 0.5, 0.7], free: {tilt: 30 deg}}
  - {id: b, arm: right, move: {xyz: [0.3, 0, 0.8], free: {area: [40 mm, 20 mm]}}}
"""


def test_tools_lean_at_targets_of_parts_without_grasps(block: Path) -> None:
    """By hand: half of an equilateral triangle; the part leans with the tool from pick to place, and lies as before."""
    (block / "tasks.yaml").write_text(FREE)
    job = load_job("tasks.yaml")
    held, look = job.tasks
    assert [t.part for t in held.grasps] == ["plain", *(f"plain@tilt {way}" for way in ("+x", "+y", "-x", "-y"))]  # fmt: skip
    leaning = held.grasps[1]
    turn = np.array([[1, 0, 0], [0, np.sqrt(0.75), -0.5], [0, 0.5, np.sqrt(0.75)]])
    for stop, first in zip(leaning.stops, held.stops, strict=True):
        assert pose(stop).rotation == pytest.approx(pose(first).rotation @ turn)
        assert pose(stop).translation == pytest.approx(pose(first).translation)
    assert [isinstance(s.target, PoseTarget) and s.target.free_yaw for s in (*held.stops, *leaning.stops)] == [True, False, False, False]  # fmt: skip
    [shape] = job.cell.parts["plain@tilt +x"]
    assert shape.pose.rotation == pytest.approx(turn.T)
    corner = look.grasps[1]
    assert pose(corner.stops[0]).translation == pytest.approx((0.32, 0.01, 0.8))
    assert corner.part == ""


@pytest.mark.parametrize(
    ("old", "new", "wanted"),
    [
        (", free: {tilt: 30 deg}}\n  - {id: b", "}\n  - {id: b", "8:43: E300 the tool holds the part alike at pick and place; give both the same 'tilt' and 'area', or remove it"),
        ("part: plain", "part: block", "8:61: E300 tilt: its part has grasps; give it to them in the cell file"),
        ("    place:", "    handover: {xyz: [0.4, 0, 0.8], grip: {xyz: [0, 0, 0.1]}}\n    place:", "8:61: E300 tilt: hand-overs have none; remove it, or hand over a part with grasps"),
    ],
)  # fmt: skip
def test_freedom_that_a_target_cannot_have(
    block: Path, messages: Messages, old: str, new: str, wanted: str
) -> None:
    """At its place, with a remedy."""
    assert old in FREE
    (block / "tasks.yaml").write_text(FREE.replace(old, new))
    assert f"tasks.yaml:{wanted}" in messages(lambda: load_job("tasks.yaml"))
