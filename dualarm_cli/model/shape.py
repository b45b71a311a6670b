"""Shape: solid of a cell or a robot."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Literal

import coal
import numpy as np
import numpy.typing as npt
import pinocchio as pin

from dualarm_cli.geometry.arrays import FloatArray, readonly
from dualarm_cli.records import dataclass

ShapeKind = Literal["box", "sphere", "cylinder", "capsule", "mesh", "half_space"]


@dataclass(frozen=True, eq=False)
class Hull:
    """Convex hull of a mesh."""

    corners: FloatArray
    """Corners [m], shape (n, 3)."""
    triangles: npt.NDArray[np.int64]
    """Corner indices of faces, counterclockwise from outside, shape (m, 3)."""

    def __post_init__(self) -> None:
        """Freeze the corners."""
        object.__setattr__(self, "corners", readonly(self.corners))


@dataclass(frozen=True)
class Shape:
    """Solid with its kind, size and pose in the frame that holds it."""

    kind: ShapeKind
    """Kind of solid; the axis of a capsule or cylinder is z."""
    size: tuple[float, ...]
    """Box: full sides x, y, z; sphere: radius; cylinder and capsule: radius, length (a capsule's
    between the centres of its caps); mesh and half_space: none (a half-space fills z below 0) [m]."""
    pose: pin.SE3
    """Pose in the holding frame."""
    hull: Hull | None = None
    """Convex hull of a mesh; None for any other kind."""

    def __post_init__(self) -> None:
        """Refuse a mesh without a hull.

        Raises:
            ValueError: there is none, or a shape of another kind has one.
        """
        if (self.kind == "mesh") != (self.hull is not None):
            raise ValueError("a mesh has a hull, and no other shape has one")

    @property
    def geometry(self) -> coal.CollisionGeometry:
        """Solid for coal, in its own frame."""
        if self.kind == "box":
            return coal.Box(*self.size)
        if self.kind == "sphere":
            return coal.Sphere(self.size[0])
        if self.kind == "cylinder":
            return coal.Cylinder(*self.size)
        if self.kind == "capsule":
            return coal.Capsule(*self.size)
        if self.hull is not None:
            return _convex(self.hull)
        return coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)


def _convex(hull: Hull) -> coal.Convex:
    corners, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    corners.extend(list(hull.corners))
    triangles.extend([coal.Triangle(*corner) for corner in hull.triangles.tolist()])
    return coal.Convex(corners, triangles)


def uniform_inertia(shapes: Iterable[Shape]) -> pin.Inertia:
    """Compute the inertia of solids with density 1 kg/m³, in their frame.

    Where two solids overlap, both count.

    Args:
        shapes: of bounded volume.
    """
    total = pin.Inertia.Zero()
    for shape in shapes:
        solid = shape.geometry
        moments = solid.computeMomentofInertiaRelatedToCOM()
        total = total + shape.pose.act(
            pin.Inertia(solid.computeVolume(), np.asarray(solid.computeCOM()).ravel(), moments)
        )
    return total


@dataclass(frozen=True)
class VisualMesh:
    """Mesh file that shows how a link looks; nothing is checked with it."""

    link: str
    """Link of the URDF."""
    file: Path
    """The file."""
    scale: tuple[float, ...]
    """Factors along x, y and z from the file's unit to metres."""
    pose: pin.SE3
    """Pose in the link frame."""
