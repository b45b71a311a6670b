"""Arrays of pairs of solids for the quick collision test.

Solids are replaced by capsules around them. Pairs of boxes also have the gaps along all separating axes. Both are
computed for many pairs and postures at once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import coal
import numpy as np

from dualarm_cli.collision.solids import Pair, Solid
from dualarm_cli.collision.tree import JointTree
from dualarm_cli.compiled.pair_margins import BOX, CAPSULE, PLANE, SolidPairs
from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class PairGroup:
    """Pairs of solids that are tested together."""

    joints: frozenset[int]
    """Joints whose frames are required."""
    arrays: SolidPairs
    """Arrays of the pairs for the compiled function."""
    pairs: tuple[Pair, ...]
    """All pairs of the group."""
    rough: tuple[Pair, ...]
    """Pairs with a hull that is larger than its solid."""
    both_boxes: BoxPairs
    """Rough pairs of two boxes."""


def pair_group(
    solids: Sequence[Solid], hulls: Hulls, tree: JointTree, pairs: Sequence[Pair]
) -> PairGroup:
    """Build the arrays of pairs of solids.

    Args:
        solids: solids of the cell.
        hulls: capsules around them.
        tree: joint tree of the robot.
        pairs: pairs of the solids.
    """
    capsules: dict[int, int] = {}
    boxes: dict[int, int] = {}
    normals: list[FloatArray] = []
    rows: list[tuple[int, int, int]] = []
    lengths: list[tuple[float, float]] = []
    rough = np.array([is_rough(solids[p.first], solids[p.second]) for p in pairs], dtype=np.bool_)
    for pair in pairs:
        capsule, partner = pair.first, pair.second
        # The partner keeps its form if one of them does.
        if keeps_form(solids[capsule]) and not keeps_form(solids[partner]):
            capsule, partner = partner, capsule
        solid = solids[partner]
        slack = float(hulls.radius[capsule]) + pair.required
        length = float(hulls.length[capsule])
        first = capsules.setdefault(capsule, len(capsules))
        if isinstance(solid.geometry, coal.Halfspace):
            normal = product(solid.pose.rotation, np.asarray(solid.geometry.n).ravel())
            slack += float(solid.geometry.d + product(normal, solid.pose.translation))
            rows.append((first, PLANE, len(normals)))
            normals.append(normal)
        elif keeps_form(solid):
            rows.append((first, BOX, boxes.setdefault(partner, len(boxes))))
        else:
            slack += float(hulls.radius[partner])
            length += float(hulls.length[partner])
            rows.append((first, CAPSULE, capsules.setdefault(partner, len(capsules))))
        lengths.append((slack, slack + length))
    enclosed, placed = list(capsules), [_placed(solids[box], tree) for box in boxes]
    joints = {solids[number].joint for number in (*capsules, *boxes)}
    row = np.array(rows, dtype=np.int64).reshape(-1, 3)
    length_pairs = np.array(lengths).reshape(-1, 2)
    arrays = SolidPairs.of(
        {
            "joint": np.array(sorted(tree.above(joints)), dtype=np.int64),
            "capsule_joint": np.array([solids[k].joint for k in enclosed], dtype=np.int64),
            "center": hulls.center[enclosed],
            "half": hulls.half[enclosed],
            "capsule": row[:, 0],
            "kind": row[:, 1],
            "solid": row[:, 2],
            "slack": length_pairs[:, 0],
            "ball": length_pairs[:, 1],
            "rough": np.where(rough, np.cumsum(rough) - 1, -1),
            "normal": np.array(normals).reshape(-1, 3),
            "box_joint": np.array([solids[box].joint for box in boxes], dtype=np.int64),
            "axes": np.array([axes for axes, *_ in placed]).reshape(-1, 3, 3),
            "box_center": np.array([center for _, center, _ in placed]).reshape(-1, 3),
            "box_half": np.array([half for *_, half in placed]).reshape(-1, 3),
        }
    )
    doubtful = tuple(pair for pair, is_doubtful in zip(pairs, rough, strict=True) if is_doubtful)
    return PairGroup(
        frozenset(joints), arrays, tuple(pairs), doubtful, BoxPairs.of(solids, tree, doubtful)
    )


def _placed(solid: Solid, tree: JointTree) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Compute the bounding box of a solid: axes, centre and half sides.

    Axes are rows, in the frame of its joint.
    """
    R_tree_joint = tree.R_joint_own[solid.joint].T
    axes = product(R_tree_joint, solid.pose.rotation).T
    center, half = box_around(solid.geometry)
    return axes, product(axes, R_tree_joint, np.asarray(solid.pose.act(center))), half


