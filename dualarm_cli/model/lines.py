"""Straight lines of a stop: lengths and directions of approach and retract."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pinocchio as pin

from dualarm_cli.geometry.arrays import FloatArray, readonly
from dualarm_cli.geometry.products import cross, norm, product
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class LineDirection:
    """Direction from a target to the outer end of its approach or retract."""

    vector: tuple[float, float, float] = (0.0, 0.0, -1.0)
    """Unit vector, in the frame of the fixed tool or of the world."""
    fixed: bool = False
    """Whether it is in the world's frame, and does not turn with the tool."""

    def axes(self, R_world_tool: FloatArray) -> FloatArray:
        """Compute the line's axes in the tool's frame as columns, z towards the target.

        Args:
            R_world_tool: rotation of the tool, shape (3, 3).
        """
        return _axes(tuple(self._outward(R_world_tool).tolist()))

    def back(self, R_world_tool: FloatArray, distance: float) -> pin.SE3:
        """Build the displacement by a distance outward [m], in the tool's frame."""
        return pin.SE3(np.eye(3), self._outward(R_world_tool) * distance)

    def _outward(self, R_world_tool: FloatArray) -> FloatArray:
        """Compute the unit vector in the tool's frame, shape (3,)."""
        vector: FloatArray = np.array(self.vector)
        return product(R_world_tool.T, vector) if self.fixed else vector

    def in_frame(self, R: FloatArray) -> LineDirection:
        """Convert to another frame of the tool; lines along the tool and fixed ones stay.

        Args:
            R: rotation of this frame of the tool in the other, shape (3, 3).
        """
        if self.fixed or self == LineDirection():
            return self
        x, y, z = product(R, np.array(self.vector)).tolist()
        return replace(self, vector=(x, y, z))


@lru_cache(maxsize=64)
def _axes(outward: tuple[float, float, float]) -> FloatArray:
    """Complete a unit vector to axes as columns, z opposite to it, shape (3, 3)."""
    z = -np.array(outward)
    y = cross(z, np.eye(3)[int(abs(z[0]) > 0.9)])
    y = y / norm(y)
    return readonly(np.stack([cross(y, z), y, z], axis=-1))


@dataclass(frozen=True)
class LineDirections:
    """Directions of the lines of a stop, from the target outward."""

    approach: LineDirection = LineDirection()
    """Direction from the target to the start of the approach."""
    retract: LineDirection = LineDirection()
    """Direction from the target to the end of the retract."""

    @property
    def vectors(self) -> FloatArray:
        """Vectors in the tool's frame, then in the world's, zero elsewhere, shape (2, 2, 3)."""
        vectors = np.zeros((2, 2, 3))
        for k, line in enumerate((self.approach, self.retract)):
            vectors[int(line.fixed), k] = line.vector
        return vectors


Line = tuple[float, LineDirection]
"""Length [m], 0 for none, and direction outward of an approach or retract."""
