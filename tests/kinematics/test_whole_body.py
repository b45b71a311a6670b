"""Tools, elbows, carried points, screws and drift of a whole body, against finite differences and pinocchio."""

from __future__ import annotations

import dataclasses

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.files.robots.robots import load_robot
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinematics.dynamics import JointCoordinates
from dualarm_cli.kinematics.whole_body import (
    WholeBody,
    bracket,
    cobracket,
    screw_rates,
    tool_drift,
)
from dualarm_cli.model.cell import Cell, Tool

STEP = 1e-6
NAMES = ("sda10f", "amiro_like", "nextage")


def cell_of(name: str) -> Cell:
    """A robot on a base that is turned and moved, with tools that stick out."""
    robot = load_robot(name).robot
    base = pin.SE3(pin.rpy.rpyToMatrix(0.1, -0.2, 0.3), np.array([0.4, -0.1, 0.2]))
    tool = Tool(pin.SE3(pin.rpy.rpyToMatrix(0.2, 0.1, -0.4), np.array([0.02, 0.03, 0.12])))
    return Cell(robot, base, {arm.name: tool for arm in robot.arms})


@pytest.mark.parametrize("name", NAMES)
def test_no_sine_is_left_to_pinocchio(name: str) -> None:
    """All joints of these robots turn: each has two coordinates, whose squares sum to 1."""
    robot = load_robot(name).robot
    coordinates = JointCoordinates(robot)
    q = np.random.default_rng(5).uniform(-3.0, 3.0, len(robot.joints))
    assert coordinates.model.nq == 2 * len(q)
    pairs = coordinates.of(q).reshape(-1, 2)
    np.testing.assert_allclose(np.arctan2(pairs[:, 1], pairs[:, 0])[coordinates.back], q)
    np.testing.assert_allclose((pairs * pairs).sum(axis=1), 1.0)


@pytest.mark.parametrize("name", NAMES)
def test_jacobians_are_finite_differences(name: str) -> None:
    """Tools (linear and angular), elbows, and points that the platform carries, at random configurations."""
    cell = cell_of(name)
    body, limits = WholeBody(cell), cell.robot.limits
    random = np.random.default_rng(0)
    points = np.array([[0.3, 0.1, -0.2], [0.0, -0.3, 0.1]])
    for _ in range(4):
        q = random.uniform(limits.lower, limits.upper)
        here = body.at(q)
        J_elbow, (_, J_points) = body.elbow_jacobian(here), body.carried_points(here, points)
        for joint in range(len(q)):
            change = np.zeros(len(q))
            change[joint] = STEP
            after, before = body.at(q + change), body.at(q - change)
            for a in range(2):
                rows = here.J[6 * a : 6 * a + 6, joint]
                slope = (after.p[a] - before.p[a]) / (2 * STEP)
                turn = pin.log3(after.R[a] @ before.R[a].T) / (2 * STEP)
                np.testing.assert_allclose(rows, np.concatenate([slope, turn]), atol=1e-8)
                slope = (after.elbow[a] - before.elbow[a]) / (2 * STEP)
                np.testing.assert_allclose(J_elbow[a, :, joint], slope, atol=1e-8)
            there, back = (body.carried_points(state, points)[0] for state in (after, before))
            np.testing.assert_allclose(
                J_points[:, :, joint], (there - back) / (2 * STEP), atol=1e-8
            )


@pytest.mark.parametrize("name", NAMES)
def test_tools_are_where_pinocchio_has_them(name: str) -> None:
    """Base, flange and tool composed from pinocchio's own frame placements."""
    cell = cell_of(name)
    body = WholeBody(cell)
    model = pin.buildModelFromXML(cell.robot.urdf)
    data = model.createData()
    random = np.random.default_rng(1)
    for _ in range(5):
        q = random.uniform(cell.robot.limits.lower, cell.robot.limits.upper)
        order = [cell.robot.joints.index(joint) for joint in list(model.names)[1:]]
        pin.framesForwardKinematics(model, data, q[order])
        state, (R, p) = body.at(q), body.tools(q)
        for a, arm in enumerate(cell.robot.arms):
            expected = cell.base * data.oMf[model.getFrameId(arm.flange)] * cell.tools[arm.name].tcp
            np.testing.assert_allclose(state.p[a], expected.translation, atol=1e-12)
            np.testing.assert_allclose(state.R[a], expected.rotation, atol=1e-12)
            np.testing.assert_allclose(p[a], expected.translation, atol=1e-12)
            np.testing.assert_allclose(R[a], expected.rotation, atol=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_drift_and_screw_rates_are_derivatives_along_a_motion(name: str) -> None:
    """dJ/dt qd and dS/dt by central differences along a random velocity."""
    cell = cell_of(name)
    body, limits = WholeBody(cell), cell.robot.limits
    random = np.random.default_rng(2)
    for _ in range(4):
        q = random.uniform(limits.lower, limits.upper)
        qd = random.normal(size=len(q))
        here, after, before = body.at(q), body.at(q + STEP * qd), body.at(q - STEP * qd)
        drift = (after.J - before.J) / (2 * STEP) @ qd
        found = tool_drift(here.S, here.p, body.moves, body.before, qd)
        np.testing.assert_allclose(found, drift, atol=1e-7)
        rates = (after.S - before.S) / (2 * STEP)
        np.testing.assert_allclose(screw_rates(here.S, body.before, qd), rates, atol=1e-7)


def test_the_cobracket_is_the_transpose_of_the_bracket() -> None:
    """Y . ad(x)^T z = z . [x, y] for random screws, and [x, x] = 0."""
    x, y, z = np.random.default_rng(3).normal(size=(3, 50, 6))
    left, right = (z * bracket(x, y)).sum(axis=1), (y * cobracket(x, z)).sum(axis=1)
    np.testing.assert_allclose(left, right, atol=1e-12)
    np.testing.assert_allclose(bracket(x, x), 0.0, atol=1e-12)


def test_an_idle_arm_moves_no_other_tool(tasks_folder) -> None:
    """On a turning platform the platform moves both tools, an arm's joints its own alone."""
    cell = load_job(tasks_folder / "04_packing" / "tasks.yaml").cell
    body = WholeBody(cell)
    platform = cell.robot.columns(cell.robot.platform)
    left, right = (cell.robot.columns(arm.joints) for arm in cell.robot.arms)
    assert body.moves[:, platform].all()
    assert body.moves[0, left].all() and not body.moves[0, right].any()
    assert body.moves[1, right].all() and not body.moves[1, left].any()


def test_shoulders_of_the_amiro_like_robot_are_the_published_lengths_apart() -> None:
    """570 mm from waist pitch axis to shoulder, 350 mm (half of 700 mm) upper arm; Choi et al. Table 1."""
    robot = load_robot("amiro_like").robot
    cell = Cell(
        robot, pin.SE3.Identity(), {arm.name: Tool(pin.SE3.Identity()) for arm in robot.arms}
    )
    places, upper = WholeBody(cell).shoulders()
    np.testing.assert_allclose(places[:, 2], 0.570, atol=1e-9)
    np.testing.assert_allclose(upper, 0.350, atol=1e-9)
    assert dataclasses.is_dataclass(cell)
