"""General arms against pinocchio: forward kinematics and Jacobians."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.errors import UnsupportedError
from dualarm_cli.kinematics.general_arm import GeneralArm
from dualarm_cli.kinematics.serial_chain import pose_error

BASE = pin.SE3(pin.rpy.rpyToMatrix(0.4, -0.3, 1.1), np.array([0.3, -0.2, 0.7]))


def measured(general_robots, name, side):
    """One arm in a carried frame that is neither the root nor parallel to it."""
    robot = general_robots.ROBOTS[name]
    model = pin.buildModelFromXML(robot.urdf)
    joints = [f"{side}_j{k}" for k in range(1, len(robot.home[side]) + 1)]
    columns = [model.idx_qs[model.getJointId(joint)] for joint in joints]
    limits = model.lowerPositionLimit[columns], model.upperPositionLimit[columns]
    return model, columns, GeneralArm.from_model(model, joints, f"{side}_flange", BASE, limits)


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("name", ["yumi", "nextage", "spherical"])
def test_forward_and_jacobian_are_pinocchios(general_robots, name, side):
    """At 100 random postures, whatever the axes of the joints are called; the base moves with the carried frame."""
    model, columns, arm = measured(general_robots, name, side)
    rng = np.random.default_rng(3)
    q = rng.uniform(arm.lower, arm.upper, (100, arm.axes))
    R, p = arm.forward(q)
    J = arm.jacobian(q)
    data, frame = model.createData(), model.getFrameId(f"{side}_flange")
    for k in range(len(q)):
        position = pin.neutral(model)
        position[columns] = q[k]
        pin.framesForwardKinematics(model, data, position)
        expected = BASE * data.oMf[frame]
        assert np.abs(R[k] - expected.rotation).max() < 1e-12
        assert np.abs(p[k] - expected.translation).max() < 1e-12
        world = pin.computeFrameJacobian(model, data, position, frame, pin.LOCAL_WORLD_ALIGNED)
        own = world[:, [model.idx_vs[model.getJointId(model.names[i + 1])] for i in columns]]
        turned = np.vstack([BASE.rotation @ own[:3], BASE.rotation @ own[3:]])
        assert np.abs(J[k] - turned).max() < 1e-12


def test_shapes_of_any_dimension_are_kept(general_robots):
    """Postures (2, 3, n) have poses (2, 3, ...), each as if it were alone."""
    _, _, arm = measured(general_robots, "yumi", "left")
    q = np.random.default_rng(0).uniform(-1, 1, (2, 3, 7))
    R, p = arm.forward(q)
    assert (R.shape, p.shape, arm.jacobian(q).shape) == ((2, 3, 3, 3), (2, 3, 3), (2, 3, 6, 7))
    assert np.array_equal(p[1, 2], arm.forward(q[1, 2])[1])


def test_the_second_joint_is_on_an_arc_about_the_first_one(general_robots):
    """Against the nearest of many positions of joint 1, the second one off its axis in both directions."""
    _, _, arm = measured(general_robots, "yumi", "left")
    p_parent_joint, lower, upper = (
        np.array(values) for values in (arm.p_parent_joint, arm.lower, arm.upper)
    )
    p_parent_joint[1] = [-0.03, 0.05, 0.1]
    lower[0], upper[0] = 0.2, 1.4
    arm = replace(arm, p_parent_joint=p_parent_joint, lower=lower, upper=upper)
    points = np.random.default_rng(5).uniform(-0.5, 0.5, (200, 3)) + p_parent_joint[0]
    turns = np.array([pin.utils.rotate("z", q) for q in np.linspace(0.2, 1.4, 4001)])
    arc = p_parent_joint[0] + turns @ p_parent_joint[1] @ arm.R_parent_joint[0].T
    nearest = np.sqrt(((points[:, None] - arc) ** 2).sum(axis=-1)).min(axis=1)
    assert np.abs(arm._distance_to_second(points) - nearest).max() < 1e-5


@pytest.mark.parametrize("name", ["yumi", "nextage", "spherical"])
def test_the_reach_is_that_of_the_stretched_arm(general_robots, name):
    """Whatever the places of the joints' origins along their axes; as far as the farthest of random postures."""
    _, _, arm = measured(general_robots, name, "left")
    rng = np.random.default_rng(7)
    q = rng.uniform(-np.pi, np.pi, (20_000, arm.axes))
    p = arm.forward(q)[1]
    farthest = np.linalg.norm(p - arm.p_parent_joint[0], axis=1).max()
    assert farthest <= arm.reach <= 1.03 * farthest
    moved, up = rng.uniform(-0.5, 0.5, arm.axes), np.array([0.0, 0.0, 1.0])
    moved[0] = 0.0
    steps = arm.p_parent_joint + moved[:, None] * arm.R_parent_joint[:, :, 2]
    steps[1:] -= moved[:-1, None] * up
    same = replace(arm, p_parent_joint=steps, p_last_flange=arm.p_last_flange - moved[-1] * up)
    np.testing.assert_allclose(same.forward(q[:100])[1], p[:100], atol=1e-12)
    assert same.reach == pytest.approx(arm.reach, rel=2e-3)


def test_a_pose_error_is_the_rotation_vector_between_rotations():
    """Against pinocchio's logarithm, up to nearly half a turn."""
    rng = np.random.default_rng(1)
    for size in (1e-9, 0.1, 3.0, np.pi - 1e-4):
        axis = rng.normal(size=3)
        vector = size * axis / np.linalg.norm(axis)
        R = pin.rpy.rpyToMatrix(*rng.uniform(-1, 1, 3))
        found = pose_error(R[None], np.zeros((1, 3)), (pin.exp3(vector) @ R)[None], np.ones((1, 3)))
        assert np.allclose(found[0, 3:], vector, atol=1e-11)
        assert np.array_equal(found[0, :3], np.ones(3))


def test_the_wrist_gap_is_what_the_numbers_say(general_robots):
    """0 for a spherical wrist, 45 mm on the Nextage.

    There axes 5 (y) and 6 (x) pass at 90 mm, and 4 (z) meets both: the point half way between is 45 mm from 5 and 6.
    """
    assert measured(general_robots, "spherical", "left")[2].wrist_gap < 1e-15
    assert measured(general_robots, "nextage", "left")[2].wrist_gap == pytest.approx(
        0.045, abs=1e-9
    )


def test_five_joints_are_refused(general_robots):
    """With the reason."""
    model, _, arm = measured(general_robots, "spherical", "left")
    five = [f"left_j{k}" for k in range(1, 6)]
    with pytest.raises(UnsupportedError, match="5 joints; 6 are needed"):
        GeneralArm.from_model(model, five, "left_flange", BASE, (arm.lower[:5], arm.upper[:5]))
