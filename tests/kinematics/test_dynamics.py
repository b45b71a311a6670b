"""Mass matrix and torques against pinocchio's recursive Newton-Euler algorithm."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from dualarm_cli.files.robots.robots import load_robot
from dualarm_cli.kinematics.dynamics import Dynamics
from dualarm_cli.model.cell import Cell, Tool


def test_mass_matrix_and_rest_are_newton_eulers_torques() -> None:
    """M a + h = rnea(q, v, a) at random states, with a tool's mass and a base that is tilted."""
    robot = load_robot("openarm").robot
    base = pin.SE3(pin.rpy.rpyToMatrix(0.3, -0.2, 0.5), np.array([0.1, 0.2, 0.3]))
    weight = pin.Inertia(0.8, np.array([0.01, 0.0, 0.1]), 0.01 * np.eye(3))
    tool = Tool(pin.SE3.Identity(), weight)
    dynamics = Dynamics(Cell(robot, base, {arm.name: tool for arm in robot.arms}), {})
    model = pin.buildModelFromXML(robot.urdf)
    # Gravity as the tilted base sees it.
    model.gravity.linear = base.rotation.T @ np.array([0.0, 0.0, -9.81])
    for arm in robot.arms:
        frame = model.frames[model.getFrameId(arm.flange)]
        model.appendBodyToJoint(frame.parentJoint, weight, frame.placement)
    data = model.createData()
    order = [robot.joints.index(joint) for joint in list(model.names)[1:]]
    random = np.random.default_rng(0)
    for _ in range(5):
        q = random.uniform(robot.limits.lower, robot.limits.upper)
        v, a = random.normal(size=(2, len(q)))
        M, rest = dynamics.at(q, v)
        expected = np.empty(len(q))
        expected[order] = pin.rnea(model, data, q[order], v[order], a[order])
        np.testing.assert_allclose(M @ a + rest, expected, atol=1e-9)
        np.testing.assert_allclose(M, M.T, atol=1e-12)


def test_a_robot_without_torque_limits_says_so_for_every_joint() -> None:
    """The SDA10F's URDF has effort 0 throughout, the OpenArm's has all of them."""
    for name, unknown in (("sda10f", 15), ("openarm", 0)):
        robot = load_robot(name).robot
        tools = {arm.name: Tool(pin.SE3.Identity()) for arm in robot.arms}
        assert len(Dynamics(Cell(robot, pin.SE3.Identity(), tools)).unknown) == unknown
