"""Feature curves of parts, by arc length; their frames never flip."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import cached_property

import numpy as np
import pinocchio as pin

from dualarm_cli.geometry.arrays import FloatArray, readonly
from dualarm_cli.geometry.elementary import arcsin, arctan2
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.geometry.rotations import from_quaternion, to_quaternion
from dualarm_cli.model.curves.arc_length import ArcLength
from dualarm_cli.model.curves.contours import Contour
from dualarm_cli.model.curves.point_spline import (
    SPLINE,
    UNIT,
    PointSpline,
    chord_parameters,
    quintic,
    telling,
)
from dualarm_cli.model.curves.tool_path import Poses
from dualarm_cli.records import dataclass

STANDS = 1e-9
"""Relative speed by the parameter below which a contour stops."""
SAME_PLACE = 1e-5
"""Distance of the ends below which a curve through poses is closed [m]."""


@dataclass(frozen=True)
class MeasuredCurve(ABC):
    """Curve on a part, by arc length."""

    contour: Contour
    """Curve by a parameter, in its own frame."""
    T_part_curve: pin.SE3
    """Pose of the contour's frame in the part."""

    @cached_property
    def arc(self) -> ArcLength:
        """Arc length over the contour's parameter ([Qin2024] Eq. 14)."""
        return ArcLength.refine(
            lambda t: np.asarray(norm(self.contour.rate(t), axis=1)), self.contour.nodes
        )

    @cached_property
    def length(self) -> float:
        """Length [m]."""
        return self.arc.whole

    def at(self, s: FloatArray) -> Poses:
        """Compute frames on the curve in the part's frame at lengths (k,) [m]."""
        return self.at_parameter(self.arc.at(np.clip(s, 0.0, self.length)))

    def at_parameter(self, t: FloatArray) -> Poses:
        """Compute frames on the curve in the part's frame at parameters (k,)."""
        T = self.T_part_curve
        return product(T.rotation, self.frames(t)), product(
            self.contour.point(t), T.rotation.T
        ) + T.translation

    def directions(self, s: FloatArray) -> FloatArray:
        """Compute unit tangents (k, 3) in the part's frame at lengths (k,) [m].

        Frames from a file may have another x axis.
        """
        rate = self.contour.rate(self.arc.at(np.clip(s, 0.0, self.length)))
        tangents: FloatArray = product(rate, self.T_part_curve.rotation.T)
        return tangents / norm(tangents, axis=1)[:, None]

    @abstractmethod
    def frames(self, t: FloatArray) -> FloatArray:
        """Compute rotations (k, 3, 3) in the contour's frame at parameters (k,)."""


@dataclass(frozen=True)
class FeatureCurve(MeasuredCurve):
    """Contour on a part, with frames: x along the curve, z outwards.

    z is the surface's normal made perpendicular to the curve; as both are smooth the frame never flips ([Qin2024]
    section 3.3, Fig. 8).
    """

    def frames(self, t: FloatArray) -> FloatArray:
        """Compute rotations (k, 3, 3) in the contour's frame at parameters (k,)."""
        return contour_frames(self.contour, t)


