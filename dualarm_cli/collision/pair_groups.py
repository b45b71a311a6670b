"""Pairs of solids in arrays, and the margins of their hulls in many postures at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import coal
import numpy as np

from dualarm_cli.collision.distances import box_distance, dot, segment_distance
from dualarm_cli.collision.hulls import Hulls, box_around, is_rough, keeps_form
from dualarm_cli.collision.solids import WORLD, Pair, Solid
from dualarm_cli.collision.tree import JointTree
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray

Frames = Mapping[int, tuple[FloatArray, FloatArray]]
"""Rotations (3, 3, n) and translations (3, n) by joint."""

ENOUGH = 0.01
"""Margins that balls around two solids show to be greater than this are not looked at more closely [m]."""
ALIGNED = 1e-12
"""Boxes whose axes are off those of their joint's frame by no more are along it."""


@dataclass(frozen=True)
class _Capsules:
    """Capsules that move with joints, joint by joint."""

    joints: tuple[tuple[int, int, int], ...]
    """Joint, first capsule and the one after the last."""
    center: FloatArray
    """Middle of each in its joint's frame [m], shape (h, 3)."""
    half: FloatArray
    """From there to one end [m], shape (h, 3)."""


@dataclass(frozen=True)
class _Rounds:
    """Pairs of capsules."""

    first: IntArray
    """Capsules on the one side, shape (p,)."""
    second: IntArray
    """Capsules on the other side, shape (p,)."""
    slack: FloatArray
    """Both radii and the required clearance [m], shape (p, 1)."""
    ball: FloatArray
    """The same and both half lengths, shape (p, 1)."""


@dataclass(frozen=True)
class _Boxes:
    """Pairs of a capsule and a box; all boxes move with one joint, or all of them stand."""

    joint: int
    """The joint that they move with."""
    axes: FloatArray | None
    """Axes of each pair's box in the joint's frame, shape (3 axes, 3, p, 1); None where all are along that frame's."""
    p: FloatArray
    """Its centre there [m], shape (3, p, 1)."""
    half: FloatArray
    """Half sides [m], shape (3, p, 1)."""
    hulls: IntArray
    """The capsules, shape (p,)."""
    slack: FloatArray
    """Their radii and the required clearances [m], shape (p, 1)."""
    ball: FloatArray
    """The same and their half lengths, shape (p, 1)."""
    both: FloatArray
    """The same and the radii of the balls around the boxes, shape (p, 1)."""


@dataclass(frozen=True)
class _Planes:
    """Pairs of a capsule and a half-space that stands in the root link's frame."""

    hulls: IntArray
    """The capsules, shape (p,)."""
    normal: FloatArray
    """Outward unit normals, shape (3, p, 1)."""
    slack: FloatArray
    """Where the planes are along them, the capsules' radii and the required clearances [m], shape (p, 1)."""


@dataclass(frozen=True)
class PairGroup:
    """Pairs that are tested together."""

    joints: frozenset[int]
    """Joints whose frames are needed."""
    hulls: _Capsules
    rounds: _Rounds
    boxes: tuple[_Boxes, ...]
    planes: _Planes
    pairs: tuple[Pair, ...]
    """The pairs in the order of rounds, planes and boxes, q of them."""
    rough: BoolArray
    """Whether a hull of the pair is wider than the solid, shape (q,)."""


