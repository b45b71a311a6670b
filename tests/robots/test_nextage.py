"""The Kawada Nextage Open against published numbers (sources: robots/README.md)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.files.robots.robots import load_robot

Axes = Callable[[pin.Model, tuple[str, ...], np.ndarray], tuple[np.ndarray, ...]]

# Left arm, joints 0 to 5: lower, upper [deg], velocity [deg/s]; mass of the link [kg].
LEFT = [
    (-88, 88, 172, 1.326),
    (-140, 60, 133, 1.149),
    (-158, 0, 215, 0.578),
    (-105, 165, 264, 0.457),
    (-100, 100, 224, 0.418),
    (-163, 163, 300, 1.052),
]
SIDES = {"left": 1.0, "right": -1.0}
# Joints 0, 3 and 5 turn about axes in the plane of symmetry or tilted with the shoulders.
MIRROR = np.array([-1.0, 1.0, 1.0, -1.0, 1.0, -1.0])


def _joints(side: str) -> tuple[str, ...]:
    return tuple(f"{side}_{number}" for number in range(6))


def _between(axes: np.ndarray, points: np.ndarray, first: int, second: int) -> float:
    """Returns the distance of two lines [m]."""
    across = np.cross(axes[first], axes[second])
    apart = points[second] - points[first]
    if np.linalg.norm(across) < 1e-9:
        return float(np.linalg.norm(np.cross(axes[first], apart)))
    return float(abs(apart @ across) / np.linalg.norm(across))


def test_limits_are_the_published_ones() -> None:
    """Chest 163 deg, 110 deg/s; joint 3 of the right arm is mirrored; top speed in 0.3 s."""
    robot = load_robot("nextage").robot
    assert robot.platform == ("chest",)
    chest = robot.limits.select(["chest"])
    np.testing.assert_allclose([*chest.lower, *chest.upper], np.radians([-163, 163]), rtol=1e-15)
    np.testing.assert_allclose(chest.velocity, np.radians(110), rtol=1e-15)
    for arm in robot.arms:
        assert arm.joints == _joints(arm.name)
        assert arm.kind == "general"
        lower, upper, velocity, _ = np.array(LEFT).T
        if arm.name == "right":
            lower, upper = (
                np.where(MIRROR < 0, -upper, lower),
                np.where(MIRROR < 0, -lower, upper),
            )
        limits = robot.limits.select(arm.joints)
        np.testing.assert_allclose(limits.lower, np.radians(lower), rtol=1e-15)
        np.testing.assert_allclose(limits.upper, np.radians(upper), rtol=1e-15)
        np.testing.assert_allclose(limits.velocity, np.radians(velocity), rtol=1e-15)
    np.testing.assert_allclose(robot.limits.velocity / robot.limits.acceleration, 0.3, rtol=0.001)


@pytest.mark.parametrize("side", SIDES)
def test_axes_are_as_far_apart_as_published(
    side: str, pin_model: Callable[[str], pin.Model], joint_axes: Axes
) -> None:
    """0-1 and 3-4 meet, 1-2 are parallel and 0.250 m apart, 2-3 0.030 m, 4-5 0.090 m."""
    model = pin_model("nextage")
    q = np.random.default_rng(4).uniform(model.lowerPositionLimit, model.upperPositionLimit)
    axes, points = joint_axes(model, _joints(side), q)
    found = [_between(axes, points, i, i + 1) for i in range(5)]
    np.testing.assert_allclose(found, [0.0, 0.250, 0.030, 0.0, 0.090], atol=1e-12)
    assert abs(axes[1] @ axes[2]) == pytest.approx(1.0, abs=1e-12)
    for i in (0, 2, 3, 4):
        assert abs(axes[i] @ axes[i + 1]) < 1e-12


@pytest.mark.parametrize("side", SIDES)
def test_shoulders_lean_outward_by_15_degrees(
    side: str, pin_model: Callable[[str], pin.Model], joint_axes: Axes
) -> None:
    """0.145 m to each side of the chest's axis and 0.370296 m above the waist, 0.97 m high."""
    model = pin_model("nextage")
    axes, points = joint_axes(model, ("chest", *_joints(side)), np.zeros(model.nq))
    np.testing.assert_allclose(points[0], [0.0, 0.0, 0.97], atol=1e-12)
    np.testing.assert_allclose(points[1], [0.0, SIDES[side] * 0.145, 0.97 + 0.370296], atol=1e-12)
    tilt = np.degrees(np.arctan2(SIDES[side] * axes[1, 1], axes[1, 2]))
    # 15 deg are published as 0.261799 rad.
    assert tilt == pytest.approx(15.0, abs=5e-5)