@dataclass(frozen=True)
class PoseCurve(MeasuredCurve):
    """Smooth curve through given frames, C4 in position and rotation.

    Its parameter is chord length. Only the travelled distance counts as length, not the rotation. Rotations are
    quintics of quaternion entries.
    """

    rotations: FloatArray
    """Rotations at the contour's points, shape (k, 3, 3)."""

    def __post_init__(self) -> None:
        """Freeze the array."""
        object.__setattr__(self, "rotations", readonly(self.rotations))

    @classmethod
    def through(cls, poses: Sequence[pin.SE3], T_part_curve: pin.SE3) -> PoseCurve:
        """Interpolate frames; a curve that ends at its start is closed smoothly.

        Args:
            poses: two or more; neighbours have different positions.
            T_part_curve: frame of the poses, in the part's frame.
        """
        p = np.array([pose.translation for pose in poses])
        R = np.array([pose.rotation for pose in poses])
        closed = len(p) > 3 and float(norm(p[0] - p[-1])) < SAME_PLACE
        t, turned = chord_parameters(p), _quaternions(R)
        # Equal rotations at both ends still count as open: their quaternions change signs.
        k = max(telling(t, p, closed=closed), telling(t, UNIT * turned, closed=False), key=len)
        return cls(PointSpline(p[k], R[k, :, 2], closed, t[k]), T_part_curve, R[k])

    @cached_property
    def _turning(self) -> object:
        assert isinstance(self.contour, PointSpline)
        knots, q = self.contour.knots, _quaternions(self.rotations)
        sign = 1.0 if float(product(q[0], q[-1])) > 0.0 else -1.0
        if not self.contour.closed or np.abs(q[-1] - sign * q[0]).max() > SPLINE.same_normal:
            return quintic(knots, q, closed=False)
        # After two rounds the quaternions repeat.
        twice = np.concatenate([q[:-1], sign * q[:-1], q[:1]])
        return quintic(np.concatenate([knots[:-1], 1.0 + knots]), twice, closed=True)

    def frames(self, t: FloatArray) -> FloatArray:
        """Compute rotations (k, 3, 3) in the contour's frame at parameters (k,)."""
        return from_quaternion(self._turning(t))  # type: ignore[operator]


def _quaternions(R: FloatArray) -> FloatArray:
    """Convert rotations (k, 3, 3) to quaternions (k, 4) with continuous signs."""
    q = to_quaternion(R)
    turns = np.where((q[1:] * q[:-1]).sum(axis=1) < 0.0, -1.0, 1.0)
    quaternions: FloatArray = q * np.cumprod(np.append(1.0, turns))[:, None]
    return quaternions


def contour_frames(contour: Contour, t: FloatArray) -> FloatArray:
    """Compute frames (k, 3, 3): x along the curve, z outwards."""
    rate, normal = contour.rate(t), contour.normal(t)
    x = rate / norm(rate, axis=1)[:, None]
    z = normal - (normal * x).sum(axis=1)[:, None] * x
    z /= norm(z, axis=1)[:, None]
    return np.stack([x, np.cross(z, x), z], axis=-1)


def least_lean(contour: Contour) -> float:
    """Compute the least angle between a contour and its normal [rad].

    Near 0 the frame is undefined.
    """
    rate, normal = contour.rate(contour.nodes), contour.normal(contour.nodes)
    with np.errstate(invalid="ignore", divide="ignore"):
        sine = norm(np.cross(rate, normal), axis=1) / (norm(rate, axis=1) * norm(normal, axis=1))
    return float(arcsin(np.clip(np.nan_to_num(sine), 0.0, 1.0)).min())


def sharpest_bend(contour: Contour) -> tuple[float, FloatArray]:
    """Find the largest change of direction between nodes [rad] and its point (3,) [m].

    On a smooth contour it is small. Where it is large the contour has a corner or turns back, and its frame flips.
    """
    rate = contour.rate(contour.nodes)
    turned = _angles(rate)
    # Where the contour stops, its direction does not follow from its neighbours'.
    turned[norm(rate[1:], axis=1) < STANDS * norm(rate, axis=1).max()] = np.pi
    k = int(np.argmax(turned))
    return float(turned[k]), contour.point(contour.nodes[k + 1 : k + 2])[0]


def sharpest_roll(contour: Contour) -> tuple[float, FloatArray]:
    """Find the largest rotation of z between nodes [rad] and its point (3,) [m].

    Where it is large, given normals flip between two points.
    """
    turned = _angles(contour_frames(contour, contour.nodes)[:, :, 2])
    k = int(np.argmax(turned))
    return float(turned[k]), contour.point(contour.nodes[k + 1 : k + 2])[0]


def _angles(v: FloatArray) -> FloatArray:
    """Compute the angles between neighbouring vectors (k, 3), shape (k - 1,) [rad]."""
    sine = norm(np.cross(v[:-1], v[1:]), axis=1)
    return arctan2(sine, (v[:-1] * v[1:]).sum(axis=1))