@dataclass(frozen=True)
class Hulls:
    """Capsules around s solids, in the tree's frame of their joint; undefined for half-spaces."""

    center: FloatArray
    """Centres [m], shape (s, 3)."""
    half: FloatArray
    """Vectors from centre to one end [m], shape (s, 3)."""
    radius: FloatArray
    """Radii [m], shape (s,)."""
    length: FloatArray
    """Lengths of `half` [m], shape (s,)."""

    @classmethod
    def of(cls, solids: Sequence[Solid], tree: JointTree) -> Hulls:
        """Build the capsules around solids.

        Args:
            solids: the solids to enclose.
            tree: joint tree of the robot.
        """
        ends = [_hull(solid, tree) for solid in solids]
        half = np.array([0.5 * (a - b) for a, b, _ in ends]).reshape(-1, 3)
        return cls(
            np.array([0.5 * (a + b) for a, b, _ in ends]).reshape(-1, 3),
            half,
            np.array([radius for *_, radius in ends]),
            norm(half, axis=1),
        )


def is_rough(solid_a: Solid, solid_b: Solid) -> bool:
    """Check whether the hulls' margin may be less than that of the solids."""
    forms = [solid.geometry for solid in (solid_a, solid_b)]
    exact = [isinstance(form, coal.Capsule | coal.Sphere) for form in forms]
    boxes = [isinstance(form, coal.Box | coal.Halfspace) for form in forms]
    return not (all(exact) or (any(exact) and any(boxes)))


def keeps_form(solid: Solid) -> bool:
    """Check whether a solid is tested by its own form, not its hull.

    Boxes, half-spaces and convex solids keep theirs.
    """
    return isinstance(
        solid.geometry, coal.Halfspace | coal.Box | coal.ConvexBase
    ) and not isinstance(solid.geometry, coal.Capsule | coal.Sphere | coal.Cylinder)


def box_around(geometry: coal.CollisionGeometry) -> tuple[FloatArray, FloatArray]:
    """Compute a solid's bounding box in its own frame: centre and half sides [m]."""
    if isinstance(geometry, coal.Box):
        return np.zeros(3), np.array(geometry.halfSide).ravel()
    geometry.computeLocalAABB()
    low = np.array(geometry.aabb_local.min_).ravel()
    high = np.array(geometry.aabb_local.max_).ravel()
    return 0.5 * (low + high), 0.5 * (high - low)


def _hull(solid: Solid, tree: JointTree) -> tuple[FloatArray, FloatArray, float]:
    """Compute a capsule around a solid: both ends and radius [m].

    The ends are in the tree's frame of the solid's joint. A cylinder lies within the capsule about its own axis, a box
    within that about its longest side's middle line with half the diagonal of the others as its radius. A half-space
    has no capsule: all values are zero.
    """
    form = solid.geometry
    if isinstance(form, coal.Halfspace):
        return np.zeros(3), np.zeros(3), 0.0
    center, end = np.zeros(3), np.zeros(3)
    if isinstance(form, coal.Sphere):
        radius = float(form.radius)
    elif isinstance(form, coal.Capsule | coal.Cylinder):
        end[2], radius = form.halfLength, float(form.radius)
    else:
        center, half = box_around(form)
        longest = int(np.argmax(half))
        end[longest] = half[longest]
        radius = float(norm(np.delete(half, longest)))
    R_tree_joint = tree.R_joint_own[solid.joint].T
    first, second = (
        product(R_tree_joint, np.asarray(solid.pose.act(center + sign * end)))
        for sign in (1.0, -1.0)
    )
    return first, second, radius


LEAST_SINE = 0.05
"""Smallest sine between edges with a separating axis of their own.

For smaller ones the axes of the sides are nearly as good.
"""
_NEXT, _LAST = np.array([1, 2, 0]), np.array([2, 0, 1])

