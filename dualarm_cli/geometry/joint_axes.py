"""Joint axes of an arm, measured: where they meet, and how far seven are from spherical-revolute-spherical."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
import pinocchio as pin

from dualarm_cli.geometry.arrays import FloatArray, readonly
from dualarm_cli.geometry.elementary import arcsin
from dualarm_cli.geometry.linear_systems import least_squares
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.records import dataclass

SRS_TOLERANCE = 1e-6
"""Largest deviation from exact geometry that closed forms may ignore [m and rad]."""
PARALLEL = 1e-9
"""Below this sine of their angle two axes count as parallel when their distance is measured."""


@dataclass(frozen=True)
class SrsDeviation:
    """How far an arm is from exact SRS geometry."""

    shoulder: float
    """Largest distance of axes 1 to 3 from their common centre [m]."""
    elbow: float
    """Largest distance of axes 3 to 5 from their common centre [m]."""
    wrist: float
    """Largest distance of axes 5 to 7 from their common centre [m]."""
    gaps: tuple[float, ...]
    """Distance of each axis from the next one, six of them [m]: the offsets of a data sheet."""
    angle: float
    """Largest deviation of two consecutive axes from a right angle [rad]."""

    @property
    def largest(self) -> float:
        """The largest of them, in m or rad."""
        return max(self.shoulder, self.elbow, self.wrist, *self.gaps, self.angle)

    def __str__(self) -> str:
        """Returns the deviations in mm and rad."""
        gaps = ", ".join(f"{gap * 1000:.3g}" for gap in self.gaps)
        return (
            f"axes miss the shoulder by {self.shoulder * 1000:.3g} mm, the elbow by "
            f"{self.elbow * 1000:.3g} mm, the wrist by {self.wrist * 1000:.3g} mm, "
            f"each other by {gaps} mm, right angles by {self.angle:.3g} rad"
        )


@dataclass(frozen=True)
class SrsGeometry:
    """An SRS arm at q = 0 in its base frame."""

    axes: FloatArray
    """Unit joint axes, shape (7, 3)."""
    shoulder: FloatArray
    """Where axes 1 to 3 meet [m], shape (3,)."""
    elbow: FloatArray
    """Where axes 3 to 5 meet [m], shape (3,)."""
    wrist: FloatArray
    """Where axes 5 to 7 meet [m], shape (3,)."""
    R_flange: FloatArray
    """Rotation of the flange, shape (3, 3)."""
    p_flange: FloatArray
    """Position of the flange [m], shape (3,)."""
    deviation: SrsDeviation
    """How far the axes are from meeting like that."""

    def __post_init__(self) -> None:
        """Freezes the arrays."""
        for name in ("axes", "shoulder", "elbow", "wrist", "R_flange", "p_flange"):
            object.__setattr__(self, name, readonly(getattr(self, name)))

    @classmethod
    def measure(
        cls, axes: FloatArray, points: FloatArray, R_flange: FloatArray, p_flange: FloatArray
    ) -> SrsGeometry:
        """Returns centres, links and deviations of any seven axes, SRS or not.

        A centre is the point nearest to its three axes in the least-squares sense.

        Args:
            axes: unit joint axes at q = 0, shape (7, 3).
            points: a point on each axis [m], shape (7, 3).
            R_flange: rotation of the flange, shape (3, 3).
            p_flange: position of the flange [m], shape (3,).
        """
        axes, points = np.asarray(axes, dtype=np.float64), np.asarray(points, dtype=np.float64)
        (shoulder, miss_s), (elbow, miss_e), (wrist, miss_w) = (
            meeting_point(axes[i : i + 3], points[i : i + 3]) for i in (0, 2, 4)
        )
        gaps = tuple(_distance(axes[i], points[i], axes[i + 1], points[i + 1]) for i in range(6))
        skew = np.abs((axes[:-1] * axes[1:]).sum(axis=1)).max()
        deviation = SrsDeviation(miss_s, miss_e, miss_w, gaps, float(arcsin(min(1.0, skew))))
        return cls(axes, shoulder, elbow, wrist, R_flange, p_flange, deviation)

    @property
    def upper(self) -> float:
        """Length of the upper arm, shoulder to elbow [m]."""
        return float(norm(self.elbow - self.shoulder))

    @property
    def fore(self) -> float:
        """Length of the forearm, elbow to wrist [m]."""
        return float(norm(self.wrist - self.elbow))

    @property
    def p_flange_wrist(self) -> FloatArray:
        """Wrist centre in the flange frame [m], shape (3,)."""
        wrist: FloatArray = product(self.R_flange.T, self.wrist - self.p_flange)
        return wrist

    def is_srs(self, tolerance: float) -> bool:
        """Returns whether every deviation is within the tolerance [m and rad] and both links exist.

        Args:
            tolerance: largest deviation that may be ignored; the closed forms are wrong by about as
                much at the shoulder, and by an angular deviation times the reach at the flange.
        """
        return self.deviation.largest <= tolerance and min(self.upper, self.fore) > tolerance


def meeting_point(axes: FloatArray, points: FloatArray) -> tuple[FloatArray, float]:
    """Returns the point nearest to lines in the least-squares sense [m], shape (3,), and its largest distance [m].

    Args:
        axes: unit directions, shape (n, 3).
        points: a point on each line [m], shape (n, 3).
    """
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    normal, right = across.sum(axis=0), product(across, points[:, :, None]).sum(axis=0)[:, 0]
    centre = least_squares(normal, right)
    distance = norm(product(across, (centre - points)[:, :, None])[..., 0], axis=1)
    return centre, float(distance.max())


def _distance(e: FloatArray, p: FloatArray, f: FloatArray, r: FloatArray) -> float:
    """Returns the distance [m] of the line through p along e from the line through r along f."""
    common = np.cross(e, f)
    sine = norm(common)
    if sine < PARALLEL:
        return float(norm(np.cross(e, r - p)))
    return float(abs(product(common, r - p)) / sine)


def joint_axes(model: pin.Model, joints: Sequence[str]) -> tuple[FloatArray, FloatArray]:
    """Returns the axes of n joints in the root frame, all joints at 0: unit directions and points [m], both (n, 3).

    A joint that slides has a zero direction.

    Args:
        model: the robot.
        joints: their names.
    """
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    axes, points = np.empty((len(joints), 3)), np.empty((len(joints), 3))
    for k, name in enumerate(joints):
        index = model.getJointId(name)
        twist = pin.getJointJacobian(model, data, index, pin.LOCAL)[:, model.idx_vs[index]]
        axes[k], points[k] = (
            product(data.oMi[index].rotation, twist[3:]),
            data.oMi[index].translation,
        )
    return axes, points


def parallel_deviation(axes: FloatArray) -> float:
    """Returns the largest sine of the angles of axes 2, 3 and 4: 0 where the three are parallel.

    Args:
        axes: unit joint axes, shape (n, 3).
    """
    pairs = ((1, 2), (1, 3), (2, 3))
    return float(max(norm(np.cross(axes[i], axes[j])) for i, j in pairs))


def measured_kind(
    axes: FloatArray, points: FloatArray
) -> Literal["srs", "spherical_wrist", "parallel_axes", "general"]:
    """Returns the kind of an arm.

    Args:
        axes: unit joint axes, shape (n, 3); zero for a joint that slides.
        points: a point on each axis [m], shape (n, 3).
    """
    if not np.allclose(norm(axes, axis=1), 1.0, atol=1e-9):
        return "general"
    if len(axes) == 7:
        geometry = SrsGeometry.measure(axes, points, np.eye(3), np.zeros(3))
        return "srs" if geometry.is_srs(SRS_TOLERANCE) else "general"
    if len(axes) == 6 and meeting_point(axes[3:], points[3:])[1] <= SRS_TOLERANCE:
        return "spherical_wrist"
    if len(axes) == 6 and parallel_deviation(axes) <= SRS_TOLERANCE:
        return "parallel_axes"
    return "general"
