"""Spherical-revolute-spherical arms as three rotations, a bend and three rotations."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, readonly
from dualarm_cli.geometry.elementary import arctan2, cos, sin
from dualarm_cli.geometry.joint_axes import SrsGeometry
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.records import dataclass

ZERO = 1e-12
"""Offset below which a joint has none, by rounding of the URDF [rad]."""
LEANING = 1e-9
"""Cosine between an outer axis and its link below which the sign stays."""


@dataclass(frozen=True)
class SrsCanonical:
    """Canonical form of an SRS arm.

    The flange rotation is B Z Y Z Y Z Y Z C, with theta = sign q + offset.

    Z(theta1) Y(theta2) Z(theta3) orients the upper arm, Y(theta4) bends the elbow, and the last
    triple is the wrist; each link lies along the z axis before it, so that theta4 = 0 is the
    stretched arm, theta2 = 0 the upper arm along axis 1 and theta6 = 0 axis 7 along the forearm.
    Our own derivation: Rot(e1, q1) Rot(e2, q2) Rot(e3, q3) with e1 ⊥ e2 ⊥ e3 equals
    B Z(q1) Y(q2 + b) Z(q3) Y(-b) B^T with B = [e2 × e1, e2, e1] and
    e3 = cos b e1 + sin b e2 × e1; the angle from one Y axis to the next is an offset of the Z
    between.
    """

    sign: FloatArray
    """+1 or -1 per joint, shape (7,); joints 2, 4 and 6 always have +1."""
    offset: FloatArray
    """Angle of the canonical joint at q = 0 [rad], shape (7,).

    Joints 1 and 7 have none.
    """
    B: FloatArray
    """Base frame of the canonical chain, its z along axis 1, shape (3, 3)."""
    C: FloatArray
    """Flange in the last canonical frame, shape (3, 3)."""

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for name in ("sign", "offset", "B", "C"):
            object.__setattr__(self, name, readonly(getattr(self, name)))

    @classmethod
    def of(cls, geometry: SrsGeometry) -> SrsCanonical:
        """Compute the canonical form of an SRS geometry.

        Args:
            geometry: of an SRS arm; deviations are absorbed link by link, so that all frames stay
                orthonormal.
        """
        n = geometry.axes
        upper = _unit(geometry.elbow - geometry.shoulder)
        fore = _unit(geometry.wrist - geometry.elbow)
        sign = np.ones(7)
        # Outer axes point along their link rather than against it: theta2 and theta6 are then
        # measured from the nearer of the two singular positions.
        sign[0] = -1.0 if product(n[0], upper) < -LEANING else 1.0
        sign[2] = np.sign(product(n[2], upper)) or 1.0
        sign[4] = np.sign(product(n[4], fore)) or 1.0
        sign[6] = -1.0 if product(n[6], fore) < -LEANING else 1.0
        e1, e2 = sign[0] * n[0], _unit(n[1] - product(n[1], n[0]) * n[0])
        B = np.column_stack([np.cross(e2, e1), e2, e1])
        offset = np.zeros(7)
        frame, offset[1] = _swing(B, upper)
        frame, offset[2] = _twist(frame, n[3])
        frame, offset[3] = _swing(frame, fore)
        frame, offset[4] = _twist(frame, n[5])
        frame, offset[5] = _swing(frame, sign[6] * n[6])
        offset[np.abs(offset) < ZERO] = 0.0
        return cls(sign, offset, B, product(frame.T, geometry.R_flange))

    def chain(self, q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Compute flange columns (3, 3, n), directions of upper arm and forearm, elbow normal.

        Everything is in the canonical base frame; the flange is column by column: [:, j] is column
        j. The normal is joint 4's axis, turned over where theta4 < 0, shape (3, n) like the
        directions.

        Args:
            q: joints [rad], shape (..., 7), n of them.
        """
        theta = self.sign[:, None] * q.reshape(-1, 7).T + self.offset[:, None]
        s, c = sin(theta), cos(theta)
        frame = tuple(np.eye(3)[:, :, None])
        frame = _turn_bend(frame, s[0], c[0], s[1], c[1])
        upper = frame[2]
        # Bending does not move the axis it is about: y of the frame is joint 4's axis.
        frame = _turn_bend(frame, s[2], c[2], s[3], c[3])
        normal, fore = frame[1] * np.where(s[3] < 0.0, -1.0, 1.0), frame[2]
        x, y, z = _turn_bend(frame, s[4], c[4], s[5], c[5])
        columns = np.stack([c[6] * x + s[6] * y, c[6] * y - s[6] * x, z], axis=1)
        return columns, upper, fore, normal


def _turn_bend(
    frame: tuple[FloatArray, ...],
    s_turn: FloatArray,
    c_turn: FloatArray,
    s_bend: FloatArray,
    c_bend: FloatArray,
) -> tuple[FloatArray, ...]:
    """Compute the columns of frame · Z(turn) · Y(bend), (3, n) each."""
    x, y, z = frame
    x, y = c_turn * x + s_turn * y, c_turn * y - s_turn * x
    return c_bend * x - s_bend * z, y, s_bend * x + c_bend * z


def _swing(frame: FloatArray, direction: FloatArray) -> tuple[FloatArray, float]:
    """Turn a frame about its y until z points along a direction.

    Returns the frame and the angle.
    """
    angle = float(arctan2(product(direction, frame[:, 0]), product(direction, frame[:, 2])))
    c, s = cos(angle), sin(angle)
    return product(frame, np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])), angle


def _twist(frame: FloatArray, direction: FloatArray) -> tuple[FloatArray, float]:
    """Turn a frame about its z until y points along a direction.

    Returns the frame and the angle.
    """
    angle = float(arctan2(-product(direction, frame[:, 0]), product(direction, frame[:, 1])))
    c, s = cos(angle), sin(angle)
    return product(frame, np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])), angle


def _unit(v: FloatArray) -> FloatArray:
    unit: FloatArray = v / norm(v)
    return unit