Frames = Mapping[int, tuple[FloatArray, FloatArray]]
"""Rotations (3, 3, n) and translations (3, n) by joint."""


@dataclass(frozen=True)
class BoxPairs:
    """Pairs of two boxes, b of them; the first index selects the box."""

    number: IntArray
    """Indices among the pairs, shape (b,)."""
    joint: IntArray
    """Joints of the boxes, shape (2, b)."""
    R: FloatArray
    """Rotations of the boxes in the tree's frames of these joints, shape (2, b, 3, 3)."""
    p: FloatArray
    """Centres of the boxes in these frames [m], shape (2, b, 3)."""
    half: FloatArray
    """Half sides [m], shape (2, b, 3)."""
    required: FloatArray
    """Required clearances [m], shape (b,)."""

    @classmethod
    def of(cls, solids: Sequence[Solid], tree: JointTree, pairs: Sequence[Pair]) -> BoxPairs:
        """Select the pairs of boxes.

        Args:
            solids: solids of the cell.
            tree: joint tree of the robot.
            pairs: pairs of the solids.
        """
        rows: list[list[tuple[int, FloatArray, FloatArray, FloatArray]]] = []
        numbers, required = [], []
        for number, pair in enumerate(pairs):
            both = [solids[pair.first], solids[pair.second]]
            if not all(isinstance(solid.geometry, coal.Box) for solid in both):
                continue
            numbers.append(number)
            required.append(pair.required)
            rows.append([_placed_box(solid, tree) for solid in both])
        b = len(rows)

        def of_both(k: int, *shape: int) -> FloatArray:
            values = np.array([[box[k] for box in row] for row in rows], dtype=np.float64)
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
        """Compute the largest gap of each pair along its separating axes [m], shape (m,).

        It is never more than their distance, and negative where they overlap: boxes are apart if and only if one of
        these axes, which belong to their sides and edges, separates them ([Gottschalk1996]).

        Args:
            which: indices among the b pairs, shape (m,).
            frames: frames of their joints in n postures.
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


def _placed_box(solid: Solid, tree: JointTree) -> tuple[int, FloatArray, FloatArray, FloatArray]:
    """Place a box in the tree's frame of its joint.

    Returns:
        Joint, rotation (3, 3), centre (3,) [m] and half sides (3,) [m].
    """
    R_tree_joint = tree.R_joint_own[solid.joint].T
    center, half = box_around(solid.geometry)
    return (
        solid.joint,
        product(R_tree_joint, solid.pose.rotation),
        product(R_tree_joint, np.asarray(solid.pose.act(center))),
        half,
    )


def _largest_gap(
    C: FloatArray, t: FloatArray, half_a: FloatArray, half_b: FloatArray
) -> FloatArray:
    """Compute the largest gap of each pair of boxes [m], shape (m,).

    Args:
        C: the second box's axes in the first one's frame, shape (m, 3, 3).
        t: the second box's centre in the first one's frame [m], shape (m, 3).
        half_a: half sides of the first box [m], shape (m, 3).
        half_b: half sides of the second box [m], shape (m, 3).
    """
    size = np.abs(C)
    sides = np.abs(t) - half_a - product(size, half_b[..., None])[..., 0]
    across = np.abs(product(np.swapaxes(C, 1, 2), t[..., None])[..., 0])
    across -= half_b + product(np.swapaxes(size, 1, 2), half_a[..., None])[..., 0]
    # Axis i, j is the cross product of the boxes' axes i and j: its length is the sine between them.
    distance = np.abs(t[:, _LAST, None] * C[:, _NEXT] - t[:, _NEXT, None] * C[:, _LAST])
    reach = half_a[:, _NEXT, None] * size[:, _LAST] + half_a[:, _LAST, None] * size[:, _NEXT]
    reach += half_b[:, None, _NEXT] * size[:, :, _LAST] + half_b[:, None, _LAST] * size[:, :, _NEXT]
    sine = np.sqrt(np.maximum(1.0 - C * C, 0.0))
    edges = np.where(
        sine > LEAST_SINE, (distance - reach) / np.maximum(sine, LEAST_SINE), -np.inf
    ).reshape(-1, 9)
    gap: FloatArray = np.maximum(np.maximum(sides, across).max(axis=1), edges.max(axis=1))
    return gap
