"""Pairs of solids in arrays, and the margins of their hulls in many postures at once."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import coal
import numpy as np
from numpy.typing import NDArray

from dualarm_cli.collision.box_pairs import BoxPairs
from dualarm_cli.collision.hulls import Hulls, box_around, is_rough, keeps_form
from dualarm_cli.collision.solids import Pair, Solid
from dualarm_cli.collision.tree import JointTree
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray

Singles = NDArray[np.float32]
"""Most pairs in most postures are far apart, and half the bytes take half the time; near ones are computed exactly."""
Frames = Mapping[int, tuple[Singles, Singles]]
"""Rotations (3, 3, n) and translations (3, n) by joint."""

ROUNDED = 4e-6
"""What margins are less by, for the rounding of places in single precision, about 1e-6 at two metres [m]."""
ALIKE = 9
"""Digits to which the axes of boxes are the same: places are then the same to a nanometre."""


@dataclass(frozen=True)
class Capsules:
    """Round hulls of s solids, those that move with one joint one after the other."""

    number: IntArray
    """Number of each solid's capsule, shape (s,)."""
    spans: Mapping[int, tuple[int, int]]
    """First capsule of each joint and the one after its last."""
    center: Singles
    """Middle of each in its joint's frame [m], shape (s, 3)."""
    half: Singles
    """From there to one end [m], shape (s, 3)."""

    @classmethod
    def of(cls, solids: Sequence[Solid], hulls: Hulls) -> Capsules:
        """Puts hulls in the order of their joints."""
        joint = np.array([solid.joint for solid in solids], dtype=np.int64)
        order = np.argsort(joint, kind="stable")
        number = np.empty_like(order)
        number[order] = np.arange(len(order))
        values, first, count = np.unique(joint[order], return_index=True, return_counts=True)
        spans = {
            int(j): (int(low), int(low + n)) for j, low, n in zip(values, first, count, strict=True)
        }
        center, half = (x[order].astype(np.float32) for x in (hulls.center, hulls.half))
        return cls(number, spans, center, half)

    def placed(self, frames: Frames, joints: Iterable[int], n: int) -> tuple[Singles, Singles]:
        """Returns middles and half vectors in n postures [m], shape (3, s, n) each; of the given joints alone."""
        center, half = np.empty((2, 3, len(self.center), n), dtype=np.float32)
        for joint in joints:
            low, high = self.spans.get(joint, (0, 0))
            R, p = frames[joint]
            center[:, low:high] = p[:, None] + self.center[low:high] @ R
            half[:, low:high] = self.half[low:high] @ R
        return center, half


@dataclass(frozen=True)
class Rounds:
    """Pairs of capsules."""

    first: IntArray
    """Capsules on the one side, shape (p,)."""
    second: IntArray
    """Capsules on the other side, shape (p,)."""
    slack: FloatArray
    """Both radii and the required clearance [m], shape (p, 1)."""
    ball: Singles
    """The same and both half lengths, shape (p, 1)."""


@dataclass(frozen=True)
class Boxes:
    """Pairs of a capsule and a box; all boxes move with one joint, or all of them stand, and all have the same axes."""

    joint: int
    """The joint that they move with."""
    axes: Singles | None
    """Their axes in the joint's frame, one a row, shape (3, 3); None where they are that frame's."""
    p: Singles
    """Their centres along these axes [m], shape (3, p, 1)."""
    half: Singles
    """Half sides [m], shape (3, p, 1)."""
    hulls: IntArray
    """The capsules, shape (h,)."""
    hull: IntArray
    """Which of them belongs to each pair, shape (p,)."""
    slack: FloatArray
    """Their radii and the required clearances [m], shape (p, 1)."""
    ball: Singles
    """The same and their half lengths, shape (p, 1)."""


@dataclass(frozen=True)
class Planes:
    """Pairs of a capsule and a half-space that stands in the root link's frame."""

    hulls: IntArray
    """The capsules, shape (p,)."""
    normal: Singles
    """Outward unit normals, shape (3, p, 1)."""
    slack: Singles
    """Where the planes are along them, the capsules' radii and the required clearances [m], shape (p, 1)."""


@dataclass(frozen=True)
class PairGroup:
    """Pairs that are tested together."""

    joints: frozenset[int]
    """Joints whose frames are needed."""
    rounds: Rounds
    boxes: tuple[Boxes, ...]
    planes: Planes
    pairs: tuple[Pair, ...]
    """The pairs in the order of rounds, planes and boxes, q of them."""
    rough: BoolArray
    """Whether a hull of the pair is wider than the solid, shape (q,)."""
    both_boxes: BoxPairs
    """Those of the rough ones that are two boxes."""


