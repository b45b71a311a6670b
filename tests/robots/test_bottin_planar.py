"""The planar robot of [Bottin2021]: Table 1, Eq. 1 and the moves of Table 2."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.files.robots.robots import load_robot

# [Bottin2021], Table 1 [m, rad].
R0, ALPHA, LINK, PHI0 = 0.050, math.radians(120), 0.070, math.radians(-30)
START = {"left": (0.120, 0.0), "right": (0.0, 0.120)}
TARGET = {"left": (0.080, 0.010), "right": (0.050, 0.100)}

# [Bottin2021], Table 2 [deg]: platform's turn, displacement of the elbows of arm 1 (ours: left) and
# arm 2. Rows 6 and 7 are out of arm 2's reach.
TABLE_2 = {
    1: (-113.63, 59.14, -58.17),
    2: (-40.43, 4.62, 5.24),
    3: (-26.57, -6.87, 7.61),
    4: (39.49, -45.01, -33.88),
    5: (-70.10, 28.95, -12.75),
    8: (-0.47, -27.55, -0.40),
}
TURNS = [*(row[0] for row in TABLE_2.values()), 109.90, 179.53]


def _shoulder(side: str, phi: float) -> np.ndarray:
    """Returns the shoulder of arm 1 or 2 ([Bottin2021] Eq. 1)."""
    azimuth = phi + (ALPHA if side == "right" else 0.0)
    return R0 * np.array([math.cos(azimuth), math.sin(azimuth)])


def _interior(side: str, phi: float, target: tuple[float, float]) -> float:
    """Returns the angle between the links by the cosine rule ([Bottin2021] Eq. 3)."""
    square = float(np.sum((np.array(target) - _shoulder(side, phi)) ** 2))
    return math.acos((2 * LINK**2 - square) / (2 * LINK**2))


def _joints(side: str, phi: float, target: tuple[float, float]) -> tuple[float, float]:
    """Returns joints 1 and 4 that put the wrist on a point, elbow outward.

    Both links are equal: the triangle is isosceles, so link 1 leaves the line to the wrist by half
    of joint 4. Joint 1 counts from the radius through the shoulder.
    """
    bend = math.pi - _interior(side, phi, target)
    q4 = bend if side == "left" else -bend
    line = np.array(target) - _shoulder(side, phi)
    radius = phi + (ALPHA if side == "right" else 0.0)
    q1 = math.atan2(line[1], line[0]) - q4 / 2 - radius
    return math.remainder(q1, 2 * math.pi), q4


@pytest.fixture(scope="module")
def planar(pin_model: Callable[[str], pin.Model]) -> tuple[pin.Model, pin.Data]:
    """Returns pinocchio's model and data."""
    model = pin_model("bottin_planar")
    return model, model.createData()


def _configuration(model: pin.Model, values: dict[str, float]) -> np.ndarray:
    q = np.zeros(model.nq)
    for name, value in values.items():
        q[model.idx_qs[model.getJointId(name)]] = value
    return q


def _posture(model: pin.Model, phi: float, points: dict[str, tuple[float, float]]) -> np.ndarray:
    values = {"platform_joint": phi}
    for side, point in points.items():
        values[f"{side}_1"], values[f"{side}_4"] = _joints(side, phi, point)
    return _configuration(model, values)


@pytest.mark.parametrize("phi", [0.0, PHI0, 2.5, -6.0])
def test_shoulders_follow_equation_1(planar: tuple[pin.Model, pin.Data], phi: float) -> None:
    """Left is the paper's arm 1 at azimuth phi, right its arm 2 at phi + 120 deg, 50 mm out."""
    model, data = planar
    pin.forwardKinematics(model, data, _configuration(model, {"platform_joint": phi}))
    for side in ("left", "right"):
        p = data.oMi[model.getJointId(f"{side}_1")].translation
        np.testing.assert_allclose(p, [*_shoulder(side, phi), 0.0], atol=1e-15)


