"""A quick test of many postures: moving solids in round hulls, all pairs in arrays; what it calls free is free."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import coal
import numpy as np
import pinocchio as pin

from dualarm_cli.collision.distances import box_distance, dot, segment_distance
from dualarm_cli.collision.reach import can_meet
from dualarm_cli.collision.solids import (
    WORLD,
    Pair,
    Solid,
    cell_solids,
    pairs_that_must_keep_apart,
)
from dualarm_cli.collision.tree import JointTree
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.model.cell import Cell

Frames = Mapping[int, tuple[FloatArray, FloatArray]]
"""Rotations (3, 3, n) and translations (3, n) by joint."""

BLOCK = 20_000
"""Pairs in postures that are tested at a time: their arrays stay in the cache."""
LEAST_ROWS = 128
"""Postures that are tested at a time at least."""
ENOUGH = 0.01
"""Margins that balls around two solids show to be greater than this are not looked at more closely [m]."""
ALIGNED = 1e-12
"""Boxes whose axes are off those of their joint's frame by no more are along it."""
DOUBTED = 0.004
"""Margins below this of solids in hulls wider than they are are looked at by coal, if all else keeps clear [m]."""


@dataclass(frozen=True)
class _Hulls:
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
    hulls: _Hulls
    rounds: _Rounds
    boxes: tuple[_Boxes, ...]
    planes: _Planes
    pairs: tuple[Pair, ...]
    """The pairs in the order of rounds, planes and boxes, q of them."""
    rough: BoolArray
    """Whether a hull of the pair is wider than the solid, shape (q,)."""