def pair_group(
    solids: Sequence[Solid],
    hulls: Hulls,
    capsules: Capsules,
    tree: JointTree,
    pairs: Sequence[Pair],
) -> PairGroup:
    """Returns pairs of solids as arrays.

    Args:
        solids: of the cell.
        hulls: around them.
        capsules: the same in the order that counts.
        tree: of the robot.
        pairs: of the solids.
    """
    rounds: list[tuple[int, int, float]] = []
    boxes: dict[tuple[int, bytes], list[tuple[int, int, float]]] = {}
    planes: list[tuple[int, FloatArray, float]] = []
    kinds: list[list[Pair]] = [[], []]
    boxed: dict[tuple[int, bytes], list[Pair]] = {}
    for pair in pairs:
        one, other = pair.first, pair.second
        # The one that is kept as it is: what stands, or else a box.
        if keeps_form(solids[one]) and not keeps_form(solids[other]):
            one, other = other, one
        solid = solids[other]
        slack = float(hulls.radius[one]) + pair.required + ROUNDED
        if isinstance(solid.geometry, coal.Halfspace):
            normal = solid.pose.rotation @ np.asarray(solid.geometry.n).ravel()
            offset = float(solid.geometry.d + normal @ solid.pose.translation)
            planes.append((one, normal, offset + slack))
            kinds[1].append(pair)
        elif keeps_form(solid):
            kind = solid.joint, (np.round(_axes(solid, tree), ALIKE) + 0.0).tobytes()
            boxes.setdefault(kind, []).append((one, other, slack))
            boxed.setdefault(kind, []).append(pair)
        else:
            kinds[0].append(pair)
            rounds.append((one, other, slack + float(hulls.radius[other])))
    used = {hull for one, other, _ in rounds for hull in (one, other)}
    used |= {hull for found in boxes.values() for hull, *_ in found}
    used |= {hull for hull, *_ in planes}
    joints = {solids[hull].joint for hull in used} | {joint for joint, _ in boxes}
    number = capsules.number
    ordered = (*kinds[0], *kinds[1], *(pair for some in boxed.values() for pair in some))
    radii = np.array([s for *_, s in rounds]).reshape(-1, 1)
    lengths = [hulls.length[a] + hulls.length[b] for a, b, _ in rounds]
    return PairGroup(
        frozenset(joints),
        Rounds(
            np.array([number[a] for a, _, _ in rounds], dtype=np.int64),
            np.array([number[b] for _, b, _ in rounds], dtype=np.int64),
            radii,
            (radii + np.array(lengths).reshape(-1, 1)).astype(np.float32),
        ),
        tuple(
            _box_pairs(solids, hulls, tree, joint, found, number)
            for (joint, _), found in boxes.items()
        ),
        Planes(
            np.array([number[hull] for hull, *_ in planes], dtype=np.int64),
            np.array([n for _, n, _ in planes], dtype=np.float32).reshape(-1, 3).T[..., None],
            np.array([s for *_, s in planes], dtype=np.float32).reshape(-1, 1),
        ),
        ordered,
        np.array(
            [is_rough(solids[pair.first], solids[pair.second]) for pair in ordered], dtype=np.bool_
        ),
        BoxPairs.of(solids, tree, ordered),
    )


def _axes(solid: Solid, tree: JointTree) -> FloatArray:
    """Returns a box's axes in its joint's frame, one a row, shape (3, 3)."""
    axes: FloatArray = (tree.R_joint_own[solid.joint].T @ solid.pose.rotation).T
    return axes


def _box_pairs(
    solids: Sequence[Solid],
    hulls: Hulls,
    tree: JointTree,
    joint: int,
    found: Sequence[tuple[int, int, float]],
    number: IntArray,
) -> Boxes:
    """Returns pairs of boxes of the same axes that move with one joint; found are capsule, box and slack."""
    own = tree.R_joint_own[joint].T
    axes = _axes(solids[found[0][1]], tree)
    centers, halves = [], []
    for _, box, _ in found:
        solid = solids[box]
        center, half = box_around(solid.geometry)
        centers.append(axes @ own @ np.asarray(solid.pose.act(center)))
        halves.append(half)
    slack = np.array([s for *_, s in found]).reshape(-1, 1)
    ball = slack + hulls.length[[hull for hull, *_ in found]][:, None]
    used, hull = np.unique(number[[hull for hull, *_ in found]], return_inverse=True)
    straight = np.array_equal(np.round(axes, ALIKE), np.eye(3))
    return Boxes(
        joint,
        None if straight else axes.astype(np.float32),
        np.array(centers, dtype=np.float32).T[..., None],
        np.array(halves, dtype=np.float32).T[..., None],
        used,
        hull,
        slack,
        ball.astype(np.float32),
    )
