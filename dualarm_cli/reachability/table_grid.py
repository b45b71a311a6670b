"""Grid of points on a table, with the tool poses at them."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray, readonly
from dualarm_cli.geometry.elementary import TURN, arctan2, cos, sin
from dualarm_cli.geometry.products import product
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.kinematics.platform_chain import rotation_z
from dualarm_cli.records import dataclass

YAWS = 8
"""Number of yaws of a tool, 45 degrees apart."""


@dataclass(frozen=True)
class TableGrid:
    """Grid of n nodes over platform angle, height, y and x, the last fastest."""

    platform: FloatArray
    """Positions of the platform's joints, shape (a, k) [rad or m]."""
    heights: FloatArray
    """Heights of the tool centre point above the world's origin [m], shape (h,)."""
    y: FloatArray
    """Coordinates along y [m], shape (ny,)."""
    x: FloatArray
    """Coordinates along x [m], shape (nx,)."""
    tilt: float = 0.0
    """Tilt of the tool from straight down, its tip away from the centre [rad]."""
    centre: tuple[float, float] = (0.0, 0.0)
    """Centre from which tips lean away [m]."""

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for name in ("platform", "heights", "y", "x"):
            object.__setattr__(self, name, readonly(getattr(self, name)))

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Number of platform positions, heights, y and x."""
        return len(self.platform), len(self.heights), len(self.y), len(self.x)

    @property
    def step(self) -> float:
        """Distance of neighbouring points [m]; 0 for a single point."""
        side = max(self.x, self.y, key=len)
        return round(float(side[1] - side[0]), 9) if len(side) > 1 else 0.0

    @cached_property
    def size(self) -> int:
        """Number of nodes."""
        return int(np.prod(self.shape))

    def points(self, node: IntArray) -> FloatArray:
        """Compute the positions of nodes in the world [m], shape (m, 3)."""
        _, h, iy, ix = np.unravel_index(node, self.shape)
        return np.stack([self.x[ix], self.y[iy], self.heights[h]], axis=1)

    def platform_at(self, node: IntArray) -> FloatArray:
        """Return the platform positions at nodes, shape (m, k)."""
        return self.platform[np.unravel_index(node, self.shape)[0]]

    def tools(self, node: IntArray, yaw: IntArray) -> tuple[FloatArray, FloatArray]:
        """Compute the tool poses at nodes: rotations (m, 3, 3) and tips (m, 3) [m].

        Args:
            node: numbers of nodes.
            yaw: yaw numbers about the tool's axis, of YAWS, shape (m,).
        """
        tip = self.points(node)
        away = arctan2(tip[:, 1] - self.centre[1], tip[:, 0] - self.centre[0])
        c, s = cos(self.tilt), sin(self.tilt)
        # Straight down: half a turn about x. Then the z axis leans towards x.
        leaning = np.array([[c, 0.0, s], [0.0, -1.0, 0.0], [s, 0.0, -c]])
        turn = away if self.tilt else np.zeros(len(tip))
        R = product(
            rotation_z(turn),
            leaning,
            rotation_z(np.asarray(yaw * (TURN / YAWS), dtype=np.float64)),
        )
        return R, tip

    def neighbours(self, node: IntArray) -> list[tuple[IntArray, BoolArray]]:
        """Compute the neighbours of nodes, and their mask, by direction along each axis."""
        index = np.array(np.unravel_index(node, self.shape))
        neighbours = []
        for axis, length in enumerate(self.shape):
            for direction in (-1, 1):
                moved = index.copy()
                moved[axis] += direction
                exists = (moved[axis] >= 0) & (moved[axis] < length)
                moved[axis] = np.clip(moved[axis], 0, length - 1)
                neighbours.append((np.ravel_multi_index(tuple(moved), self.shape), exists))
        return neighbours

    def every(self, step: int) -> IntArray:
        """Select every `step`-th node along each axis, and all along short axes."""
        picked = [
            np.arange(
                min(step // 2, length - 1) if length > 2 else 0, length, step if length > 2 else 1
            )
            for length in self.shape
        ]
        mesh = np.meshgrid(*picked, indexing="ij")
        return np.ravel_multi_index(tuple(mesh), self.shape).ravel()


def flange_poses(
    model: CellModel, arm: str, grid: TableGrid, node: IntArray, yaw: IntArray, back: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Compute flange poses of tools at nodes, in the frame that carries the arms.

    Args:
        model: the cell.
        arm: name of the arm.
        grid: the nodes.
        node: node numbers, shape (m,).
        yaw: yaw numbers about the tool's axis, shape (m,).
        back: length by which the tool is drawn back along its axis [m].

    Returns:
        Rotations, shape (m, 3, 3), and positions [m], shape (m, 3).
    """
    R, p = grid.tools(node, yaw)
    return carried_flanges(model, arm, grid.platform_at(node), R, p - back * R[..., 2])


def carried_flanges(
    model: CellModel, arm: str, platform: FloatArray, R: FloatArray, p: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Compute flange poses of tools, in the frame that carries the arms.

    Args:
        model: the cell.
        arm: name of the arm.
        platform: positions of the platform's joints [rad or m], shape (m or 1, k).
        R: rotations of the tools in the world, shape (m, 3, 3).
        p: tool centre points [m], shape (m, 3).

    Returns:
        Rotations, shape (m, 3, 3), and positions [m], shape (m, 3).
    """
    T = model.arms[arm].T_flange_tcp.inverse()
    R_world, p_world = model.platform.pose(platform)
    R_carried = np.swapaxes(R_world, -1, -2)
    R, p = product(R_carried, R), product(R_carried, (p - p_world)[..., None])[..., 0]
    return product(R, T.rotation), p + product(R, T.translation)
