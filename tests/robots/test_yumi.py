"""The ABB YuMi against published numbers (sources: robots/README.md)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.files.robots.robots import load_robot

Axes = Callable[[pin.Model, tuple[str, ...], np.ndarray], tuple[np.ndarray, ...]]
Normals = Callable[[np.ndarray, np.ndarray], np.ndarray]

# The maker's number of each joint from base to flange: lower, upper [deg], velocity [deg/s].
LIMITS = {
    1: (-168.5, 168.5, 180),
    2: (-143.5, 43.5, 180),
    7: (-168.5, 168.5, 180),
    3: (-123.5, 80.0, 180),
    4: (-290.0, 290.0, 400),
    5: (-88.0, 138.0, 400),
    6: (-229.0, 229.0, 400),
}
SIDES = ("left", "right")


def _joints(side: str) -> tuple[str, ...]:
    return tuple(f"{side}_{number}" for number in LIMITS)


def test_limits_are_the_published_ones_in_the_makers_order() -> None:
    """1, 2, 7, 3, 4, 5, 6 from base to flange; rates are assumed: top speed in 0.3 s."""
    robot = load_robot("yumi").robot
    assert [arm.joints for arm in robot.arms] == [_joints(side) for side in SIDES]
    assert [arm.kind for arm in robot.arms] == ["general", "general"]
    lower, upper, velocity = np.array(list(LIMITS.values())).T
    for arm in robot.arms:
        limits = robot.limits.select(arm.joints)
        np.testing.assert_allclose(limits.lower, np.radians(lower), rtol=1e-15)
        np.testing.assert_allclose(limits.upper, np.radians(upper), rtol=1e-15)
        np.testing.assert_allclose(limits.velocity, np.radians(velocity), rtol=1e-15)
        np.testing.assert_allclose(limits.velocity / limits.acceleration, 0.3, rtol=0.001)


@pytest.mark.parametrize("side", SIDES)
def test_consecutive_axes_are_as_far_apart_as_published(
    side: str, pin_model: Callable[[str], pin.Model], joint_axes: Axes, common_normals: Normals
) -> None:
    """30, 30, 40.5, 40.5, 27, 27 mm and at right angles, in any posture: no two axes meet."""
    model = pin_model("yumi")
    q = np.random.default_rng(5).uniform(model.lowerPositionLimit, model.upperPositionLimit)
    axes, points = joint_axes(model, _joints(side), q)
    feet = common_normals(axes, points)
    distances = np.linalg.norm(feet[:, 1] - feet[:, 0], axis=1)
    np.testing.assert_allclose(distances, [0.030, 0.030, 0.0405, 0.0405, 0.027, 0.027], atol=1e-12)
    assert np.abs((axes[:-1] * axes[1:]).sum(axis=1)).max() < 1e-12


@pytest.mark.parametrize("side", SIDES)
def test_links_are_as_long_as_the_single_arm_says(
    side: str, pin_model: Callable[[str], pin.Model], joint_axes: Axes, common_normals: Normals
) -> None:
    """Between the common normals along axes 7, 4 and 6: 251.5, 265 and 36 mm to 0.1 mm."""
    model = pin_model("yumi")
    q = np.zeros(model.nq)
    axes, points = joint_axes(model, _joints(side), q)
    feet = common_normals(axes, points)
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    flange = data.oMf[model.getFrameId(f"{side}_tool0")]
    ends = [feet[2, 0] - feet[1, 1], feet[4, 0] - feet[3, 1], flange.translation - feet[5, 1]]
    np.testing.assert_allclose(np.linalg.norm(ends, axis=1), [0.2515, 0.265, 0.036], atol=1e-4)
    np.testing.assert_allclose(flange.rotation[:, 2], axes[6], atol=1e-12)
    # The flange looks away from the wrist.
    assert ends[2] @ axes[6] > 0.0


def test_both_arms_are_the_same_arm_on_mirrored_mounts(
    pin_model: Callable[[str], pin.Model],
) -> None:
    """Mounted at (0.05355, +-0.0725, 0.41492); the published mounts are mirrored to 0.25 deg."""
    model = pin_model("yumi")
    data = model.createData()
    q = np.tile(np.random.default_rng(1).uniform(-1.0, 1.0, 7), 2)
    pin.framesForwardKinematics(model, data, q)
    flanges, mounts = [], []
    for side in SIDES:
        mounts.append(model.jointPlacements[model.getJointId(f"{side}_1")])
        flanges.append(mounts[-1].actInv(data.oMf[model.getFrameId(f"{side}_tool0")]))
    assert flanges[0].isApprox(flanges[1], 1e-12)
    np.testing.assert_array_equal(mounts[0].translation, [0.05355, 0.0725, 0.41492])
    np.testing.assert_array_equal(mounts[1].translation, [0.05355, -0.0725, 0.41492])
    mirror = np.diag([1.0, -1.0, 1.0])
    apart = pin.log3(mounts[1].rotation.T @ mirror @ mounts[0].rotation @ mirror)
    assert np.degrees(np.linalg.norm(apart)) < 0.25


def test_home_holds_both_tools_straight_down_in_front() -> None:
    """Flanges at (0.40, +-0.20, 0.15) m with rpy 180 deg, 0, 0 as near as 0.1 deg per joint."""
    robot = load_robot("yumi").robot
    model = pin.buildModelFromXML(robot.urdf)
    data = model.createData()
    q = np.array(robot.postures["home"])
    pin.framesForwardKinematics(model, data, q)
    for side, y in zip(SIDES, (0.2, -0.2), strict=True):
        flange = data.oMf[model.getFrameId(f"{side}_tool0")]
        np.testing.assert_allclose(flange.translation, [0.4, y, 0.15], rtol=0, atol=1e-3)
        np.testing.assert_allclose(flange.rotation, np.diag([1.0, -1.0, -1.0]), rtol=0, atol=2e-3)


def test_body_fills_what_was_measured(pin_model: Callable[[str], pin.Model]) -> None:
    """Both boxes together reach from (-0.361, -0.200, -0.100) to (0.135, 0.200, 0.471) m."""
    robot = load_robot("yumi").robot
    model = pin_model("yumi")
    shapes = pin.buildGeomFromUrdfString(model, robot.urdf, pin.GeometryType.COLLISION)
    corners = []
    for shape in shapes.geometryObjects:
        if shape.parentJoint == 0:
            half, centre = shape.geometry.halfSide, shape.placement.translation
            corners += [centre - half, centre + half]
    np.testing.assert_allclose(np.min(corners, axis=0), [-0.361, -0.2, -0.1], atol=1e-12)
    np.testing.assert_allclose(np.max(corners, axis=0), [0.135, 0.2, 0.471], atol=1e-12)


def test_no_mass_and_no_torque_is_claimed(pin_model: Callable[[str], pin.Model]) -> None:
    """The published description has placeholders only, so there are none here."""
    model = pin_model("yumi")
    assert all(inertia.mass == 0.0 for inertia in model.inertias)
    assert (model.effortLimit == 0.0).all()
