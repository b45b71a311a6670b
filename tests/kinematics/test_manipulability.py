"""Manipulability with gradient and rate: finite differences, pinocchio's kinematic Hessians, products of arms."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.files.robots.robots import load_robot
from dualarm_cli.kinematics.manipulability import (
    manipulability,
    manipulability_rates,
)
from dualarm_cli.kinematics.whole_body import WholeBody, bracket
from dualarm_cli.model.cell import Cell, Tool

STEP = 1e-5


def generalized_jacobian(J: np.ndarray) -> np.ndarray:
    """J_G of [J_R; J_L]: the mean of both tools' motions, then right minus left ([Zhang2024] Eq. 4-6)."""
    return np.vstack([(J[:6] + J[6:]) / 2.0, J[:6] - J[6:]])


def body_of(name: str) -> tuple[WholeBody, Cell]:
    """A robot with tools that stick out."""
    robot = load_robot(name).robot
    tool = Tool(pin.SE3(pin.rpy.rpyToMatrix(0.2, 0.1, -0.4), np.array([0.02, 0.03, 0.12])))
    cell = Cell(robot, pin.SE3.Identity(), {arm.name: tool for arm in robot.arms})
    return WholeBody(cell), cell


def postures(cell: Cell, count: int, seed: int) -> np.ndarray:
    """Random configurations in the middle 80 % of the joints' ranges."""
    low, high = cell.robot.limits.lower, cell.robot.limits.upper
    share = np.random.default_rng(seed).uniform(0.1, 0.9, (count, len(low)))
    return low + share * (high - low)


@pytest.mark.parametrize("name", ["openarm", "sda10f", "yumi", "nextage"])
def test_gradient_and_rate_are_finite_differences(name: str) -> None:
    """D log M / dq by differences of log det at the tools, and its rate by differences of the gradient."""
    body, cell = body_of(name)
    random = np.random.default_rng(0)
    for q in postures(cell, 4, 1):
        qd = random.normal(size=len(q))
        found = manipulability_rates(body, body.at(q).S, qd)
        slope = [
            np.log(
                manipulability(body.at(q + STEP * e).J) / manipulability(body.at(q - STEP * e).J)
            )
            / (2 * STEP)
            for e in np.eye(len(q))
        ]
        scale = max(1.0, float(np.abs(found.gradient).max()))
        np.testing.assert_allclose(found.gradient, slope, atol=1e-6 * scale**2)
        ahead, behind = (
            manipulability_rates(body, body.at(q + s * STEP * qd).S, qd).gradient for s in (1, -1)
        )
        rate = (ahead - behind) / (2 * STEP)
        np.testing.assert_allclose(found.rate, rate, atol=1e-5 * max(1.0, np.abs(rate).max()))


@pytest.mark.parametrize("name", ["openarm", "sda10f"])
def test_brackets_are_pinocchios_kinematic_hessian(name: str) -> None:
    """The world-frame Hessian of each arm's last joint; pinocchio 4.1 hands it over in another memory order."""
    body, cell = body_of(name)
    model = pin.buildModelFromXML(cell.robot.urdf)
    data, nv = model.createData(), model.nv
    order = [cell.robot.joints.index(joint) for joint in list(model.names)[1:]]
    for q in postures(cell, 2, 2):
        pin.computeJointJacobians(model, data, q[order])
        pin.computeForwardKinematicsDerivatives(model, data, q[order], np.zeros(nv), np.zeros(nv))
        pin.computeJointKinematicHessians(model, data)
        S = body.at(q).S
        ours = body.before[:, :, None] * bracket(S[:, None], S[None])
        for arm in cell.robot.arms:
            last = model.getJointId(arm.joints[-1])
            H = pin.getJointKinematicHessian(model, data, last, pin.WORLD)
            H = H.ravel("C").reshape((6, nv, nv), order="F")
            chain = [i - 1 for i in list(model.supports[last])[1:]]
            for j in chain:
                for i in chain:
                    expected = H[:, j, i]
                    found = ours[order[i], order[j]]
                    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_independent_arms_multiply() -> None:
    """M_G = M_R M_L to 1e-12 on a fixed base; J_G is the stacked Jacobian times a matrix of determinant 1."""
    body, cell = body_of("openarm")
    left, right = (cell.robot.columns(arm.joints) for arm in cell.robot.arms)
    for q in postures(cell, 50, 3):
        J = body.at(q).J
        J_G = generalized_jacobian(np.vstack([J[6:], J[:6]]))
        product = manipulability(J[:6][:, left]) * manipulability(J[6:][:, right])
        assert manipulability(J_G) == pytest.approx(product, rel=1e-10, abs=1e-12)
        assert manipulability(J) == pytest.approx(product, rel=1e-10, abs=1e-12)


def test_arms_on_one_platform_do_not_multiply() -> None:
    """With a shared platform M of both tools is not the product of the arms' own."""
    body, cell = body_of("sda10f")
    left, right = (cell.robot.columns(arm.joints) for arm in cell.robot.arms)
    q = postures(cell, 1, 4)[0]
    J = body.at(q).J
    product = manipulability(J[:6][:, left]) * manipulability(J[6:][:, right])
    assert manipulability(J) > 1.01 * product
