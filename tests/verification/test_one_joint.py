"""A robot with one joint, for which pinocchio makes vectors of its matrices, is judged like any other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.model.cell import Cell, Obstacle, Tool
from dualarm_cli.model.dwell import Dwell
from dualarm_cli.model.job import Job, JointTarget, Stop, Task
from dualarm_cli.model.motion.joint_motion import JointMotion
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.place import NOWHERE
from dualarm_cli.model.robot import Arm, JointLimits, Robot
from dualarm_cli.model.schedule import Event, Provenance, Schedule, ScheduleRobot, Segment, Stage
from dualarm_cli.model.shape import Shape
from dualarm_cli.verification import verify

URDF = """\
<robot name="one"><link name="base"/><link name="arm"/><link name="flange"/>
<joint name="j" type="revolute"><parent link="base"/><child link="arm"/><origin xyz="0 0 0.5"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" velocity="2" effort="10"/></joint>
<joint name="f" type="fixed"><parent link="arm"/><child link="flange"/><origin xyz="0.5 0 0"/></joint></robot>
"""
ONE = np.ones(1)
LIMITS = JointLimits(("j",), -3 * ONE, 3 * ONE, 2 * ONE, 50 * ONE, 500 * ONE, ("assumed",))
ROBOT = Robot("one", URDF, (), (Arm("left", ("j",), "flange", "general"),), LIMITS)
BALL = Shape("sphere", (0.05,), pin.SE3.Identity())


def at(angle: float) -> pin.SE3:
    """The tool: 0.5 m out, 0.1 m above the flange."""
    place = np.array([0.5 * np.cos(angle), 0.5 * np.sin(angle), 0.6])
    return pin.SE3(pin.utils.rotate("z", angle), place)


@pytest.fixture
def job() -> Job:
    """A radian to the left past a ball 0.2 m farther out than the tool's, 0.1 m from ball to ball."""
    tool = Tool(pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.1])), shapes=(BALL,))
    angle, far = 0.4, 0.7
    ball = replace(BALL, pose=pin.SE3(np.eye(3), far * np.array([np.cos(angle), np.sin(angle), 0])))
    ball.pose.translation = ball.pose.translation + np.array([0.0, 0.0, 0.5])
    cell = Cell(ROBOT, pin.SE3.Identity(), {"left": tool}, obstacles=(Obstacle("ball", ball),))
    target = JointTarget(np.array([[1.0]]))
    task = Task("a", "left", (Stop("move", target, 0.0, 0.0, Dwell(), NOWHERE),))
    return Job(cell, (task,), "home", False)


@pytest.fixture
def schedule(job: Job) -> Schedule:
    """Four jerks of half a second."""
    d = np.array([1 / 12, 1 / 2, 11 / 12, 1])
    h = 0.5
    motion = Trajectory(
        ("j",),
        h * np.arange(5.0),
        np.append(0.0, d)[:, None],
        np.array([0, 1 / 4, 1 / 2, 1 / 4, 0])[:, None] / h,
        np.array([0, 1 / 2, 0, -1 / 2, 0])[:, None] / h**2,
    )
    stage = Stage(0.0, 2.0, ("a",), "fixed", None, 0.0, {"left": 2.0}, {"j": 2.0}, "j")
    return Schedule(
        ScheduleRobot.of_job(job),
        JointMotion.of(motion),
        (stage,),
        (Segment("left", "transfer", "a", "move", 0.0, 2.0),),
        (Event(2.0, "left", "a", "move", "left_tcp", at(1.0)),),
        Provenance("0", {}, {}, 0),
    )


def test_its_motion_passes_with_and_without_its_tasks(schedule, job):
    """And its least clearance is 0.1 m, of the two balls."""
    assert verify(schedule).passed
    verification = verify(schedule, job, clearance=True)
    assert verification.passed
    [clearance] = verification.clearances
    assert clearance.clearance == pytest.approx(0.1, abs=1e-3)


def test_a_tool_that_is_elsewhere_is_found(schedule, job):
    """By two micrometres, and by a milliradian of the joint's target."""
    event = schedule.events[0]
    pose = pin.SE3(event.pose.rotation, event.pose.translation + np.array([0.0, 0.0, 2e-6]))
    off = replace(schedule, events=(replace(event, pose=pose),))
    assert {check.name for check in verify(off).failures} == {"tool_position_at_events"}
    task = job.tasks[0]
    stop = replace(task.stops[0], target=JointTarget(np.array([[1.001]])))
    other = replace(job, tasks=(replace(task, stops=(stop,)),))
    assert [check.name for check in verify(schedule, other).failures] == ["events_at_targets"]


def test_a_contact_is_found(schedule, job):
    """A clearance of 101 mm is more than there is."""
    near = replace(job, cell=replace(job.cell, clearance=0.101))
    assert [check.name for check in verify(schedule, near, clearance=True).failures] == [
        "collisions"
    ]
