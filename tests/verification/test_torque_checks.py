"""Torques on paths: a pendulum whose torques are m g L cos q + m L² dω/dt."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.kinds.path.checks import check_torques
from dualarm_cli.model.cell import Tool
from dualarm_cli.model.robot import Arm
from dualarm_cli.model.trajectory import Trajectory

MASS, LENGTH, GRAVITY = 2.0, 0.5, 9.81
URDF = """\
<robot name="pendulum"><link name="base"/>
<joint name="swing" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" velocity="9" effort="{effort}"/></joint><link name="arm"/></robot>
"""


def judged(effort, q, v=0.0, a=0.0, *, base=None, asked=True, kind="path", task="wipe", **segment):
    """The check of a tenth of a second at an angle, a speed and an acceleration."""
    arm = Arm("left", ("swing",), "arm", "general")
    tool = Tool(pin.SE3(np.eye(3), np.array([LENGTH, 0.0, 0.0])), mass=MASS)
    robot = SimpleNamespace(urdf=URDF.format(effort=effort), arms=(arm,))
    cell = SimpleNamespace(robot=robot, tools={"left": tool}, base=base or pin.SE3.Identity())
    path = SimpleNamespace(torque=asked)
    job = SimpleNamespace(cell=cell, tasks=(SimpleNamespace(id="wipe", path=path),))
    h = 0.1
    rows = np.array([[[q], [v], [a]], [[q + v * h + a * h * h / 2], [v + a * h], [a]]])
    motion = Trajectory(("swing",), np.array([0.0, h]), rows[:, 0], rows[:, 1], rows[:, 2])
    span = {"start": 0.0, "end": h} | segment
    segments = (SimpleNamespace(kind=kind, task=task, **span),)
    return check_torques(SimpleNamespace(trajectory=motion, segments=segments), job)


@pytest.mark.parametrize("q", [0.0, 0.7, -2.0])
def test_a_torque_that_stands_against_gravity_is_measured(q):
    """Its share of the limit, to one and to a little more."""
    torque = MASS * GRAVITY * LENGTH * abs(np.cos(q))
    for share, verdict in ((0.9, "passed"), (1.0005, "passed"), (1.0015, "failed")):
        check = judged(torque / share, q)
        assert check.measured == pytest.approx(share, rel=1e-9)
        assert check.verdict == verdict
        assert check.detail.startswith("swing on wipe at ")


def test_a_torque_that_moves_the_tool_is_measured():
    """Upright it swings up at 40 rad/s²: m L² times that, and what gravity takes at the worst of the angles."""
    check = judged(100.0, np.pi / 2, a=40.0)
    ends = np.array([np.pi / 2, np.pi / 2 + 40.0 * 0.1**2 / 2])
    torque = MASS * LENGTH**2 * 40.0 - MASS * GRAVITY * LENGTH * np.cos(ends)
    assert check.measured == pytest.approx(np.abs(torque).max() / 100.0, rel=1e-9)


def test_gravity_is_as_it_is_where_the_robot_stands():
    """On its side by a quarter turn the arm hangs along gravity, or stands on it: nothing is to be held."""
    base = pin.SE3(pin.utils.rotate("y", np.pi / 2), np.zeros(3))
    assert judged(1.0, 0.0, base=base).measured == pytest.approx(0.0, abs=1e-12)
    torque = MASS * GRAVITY * LENGTH
    assert judged(torque, np.pi / 2, base=base).measured == pytest.approx(1.0, rel=1e-9)


@pytest.mark.parametrize(
    "changes", [{"kind": "transfer"}, {"task": "other"}, {"start": 0.1}, {"asked": False}]
)
def test_only_paths_that_ask_for_it_are_measured(changes):
    """Another segment, another task, a path without length, and a path that does not ask."""
    check = judged(1e-3, 0.0, **changes)
    assert check.verdict == "not checked"
    asked = "no path has torque limits"
    assert check.detail == (asked if "asked" in changes else "no segment of kind path")
    assert judged(1e-3, 0.0).verdict == "failed"


def test_without_a_job_nothing_is_known_of_paths():
    """No failure either."""
    assert check_torques(SimpleNamespace(segments=()), None).verdict == "not checked"
