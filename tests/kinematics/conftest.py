"""Seven-axis arms written as chains of joint frames, and their axes at q = 0."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.geometry.joint_axes import SrsGeometry
from dualarm_cli.kinematics.srs_arm import SrsArm

HALF = np.pi / 2


@dataclass(frozen=True)
class Chain:
    """Joint frames relative to the one before, local axes, flange, limits."""

    placements: list[pin.SE3]
    axes: list[np.ndarray]
    flange: pin.SE3
    lower: np.ndarray
    upper: np.ndarray

    def measured(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Returns axes, points, flange rotation and position at q = 0."""
        T, axes, points = pin.SE3.Identity(), [], []
        for placement, axis in zip(self.placements, self.axes, strict=True):
            T = T * placement
            axes.append(T.rotation @ axis)
            points.append(T.translation.copy())
        T = T * self.flange
        return np.array(axes), np.array(points), T.rotation, T.translation

    def arm(self) -> SrsArm:
        """Returns the arm as measured on its axes."""
        return SrsArm(SrsGeometry.measure(*self.measured()), self.lower, self.upper)

    def model(self) -> pin.Model:
        """Returns the same chain as a pinocchio model whose last frame is the flange."""
        model, parent = pin.Model(), 0
        for k, (placement, axis) in enumerate(zip(self.placements, self.axes, strict=True)):
            joint = pin.JointModelRevoluteUnaligned(*axis)
            parent = model.addJoint(parent, joint, placement, f"j{k + 1}")
        model.addFrame(pin.Frame("flange", parent, self.flange, pin.FrameType.OP_FRAME))
        return model


def _se3(xyz: tuple[float, ...], rpy: tuple[float, ...] = (0.0, 0.0, 0.0)) -> pin.SE3:
    return pin.SE3(pin.rpy.rpyToMatrix(*rpy), np.array(xyz, dtype=float))


def _sda10f(s: int) -> Chain:
    """SDA10F arm, s = 1 left, -1 right (MOTO motoman_sda10f_support: origins and axis signs)."""
    rows = [
        ((0.1, s * 0.265, 1.2), (HALF, 0.0, (s - 1) * HALF), -s),
        ((0, 0, 0), (-HALF, 0, 0), -s),
        ((0, 0.36, 0), (HALF, 0, 0), -s),
        ((0, 0, 0), (-HALF, 0, 0), s),
        ((0, 0.36, 0), (HALF, 0, 0), s),
        ((0, 0, 0), (-HALF, 0, 0), s),
        ((0, 0.155, 0), (-HALF, 0, 0), -s),
    ]
    limit = np.deg2rad([180, 110, 170, 135, 180, 110, 180])
    return Chain(
        [_se3(xyz, rpy) for xyz, rpy, _ in rows],
        [np.array([0.0, 0.0, sign]) for *_, sign in rows],
        _se3((0, 0, 0), (0, 0, np.pi)),
        -limit,
        limit,
    )


def _iiwa14() -> Chain:
    """KUKA LBR iiwa 14: .360, .420, .400, .126; axes z y z -y z y z."""
    heights = (0.1575, 0.2025, 0.2045, 0.2155, 0.1845, 0.2155, 0.081)
    limit = np.deg2rad([170, 120, 170, 120, 170, 120, 175])
    z, y = np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])
    return Chain(
        [_se3((0, 0, h)) for h in heights],
        [z, y, z, -y, z, y, z],
        _se3((0, 0, 0.045)),
        -limit,
        limit,
    )


def _openarm() -> Chain:
    """OpenArm v10, right: axes z -x z y z x y, a zero with axis 7 across the forearm."""
    offsets = [
        (0, 0, 0.0625), (-0.0301, 0, 0.06), (0.0301, 0, 0.06625), (0, 0.0315, 0.15375),
        (0, -0.0315, 0.0955), (0.0375, 0, 0.1205), (-0.0375, 0, 0),
    ]  # fmt: skip
    x, y, z = np.eye(3)
    return Chain(
        [_se3(xyz) for xyz in offsets],
        [z, -x, z, y, z, x, y],
        _se3((0.01, 0.02, 0.1), (0.3, 0.2, 0.1)),
        np.array([-1.396, -0.1745, -1.571, 0.0, -1.571, -0.785, -1.571]),
        np.array([3.491, 3.316, 1.571, 2.443, 1.571, 0.785, 1.571]),
    )


def _bent() -> Chain:
    """An iiwa whose zero is another posture, axes 1, 2, 5 and 6 reversed, base and flange askew."""
    straight = _iiwa14()
    zero = np.array([0.3, -0.7, 2.1, 1.2, -2.6, 0.9, 0.4])
    reversed_axes = np.array([-1, -1, 1, 1, -1, -1, 1])
    placements = [
        placement * pin.SE3(pin.exp3(axis * angle), np.zeros(3))
        for placement, axis, angle in zip(straight.placements, straight.axes, zero, strict=True)
    ]
    placements[0] = _se3((0.2, -0.4, 0.9), (0.5, -0.8, 1.9)) * placements[0]
    return Chain(
        placements,
        [sign * axis for sign, axis in zip(reversed_axes, straight.axes, strict=True)],
        _se3((0.03, -0.05, 0.11), (1.1, 0.4, -2.0)),
        np.array([-np.inf, -2.0, -3.5, -3.0, -6.0, -2.2, -np.inf]),
        np.array([np.inf, 1.0, 2.9, 0.4, 6.0, 1.6, np.inf]),
    )


def _yumi() -> Chain:
    """ABB YuMi IRB 14000 left: axes offset by 30, 30, 41.88, 40.5, 27 and 27 mm; not SRS."""
    rows = [
        ((0.05355, 0.0725, 0.41492), (0.9781, -0.5716, 2.3180)), ((0.03, 0, 0.1), (HALF, 0, 0)),
        ((-0.03, 0.17283, 0), (-HALF, 0, 0)), ((-0.04188, 0, 0.07873), (HALF, -HALF, 0)),
        ((0.0405, 0.16461, 0), (-HALF, 0, 0)), ((-0.027, 0, 0.10039), (HALF, 0, 0)),
        ((0.027, 0.029, 0), (-HALF, 0, 0)),
    ]  # fmt: skip
    z = np.array([0.0, 0.0, 1.0])
    return Chain([_se3(*row) for row in rows], [z] * 7, _se3((0, 0, 0)), -np.ones(7), np.ones(7))


CHAINS = {
    "sda10f_left": _sda10f(1),
    "sda10f_right": _sda10f(-1),
    "iiwa14": _iiwa14(),
    "openarm": _openarm(),
    "bent": _bent(),
}


@pytest.fixture(scope="session", params=list(CHAINS))
def chain(request: pytest.FixtureRequest) -> Chain:
    """Each SRS arm in turn."""
    return CHAINS[request.param]


@pytest.fixture(scope="session")
def arm(chain: Chain) -> SrsArm:
    """The arm of the chain."""
    return chain.arm()


@pytest.fixture(scope="session")
def chains() -> dict[str, Chain]:
    """SRS arms by name, and yumi, which is none."""
    return {**CHAINS, "yumi": _yumi()}