def test_home_is_the_papers_initial_configuration(planar: tuple[pin.Model, pin.Data]) -> None:
    """Platform at -30 deg, wrists at (120, 0) and (0, 120) mm within 1e-12 m, tools down."""
    model, data = planar
    home = np.array(load_robot("bottin_planar").robot.postures["home"])
    np.testing.assert_allclose(home, _posture(model, PHI0, START), atol=1e-12)
    pin.framesForwardKinematics(model, data, home)
    for side, (x, y) in START.items():
        flange = data.oMf[model.getFrameId(f"{side}_flange")]
        np.testing.assert_allclose(flange.translation, [x, y, 0.0], rtol=0, atol=1e-12)
        np.testing.assert_allclose(flange.rotation[:, 2], [0.0, 0.0, -1.0], rtol=0, atol=1e-12)
        wrist = data.oMi[model.getJointId(f"{side}_7")].translation
        np.testing.assert_allclose(flange.translation, wrist, rtol=0, atol=1e-15)


def test_links_are_70_mm_long(planar: tuple[pin.Model, pin.Data]) -> None:
    """Shoulder to elbow and elbow to wrist, at a random posture."""
    model, data = planar
    pin.forwardKinematics(model, data, np.random.default_rng(2).uniform(-3.0, 3.0, model.nq))
    for side in ("left", "right"):
        centres = [data.oMi[model.getJointId(f"{side}_{i}")].translation for i in (1, 4, 7)]
        np.testing.assert_allclose(
            np.linalg.norm(np.diff(centres, axis=0), axis=1), LINK, rtol=1e-12
        )


@pytest.mark.parametrize("number", TABLE_2)
def test_moves_of_table_2_give_its_elbow_displacements(
    planar: tuple[pin.Model, pin.Data], number: int
) -> None:
    """The wrists reach their targets in the plane, and the elbows turn by what the paper prints."""
    model, data = planar
    turn, *printed = TABLE_2[number]
    start, end = (
        _posture(model, phi, points)
        for phi, points in ((PHI0, START), (PHI0 + math.radians(turn), TARGET))
    )
    assert (end >= model.lowerPositionLimit).all()
    assert (end <= model.upperPositionLimit).all()
    pin.framesForwardKinematics(model, data, end)
    for side, displacement in zip(("left", "right"), printed, strict=True):
        p = data.oMf[model.getFrameId(f"{side}_flange")].translation
        np.testing.assert_allclose(p, [*TARGET[side], 0.0], rtol=0, atol=1e-12)
        column = model.idx_qs[model.getJointId(f"{side}_4")]
        # The paper's signs are those of a mirrored pair: the angle between the links grows with its
        # arm 1's elbow and shrinks with its arm 2's, as our joints count with the sign turned.
        got = math.degrees(start[column] - end[column])
        # Turn and displacement are printed to 0.01 deg, and the elbow turns somewhat faster.
        assert got == pytest.approx(displacement, abs=0.012)


def test_the_platform_can_take_every_angle_of_table_2(planar: tuple[pin.Model, pin.Data]) -> None:
    """All eight rows, and a full turn either way."""
    model, _ = planar
    lower, upper = model.lowerPositionLimit[0], model.upperPositionLimit[0]
    angles = PHI0 + np.radians(TURNS)
    assert ((angles > lower) & (angles < upper)).all()
    np.testing.assert_allclose([lower, upper], [-2 * math.pi, 2 * math.pi], rtol=1e-15)


def test_the_wrist_can_be_anywhere_in_the_plane_with_the_tool_down(
    planar: tuple[pin.Model, pin.Data],
) -> None:
    """Joints 1, 4 and 7 alone keep the arm in z = 0 and turn the tool about the vertical."""
    model, data = planar
    rng = np.random.default_rng(7)
    for _ in range(50):
        moved = {f"{side}_{i}": rng.uniform(-3.1, 3.1) for side in START for i in (1, 4, 7)}
        pin.framesForwardKinematics(model, data, _configuration(model, moved))
        for side in START:
            flange = data.oMf[model.getFrameId(f"{side}_flange")]
            assert abs(flange.translation[2]) < 1e-15
            np.testing.assert_allclose(flange.rotation[:, 2], [0.0, 0.0, -1.0], atol=1e-15)
