"""A tool's place by arrays, against pinocchio on random trees of joints."""

from __future__ import annotations

import dataclasses

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.errors import InputError
from dualarm_cli.model.motion.joint_motion import JointMotion
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.schedule import ScheduleArm
from dualarm_cli.verification.measuring.tool_model import ToolModel

AXES = ("1 0 0", "0 1 0", "0 0 1", "-1 0 0", "0 0 -1", "0.6 0 0.8", "1 2 -3")


def random_urdf(rng, arms, joints):
    """Returns a body with arms whose joints turn or slide about any axis, with fixed joints between."""
    parts = ['<robot name="r"><link name="root"/>']
    for arm in arms:
        parent = "root"
        for k in range(joints):
            name = f"{arm}{k}"
            kind = rng.choice(["revolute", "revolute", "prismatic"])
            xyz, rpy = (" ".join(map(repr, rng.uniform(-1, 1, 3).tolist())) for _ in range(2))
            axis = rng.choice(AXES)
            bend = " ".join(map(repr, rng.uniform(-1, 1, 3).tolist()))
            parts.append(
                f'<link name="{name}_in"/><link name="{name}_out"/>'
                f'<joint name="{name}" type="{kind}"><parent link="{parent}"/>'
                f'<child link="{name}_in"/><origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>'
                f'<limit lower="-3" upper="3" velocity="1" effort="0"/></joint>'
                f'<joint name="{name}_bend" type="fixed"><parent link="{name}_in"/>'
                f'<child link="{name}_out"/><origin xyz="{bend}" rpy="{bend}"/></joint>'
            )
            parent = f"{name}_out"
    return "".join(parts) + "</robot>"


def with_robot(clean, urdf, arms, joints):
    """Returns a schedule of one knot for another robot, its joints in reverse order."""
    names = tuple(f"{arm}{k}" for arm in arms for k in range(joints))[::-1]
    zero = np.zeros((1, len(names)))
    robot = dataclasses.replace(
        clean.schedule.robot,
        urdf=urdf,
        base=pin.SE3.Random(),
        arms={arm: ScheduleArm(f"{arm}{joints - 1}_out", pin.SE3.Random()) for arm in arms},
    )
    trajectory = Trajectory(names, np.zeros(1), zero, zero, zero)
    return dataclasses.replace(clean.schedule, robot=robot, motion=JointMotion.of(trajectory))


@pytest.mark.parametrize("seed", range(20))
def test_tools_of_random_robots_are_where_pinocchio_puts_them(clean, seed):
    """Any axis, sliding joints, fixed joints, base, tool, order of columns: below 1e-13 m and rad."""
    rng = np.random.default_rng(seed)
    pin.seed(seed)
    arms, joints = ("left", "right"), int(rng.integers(1, 8))
    model = ToolModel(with_robot(clean, random_urdf(rng, arms, joints), arms, joints))
    q = rng.uniform(-3, 3, (25, 2 * joints))
    for arm in arms:
        R, p = model.poses(arm, q)
        expected = [model.pose(arm, row) for row in q]
        assert np.allclose(R, [pose.rotation for pose in expected], rtol=0, atol=1e-13)
        assert np.allclose(p, [pose.translation for pose in expected], rtol=1e-13, atol=1e-13)


def test_no_joint_vectors_have_no_poses(clean):
    """Arrays of length 0, not an error."""
    R, p = ToolModel(clean.schedule).poses("left", np.empty((0, 7)))
    assert (R.shape, p.shape) == ((0, 3, 3), (0, 3))


def test_joint_vectors_are_left_as_they_are(clean):
    """The sums are made in arrays of their own: the same twice, and the input is not written to."""
    model = ToolModel(clean.schedule)
    q = np.array(clean.schedule.trajectory.position)
    first, before = model.poses("left", q), q.copy()
    again = model.poses("left", q)
    assert np.array_equal(q, before)
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))


def test_a_joint_without_an_axis_is_bad_input_that_names_it(clean):
    """A matrix that is no rotation comes of it in pinocchio, without a word."""
    urdf = clean.schedule.robot.urdf
    at = urdf.index('name="l2"')
    broken = urdf[:at] + urdf[at:].replace('axis xyz="0 0 1"', 'axis xyz="0 0 0"', 1)
    schedule = dataclasses.replace(
        clean.schedule, robot=dataclasses.replace(clean.schedule.robot, urdf=broken)
    )
    with pytest.raises(InputError, match="joint 'l2' has an axis of length 0"):
        ToolModel(schedule)


def test_a_flange_that_is_no_text_to_pinocchio_is_bad_input(clean):
    """A lone surrogate, as JSON can spell it."""
    arms = {
        name: dataclasses.replace(arm, flange="\ud800")
        for name, arm in clean.schedule.robot.arms.items()
    }
    robot = dataclasses.replace(clean.schedule.robot, arms=arms)
    with pytest.raises(InputError, match="is not in the URDF"):
        ToolModel(dataclasses.replace(clean.schedule, robot=robot))