@pytest.mark.parametrize("side", SIDES)
def test_forearm_is_0_235_m_long_behind_the_elbows_offset(
    side: str, pin_model: Callable[[str], pin.Model]
) -> None:
    """Joint 4 lies 0.235 m below and 0.030 m behind joint 2, the flange 0.047 m before joint 4."""
    model = pin_model("nextage")
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.zeros(model.nq))
    elbow = data.oMi[model.getJointId(f"{side}_2")]
    wrist = data.oMi[model.getJointId(f"{side}_4")]
    flange = data.oMf[model.getFrameId(f"{side}_tool0")]
    np.testing.assert_allclose(elbow.actInv(wrist.translation), [-0.03, 0, -0.235], atol=1e-12)
    np.testing.assert_allclose(wrist.actInv(flange.translation), [-0.047, 0, -0.09], atol=1e-12)
    # The flange's z axis is joint 5's axis and looks backward while the arm hangs.
    np.testing.assert_allclose(flange.rotation[:, 2], [-1.0, 0.0, 0.0], atol=1e-12)


def test_right_arm_is_the_mirrored_left_arm(pin_model: Callable[[str], pin.Model]) -> None:
    """Mirrored joints hold the right flange at the mirrored place, 50 random postures."""
    model = pin_model("nextage")
    data = model.createData()
    rng = np.random.default_rng(8)
    mirror = np.diag([1.0, -1.0, 1.0])
    for _ in range(50):
        left = rng.uniform(model.lowerPositionLimit[1:7], model.upperPositionLimit[1:7])
        pin.framesForwardKinematics(model, data, np.concatenate([[0.0], left, MIRROR * left]))
        one, other = (data.oMf[model.getFrameId(f"{side}_tool0")] for side in SIDES)
        np.testing.assert_allclose(other.translation, mirror @ one.translation, atol=1e-12)
        np.testing.assert_allclose(other.rotation, mirror @ one.rotation @ mirror, atol=1e-12)


def test_home_holds_both_tools_straight_down_in_front() -> None:
    """Flanges at (0.35, +-0.20, 1.10) m with rpy 180 deg, 0, 0 as near as 0.1 deg per joint."""
    robot = load_robot("nextage").robot
    model = pin.buildModelFromXML(robot.urdf)
    data = model.createData()
    q = np.array(robot.postures["home"])
    pin.framesForwardKinematics(model, data, q)
    for side, sign in SIDES.items():
        flange = data.oMf[model.getFrameId(f"{side}_tool0")]
        np.testing.assert_allclose(flange.translation, [0.35, sign * 0.2, 1.1], rtol=0, atol=1e-3)
        np.testing.assert_allclose(flange.rotation, np.diag([1.0, -1.0, -1.0]), rtol=0, atol=2e-3)
    left, right = (q[robot.columns(arm.joints)] for arm in robot.arms)
    np.testing.assert_array_equal(right, MIRROR * left)
    assert q[robot.joints.index("chest")] == 0.0


def test_arms_weigh_what_is_published_and_the_chest_is_not_known(
    pin_model: Callable[[str], pin.Model],
) -> None:
    """4.980 kg per arm: 1.326 + 1.149 + 0.578 + 0.457 + 0.418 + 1.052; no torque is known."""
    model = pin_model("nextage")
    masses = [inertia.mass for inertia in model.inertias]
    assert masses == pytest.approx([0.0, 0.0, *([row[3] for row in LEFT] * 2)])
    assert (model.effortLimit == 0.0).all()
