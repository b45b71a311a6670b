# ruff: noqa: E501 (tables of exact messages, one a line)
"""Hand-overs in task files: what they become, and every mistake at its place."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.job import PoseTarget

Change = Callable[..., None]
Messages = Callable[..., list[str]]

HANDOVER = """\
dualarm: tasks/1
cell: cell.yaml
start: bent
defaults: {approach: 80 mm, retract: 60 mm, dwell: {gripper: 0.2 s}}
tasks:
  - id: flip
    arm: left
    part: bracket
    pick: {at: bin, xyz: [0, 0, 50 mm]}
    handover: {at: bin, xyz: [0, 0, 0.3], rpy: [90 deg, 0, 0], grip: {xyz: [0, 0, 100 mm], rpy: [180 deg, 0, 0]}}
    place: {xyz: [0.2, -0.5, 0.8]}
  - id: next
    arm: left
    move: {joints: [0.5, -90 deg]}
"""


@pytest.fixture
def flip(project: Path, change: Change) -> Path:
    """The tiny project with a part that the left arm gives to the right one."""
    (project / "tasks.yaml").write_text(HANDOVER)
    change(
        "cell.yaml",
        "clearance:",
        "parts: {bracket: {shapes: [{box: [20 mm, 20 mm, 60 mm], xyz: [0, 0, 30 mm]}]}}\n"
        "clearances: [{between: [bracket, table], clearance: 5 mm}]\n"
        "allowed_contacts: [[bracket, la]]\nclearance:",
    )
    return project


def test_a_handover_becomes_a_share_of_each_arm(flip: Path) -> None:
    """The giver's pick and give, the taker's take and place; approach is the taker's, retract the giver's."""
    giving, taking, _ = load_job("tasks.yaml").tasks
    assert (giving.id, giving.arm, giving.part) == ("flip", "left", "bracket")
    assert (taking.id, taking.arm, taking.part) == ("flip", "right", "bracket@flip")
    assert giving.handover is taking.handover
    lines = [(s.action, s.approach, s.retract, s.dwell.total) for s in giving.stops + taking.stops]
    assert lines == [
        ("pick", 0.08, 0.06, 0.2),
        ("give", 0.0, 0.06, 0.2),
        ("take", 0.08, 0.0, 0.2),
        ("place", 0.08, 0.06, 0.2),
    ]
    give, take = giving.stops[1].target, taking.stops[0].target
    assert isinstance(give, PoseTarget) and isinstance(take, PoseTarget)
    # bin at (0.4, 0.1, 0.7) turned by 90 deg about z: the giving tool 0.3 above it; its z is Rz(90) Rx(90) e_z = e_x.
    assert give.pose.translation == pytest.approx([0.4, 0.1, 1.0])
    assert give.pose.rotation[:, 2] == pytest.approx([1, 0, 0], abs=1e-15)
    # The taking one 100 mm further along that, looking back.
    assert take.pose.translation == pytest.approx([0.5, 0.1, 1.0])
    assert take.pose.rotation[:, 2] == pytest.approx([-1, 0, 0], abs=1e-15)


def test_the_part_hangs_in_the_taking_tool_as_the_grip_has_it(flip: Path) -> None:
    """One solid, seen from two tools: the box's far end, 60 mm from the giver, is 40 mm from the taker."""
    job = load_job("tasks.yaml")
    [given], [taken] = job.cell.parts["bracket"], job.cell.parts["bracket@flip"]
    work = job.tasks[0].handover
    assert work is not None
    corner = np.array([0.01, 0.01, 0.03])
    np.testing.assert_allclose(
        work.grip.act(taken.pose.act(corner)), given.pose.act(corner), atol=1e-15
    )
    assert taken.pose.act(np.array([0, 0, 0.03])) == pytest.approx([0, 0, 0.04])
    # What the cell says of the part holds for it in either tool.
    assert ("bracket@flip", "table", 0.005) in job.cell.clearances
    assert ("bracket@flip", "la") in job.cell.allowed_contacts
    assert job.carried() == [("left", "bracket"), ("right", "bracket@flip")]


