"""Forward kinematics of a schedule's own URDF, and what it refuses."""

from __future__ import annotations

import dataclasses

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.errors import InputError
from dualarm_cli.model.motion.joint_motion import JointMotion
from dualarm_cli.verification.measuring.tool_model import ToolModel, rotation_angle


def with_robot(schedule, **changes):
    """Returns the schedule with another robot."""
    return dataclasses.replace(schedule, robot=dataclasses.replace(schedule.robot, **changes))


def test_tools_are_where_plane_trigonometry_puts_them(clean):
    """The events' poses are sums of sines and cosines, base and tool included."""
    model = ToolModel(clean.schedule)
    for event in clean.schedule.events:
        q = clean.schedule.trajectory.at(np.array([event.time]))[0]
        pose = model.pose(event.arm, q[0])
        assert np.allclose(pose.homogeneous, event.pose.homogeneous, rtol=0, atol=1e-14)
        R, p = model.poses(event.arm, q)
        assert np.allclose(R[0], event.pose.rotation, rtol=0, atol=1e-14)
        assert np.allclose(p[0], event.pose.translation, rtol=0, atol=1e-14)


def test_the_order_of_the_joints_is_the_schedules_own(clean):
    """Columns in reverse order are the same motion."""
    trajectory = clean.schedule.trajectory
    reverse = dataclasses.replace(
        trajectory,
        joints=trajectory.joints[::-1],
        **{
            name: getattr(trajectory, name)[:, ::-1]
            for name in ("position", "velocity", "acceleration")
        },
    )
    other = dataclasses.replace(clean.schedule, motion=JointMotion.of(reverse))
    one = ToolModel(clean.schedule).poses("left", trajectory.position)
    two = ToolModel(other).poses("left", reverse.position)
    assert all(np.array_equal(a, b) for a, b in zip(one, two, strict=True))


def rename(urdf, old, new):
    """Returns URDF text in which a name is another."""
    return urdf.replace(f'"{old}"', f'"{new}"')


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda urdf: "", "robot.urdf cannot be read"),
        (lambda urdf: urdf[: len(urdf) // 2], "robot.urdf cannot be read"),
        (lambda urdf: "no xml", "robot.urdf cannot be read"),
        (lambda urdf: rename(urdf, "l2", "elbow"), "'l2' is not a joint of the URDF"),
        (lambda urdf: rename(urdf, "l_flange", "hand"), "robot.arms.left.flange: 'l_flange'"),
        (
            lambda urdf: urdf.replace('"r_f" type="fixed"', '"r_f" type="revolute"').replace(
                'rpy="0 1.5707963267948966 0"/>',
                'rpy="0 1.5707963267948966 0"/><limit lower="-1" upper="1" velocity="1" effort="0"/>',
            ),
            "the URDF's moving joint 'r_f' is missing",
        ),
        (
            lambda urdf: urdf.replace('"turn" type="revolute"', '"turn" type="continuous"'),
            "continuous",
        ),
    ],
    ids=["empty", "half", "text", "joint", "flange", "moving", "continuous"],
)
def test_a_urdf_that_does_not_fit_is_bad_input_and_says_what(clean, change, message):
    """No crash of the library and no finding without a model: exit 2."""
    schedule = with_robot(clean.schedule, urdf=change(clean.schedule.robot.urdf))
    with pytest.raises(InputError, match=message):
        ToolModel(schedule)


def test_every_moving_joint_has_to_be_there(clean):
    """Each of them left out in turn."""
    joints = clean.schedule.trajectory.joints
    for lost in joints:
        others = [name for name in joints if name != lost]
        fewer = dataclasses.replace(
            clean.schedule, motion=JointMotion.of(clean.schedule.trajectory.select(others))
        )
        with pytest.raises(InputError, match=f"moving joint '{lost}' is missing"):
            ToolModel(fewer)


def test_the_universe_is_not_a_joint(clean):
    """The library's name for the fixed world is in no robot's list of joints."""
    trajectory = clean.schedule.trajectory
    wide = {
        name: np.pad(getattr(trajectory, name), ((0, 0), (0, 1)))
        for name in ("position", "velocity", "acceleration")
    }
    trajectory = dataclasses.replace(trajectory, joints=(*trajectory.joints, "universe"), **wide)
    with pytest.raises(InputError, match="'universe' is not a joint"):
        ToolModel(dataclasses.replace(clean.schedule, motion=JointMotion.of(trajectory)))


def test_a_flange_that_shares_its_name_with_a_joint_is_the_link(clean):
    """URDF has one list of names for links and another for joints."""
    robot = clean.schedule.robot
    arms = {name: dataclasses.replace(arm, flange="l3" if name == "left" else arm.flange)
            for name, arm in robot.arms.items()}  # fmt: skip
    same = with_robot(clean.schedule, urdf=rename(robot.urdf, "l_flange", "l3"), arms=arms)
    q = clean.schedule.trajectory.position
    expected = ToolModel(clean.schedule).poses("left", q)
    assert np.array_equal(ToolModel(same).poses("left", q)[1], expected[1])


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-6, 0.5, np.pi / 2, 3.0, np.pi - 1e-7, np.pi])
def test_angles_of_rotations_are_exact_from_nothing_to_half_a_turn(angle):
    """About any axis; the arc cosine of the trace would lose everything below 1e-8."""
    rng = np.random.default_rng(3)
    for axis in rng.normal(size=(20, 3)):
        R = pin.AngleAxis(angle, axis / np.linalg.norm(axis)).toRotationMatrix()
        # Near half a turn the sine is what remains of entries that are rounded to 1e-16.
        assert rotation_angle(R) == pytest.approx(
            angle, rel=1e-3 if angle < 1e-9 else 1e-9, abs=3e-15
        )
