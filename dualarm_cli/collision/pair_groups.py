"""Pairs of solids in arrays, and the margins of their hulls in many postures at once."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import coal
import numpy as np
from numpy.typing import NDArray

from dualarm_cli.collision.box_pairs import BoxPairs
from dualarm_cli.collision.distances import box_distance, dot, segment_distance
from dualarm_cli.collision.hulls import Hulls, box_around, is_rough, keeps_form
from dualarm_cli.collision.solids import WORLD, Pair, Solid
from dualarm_cli.collision.tree import JointTree
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray

Singles = NDArray[np.float32]
"""Most pairs in most postures are far apart, and half the bytes take half the time; near ones are told exactly."""
Frames = Mapping[int, tuple[Singles, Singles]]
"""Rotations (3, 3, n) and translations (3, n) by joint."""

ROUNDED = 4e-6
"""What margins are less by, for the rounding of places in single precision, about 1e-6 at two metres [m]."""
ENOUGH = 0.01
"""Margins that balls around two solids show to be greater than this are not looked at more closely [m]."""
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
class _Rounds:
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
class _Boxes:
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
class _Planes:
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
    rounds: _Rounds
    boxes: tuple[_Boxes, ...]
    planes: _Planes
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
        _Rounds(
            np.array([number[a] for a, _, _ in rounds], dtype=np.int64),
            np.array([number[b] for _, b, _ in rounds], dtype=np.int64),
            radii,
            (radii + np.array(lengths).reshape(-1, 1)).astype(np.float32),
        ),
        tuple(
            _box_pairs(solids, hulls, tree, joint, found, number)
            for (joint, _), found in boxes.items()
        ),
        _Planes(
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


def pair_margins(group: PairGroup, frames: Frames, center: Singles, half: Singles) -> Singles:
    """Returns the margins of all q pairs of a group's hulls [m], shape (q, n), in n postures.

    Args:
        group: the pairs.
        frames: of the group's joints.
        center: middles of the capsules [m], shape (3, s, n).
        half: from there to one end [m], shape (3, s, n).
    """
    planes = group.planes
    margins = np.empty((len(group.pairs), center.shape[2]), dtype=np.float32)
    rounds, flats = len(group.rounds.first), len(planes.hulls)
    margins[:rounds] = _round_margins(group.rounds, center, half)
    if flats:
        height = dot(planes.normal, center[:, planes.hulls])
        height -= np.abs(dot(planes.normal, half[:, planes.hulls]))
        margins[rounds : rounds + flats] = height - planes.slack
    first = rounds + flats
    for boxes in group.boxes:
        last = first + len(boxes.hull)
        margins[first:last] = _box_margins(boxes, frames[boxes.joint], center, half)
        first = last
    return margins


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
) -> _Boxes:
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
    return _Boxes(
        joint,
        None if straight else axes.astype(np.float32),
        np.array(centers, dtype=np.float32).T[..., None],
        np.array(halves, dtype=np.float32).T[..., None],
        used,
        hull,
        slack,
        ball.astype(np.float32),
    )


def _round_margins(pairs: _Rounds, center: Singles, half: Singles) -> Singles:
    """Returns the margins of p pairs of capsules [m], shape (p, n), for middles and half vectors (3, s, n) [m]."""
    apart = center[:, pairs.first]
    apart -= center[:, pairs.second]
    margin = np.sqrt(dot(apart, apart))
    margin -= pairs.ball
    near = np.nonzero(margin < ENOUGH)
    if len(near[0]):
        ends = []
        for hulls in (pairs.first, pairs.second):
            at = slice(None), hulls[near[0]], near[1]
            middle, to_end = center[at].astype(np.float64), half[at].astype(np.float64)
            ends += [middle + to_end, middle - to_end]
        margin[near] = segment_distance(*ends) - pairs.slack[near[0], 0]
    return margin


def _box_margins(
    boxes: _Boxes, frame: tuple[Singles, Singles], center: Singles, half: Singles
) -> Singles:
    """Returns the margins of p capsules from boxes [m], shape (p, n), for middles and half vectors (3, s, n) [m].

    By the balls around the capsules, along the axes that the boxes have in common; the nearest ones exactly.
    """
    R, p = frame
    middle = center[:, boxes.hulls]
    if boxes.joint != WORLD:
        middle -= p[:, None]
    apart = _seen(boxes, R, middle)[:, boxes.hull]
    apart -= boxes.p
    margin = _from_balls(apart, boxes.half, boxes.ball)
    pair, row = np.nonzero(margin < ENOUGH)
    if not len(pair):
        return margin
    middle = apart[:, pair, row]
    to_end = _seen(boxes, R[:, :, row], half[:, boxes.hulls[boxes.hull[pair]], row])
    ends = [(middle + sign * to_end).astype(np.float64) for sign in (1.0, -1.0)]
    exact = box_distance(ends[0], ends[1], boxes.half[:, pair, 0].astype(np.float64))
    margin[pair, row] = exact - boxes.slack[pair, 0]
    return margin


def _from_balls(middle: Singles, half: Singles, ball: Singles) -> Singles:
    """Returns how far balls about middles (3, ...) are from boxes about the origin at least [m], shape (...)."""
    outside = np.abs(middle)
    outside -= half
    np.maximum(outside, 0.0, out=outside)
    found: Singles = np.sqrt(dot(outside, outside))
    found -= ball
    return found


def _seen(boxes: _Boxes, R: Singles, x: Singles) -> Singles:
    """Returns vectors (3, ..., n) along the axes of boxes, of that shape, for rotations (3, 3, n) of their joint."""
    if boxes.joint != WORLD:
        x = np.stack([dot(R[:, k], x) for k in range(3)])
    if boxes.axes is None:
        return x
    found: Singles = (boxes.axes @ x.reshape(3, -1)).reshape(x.shape)
    return found
