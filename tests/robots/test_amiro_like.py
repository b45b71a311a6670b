"""The robot after the AMIRO of [Choi2020]: what is published, and what was asked of the rest."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.files.robots.robots import load_robot
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.cell import Cell, Tool
from dualarm_cli.model.robot import Robot

Axes = Callable[[pin.Model, tuple[str, ...], np.ndarray], tuple[np.ndarray, ...]]

SIDES = {"left": 1.0, "right": -1.0}
# Joints l, e, r, t turn about axes in the plane of symmetry; mirroring turns their sign.
MIRROR = np.array([1.0, -1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
# Tool forward (z along x), its x axis down.
FORWARD = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
CENTRE = {side: np.array([0.42, sign * 0.22, 1.05]) for side, sign in SIDES.items()}
RADIUS = 0.10


@pytest.fixture(scope="module")
def robot() -> Robot:
    """The bundled robot."""
    return load_robot("amiro_like").robot


def _circle(side: str) -> np.ndarray:
    """Returns 36 points of the vertical circle across the forward direction, shape (36, 3)."""
    turn = np.linspace(0.0, 2.0 * np.pi, 36, endpoint=False)
    around = np.column_stack([np.zeros(36), np.cos(turn), np.sin(turn)])
    points: np.ndarray = CENTRE[side] + RADIUS * around
    return points


def test_lengths_are_the_published_ones(
    pin_model: Callable[[str], pin.Model], joint_axes: Axes
) -> None:
    """0.700 m from shoulder to wrist with the arm straight, 0.570 m from pitch axis to shoulder."""
    model = pin_model("amiro_like")
    q = np.zeros(model.nq)
    # Waist and upper arm anywhere: neither length may change.
    q[[0, 1, 2, 3, 4]] = [0.7, 0.5, -1.0, 0.4, 0.3]
    axes, points = joint_axes(model, ("waist_pitch", "left_s", "left_b", "right_s", "right_b"), q)
    for shoulder, wrist in ((1, 2), (3, 4)):
        assert np.linalg.norm(points[wrist] - points[shoulder]) == pytest.approx(0.700, abs=1e-12)
        across = np.cross(axes[0], points[shoulder] - points[0])
        assert np.linalg.norm(across) == pytest.approx(0.570, abs=1e-12)


def test_waist_turns_first_and_then_bends_forward(
    robot: Robot, pin_model: Callable[[str], pin.Model], joint_axes: Axes
) -> None:
    """Two joints carry the arms: yaw about z, pitch about y, positive forward."""
    assert robot.platform == ("waist_yaw", "waist_pitch")
    model = pin_model("amiro_like")
    axes, _ = joint_axes(model, robot.platform, np.zeros(model.nq))
    np.testing.assert_allclose(axes, [[0, 0, 1], [0, 1, 0]], atol=1e-15)
    q = np.zeros(model.nq)
    q[1] = np.radians(30.0)
    _, points = joint_axes(model, ("left_s",), q)
    # 0.570 m lean forward by half of it, from a pitch axis 0.75 m high.
    np.testing.assert_allclose(
        points[0], [0.285, 0.22, 0.75 + 0.570 * np.sqrt(0.75)], rtol=0, atol=1e-12
    )


def test_masses_are_the_published_ones(pin_model: Callable[[str], pin.Model]) -> None:
    """14.5 kg per arm and 14.0 kg body [Choi2020, Table 1]."""
    model = pin_model("amiro_like")
    masses = {name: inertia.mass for name, inertia in zip(model.names, model.inertias, strict=True)}
    for side in SIDES:
        assert sum(masses[f"{side}_{key}"] for key in "sleurbt") == pytest.approx(14.5, abs=1e-12)
    assert masses["waist_yaw"] + masses["waist_pitch"] == pytest.approx(14.0, abs=1e-12)


def test_arms_are_mirrored_and_rates_assumed(robot: Robot) -> None:
    """Ranges of the right arm are the left arm's, mirrored; top speed in 0.3 s."""
    left, right = (robot.limits.select(arm.joints) for arm in robot.arms)
    np.testing.assert_array_equal(right.lower, np.where(MIRROR < 0, -left.upper, left.lower))
    np.testing.assert_array_equal(right.upper, np.where(MIRROR < 0, -left.lower, left.upper))
    np.testing.assert_array_equal(right.velocity, left.velocity)
    np.testing.assert_allclose(robot.limits.velocity / robot.limits.acceleration, 0.3, rtol=0.001)