class QuickTest:
    """Round hulls of all moving solids of a cell, and its pairs by which joints move them."""

    def __init__(self, cell: Cell, carried: Sequence[tuple[str, str]] = ()) -> None:
        """Prepares a cell.

        Args:
            cell: the noun.
            carried: arm and part for every part that an arm ever carries.

        Raises:
            InputError: a mesh that cannot be used.
        """
        robot = cell.robot
        model = pin.buildModelFromXML(robot.urdf)
        self._tree = JointTree.of(model, robot.joints)
        self._solids = cell_solids(cell, model, carried)
        self._pairs = [
            pair
            for pair in pairs_that_must_keep_apart(model, self._solids, cell)
            if can_meet(model, self._solids[pair.first], self._solids[pair.second], pair, ENOUGH)
        ]
        hulls = [_hull(solid, self._tree) for solid in self._solids]
        self._center = np.array([0.5 * (a + b) for a, b, _ in hulls])
        self._half = np.array([0.5 * (a - b) for a, b, _ in hulls])
        self._radius = np.array([radius for *_, radius in hulls])
        self._length = np.linalg.norm(self._half, axis=1)
        members = {arm.name: set(arm.joints) for arm in robot.arms}
        self.arms = tuple(members)
        """Names of the arms."""
        self._moved_by = [_movers(model, solid, members) for solid in self._solids]
        self._groups: dict[tuple[str, ...], PairGroup] = {}

    def own(self, arm: str, part: str = "", on_line: bool = False) -> PairGroup:
        """Returns the pairs that one arm's joints or only the platform's move.

        Args:
            arm: its name.
            part: what it carries, if anything.
            on_line: whether it is on one of a stop's lines: there a part may touch what stands still.
        """
        key = ("own", arm, part, "line" if on_line else "")
        if key not in self._groups:
            self._groups[key] = self._group(self._own_pairs(arm, part, on_line))
        return self._groups[key]

    def _own_pairs(self, arm: str, part: str, on_line: bool) -> list[Pair]:
        return [
            pair
            for pair in self._pairs
            if self._movers_of(pair) <= {arm}
            and self._carries(pair, {arm: part})
            and not (on_line and self._part_on_ground(pair))
        ]

    def cross(self, parts: Mapping[str, str] | None = None) -> PairGroup:
        """Returns the pairs of one arm with the other.

        Args:
            parts: what each arm carries, if anything, by arm.
        """
        carried = parts or {}
        key = ("cross", *(carried.get(arm, "") for arm in self.arms))
        if key not in self._groups:
            self._groups[key] = self._group(
                [
                    pair
                    for pair in self._pairs
                    if len(self._movers_of(pair)) == 2 and self._carries(pair, carried)
                ]
            )
        return self._groups[key]

    def margins(self, group: PairGroup, position: FloatArray) -> FloatArray:
        """Returns a bound below the least of distance less required clearance over a group's pairs [m], shape (n,).

        Args:
            group: of this test.
            position: all joints of the robot [rad], shape (n, columns).
        """
        least = np.full(len(position), np.inf)
        if group.pairs:
            rows = max(LEAST_ROWS, BLOCK // len(group.pairs))
            for k in range(0, len(position), rows):
                least[k : k + rows] = self._block(group, position[k : k + rows])
        return least

    def nearest(
        self, position: FloatArray, parts: Mapping[str, str] | None = None
    ) -> tuple[str, str, float]:
        """Returns the two bodies of all pairs that have the least margin at one configuration, and it [m]; by coal.

        Args:
            position: all joints of the robot [rad], shape (columns,).
            parts: what each arm carries, if anything, by arm.
        """
        return self._nearest(
            position, [pair for pair in self._pairs if self._carries(pair, parts or {})]
        )

    def nearest_of_own(
        self, arm: str, position: FloatArray, part: str = "", on_line: bool = False
    ) -> tuple[str, str, float]:
        """Returns the same among the pairs of one arm's own group; arguments as of `own`."""
        return self._nearest(position, self._own_pairs(arm, part, on_line))

    def _nearest(self, position: FloatArray, pairs: Sequence[Pair]) -> tuple[str, str, float]:
        frames = self._tree.frames(position[None], {s.joint for s in self._solids})
        margins = [self._margin(pair, frames, 0) for pair in pairs]
        worst = int(np.argmin(margins))
        one, other = self._solids[pairs[worst].first], self._solids[pairs[worst].second]
        return one.body, other.body, margins[worst]

    def _movers_of(self, pair: Pair) -> set[str]:
        return self._moved_by[pair.first] | self._moved_by[pair.second]

    def _carries(self, pair: Pair, parts: Mapping[str, str]) -> bool:
        """Returns whether all parts of a pair are carried."""
        solids = (self._solids[pair.first], self._solids[pair.second])
        return all(parts.get(s.carrier, "") == s.body for s in solids if s.carrier)

    def _part_on_ground(self, pair: Pair) -> bool:
        """Returns whether a pair is a part and something that stands still."""
        solids = (self._solids[pair.first], self._solids[pair.second])
        return any(s.carrier for s in solids) and any(s.joint == WORLD for s in solids)

    def _block(self, group: PairGroup, position: FloatArray) -> FloatArray:
        n = len(position)
        frames = self._tree.frames(position, group.joints)
        hulls = group.hulls
        center, half = np.empty((2, 3, len(hulls.center), n))
        for joint, low, high in hulls.joints:
            R, p = frames[joint]
            center[:, low:high] = p[:, None] + hulls.center[low:high] @ R
            half[:, low:high] = hulls.half[low:high] @ R
        planes = group.planes
        height = dot(planes.normal, center[:, planes.hulls])
        height -= np.abs(dot(planes.normal, half[:, planes.hulls]))
        margins = np.concatenate(
            [
                _round_margins(group.rounds, center, half),
                height - planes.slack,
                *(_box_margins(box, frames[box.joint], center, half) for box in group.boxes),
            ]
        )
        if group.rough.any():
            sure = margins[~group.rough].min(axis=0, initial=np.inf) >= 0.0
            doubted = group.rough[:, None] & (margins < DOUBTED) & sure
            for number, row in np.argwhere(doubted).tolist():
                margins[number, row] = self._margin(group.pairs[number], frames, row)
        least: FloatArray = margins.min(axis=0)
        return least

    def _margin(self, pair: Pair, frames: Frames, row: int) -> float:
        """Returns distance less required clearance of one pair in one of n postures, by coal [m]."""
        places = []
        for number in (pair.first, pair.second):
            solid = self._solids[number]
            R, p = frames[solid.joint]
            R_joint = R[..., row] @ self._tree.R_joint_own[solid.joint].T
            places.append(
                coal.Transform3s(
                    R_joint @ solid.pose.rotation,
                    p[:, row] + R_joint @ solid.pose.translation,
                )
            )
        one, other = self._solids[pair.first].geometry, self._solids[pair.second].geometry
        result = coal.DistanceResult()
        coal.distance(one, places[0], other, places[1], coal.DistanceRequest(), result)
        return float(result.min_distance) - pair.required

    def _group(self, pairs: Sequence[Pair]) -> PairGroup:
        rounds: list[tuple[int, int, float]] = []
        boxes: dict[int, list[tuple[int, int, float]]] = {}
        planes: list[tuple[int, FloatArray, float]] = []
        kinds: list[list[Pair]] = [[], []]
        boxed: dict[int, list[Pair]] = {}
        for pair in pairs:
            one, other = pair.first, pair.second
            # The one that is kept as it is: what stands, or else a box.
            if _keeps_form(self._solids[one]) and not _keeps_form(self._solids[other]):
                one, other = other, one
            solid = self._solids[other]
            slack = float(self._radius[one]) + pair.required
            if isinstance(solid.geometry, coal.Halfspace):
                normal = solid.pose.rotation @ np.asarray(solid.geometry.n).ravel()
                offset = float(solid.geometry.d + normal @ solid.pose.translation)
                planes.append((one, normal, offset + slack))
                kinds[1].append(pair)
            elif _keeps_form(solid):
                boxes.setdefault(solid.joint, []).append((one, other, slack))
                boxed.setdefault(solid.joint, []).append(pair)
            else:
                kinds[0].append(pair)
                rounds.append((one, other, slack + float(self._radius[other])))
        used = {hull for one, other, _ in rounds for hull in (one, other)}
        used |= {hull for found in boxes.values() for hull, *_ in found}
        used |= {hull for hull, *_ in planes}
        order = sorted(used, key=lambda hull: (self._solids[hull].joint, hull))
        number = {hull: k for k, hull in enumerate(order)}
        joints = [self._solids[hull].joint for hull in order]
        spans = []
        for joint in dict.fromkeys(joints):
            low = joints.index(joint)
            spans.append((joint, low, low + joints.count(joint)))
        ordered = (*kinds[0], *kinds[1], *(pair for some in boxed.values() for pair in some))
        radii = np.array([s for *_, s in rounds]).reshape(-1, 1)
        lengths = [self._length[a] + self._length[b] for a, b, _ in rounds]
        return PairGroup(
            frozenset({*joints, *boxes}),
            _Hulls(
                tuple(spans),
                self._center[order].reshape(-1, 3),
                self._half[order].reshape(-1, 3),
            ),
            _Rounds(
                np.array([number[a] for a, _, _ in rounds], dtype=np.int64),
                np.array([number[b] for _, b, _ in rounds], dtype=np.int64),
                radii,
                radii + np.array(lengths).reshape(-1, 1),
            ),
            tuple(self._box_pairs(joint, found, number) for joint, found in boxes.items()),
            _Planes(
                np.array([number[hull] for hull, *_ in planes], dtype=np.int64),
                np.array([normal for _, normal, _ in planes]).reshape(-1, 3).T[..., None],
                np.array([s for *_, s in planes]).reshape(-1, 1),
            ),
            ordered,
            np.array([self._is_rough(pair) for pair in ordered], dtype=np.bool_),
        )

    def _is_rough(self, pair: Pair) -> bool:
        """Returns whether the quick margin of a pair may be less than the true one."""
        forms = [self._solids[number].geometry for number in (pair.first, pair.second)]
        exact = [isinstance(form, coal.Capsule | coal.Sphere) for form in forms]
        boxes = [isinstance(form, coal.Box | coal.Halfspace) for form in forms]
        return not (all(exact) or (any(exact) and any(boxes)))

    def _box_pairs(
        self, joint: int, found: Sequence[tuple[int, int, float]], number: Mapping[int, int]
    ) -> _Boxes:
        """Returns pairs of boxes that move with one joint; found are capsule, box and slack."""
        own = self._tree.R_joint_own[joint].T
        axes, centers, halves = [], [], []
        for _, box, _ in found:
            solid = self._solids[box]
            center, half = _bounds(solid.geometry)
            axes.append((own @ solid.pose.rotation).T)
            centers.append(own @ np.asarray(solid.pose.act(center)))
            halves.append(half)
        aligned = np.abs(np.array(axes) - np.eye(3)).max() < ALIGNED
        slack = np.array([s for *_, s in found]).reshape(-1, 1)
        return _Boxes(
            joint,
            None if aligned else np.moveaxis(np.array(axes), 0, 2)[..., None],
            np.array(centers).T[..., None],
            np.array(halves).T[..., None],
            np.array([number[hull] for hull, *_ in found], dtype=np.int64),
            slack,
            slack + self._length[[hull for hull, *_ in found]][:, None],
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
    """Returns the margins of p capsules from boxes [m], shape (p, n), for middles and half vectors (3, h, n) [m]."""
    R, p = frame
    middle = center[:, boxes.hulls]
    if boxes.joint != WORLD:
        middle = _along(R.transpose(1, 0, 2)[:, :, None], middle - p[:, None])
    middle = middle - boxes.p
    if boxes.axes is not None:
        middle = _along(boxes.axes, middle)
    outside = np.maximum(np.abs(middle) - boxes.half, 0.0)
    margin = np.sqrt(dot(outside, outside)) - boxes.ball
    near = np.nonzero(margin < ENOUGH)
    if len(near[0]):
        pair, row = near
        to_end = half[:, boxes.hulls[pair], row]
        if boxes.joint != WORLD:
            to_end = _along(R.transpose(1, 0, 2)[:, :, row], to_end)
        if boxes.axes is not None:
            to_end = _along(boxes.axes[:, :, pair, 0], to_end)
        middle = middle[:, pair, row]
        exact = box_distance(middle + to_end, middle - to_end, boxes.half[:, pair, 0])
        margin[near] = exact - boxes.slack[pair, 0]
    return margin


def _along(axes: FloatArray, x: FloatArray) -> FloatArray:
    """Returns components of vectors (3, ...) along three axes each, of shape (3 axes, 3, ...), broadcast."""
    return np.stack([dot(axis, x) for axis in axes])


def _movers(model: pin.Model, solid: Solid, members: dict[str, set[str]]) -> set[str]:
    """Returns the arms whose joints move a solid."""
    found, joint = set(), solid.joint
    while joint != WORLD:
        found |= {arm for arm, joints in members.items() if model.names[joint] in joints}
        joint = model.parents[joint]
    return found


def _keeps_form(solid: Solid) -> bool:
    """Returns whether a solid is tested as a box or half-space rather than as a round hull."""
    return isinstance(
        solid.geometry, coal.Halfspace | coal.Box | coal.ConvexBase
    ) and not isinstance(solid.geometry, coal.Capsule | coal.Sphere | coal.Cylinder)


def _bounds(geometry: coal.CollisionGeometry) -> tuple[FloatArray, FloatArray]:
    """Returns centre and half sides of the box around a solid in its own frame [m]."""
    if isinstance(geometry, coal.Box):
        return np.zeros(3), np.array(geometry.halfSide).ravel()
    geometry.computeLocalAABB()
    low = np.array(geometry.aabb_local.min_).ravel()
    high = np.array(geometry.aabb_local.max_).ravel()
    return 0.5 * (low + high), 0.5 * (high - low)


def _hull(solid: Solid, tree: JointTree) -> tuple[FloatArray, FloatArray, float]:
    """Returns both ends, in the tree's frame of its joint, and the radius of a capsule around a solid [m].

    A cylinder lies within the capsule about its own axis, a box within that about its longest side's middle line with
    half the diagonal of the others as its radius. A half-space has none, and is never asked for it.
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
        center, half = _bounds(form)
        longest = int(np.argmax(half))
        end[longest] = half[longest]
        radius = float(np.linalg.norm(np.delete(half, longest)))
    own = tree.R_joint_own[solid.joint].T
    one, other = (own @ np.asarray(solid.pose.act(center + sign * end)) for sign in (1.0, -1.0))
    return one, other, radius
