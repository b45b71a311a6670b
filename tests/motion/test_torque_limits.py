"""Motions within torques: a pendulum by hand, and what slowing leaves as it is."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.model.cell import Cell, Tool
from dualarm_cli.model.robot import Arm, JointLimits, Robot
from dualarm_cli.model.schedule import Event, Segment
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.motion.builder import Motion
from dualarm_cli.motion.torque_limits import SETTINGS, within_torques

MASS, LENGTH, GRAVITY, ACCELERATION = 2.0, 0.5, 9.81, 40.0
URDF = """\
<robot name="pendulum"><link name="base"/>
<joint name="swing" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" velocity="9" effort="{effort}"/></joint>
<link name="arm"><inertial><mass value="1e-12"/><inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial>
</link></robot>
"""
ONE = np.ones(1)
LYING = pin.SE3(pin.utils.rotate("x", np.pi / 2), np.zeros(3))
"""Base with which the joint's axis is vertical, so that gravity needs no torque."""
H = 0.1


def job_of(effort: float, base: pin.SE3 = LYING, rule: str = "limited") -> SimpleNamespace:
    """A bar without mass about y, with a tool of 2 kg at its end."""
    limits = JointLimits(("swing",), -3 * ONE, 3 * ONE, 9 * ONE, 90 * ONE, 900 * ONE, ("assumed",))
    arm = Arm("left", ("swing",), "arm", "general")
    robot = Robot("pendulum", URDF.format(effort=effort), (), (arm,), limits)
    tcp = pin.SE3(np.eye(3), np.array([LENGTH, 0.0, 0.0]))
    tool = Tool(tcp, pin.Inertia(MASS, tcp.translation, np.zeros((3, 3))))
    cell = Cell(robot, base, {"left": tool}, torque=rule)
    return SimpleNamespace(cell=cell, tasks=())


def swing() -> Motion:
    """Forth with triangles of acceleration up to 40 rad/s², a rest of 0.1 s, and a fifth of it back."""
    a = np.array([0, 1, 0, -1, 0, 0, -0.2, 0, 0.2, 0]) * ACCELERATION
    time = np.array([0, 1, 2, 3, 4, 5, 6, 7, 8, 9]) * H
    jerk = np.diff(a) / H
    q, v = np.zeros(10), np.zeros(10)
    for k in range(9):
        v[k + 1] = v[k] + H * (a[k] + a[k + 1]) / 2
        q[k + 1] = q[k] + H * v[k] + H * H * (a[k] / 2 + jerk[k] * H / 6)
    v[[4, 5, 9]] = 0.0
    trajectory = Trajectory(("swing",), time, q[:, None], v[:, None], a[:, None])
    segments = (
        Segment("left", "transfer", "a", "place", 0.0, 0.4),
        Segment("left", "dwell", "a", "place", 0.4, 0.5),
        Segment("left", "return", "", "", 0.5, 0.9),
    )
    event = Event(0.4, "left", "a", "place", "left_tcp", pin.SE3.Identity(), 0.1)
    return Motion(trajectory, (), segments, (event,))


def test_a_span_is_slowed_as_far_as_its_torque_requires() -> None:
    """Of m L² a at the peak to a quarter: twice the time of the first swing, the other one as it was."""
    peak = MASS * LENGTH**2 * ACCELERATION
    motion, notes = within_torques(job_of(peak / 4.0 / (1.0 - SETTINGS.reserve)), swing())
    np.testing.assert_allclose(
        motion.trajectory.time, np.array([0, 2, 4, 6, 8, 9, 10, 11, 12, 13]) * H
    )
    np.testing.assert_array_equal(motion.trajectory.position, swing().trajectory.position)
    assert np.abs(motion.trajectory.acceleration).max() == pytest.approx(ACCELERATION / 4.0)
    assert [(s.start, s.end) for s in motion.segments] == [
        (0.0, pytest.approx(0.8)), (pytest.approx(0.8), pytest.approx(0.9)), (pytest.approx(0.9), pytest.approx(1.3)),
    ]  # fmt: skip
    assert motion.events[0].time == pytest.approx(0.8)
    [note] = notes
    assert note.startswith(
        "torque: 1 motion between rests is slowed, by up to 100% for swing, together by 0.400 s"
    )


def test_gravity_is_not_slowed_away() -> None:
    """Upright about y, from horizontal: m g L stays, m L² a falls by the square of the factor."""
    effort = 1.5 * MASS * GRAVITY * LENGTH / (1.0 - SETTINGS.reserve)
    motion, _ = within_torques(job_of(effort, pin.SE3.Identity()), swing())
    trajectory = motion.trajectory
    q, a = trajectory.position[:, 0], trajectory.acceleration[:, 0]
    torque = MASS * LENGTH**2 * a - MASS * GRAVITY * LENGTH * np.cos(q)
    assert np.abs(torque).max() <= effort
    assert np.abs(torque).max() == pytest.approx(effort, rel=0.02)


def test_a_joint_that_cannot_hold_still_is_refused() -> None:
    """At 0 it needs m g L = 9.81 N m; the refusal has the torque and the share."""
    with pytest.raises(
        InfeasibleError, match=r"swing needs 9\.81 N m to hold still .*, 123% of its"
    ):
        within_torques(job_of(8.0, pin.SE3.Identity()), swing())


@pytest.mark.parametrize("job", [job_of(100.0), job_of(1e-6, rule="checked"), job_of(0.0)])
def test_a_motion_that_needs_no_slowing_is_the_same_object(job: SimpleNamespace) -> None:
    """Within torques, with torques that are no limit, and without data."""
    motion = swing()
    assert within_torques(job, motion) == (motion, [])


def test_a_dwell_keeps_its_length_and_a_wait_follows() -> None:
    """A dwell of an arm in a span in which another joint moves."""
    motion = swing()
    within = replace(
        motion,
        segments=(
            Segment("left", "dwell", "a", "place", 0.0, 0.2),
            Segment("left", "wait", "b", "pick", 0.2, 0.3, reason="partner"),
            Segment("left", "transfer", "b", "pick", 0.3, 0.9),
        ),
    )
    peak = MASS * LENGTH**2 * ACCELERATION
    slowed, _ = within_torques(job_of(peak / 4.0 / (1.0 - SETTINGS.reserve)), within)
    spans = [(s.kind, round(s.start, 9), round(s.end, 9)) for s in slowed.segments]
    assert spans == [("dwell", 0.0, 0.2), ("wait", 0.2, 0.6), ("transfer", 0.6, 1.3)]
