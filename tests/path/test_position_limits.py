"""A joint's position limit that ends a path is told apart from rates, which less speed helps against."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinds.path import motion
from dualarm_cli.kinds.path.context import PathContext
from dualarm_cli.kinds.path.following.position_limits import ended_by_limit
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.kinematics.whole_body import WholeBody
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound

QUICK = PlanSettings(effort="quick")


def turning(folder: Path, general_robots, angle: int) -> Path:
    """A task file: the left UR5 turns its tool about its last axis from its posture home, in which joint 6 is at 0."""
    file = general_robots.write_cell(folder, "ur5")
    cell = load_job(file).cell
    R, p = WholeBody(cell).tools(np.array(cell.robot.postures["home"]))
    roll, pitch, yaw = pin.rpy.matrixToRpy(R[0])
    x, y, z = p[0]
    axis = ", ".join(map(str, R[0][:, 2]))
    file.write_text(
        "dualarm: tasks/1\ncell: cell.yaml\nstart: free\ntasks:\n  - id: screw\n    path:\n      arm: left\n"
        "      speed: 0.2\n      slower: allowed\n      posture: home\n      through:\n"
        f"        - {{xyz: [{x}, {y}, {z}], rpy: [{roll}, {pitch}, {yaw}]}}\n"
        f"        - {{turn: {{about: [{x}, {y}, {z}], axis: [{axis}], angle: {angle} deg}}}}\n"
    )
    return file


def test_the_joint_and_the_place_are_told_before_anything_is_followed(
    tmp_path, general_robots, monkeypatch
):
    """Joint 6 turns with the tool from 0 to its limit of 360 of 500 deg: 628.3 mm along, 100 mm of way a radian."""

    def follow(*_):
        raise AssertionError("followed, and made slower, for nothing")

    monkeypatch.setattr(motion._Trials, "attempt", follow)
    with pytest.raises(InfeasibleError) as caught:
        plan_without_bound(load_job(turning(tmp_path, general_robots, 500)), QUICK)
    said = str(caught.value)
    assert "joint left_j6 reaches its limit of 360 deg" in said
    place = float(re.search(r"left tool ([\d.]+) mm along", said)[1])
    assert 200.0 * np.pi <= place <= 200.0 * np.pi + 1e3 * 0.1 * np.radians(500) / 399
    assert "slower" not in said
    assert "another method" not in said


def test_a_turn_within_the_limits_is_not_ended(tmp_path, general_robots):
    """350 of 360 deg; 365 deg are."""
    for angle, ends in ((350, False), (365, True)):
        job = load_job(turning(tmp_path, general_robots, angle))
        context = PathContext.of(CellModel.from_cell(job.cell), job)
        work, home = job.tasks[0].path, np.array(job.cell.robot.postures["home"])
        found = ended_by_limit(context.problem(work, home, context.clock(work)))
        assert (found is not None) is ends


def test_closed_forms_over_the_arm_angle_name_the_joint_too(tmp_path):
    """No 7-axis arm of the SDA10F turns its tool by 700 deg: its last joint has 360 deg of room."""
    (tmp_path / "cell.yaml").write_text("dualarm: cell/1\nrobot: sda10f\n")
    file = tmp_path / "tasks.yaml"
    file.write_text(
        "dualarm: tasks/1\ncell: cell.yaml\nstart: free\ntasks:\n  - id: screw\n    path:\n      arm: left\n"
        "      speed: 0.2\n      posture: home\n      through:\n"
        "        - {xyz: [0.5, 0.3, 0.9], rpy: [180 deg, 0, 0]}\n"
        "        - {turn: {about: [0.5, 0.3, 0.9], axis: [0, 0, -1], angle: 700 deg}}\n"
    )
    with pytest.raises(
        InfeasibleError, match=r"joint \w+ reaches its limit of -?180 deg while the platform"
    ):
        plan_without_bound(load_job(file), QUICK)


def test_arms_with_self_motion_are_led_away_from_limits(choi, zhang):
    """The papers' own paths, which their methods follow."""
    for _, problem in (choi, zhang):
        assert ended_by_limit(problem) is None
