"""The robots without a platform (KUKA iiwa 7 and 14, OpenArm) against published numbers."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.files.robots.robots import load_robot

IIWA_RANGE = [170, 120, 170, 120, 170, 120, 175]
IIWA_VELOCITY = {
    "iiwa14": [85, 85, 100, 75, 130, 135, 135],
    "iiwa7": [98, 98, 100, 130, 140, 180, 180],
}
IIWA_HEIGHT = {"iiwa14": 0.360 + 0.420 + 0.400 + 0.126, "iiwa7": 0.340 + 0.400 + 0.400 + 0.126}

OPENARM_RIGHT = [
    (-1.396, 3.491),
    (-0.1745, 3.316),
    (-1.571, 1.571),
    (0.0, 2.443),
    (-1.571, 1.571),
    (-0.785, 0.785),
    (-1.571, 1.571),
]
OPENARM_VELOCITY = [16.75, 16.75, 5.45, 5.45, 20.94, 20.94, 20.94]


@pytest.mark.parametrize("name", IIWA_VELOCITY)
def test_iiwa_limits_are_the_published_ones(name: str) -> None:
    """Ranges and velocities in deg and deg/s; accelerations are assumed: top speed in 0.3 s."""
    robot = load_robot(name).robot
    np.testing.assert_allclose(robot.limits.upper, np.radians(IIWA_RANGE), rtol=1e-15)
    np.testing.assert_allclose(robot.limits.lower, -np.radians(IIWA_RANGE), rtol=1e-15)
    np.testing.assert_allclose(robot.limits.velocity, np.radians(IIWA_VELOCITY[name]), rtol=1e-15)
    np.testing.assert_allclose(robot.limits.velocity / robot.limits.acceleration, 0.3, rtol=0.002)


@pytest.mark.parametrize("name", IIWA_HEIGHT)
def test_iiwa_stands_upright_at_zero(name: str, pin_model: Callable[[str], pin.Model]) -> None:
    """The flange is as high as the links are long, its frame parallel to the base's."""
    model = pin_model(name)
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.zeros(7))
    flange = data.oMf[model.getFrameId("flange")]
    np.testing.assert_allclose(flange.translation, [0.0, 0.0, IIWA_HEIGHT[name]], atol=1e-15)
    np.testing.assert_allclose(flange.rotation, np.eye(3), atol=1e-15)


@pytest.mark.parametrize("name", IIWA_HEIGHT)
def test_iiwa_joints_2_4_6_turn_about_y_minus_y_y(
    name: str, pin_model: Callable[[str], pin.Model]
) -> None:
    """Signs of KUKA's axes: joint 2 leans the arm along +x, joint 4 counts the other way."""
    model = pin_model(name)
    data = model.createData()
    height = 0.36 if name == "iiwa14" else 0.34
    # Joint 2 forward 90 deg and joint 4 forward (negative) 90 deg: the forearm points down.
    q = np.radians([0, 90, 0, -90, 0, 0, 0])
    pin.framesForwardKinematics(model, data, q)
    upper, rest = (0.42, 0.526) if name == "iiwa14" else (0.4, 0.526)
    flange = data.oMf[model.getFrameId("flange")]
    np.testing.assert_allclose(flange.translation, [upper, 0.0, height - rest], atol=1e-12)


@pytest.mark.parametrize("name", IIWA_HEIGHT)
def test_iiwa_home_points_the_tool_down(name: str, pin_model: Callable[[str], pin.Model]) -> None:
    """30 deg forward, 90 deg more at the elbow, 60 deg at the wrist: half a turn in all."""
    model = pin_model(name)
    data = model.createData()
    home = np.array(load_robot(name).robot.postures["home"])
    pin.framesForwardKinematics(model, data, home)
    axis = data.oMf[model.getFrameId("flange")].rotation[:, 2]
    np.testing.assert_allclose(axis, [0.0, 0.0, -1.0], atol=1e-12)


def test_openarm_limits_are_the_published_ones_and_joints_1_and_2_mirrored() -> None:
    """The left arm's first two ranges are the right arm's with the sign turned."""
    robot = load_robot("openarm").robot
    right = np.array(OPENARM_RIGHT)
    left = right.copy()
    left[:2] = -right[:2, ::-1]
    for arm, rows in zip(robot.arms, (left, right), strict=True):
        limits = robot.limits.select(arm.joints)
        np.testing.assert_array_equal(np.column_stack([limits.lower, limits.upper]), rows)
        np.testing.assert_array_equal(limits.velocity, OPENARM_VELOCITY)


