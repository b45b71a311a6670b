"""The Yaskawa Motoman SDA10F against published numbers (sources: robots/README.md)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.files.robots.robots import load_robot

Row = tuple[float, list[float], list[float], list[float], list[float], list[float]]

# b1 [rad], both arms' S L E U R B T [rad]; tool0 in the world: left position [m] and quaternion
# xyzw, then the right ones. Expanded from the published description with another program and
# printed to six decimals.
H = 0.707107
FK: list[Row] = [
    (0.0, [0, 0, 0, 0, 0, 0, 0], [0.1, 1.14, 1.2], [0, H, H, 0], [0.1, -1.14, 1.2], [H, 0, 0, H]),
    (
        0.5,
        [0, 0, 0, 0, 0, 0, 0],
        [-0.458787, 1.048387, 1.2],
        [-0.174941, 0.685125, 0.685125, -0.174941],
        [0.634303, -0.952502, 1.2],
        [0.685125, 0.174941, 0.174941, 0.685125],
    ),
    (
        0.0,
        [1.75, 0.8, 0, -0.66, 0, 0, 0],
        [-0.037266, 0.572758, 0.442242],
        [0.706693, 0.699686, -0.024181, -0.102172],
        [-0.037266, -0.572758, 0.442242],
        [0.699686, 0.706693, -0.102172, -0.024181],
    ),
    (
        0.3,
        [0.4, -0.6, 0.8, 1.1, -0.5, 0.7, 0.2],
        [-0.378046, 0.419828, 1.741854],
        [0.138441, 0.140209, -0.225862, 0.954024],
        [-0.074962, -0.559960, 1.741854],
        [0.093035, 0.173692, 0.844667, -0.497708],
    ),
]

# Range either way [deg], velocity [deg/s], assumed acceleration [rad/s^2].
LIMITS = {
    "s": (180, 170, 9.9),
    "l": (110, 170, 9.9),
    "e": (170, 170, 9.9),
    "u": (135, 170, 9.9),
    "r": (180, 200, 11.6),
    "b": (110, 200, 11.6),
    "t": (180, 400, 23.3),
}


def _flanges(model: pin.Model, q: np.ndarray) -> dict[str, pin.SE3]:
    """Returns the world pose of both flanges."""
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    return {side: data.oMf[model.getFrameId(f"{side}_tool0")].copy() for side in ("left", "right")}


@pytest.mark.parametrize("row", FK, ids=range(1, 5))
def test_forward_kinematics_gives_the_published_poses(
    row: Row, pin_model: Callable[[str], pin.Model]
) -> None:
    """Positions and quaternions to the printed digit; a quaternion's sign is free."""
    b1, arm, left_p, left_quat, right_p, right_quat = row
    flanges = _flanges(pin_model("sda10f"), np.array([b1, *arm, *arm]))
    for side, p, quat in (("left", left_p, left_quat), ("right", right_p, right_quat)):
        np.testing.assert_allclose(flanges[side].translation, p, atol=6e-7)
        got = pin.Quaternion(flanges[side].rotation).coeffs()
        np.testing.assert_allclose(got * np.sign(got @ quat), quat, atol=1.5e-6)


def test_limits_are_those_of_the_table() -> None:
    """Ranges and velocities as published, rates as assumed; the platform 170 deg and 130 deg/s."""
    robot = load_robot("sda10f").robot
    table = {"torso_b1": (170, 130, 7.6)}
    table |= {f"{side}_{key}": row for side in ("left", "right") for key, row in LIMITS.items()}
    assert robot.joints == tuple(table)
    reach, velocity, acceleration = np.array(list(table.values())).T
    np.testing.assert_allclose(robot.limits.upper, np.radians(reach), rtol=1e-15)
    np.testing.assert_allclose(robot.limits.lower, -np.radians(reach), rtol=1e-15)
    np.testing.assert_allclose(robot.limits.velocity, np.radians(velocity), rtol=1e-15)
    np.testing.assert_array_equal(robot.limits.acceleration, acceleration)
    np.testing.assert_allclose(robot.limits.jerk, 10 * acceleration, rtol=1e-15)


def test_assumed_accelerations_reach_top_speed_in_0_3_seconds() -> None:
    """Within the rounding of the acceleration to 0.1 rad/s^2."""
    limits = load_robot("sda10f").robot.limits
    np.testing.assert_allclose(limits.velocity / limits.acceleration, 0.3, rtol=0.006)


def test_shoulders_are_where_the_platform_needs_them(pin_model: Callable[[str], pin.Model]) -> None:
    """R0 = hypot(0.100, 0.265) = 0.283240 m, azimuths +-69.326 deg, 138.651 deg between them."""
    model = pin_model("sda10f")
    data = model.createData()
    pin.forwardKinematics(model, data, np.zeros(model.nq))
    left, right = (data.oMi[model.getJointId(joint)].translation for joint in ("left_s", "right_s"))
    azimuths = [float(np.degrees(np.arctan2(p[1], p[0]))) for p in (left, right)]
    np.testing.assert_allclose(np.hypot(left[0], left[1]), 0.283240, atol=5e-7)
    np.testing.assert_allclose(azimuths, [69.326, -69.326], atol=5e-4)
    np.testing.assert_allclose(azimuths[0] - azimuths[1], 138.651, atol=1e-3)


def test_home_holds_both_tools_straight_down_in_front() -> None:
    """Flanges at (0.45, +-0.25, 1.00) m with rpy 180 deg, 0, 0, elbows bent to each side alike."""
    robot = load_robot("sda10f").robot
    model, q = pin.buildModelFromXML(robot.urdf), np.array(robot.postures["home"])
    for side, flange in _flanges(model, q).items():
        y = 0.25 if side == "left" else -0.25
        np.testing.assert_allclose(flange.translation, [0.45, y, 1.0], atol=1e-5)
        np.testing.assert_allclose(flange.rotation, np.diag([1.0, -1.0, -1.0]), atol=1e-5)
    # Joint T differs by half a turn because the two tool0 frames do; the rest is mirrored.
    left, right = (q[robot.columns(arm.joints)] for arm in robot.arms)
    np.testing.assert_array_equal(left[:6], right[:6])
    np.testing.assert_allclose(right[6] - left[6], np.pi, atol=1e-12)


def test_rest_and_zero_are_the_published_postures() -> None:
    """Rest is row 3 of the poses above, zero has every joint at 0."""
    robot = load_robot("sda10f").robot
    np.testing.assert_array_equal(robot.postures["rest"], [0.0, *FK[2][1], *FK[2][1]])
    np.testing.assert_array_equal(robot.postures["zero"], np.zeros(15))


def test_masses_add_up_to_the_estimates(pin_model: Callable[[str], pin.Model]) -> None:
    """68 kg base, 52 kg torso and 42 kg per arm: 136 kg move, the pedestal stands still."""
    model = pin_model("sda10f")
    assert sum(inertia.mass for inertia in model.inertias) == pytest.approx(136.0 + 68.0)
    assert model.inertias[1].mass == pytest.approx(52.0)
