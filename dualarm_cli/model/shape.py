"""Shape: a solid of a cell or a robot."""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from dualarm_cli.geometry.arrays import FloatArray, readonly
from dualarm_cli.records import dataclass

ShapeKind = Literal["box", "sphere", "cylinder", "capsule", "mesh", "half_space"]


@dataclass(frozen=True, eq=False)
class Hull:
    """The convex hull of a mesh: it contains the mesh, whatever its form."""

    corners: FloatArray
    """Its corners [m], shape (n, 3)."""
    triangles: npt.NDArray[np.int64]
    """Numbers of the corners of its faces, counterclockwise as seen from outside, shape (m, 3)."""

    def __post_init__(self) -> None:
        """Freezes the corners."""
        object.__setattr__(self, "corners", readonly(self.corners))


@dataclass(frozen=True)
class Shape:
    """A solid: its kind, its sizes and where it sits in the frame that holds it."""

    kind: ShapeKind
    """Which solid; a capsule's or cylinder's axis is z."""
    size: tuple[float, ...]
    """Box: full sides x, y, z; sphere: radius; cylinder and capsule: radius, length (a capsule's
    between the centres of its caps); mesh and half_space: none (a half-space fills z below 0) [m]."""
    pose: pin.SE3
    """Pose in the holding frame."""
    hull: Hull | None = None
    """That of a mesh; None for any other kind."""

    def __post_init__(self) -> None:
        """Refuses a mesh without a hull.

        Raises:
            ValueError: there is none, or a shape of another kind has one.
        """
        if (self.kind == "mesh") != (self.hull is not None):
            raise ValueError("a mesh has a hull, and no other shape has one")
