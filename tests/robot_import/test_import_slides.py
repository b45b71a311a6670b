"""Lifts and rails of imported robots: they stand, and the file says how to let them move."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from dualarm_cli.cli.run import run
from dualarm_cli.files.robots.robots import load_robot
from dualarm_cli.model.robot import Robot

TASKS = """\
dualarm: tasks/1
cell: cell.yaml
return: true
tasks:
  - {id: a, arm: left, move: {xyz: [0.55, 0.25, 0.8], rpy: [180 deg, 0, 0], free: yaw}}
  - {id: b, arm: right, move: {xyz: [0.55, -0.25, 0.95], rpy: [180 deg, 0, 0], free: yaw}}
"""


def imported(folder: Path, *options: str) -> tuple[Robot, str]:
    """Imports robot.urdf; returns the robot and its file's text."""
    out = folder / "imported"
    assert (
        run(["robot", "import", str(folder / "robot.urdf"), "--out", str(out), "--force", *options])
        == 0
    )
    file = out / "robot.yaml"
    return load_robot(str(file)).robot, file.read_text()


def plans(folder: Path) -> int:
    """Plans two moves with the imported robot; returns the exit code: 0 for a verified plan."""
    (folder / "cell.yaml").write_text(
        "dualarm: cell/1\nrobot: imported/robot.yaml\ntools: {left: {tcp: {}}, right: {tcp: {}}}\n"
    )
    (folder / "tasks.yaml").write_text(TASKS)
    tasks, out = str(folder / "tasks.yaml"), str(folder / "out")
    return run(["plan", tasks, "--out", out, "--force", "--effort", "quick", "-v"])


def test_a_lift_of_both_arms_stands_and_its_comment_lets_it_move(tmp_path, sliding_robots, capsys):
    """Frozen at 0 by itself; as the comment says, and by the option, it is the platform; plans are verified."""
    sliding_robots.write_robot(tmp_path, {"lift": sliding_robots.LIFT})
    robot, text = imported(tmp_path)
    assert "lift: slides and carries both arms; held at 0 mm" in capsys.readouterr().err
    assert robot.platform == ()
    assert not robot.sliding
    assert "frozen:" in text
    assert "  lift: 0 mm\n" in text
    assert (
        "# it carries both arms, -200 to 500 mm; to let it move between stages, delete its line"
        in text
    )
    assert plans(tmp_path) == 0
    # As the comment says.
    change = re.search(r"write `(platform: \[lift\])`", text)
    assert change is not None
    file = tmp_path / "imported" / "robot.yaml"
    without = re.sub(r"frozen:.*\n(  .*\n)+", "", text)
    file.write_text(without.replace("arms:", f"{change[1]}\narms:", 1))
    assert load_robot(str(file)).robot.platform == ("lift",)
    assert plans(tmp_path) == 0
    robot, text = imported(tmp_path, "--platform", "lift")
    assert robot.platform == ("lift",)
    assert "frozen:" not in text
    assert plans(tmp_path) == 0
    assert "place mm" in capsys.readouterr().out


def test_a_lift_below_a_waist_stands_and_the_waist_turns(tmp_path, sliding_robots):
    """The comment names the waist, in whose place the lift may move."""
    sliding_robots.write_robot(tmp_path, {"lift": sliding_robots.LIFT, "waist": None})
    robot, text = imported(tmp_path)
    assert robot.platform == ("waist",)
    assert "write `platform: [lift]` in place of waist" in text
    assert plans(tmp_path) == 0


def test_a_rail_of_one_arm_stands_and_may_be_its_first_joint(tmp_path, sliding_robots, capsys):
    """Done as the comment says, `frozen:` left empty, it is planned with numeric inverse kinematics."""
    sliding_robots.write_robot(tmp_path, {"waist": None}, joints=6, own=sliding_robots.RAIL)
    robot, text = imported(tmp_path)
    printed = capsys.readouterr().err
    assert robot.platform == ("waist",)
    for side in ("left", "right"):
        assert f"{side}_slide: slides and carries the {side} arm; held at 0 mm; " in printed
        assert f"# it carries the {side} arm, -1000 to 1500 mm" in text
        assert f"name it first in the joints of the {side} arm" in text
        text = text.replace(f"joints: [{side}_1,", f"joints: [{side}_slide, {side}_1,")
    file = tmp_path / "imported" / "robot.yaml"
    file.write_text(re.sub(r"(frozen:.*\n)(  .*\n)+", r"\1", text))
    robot = load_robot(str(file)).robot
    assert robot.sliding == {"left_slide", "right_slide"}
    assert plans(tmp_path) == 0


def test_a_lift_starts_where_nothing_touches(tmp_path, sliding_robots):
    """A block on the foot overlaps the arms' carriage in the lowest tenth: home is in the middle, in metres."""
    lift = sliding_robots.Slide("0 0 1", 0.0, 2.0)
    sliding_robots.write_robot(tmp_path, {"lift": lift})
    file = tmp_path / "robot.urdf"
    box = '<collision><geometry><box size="0.2 0.2 0.2"/></geometry></collision>'
    shaped = file.read_text().replace(
        "</robot>",
        f'<link name="block">{box}</link><joint name="on" type="fixed"><parent link="base"/>'
        '<child link="block"/><origin xyz="0 0 1"/></joint>'
        f'<link name="carriage">{box}</link><joint name="under" type="fixed">'
        '<parent link="lift_link"/><child link="carriage"/></joint></robot>',
    )
    file.write_text(shaped)
    robot, text = imported(tmp_path, "--platform", "lift")
    assert robot.postures["home"][robot.columns(["lift"])] == pytest.approx([1.0])
    assert "lift: 1.0 m" in text


def test_a_lift_without_speed_gets_one_of_lengths(tmp_path, sliding_robots, capsys):
    """100 mm/s, not 90 deg/s, and it is told."""
    sliding_robots.write_robot(tmp_path, {"lift": sliding_robots.LIFT})
    file = tmp_path / "robot.urdf"
    file.write_text(file.read_text().replace('velocity="0.5"', 'velocity="0"'))
    robot, _ = imported(tmp_path, "--platform", "lift")
    np.testing.assert_allclose(robot.limits.select(["lift"]).velocity, [0.1])
    assert "of joints that slide 100 mm/s" in capsys.readouterr().err