def pair_group(
    solids: Sequence[Solid], hulls: Hulls, tree: JointTree, pairs: Sequence[Pair]
) -> PairGroup:
    """Returns pairs of solids as arrays.

    Args:
        solids: of the cell.
        hulls: around them.
        tree: of the robot.
        pairs: of the solids.
    """
    rounds: list[tuple[int, int, float]] = []
    boxes: dict[int, list[tuple[int, int, float]]] = {}
    planes: list[tuple[int, FloatArray, float]] = []
    kinds: list[list[Pair]] = [[], []]
    boxed: dict[int, list[Pair]] = {}
    for pair in pairs:
        one, other = pair.first, pair.second
        # The one that is kept as it is: what stands, or else a box.
        if keeps_form(solids[one]) and not keeps_form(solids[other]):
            one, other = other, one
        solid = solids[other]
        slack = float(hulls.radius[one]) + pair.required
        if isinstance(solid.geometry, coal.Halfspace):
            normal = solid.pose.rotation @ np.asarray(solid.geometry.n).ravel()
            offset = float(solid.geometry.d + normal @ solid.pose.translation)
            planes.append((one, normal, offset + slack))
            kinds[1].append(pair)
        elif keeps_form(solid):
            boxes.setdefault(solid.joint, []).append((one, other, slack))
            boxed.setdefault(solid.joint, []).append(pair)
        else:
            kinds[0].append(pair)
            rounds.append((one, other, slack + float(hulls.radius[other])))
    used = {hull for one, other, _ in rounds for hull in (one, other)}
    used |= {hull for found in boxes.values() for hull, *_ in found}
    used |= {hull for hull, *_ in planes}
    order = sorted(used, key=lambda hull: (solids[hull].joint, hull))
    number = {hull: k for k, hull in enumerate(order)}
    joints = [solids[hull].joint for hull in order]
    spans = []
    for joint in dict.fromkeys(joints):
        low = joints.index(joint)
        spans.append((joint, low, low + joints.count(joint)))
    ordered = (*kinds[0], *kinds[1], *(pair for some in boxed.values() for pair in some))
    radii = np.array([s for *_, s in rounds]).reshape(-1, 1)
    lengths = [hulls.length[a] + hulls.length[b] for a, b, _ in rounds]
    return PairGroup(
        frozenset({*joints, *boxes}),
        _Capsules(
            tuple(spans),
            hulls.center[order].reshape(-1, 3),
            hulls.half[order].reshape(-1, 3),
        ),
        _Rounds(
            np.array([number[a] for a, _, _ in rounds], dtype=np.int64),
            np.array([number[b] for _, b, _ in rounds], dtype=np.int64),
            radii,
            radii + np.array(lengths).reshape(-1, 1),
        ),
        tuple(
            _box_pairs(solids, hulls, tree, joint, found, number) for joint, found in boxes.items()
        ),
        _Planes(
            np.array([number[hull] for hull, *_ in planes], dtype=np.int64),
            np.array([normal for _, normal, _ in planes]).reshape(-1, 3).T[..., None],
            np.array([s for *_, s in planes]).reshape(-1, 1),
        ),
        ordered,
        np.array(
            [is_rough(solids[pair.first], solids[pair.second]) for pair in ordered], dtype=np.bool_
        ),
    )


def pair_margins(group: PairGroup, frames: Frames, n: int) -> FloatArray:
    """Returns the margins of all q pairs of a group's hulls [m], shape (q, n).

    Args:
        group: the pairs.
        frames: of the group's joints in n postures.
        n: how many postures.
    """
    hulls, planes = group.hulls, group.planes
    center, half = np.empty((2, 3, len(hulls.center), n))
    for joint, low, high in hulls.joints:
        R, p = frames[joint]
        center[:, low:high] = p[:, None] + hulls.center[low:high] @ R
        half[:, low:high] = hulls.half[low:high] @ R
    height = dot(planes.normal, center[:, planes.hulls])
    height -= np.abs(dot(planes.normal, half[:, planes.hulls]))
    return np.concatenate(
        [
            _round_margins(group.rounds, center, half),
            height - planes.slack,
            *(_box_margins(box, frames[box.joint], center, half) for box in group.boxes),
        ]
    )


