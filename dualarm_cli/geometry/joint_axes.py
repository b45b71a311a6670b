"""Geometry of joint axes: intersection points, deviation from SRS geometry, kind of an arm."""

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
"""Deviation from exact geometry that closed forms may ignore [m and rad]."""
PARALLEL = 1e-9
"""Sine of the angle of two axes below which they count as parallel."""


@dataclass(frozen=True)
class SrsDeviation:
    """Deviation of an arm from exact SRS geometry."""

    shoulder: float
    """Largest distance of axes 1 to 3 from their common centre [m]."""
    elbow: float
    """Largest distance of axes 3 to 5 from their common centre [m]."""
    wrist: float
    """Largest distance of axes 5 to 7 from their common centre [m]."""
    gaps: tuple[float, ...]
    """Distances from each axis to the next [m], six: a data sheet's offsets."""
    angle: float
    """Largest deviation of two consecutive axes from a right angle [rad]."""

    @property
    def largest(self) -> float:
        """Largest of the deviations [m or rad]."""
        return max(self.shoulder, self.elbow, self.wrist, *self.gaps, self.angle)

    def __str__(self) -> str:
        """Format the deviations in mm and rad."""
        gaps = ", ".join(f"{gap * 1000:.3g}" for gap in self.gaps)
        return (
            f"axes miss the shoulder by {self.shoulder * 1000:.3g} mm, the elbow by "
            f"{self.elbow * 1000:.3g} mm, the wrist by {self.wrist * 1000:.3g} mm, "
            f"each other by {gaps} mm, right angles by {self.angle:.3g} rad"
        )


@dataclass(frozen=True)
class SrsGeometry:
    """Geometry of an SRS arm at q = 0 in its base frame."""

    axes: FloatArray
    """Unit joint axes, shape (7, 3)."""
    shoulder: FloatArray
    """Intersection of axes 1 to 3 [m], shape (3,)."""
    elbow: FloatArray
    """Intersection of axes 3 to 5 [m], shape (3,)."""
    wrist: FloatArray
    """Intersection of axes 5 to 7 [m], shape (3,)."""
    R_flange: FloatArray
    """Rotation of the flange, shape (3, 3)."""
    p_flange: FloatArray
    """Position of the flange [m], shape (3,)."""
    deviation: SrsDeviation
    """Deviation of the axes from these intersections."""

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for name in ("axes", "shoulder", "elbow", "wrist", "R_flange", "p_flange"):
            object.__setattr__(self, name, readonly(getattr(self, name)))

    @classmethod
    def measure(
        cls, axes: FloatArray, points: FloatArray, R_flange: FloatArray, p_flange: FloatArray
    ) -> SrsGeometry:
        """Measure centres, links and deviations of any seven axes, SRS or not.

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
        """Check that every deviation is within a tolerance and both links exist.

        Args:
            tolerance: deviation that may be ignored [m and rad]. The error of the closed forms is about as large at the
                shoulder, and an angular deviation times the reach at the flange.
        """
        return self.deviation.largest <= tolerance and min(self.upper, self.fore) > tolerance


def meeting_point(axes: FloatArray, points: FloatArray) -> tuple[FloatArray, float]:
    """Compute the point nearest to lines in the least-squares sense.

    Args:
        axes: unit directions, shape (n, 3).
        points: a point on each line [m], shape (n, 3).

    Returns:
        The point [m], shape (3,), and its largest distance from a line [m].
    """
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    normal, right = across.sum(axis=0), product(across, points[:, :, None]).sum(axis=0)[:, 0]
    centre = least_squares(normal, right)
    distance = norm(product(across, (centre - points)[:, :, None])[..., 0], axis=1)
    return centre, float(distance.max())


def _distance(e: FloatArray, p: FloatArray, f: FloatArray, r: FloatArray) -> float:
    """Compute the distance of two lines [m], each a direction and a point."""
    common = np.cross(e, f)
    sine = norm(common)
    if sine < PARALLEL:
        return float(norm(np.cross(e, r - p)))
    return float(abs(product(common, r - p)) / sine)


def joint_axes(model: pin.Model, joints: Sequence[str]) -> tuple[FloatArray, FloatArray]:
    """Compute the axes of n joints in the root frame, all joints at 0.

    Args:
        model: the robot.
        joints: their names.

    Returns:
        Unit directions, zero for a prismatic joint, and points on the axes [m], both of shape (n, 3).
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
    """Compute the largest sine of the angles of axes 2, 3 and 4.

    Args:
        axes: unit joint axes, shape (n, 3).
    """
    pairs = ((1, 2), (1, 3), (2, 3))
    return float(max(norm(np.cross(axes[i], axes[j])) for i, j in pairs))


def measured_kind(
    axes: FloatArray, points: FloatArray
) -> Literal["srs", "spherical_wrist", "parallel_axes", "general"]:
    """Determine the kind of an arm.

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