def test_openarm_arms_hang_at_zero_and_rise_sideways_and_forward(
    pin_model: Callable[[str], pin.Model],
) -> None:
    """Joint 2 lifts each arm away from the body, joint 4 lifts the forearm forward."""
    model = pin_model("openarm")
    data = model.createData()
    for side, outward in (("left", 1.0), ("right", -1.0)):
        q = np.zeros(model.nq)
        wrist = model.getJointId(f"{side}_7")
        pin.forwardKinematics(model, data, q)
        hanging = data.oMi[wrist].translation.copy()
        np.testing.assert_allclose(hanging, [0.0, outward * 0.1535, 0.262], atol=1e-12)
        second = model.idx_qs[model.getJointId(f"{side}_2")]
        wide = max((model.lowerPositionLimit[second], model.upperPositionLimit[second]), key=abs)
        q[second] = np.copysign(np.pi / 2, wide)
        pin.forwardKinematics(model, data, q)
        # Upper arm and forearm (0.220 + 0.216) sideways from the shoulder, at its height.
        level = [0.0, outward * (0.1535 + 0.436), 0.698]
        np.testing.assert_allclose(data.oMi[wrist].translation, level, atol=1e-12)
        q[second] = 0.0
        q[model.idx_qs[model.getJointId(f"{side}_4")]] = np.pi / 2
        pin.forwardKinematics(model, data, q)
        forward = [0.216, outward * 0.1535, 0.698 - 0.220]
        np.testing.assert_allclose(data.oMi[wrist].translation, forward, atol=1e-12)


def test_openarm_arms_weigh_what_the_maker_says(pin_model: Callable[[str], pin.Model]) -> None:
    """1.142 + 0.278 + 1.074 + 0.560 + 0.551 + 0.385 + 0.386 kg per arm on a body of 13.89 kg."""
    model = pin_model("openarm")
    masses = [inertia.mass for inertia in model.inertias]
    assert masses[1:] == pytest.approx([1.142, 0.278, 1.074, 0.560, 0.551, 0.385, 0.386] * 2)
    assert masses[0] == pytest.approx(13.89)


@pytest.mark.parametrize(("name", "total"), [("iiwa14", 29.9), ("iiwa7", 23.9)])
def test_iiwa_weighs_what_the_maker_says(
    name: str, total: float, urdf_tree: Callable[[str], ET.Element]
) -> None:
    """KUKA's data sheets give the weight of the whole arm, base included; links are not published."""
    masses = [float(mass.attrib["value"]) for mass in urdf_tree(name).iter("mass")]
    assert len(masses) == 8
    assert sum(masses) == pytest.approx(total, abs=1e-5)


@pytest.mark.parametrize("name", ["iiwa14", "iiwa7"])
def test_iiwa_centres_of_mass_are_within_the_links(
    name: str, pin_model: Callable[[str], pin.Model]
) -> None:
    """At zero each link's centre is above its joint and below the next one, at most 40 mm off the arm's axis."""
    model = pin_model(name)
    data = model.createData()
    pin.forwardKinematics(model, data, np.zeros(7))
    heights = [data.oMi[k].translation[2] for k in range(1, 8)] + [IIWA_HEIGHT[name]]
    for k in range(1, 8):
        centre = data.oMi[k].act(model.inertias[k].lever)
        assert heights[k - 1] < centre[2] < heights[k]
        assert np.hypot(*centre[:2]) < 0.04


def test_openarm_inertias_are_mirrored_but_for_link_4(
    pin_model: Callable[[str], pin.Model],
) -> None:
    """The left arm's links are the right arm's reflected in y; link 4 is the same part on both arms."""
    model = pin_model("openarm")
    for k in range(1, 8):
        left, right = (
            model.inertias[model.getJointId(f"{side}_{k}")] for side in ("left", "right")
        )
        mirror = np.diag([1.0, 1.0 if k == 4 else -1.0, 1.0])
        np.testing.assert_allclose(left.lever, mirror @ right.lever, atol=1e-15)
        np.testing.assert_allclose(left.inertia, mirror @ right.inertia @ mirror, atol=1e-15)