def _box_pairs(
    solids: Sequence[Solid],
    hulls: Hulls,
    tree: JointTree,
    joint: int,
    found: Sequence[tuple[int, int, float]],
    number: Mapping[int, int],
) -> _Boxes:
    """Returns pairs of boxes that move with one joint; found are capsule, box and slack."""
    own = tree.R_joint_own[joint].T
    axes, centers, halves = [], [], []
    for _, box, _ in found:
        solid = solids[box]
        center, half = box_around(solid.geometry)
        axes.append((own @ solid.pose.rotation).T)
        centers.append(own @ np.asarray(solid.pose.act(center)))
        halves.append(half)
    aligned = np.abs(np.array(axes) - np.eye(3)).max() < ALIGNED
    slack = np.array([s for *_, s in found]).reshape(-1, 1)
    ball = slack + hulls.length[[hull for hull, *_ in found]][:, None]
    return _Boxes(
        joint,
        None if aligned else np.moveaxis(np.array(axes), 0, 2)[..., None],
        np.array(centers).T[..., None],
        np.array(halves).T[..., None],
        np.array([number[hull] for hull, *_ in found], dtype=np.int64),
        slack,
        ball,
        ball + np.linalg.norm(halves, axis=1)[:, None],
    )


def _round_margins(pairs: _Rounds, center: FloatArray, half: FloatArray) -> FloatArray:
    """Returns the margins of p pairs of capsules [m], shape (p, n), for middles and half vectors (3, h, n) [m]."""
    apart = center[:, pairs.first] - center[:, pairs.second]
    margin = np.sqrt(dot(apart, apart)) - pairs.ball
    near = np.nonzero(margin < ENOUGH)
    if len(near[0]):
        ends = []
        for hulls in (pairs.first, pairs.second):
            middle, to_end = center[:, hulls[near[0]], near[1]], half[:, hulls[near[0]], near[1]]
            ends += [middle + to_end, middle - to_end]
        margin[near] = segment_distance(*ends) - pairs.slack[near[0], 0]
    return margin


def _box_margins(
    boxes: _Boxes, frame: tuple[FloatArray, FloatArray], center: FloatArray, half: FloatArray
) -> FloatArray:
    """Returns the margins of p capsules from boxes [m], shape (p, n), for middles and half vectors (3, h, n) [m].

    By balls around both; nearer ones by the ball around the capsule and the box; the nearest ones exactly.
    """
    R, p = frame
    apart = center[:, boxes.hulls]
    if boxes.joint == WORLD:
        apart -= boxes.p
    else:
        apart -= p[:, None] + boxes.p[..., 0].T @ R
    margin = np.sqrt(dot(apart, apart)) - boxes.both
    pair, row = np.nonzero(margin < ENOUGH)
    if not len(pair):
        return margin
    middle = _seen(boxes, R, pair, row, apart[:, pair, row])
    sides = boxes.half[:, pair, 0]
    outside = np.maximum(np.abs(middle) - sides, 0.0)
    found = np.sqrt(dot(outside, outside)) - boxes.ball[pair, 0]
    near = np.flatnonzero(found < ENOUGH)
    if len(near):
        pairs, rows = pair[near], row[near]
        to_end = _seen(boxes, R, pairs, rows, half[:, boxes.hulls[pairs], rows])
        middle = middle[:, near]
        exact = box_distance(middle + to_end, middle - to_end, sides[:, near])
        found[near] = exact - boxes.slack[pairs, 0]
    margin[pair, row] = found
    return margin


def _seen(boxes: _Boxes, R: FloatArray, pair: IntArray, row: IntArray, x: FloatArray) -> FloatArray:
    """Returns vectors (3, m) along the axes of the boxes of some pairs in some postures, shape (3, m)."""
    if boxes.joint != WORLD:
        x = _along(R.transpose(1, 0, 2)[:, :, row], x)
    return x if boxes.axes is None else _along(boxes.axes[:, :, pair, 0], x)


def _along(axes: FloatArray, x: FloatArray) -> FloatArray:
    """Returns components of vectors (3, ...) along three axes each, of shape (3 axes, 3, ...), broadcast."""
    return np.stack([dot(axis, x) for axis in axes])