def test_without_a_part_nothing_is_carried(flip: Path, change: Change) -> None:
    """A hand-over of something without shapes."""
    change("tasks.yaml", "    part: bracket\n", "")
    job = load_job("tasks.yaml")
    assert job.carried() == []
    assert list(job.cell.parts) == ["bracket"]


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        (("    place: {xyz: [0.2, -0.5, 0.8]}\n", ""), ["tasks.yaml:6:5: E202 'place' is missing: a hand-over has pick, handover and place"]),
        (("    pick: {at: bin, xyz: [0, 0, 50 mm]}\n", ""), ["tasks.yaml:6:5: E202 'pick' is missing: a hand-over has pick, handover and place"]),
        ((", grip: {xyz: [0, 0, 100 mm], rpy: [180 deg, 0, 0]}", ""), ["tasks.yaml:10:15: E202 'grip' is missing, or grasps of the part in the cell"]),
        (("grip: {xyz: [0, 0, 100 mm], rpy: [180 deg, 0, 0]}", "grip: {}"), ["tasks.yaml:10:64: E200 both tools in the same pose; give xyz, rpy or quat of the taking tool in the giving one's frame"]),
        (("at: bin, xyz: [0, 0, 0.3], rpy: [90 deg, 0, 0]", "joints: [0, 0]"), ["tasks.yaml:10:16: E200 'joints' does not go with 'handover': two tools meet there, so it must be a pose; give xyz, with rpy or quat"]),
        (("xyz: [0, 0, 0.3]", "xyz: [0, 0, 0.3], free: yaw"), ["tasks.yaml:10:43: E200 'free' does not go with 'handover': the taking tool's pose follows from the giving one's, so both must be fixed"]),
        (("at: bin, xyz: [0, 0, 0.3]", "at: bim, xyz: [0, 0, 0.3]"), ["tasks.yaml:10:20: E300 the cell has no frame 'bim', did you mean 'bin'? It has: bin, bin.slot, world"]),
        (("grip: {xyz: [0, 0, 100 mm], rpy: [180 deg, 0, 0]}", "grasp: top"), ["tasks.yaml:10:71: E300 the part has no grasps; name them in the cell file, or remove 'grasp'"]),
        (("grip: {xyz", "grasp: top, grip: {xyz"), ["tasks.yaml:10:76: E200 'grip' follows from 'grasp'; keep one"]),
        (("    arm: left\n    part", "    part"), ["tasks.yaml:6:5: E202 'arm' is missing"]),
        (("part: bracket", "part: racket"), ["tasks.yaml:8:11: E300 the cell has no part 'racket', did you mean 'bracket'? Parts: bracket"]),
        (("    place: {xyz", "    move: {xyz: [0, 0, 0]}\n    place: {xyz"), ["tasks.yaml:11:5: E200 'move' does not go with 'handover'; make two tasks"]),
    ],
)  # fmt: skip
def test_every_mistake_is_told_at_its_place(
    flip: Path,
    change: Change,
    messages: Messages,
    changes: tuple[str, ...],
    expected: list[str],
) -> None:
    """One mistake, one message."""
    change("tasks.yaml", *changes)
    assert messages(lambda: load_job("tasks.yaml")) == expected


def test_a_robot_with_one_arm_has_nobody_to_give_to(
    flip: Path, change: Change, messages: Messages
) -> None:
    """Told where the hand-over stands."""
    change("robot.yaml", "  right: {joints: [r1, r2], flange: r_tool, kind: general}\n", "")
    change("robot.yaml", "  r1: {acceleration: 10, jerk: none, source: datasheet}\n", "")
    change("robot.yaml", "  r2: {acceleration: 10, jerk: none, source: datasheet}\n", "")
    change("robot.yaml", ", r1: -1.5", "")
    urdf = (flip / "tiny.urdf").read_text()
    for name in ("r1", "r2"):
        urdf = urdf.replace(f'name="{name}" type="revolute"', f'name="{name}" type="fixed"')
    (flip / "tiny.urdf").write_text(urdf)
    text = messages(lambda: load_job("tasks.yaml"))
    assert [line for line in text if line.startswith("tasks.yaml:10:15") and "needs two" in line], (
        text
    )


def test_what_comes_after_a_handover_is_after_its_place(flip: Path, change: Change) -> None:
    """The giver stands while the taker still places, then goes on; the taker itself goes on anyway."""
    change("tasks.yaml", "  - id: next\n", "  - id: next\n    after: [flip]\n")
    made = [
        [(arm, task.id, stop.action) for arm, (task, stop) in stage.items()]
        for stage in load_job("tasks.yaml").stages()
    ]
    assert made[-2:] == [[("right", "flip", "place")], [("left", "next", "move")]]
    change(
        "tasks.yaml",
        "arm: left\n    move: {joints: [0.5, -90 deg]}",
        "arm: right\n    move: {xyz: [0, 0, 1]}",
    )
    assert load_job("tasks.yaml").notes == ()


