"""A schedule of odd numbers and names: what survives it survives a file."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.exporting.files import write_schedule_set
from dualarm_cli.model.dwell import Dwell
from dualarm_cli.model.motion.joint_motion import JointMotion
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.model.schedule import (
    Event,
    Provenance,
    Schedule,
    ScheduleArm,
    ScheduleRobot,
    Segment,
    Stage,
)
from dualarm_cli.model.verification import Check, Verification

URDF = (
    '<robot name="two"><link name="base"/><link name="top"/><link name="hand"/>'
    '<joint name="turn" type="revolute"><parent link="base"/><child link="top"/>'
    '<axis xyz="0 0 1"/><limit lower="-3" upper="3" velocity="4" effort="0"/></joint>'
    '<joint name="lift" type="revolute"><parent link="top"/><child link="hand"/>'
    '<axis xyz="0 1 0"/><limit lower="-3" upper="3" velocity="4" effort="0"/></joint>'
    "</robot>\n"
)


def _pose(rng: np.random.Generator) -> pin.SE3:
    axis = rng.normal(size=3)
    turn = pin.AngleAxis(float(rng.uniform(0, 3)), axis / np.linalg.norm(axis))
    return pin.SE3(turn.toRotationMatrix(), rng.normal(size=3))


@pytest.fixture(scope="session")
def schedule() -> Schedule:
    """Seven knots of two joints; nothing in it fits together, everything in it is a number."""
    rng = np.random.default_rng(11)
    joints = ("turn", "lift")
    time = np.array([0.0, 0.1, 0.2, 0.30000000000000004, 1 / 3, 0.7, 0.7])
    values = rng.normal(size=(3, 7, 2)) * 10.0 ** rng.integers(-30, 30, size=(3, 7, 2))
    values[0, :4, 0] = [-0.0, 5e-324, math.pi, 1.7976931348623157e308]
    limits = JointLimits(
        joints,
        np.array([-np.inf, -1 / 3]),
        np.array([np.inf, 1 / 3]),
        np.array([0.1, np.inf]),
        np.array([np.inf, 7.3]),
        np.array([np.inf, 1e5]),
        ("assumed", "datasheet"),
    )
    arms = {"left": ScheduleArm("hand", _pose(rng), ("lift",))}
    return Schedule(
        robot=ScheduleRobot("zwei ☃", URDF, _pose(rng), arms, limits, ("turn",), 0.1 + 0.2),
        motion=JointMotion.of(Trajectory(joints, time, *values)),
        stages=(
            Stage(0.0, 1 / 3, ("a",), "exact", 0.1, 0.2, {"left": 0.3}, {"turn": 0.4}, "turn"),
            Stage(1 / 3, 0.7, (), "fixed", None, 0.0, {}, {}, ""),
            Stage(0.2, 0.4, ("a",), "fixed", None, 0.0, {}, {}, "", arm="left"),
        ),
        segments=(
            Segment("left", "transfer", "a", "pick", 0.0, 0.1),
            Segment("left", "dwell", "a", "pick", 0.1, 0.2, Dwell(0.01, 0.02, 1 / 30)),
            Segment("left", "wait", 'b"\\', "move", 0.2, 0.3, reason="shared_zone"),
            Segment("left", "wait", "", "", 0.3, 0.7),
        ),
        events=(
            Event(0.30000000000000004, "left", "a", "pick", "left_tcp", _pose(rng), 0.1),
            Event(0.7, "left", 'b"\\', "move", "left_tcp", _pose(rng)),
        ),
        provenance=Provenance("1.2", {"tasks.yaml": "ab"}, {"timing": "ruckig", "x": None}, 5),
        lower_bound=0.1,
        verification=Verification(
            (Check("rest", "passed", 0.0, 1e-9, "rad/s", "turn"),
             Check("collisions", "not checked", None, None, "", "why"))
        ),
        notes=("a choice", "line\nbreak"),
    )  # fmt: skip


@pytest.fixture
def folder(tmp_path, schedule):
    """The schedule, written."""
    write_schedule_set(
        tmp_path / "out", schedule, {"report.json": [b"{}\n"], "schedule.csv": [b"time\n"]}, False
    )
    return tmp_path / "out"