def test_home_holds_both_tools_forward(robot: Robot) -> None:
    """Flanges at (0.42, +-0.22, 1.05) m with rpy 0, 90 deg, 0 as near as 0.1 deg per joint."""
    model = pin.buildModelFromXML(robot.urdf)
    data = model.createData()
    q = np.array(robot.postures["home"])
    pin.framesForwardKinematics(model, data, q)
    for side, centre in CENTRE.items():
        flange = data.oMf[model.getFrameId(f"{side}_tool0")]
        np.testing.assert_allclose(flange.translation, centre, rtol=0, atol=1e-3)
        np.testing.assert_allclose(flange.rotation, FORWARD, rtol=0, atol=2e-3)
    left, right = (q[robot.columns(arm.joints)] for arm in robot.arms)
    np.testing.assert_array_equal(right, MIRROR * left)
    assert (q[robot.columns(robot.platform)] == 0.0).all()


@pytest.mark.parametrize("side", SIDES)
def test_tool_can_follow_a_circle_of_radius_100_mm_around_home(side: str, robot: Robot) -> None:
    """Damped least squares from home round the circle and back: small steps, 15 deg of room."""
    model = pin.buildModelFromXML(robot.urdf)
    data = model.createData()
    q = np.array(robot.postures["home"])
    arm = next(arm for arm in robot.arms if arm.name == side)
    columns, frame = robot.columns(arm.joints), model.getFrameId(arm.flange)
    limits = robot.limits.select(arm.joints)
    for point in [*_circle(side), *_circle(side)[:1]]:
        before, target = q[columns], pin.SE3(FORWARD, point)
        for _ in range(30):
            pin.framesForwardKinematics(model, data, q)
            error = pin.log6(data.oMf[frame].actInv(target)).vector
            if np.linalg.norm(error) < 1e-10:
                break
            J = pin.computeFrameJacobian(model, data, q, frame)[:, columns]
            q[columns] += J.T @ np.linalg.solve(J @ J.T + 1e-8 * np.eye(6), error)
        assert np.linalg.norm(error) < 1e-10
        assert np.abs(q[columns] - before).max() < np.radians(25.0)
        room = np.minimum(q[columns] - limits.lower, limits.upper - q[columns])
        assert room.min() > np.radians(15.0)


@pytest.mark.parametrize("side", SIDES)
def test_elbow_is_free_all_around_the_circle(side: str, robot: Robot) -> None:
    """More than 90 deg of arm angles, in one branch, are within limits at every point of it."""
    cell = Cell(
        robot, pin.SE3.Identity(), {arm.name: Tool(pin.SE3.Identity()) for arm in robot.arms}
    )
    model = CellModel.from_cell(cell)
    home = np.array(robot.postures["home"])
    arm = model.arms[side].kinematics
    R_world, p_world = model.carried_frame(home)
    p = (_circle(side) - p_world) @ R_world
    psi = np.radians(np.arange(-180.0, 180.0))
    branch = arm.branch(home[model.arms[side].columns])
    q, reachable = arm.solve_branch(R_world.T @ FORWARD, p[:, None], psi, branch)
    within = np.all(arm.within_limits(q) & reachable, axis=0)
    assert within.sum() > 90
    # And home's own arm angle is one of them, well inside.
    index = int(np.degrees(arm.arm_angle(home[model.arms[side].columns])) + 180.0)
    assert within[(index + np.arange(-15, 16)) % 360].all()