@pytest.mark.parametrize("mode", ["paired", "free"])
def test_a_giver_that_begins_later_cannot_be_over_before(
    flip: Path, change: Change, messages: Messages, mode: str
) -> None:
    """One arm gives in both: in the file's order the first one is begun before the second one is over, whoever waits."""
    second = (flip / "tasks.yaml").read_text().split("  - id: next\n")[0].split("  - id: flip\n")[1]
    change("tasks.yaml", "  - id: next\n", f"  - id: again\n{second}  - id: next\n")
    change("tasks.yaml", "  - id: flip\n", "  - id: flip\n    after: [again]\n")
    if mode == "free":
        change("tasks.yaml", "dualarm: tasks/1\n", "dualarm: tasks/1\nmode: free\n")
    [text] = messages(lambda: load_job("tasks.yaml"))
    assert "task 'flip' must come after 'again', but order: given puts it first" in text


def test_grips_are_rigid(flip: Path) -> None:
    """The grip in the noun is the file's."""
    work = load_job("tasks.yaml").tasks[0].handover
    assert work is not None
    wanted = pin.SE3(pin.utils.rotate("x", np.pi), np.array([0.0, 0.0, 0.1]))
    assert work.grip.isApprox(wanted, 1e-12)
    assert (work.giver, work.taker) == ("left", "right")
    assert str(work.place) == "tasks.yaml:10:15"


def test_grasps_of_both_tools_say_what_the_grip_says(tasks_folder: Path, tmp_path: Path) -> None:
    """By hand for the flipped brackets: their frame is that of the giving tool, turned over.

    The taking tool is 104 mm below it, looking up.
    """
    source = tasks_folder / "13_hand_over"
    (tmp_path / "dualarm.toml").write_text("")
    cell = (source / "cell.yaml").read_text()
    old = "bracket: {shapes: [{box: [40 mm, 60 mm, 100 mm], xyz: [0, 0, 52 mm]}]}"
    new = (
        "bracket: {shapes: [{box: [40 mm, 60 mm, 100 mm], xyz: [0, 0, -52 mm], rpy: [180 deg, 0, 0]}], "
        "grasps: {above: {rpy: [180 deg, 0, 0]}, below: {xyz: [0, 0, -104 mm]}}}"
    )
    assert old in cell
    (tmp_path / "cell.yaml").write_text(cell.replace(old, new))
    text = (source / "tasks.yaml").read_text()
    for before, after in (
        ("arm: left ", "grasp: above\n    arm: left "),
        ("arm: left\n", "grasp: above\n    arm: left\n"),
        ("{at: infeed, rpy: [180 deg, 0, 0],", "{at: infeed,"),
        ("rpy: [90 deg, 0, 0]", "rpy: [-90 deg, 0, 0]"),
        ("grip: {xyz: [0, 0, 104 mm], rpy: [180 deg, 0, 0]}", "grasp: below"),
        ("{at: outfeed, xyz: [0, 0, 0]", "{at: outfeed, xyz: [0, 0, -104 mm]"),
        ("{at: outfeed, xyz: [0, -100 mm, 0]", "{at: outfeed, xyz: [0, -100 mm, -104 mm]"),
    ):
        assert before in text, before
        text = text.replace(before, after)
    (tmp_path / "tasks.yaml").write_text(text)
    stated, by_grasps = load_job(source / "tasks.yaml"), load_job(tmp_path / "tasks.yaml")
    assert [task.part for task in by_grasps.tasks[:2]] == [
        "bracket@above",
        "bracket@below",
    ]
    assert [task.grasp.choice for task in by_grasps.tasks[:2]] == ["above, below"] * 2
    for first, second in zip(stated.tasks, by_grasps.tasks, strict=True):
        for a, b in zip(first.stops, second.stops, strict=True):
            assert (a.action, a.approach, a.retract, a.dwell) == (
                b.action,
                b.approach,
                b.retract,
                b.dwell,
            )
            assert a.target.pose.isApprox(b.target.pose, 1e-12)
        assert first.handover.grip.isApprox(second.handover.grip, 1e-12)
        [before], [after] = stated.cell.parts[first.part], by_grasps.cell.parts[second.part]
        assert before.pose.isApprox(after.pose, 1e-12)
