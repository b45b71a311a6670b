"""Boxes and boxes: gaps along all separating axes, of many pairs in many postures at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import coal
import numpy as np

from dualarm_cli.collision.hulls import box_around
from dualarm_cli.collision.solids import Pair, Solid
from dualarm_cli.collision.tree import JointTree
from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.geometry.products import product
from dualarm_cli.records import dataclass

LEAST_SINE = 0.05
"""Edges whose directions differ by less have no axis of their own: the sides' axes are nearly as good."""
_NEXT, _LAST = np.array([1, 2, 0]), np.array([2, 0, 1])

Frames = Mapping[int, tuple[FloatArray, FloatArray]]
"""Rotations (3, 3, n) and translations (3, n) by joint."""


@dataclass(frozen=True)
class BoxPairs:
    """Those of some pairs that are two boxes, b of them; first index is which of the two."""

    number: IntArray
    """Their numbers among the pairs, shape (b,)."""
    joint: IntArray
    """The joints they move with, shape (2, b)."""
    R: FloatArray
    """Their rotations in the tree's frames of these joints, shape (2, b, 3, 3)."""
    p: FloatArray
    """Their centres there [m], shape (2, b, 3)."""
    half: FloatArray
    """Half sides [m], shape (2, b, 3)."""
    required: FloatArray
    """Required clearances [m], shape (b,)."""

    @classmethod
    def of(cls, solids: Sequence[Solid], tree: JointTree, pairs: Sequence[Pair]) -> BoxPairs:
        """Picks the boxes.

        Args:
            solids: of the cell.
            tree: of the robot.
            pairs: of the solids.
        """
        rows: list[list[tuple[int, FloatArray, FloatArray, FloatArray]]] = []
        numbers, required = [], []
        for number, pair in enumerate(pairs):
            both = [solids[pair.first], solids[pair.second]]
            if not all(isinstance(solid.geometry, coal.Box) for solid in both):
                continue
            numbers.append(number)
            required.append(pair.required)
            rows.append([_placed(solid, tree) for solid in both])
        b = len(rows)

        def of_both(k: int, *shape: int) -> FloatArray:
            values = np.array([[one[k] for one in row] for row in rows], dtype=np.float64)
            return np.swapaxes(values.reshape(b, 2, *shape), 0, 1)

        return cls(
            np.array(numbers, dtype=np.int64),
            of_both(0).astype(np.int64),
            of_both(1, 3, 3),
            of_both(2, 3),
            of_both(3, 3),
            np.array(required, dtype=np.float64),
        )

    def gaps(self, which: IntArray, frames: Frames, row: IntArray) -> FloatArray:
        """Returns the largest gap of m pairs of boxes along the axes of their sides and edges [m], shape (m,).

        It is never more than their distance, and negative where they overlap: boxes are apart if and only if one of
        these axes separates them ([Gottschalk1996]).

        Args:
            which: of the b pairs, shape (m,).
            frames: of their joints in n postures.
            row: number of the posture, shape (m,).
        """
        joints = sorted(frames)
        R_all, p_all = (np.stack([frames[joint][k] for joint in joints]) for k in range(2))
        axes, centers = [], []
        for side in range(2):
            at = np.searchsorted(joints, self.joint[side, which])
            R_joint = R_all[at, :, :, row]
            axes.append(product(R_joint, self.R[side, which]))
            centers.append(
                p_all[at, :, row] + product(R_joint, self.p[side, which, :, None])[..., 0]
            )
        t = product(np.swapaxes(axes[0], 1, 2), (centers[1] - centers[0])[..., None])[..., 0]
        return _largest_gap(
            product(np.swapaxes(axes[0], 1, 2), axes[1]),
            t,
            self.half[0, which],
            self.half[1, which],
        )


def _placed(solid: Solid, tree: JointTree) -> tuple[int, FloatArray, FloatArray, FloatArray]:
    """Returns a box's joint, and its rotation and centre in the tree's frame of it, and its half sides."""
    own = tree.R_joint_own[solid.joint].T
    center, half = box_around(solid.geometry)
    return (
        solid.joint,
        product(own, solid.pose.rotation),
        product(own, np.asarray(solid.pose.act(center))),
        half,
    )


def _largest_gap(C: FloatArray, t: FloatArray, one: FloatArray, other: FloatArray) -> FloatArray:
    """Returns the largest gap of m pairs of boxes [m], shape (m,).

    Args:
        C: the second box's axes in the first one's frame, shape (m, 3, 3).
        t: its centre there [m], shape (m, 3).
        one: half sides of the first box [m], shape (m, 3).
        other: of the second one, shape (m, 3).
    """
    size = np.abs(C)
    sides = np.abs(t) - one - product(size, other[..., None])[..., 0]
    across = np.abs(product(np.swapaxes(C, 1, 2), t[..., None])[..., 0])
    across -= other + product(np.swapaxes(size, 1, 2), one[..., None])[..., 0]
    # Axis i, j is the cross product of the boxes' axes i and j: its length is the sine between them.
    way = np.abs(t[:, _LAST, None] * C[:, _NEXT] - t[:, _NEXT, None] * C[:, _LAST])
    reach = one[:, _NEXT, None] * size[:, _LAST] + one[:, _LAST, None] * size[:, _NEXT]
    reach += other[:, None, _NEXT] * size[:, :, _LAST] + other[:, None, _LAST] * size[:, :, _NEXT]
    sine = np.sqrt(np.maximum(1.0 - C * C, 0.0))
    edges = np.where(
        sine > LEAST_SINE, (way - reach) / np.maximum(sine, LEAST_SINE), -np.inf
    ).reshape(-1, 9)
    gap: FloatArray = np.maximum(np.maximum(sides, across).max(axis=1), edges.max(axis=1))
    return gap
