"""A quick test of many postures: moving solids in round hulls, all pairs in arrays; what it calls free is free."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import coal
import numpy as np
import pinocchio as pin

from dualarm_cli.collision.distances import box_distance, segment_distance
from dualarm_cli.collision.solids import (
    WORLD,
    Pair,
    Solid,
    cell_solids,
    pairs_that_must_keep_apart,
)
from dualarm_cli.collision.tree import JointTree
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.cell import Cell

BLOCK = 2048
"""Postures that are tested at a time: their arrays stay in the cache."""


@dataclass(frozen=True)
class _Rounds:
    """Pairs of segments with radii."""

    first: tuple[int, ...]
    """Hulls on the one side, p of them."""
    second: tuple[int, ...]
    """Hulls on the other side."""
    slack: FloatArray
    """Both radii and the required clearance [m], shape (p,)."""


@dataclass(frozen=True)
class _Boxes:
    """Pairs of a segment and a box that moves with a joint (or stands)."""

    hulls: tuple[int, ...]
    """Segments, p of them."""
    joints: tuple[int, ...]
    """The joint that each box moves with."""
    R: FloatArray
    """Rotation of each box in its joint's frame, shape (p, 3, 3)."""
    p: FloatArray
    """Its centre there [m], shape (p, 3)."""
    half: FloatArray
    """Half sides [m], shape (p, 3)."""
    slack: FloatArray
    """Radius and required clearance [m], shape (p,)."""


@dataclass(frozen=True)
class _Planes:
    """Pairs of a segment and a half-space that stands in the root link's frame."""

    hulls: tuple[int, ...]
    """Segments, p of them."""
    normal: FloatArray
    """Outward unit normals, shape (p, 3)."""
    offset: FloatArray
    """The planes are normal·x = offset [m], shape (p,)."""
    slack: FloatArray
    """Radius and required clearance [m], shape (p,)."""


@dataclass(frozen=True)
class PairGroup:
    """Pairs that are tested together."""

    joints: frozenset[int]
    """Joints whose frames are needed."""
    rounds: _Rounds
    boxes: _Boxes
    planes: _Planes

    @property
    def empty(self) -> bool:
        """Whether there is nothing to test."""
        return not (self.rounds.first or self.boxes.hulls or self.planes.hulls)


class QuickTest:
    """Round hulls of all moving solids of a cell, and its pairs by which joints move them."""

    def __init__(self, cell: Cell) -> None:
        """Prepares a cell; parts are left out.

        Raises:
            InputError: a mesh that cannot be used.
        """
        robot = cell.robot
        model = pin.buildModelFromXML(robot.urdf)
        self._tree = JointTree.of(model, robot.joints)
        solids = cell_solids(cell, model, [])
        pairs = pairs_that_must_keep_apart(model, solids, cell)
        hulls = [_hull(solid) for solid in solids]
        self._solids, self._pairs = solids, pairs
        self._joint = [solid.joint for solid in solids]
        self._a = np.array([hull[0] for hull in hulls])
        self._b = np.array([hull[1] for hull in hulls])
        self._radius = np.array([hull[2] for hull in hulls])
        members = {arm.name: set(arm.joints) for arm in robot.arms}
        moved_by = [_movers(model, solid, members) for solid in solids]
        own: dict[str, list[Pair]] = {name: [] for name in members}
        cross: list[Pair] = []
        for pair in pairs:
            arms = moved_by[pair.first] | moved_by[pair.second]
            if len(arms) == 2:
                cross.append(pair)
            elif arms:
                own[next(iter(arms))].append(pair)
        self.own = {name: self._group(solids, found) for name, found in own.items()}
        """Pairs that one arm's joints (and the platform) move, by arm."""
        self.cross = self._group(solids, cross)
        """Pairs of one arm with the other."""

    def margins(self, group: PairGroup, position: FloatArray) -> FloatArray:
        """Returns a bound below the least of distance less required clearance over a group's pairs [m], shape (n,).

        Args:
            group: of this test.
            position: all joints of the robot [rad], shape (n, columns).
        """
        least = np.full(len(position), np.inf)
        if not group.empty:
            for k in range(0, len(position), BLOCK):
                least[k : k + BLOCK] = self._block(group, position[k : k + BLOCK])
        return least

    def nearest(self, position: FloatArray) -> tuple[str, str, float]:
        """Returns the two bodies of all pairs that have the least margin at one configuration, and it [m]; by coal.

        Args:
            position: all joints of the robot [rad], shape (columns,).
        """
        frames = self._tree.frames(position[None], frozenset(self._joint))
        places = [
            pin.SE3(frames[s.joint][0][0], frames[s.joint][1][0]) * s.pose for s in self._solids
        ]
        best = ("", "", np.inf)
        request = coal.DistanceRequest()
        for pair in self._pairs:
            one, other = self._solids[pair.first], self._solids[pair.second]
            result = coal.DistanceResult()
            transforms = [
                coal.Transform3s(places[k].rotation, places[k].translation)
                for k in (pair.first, pair.second)
            ]
            distance = coal.distance(
                one.geometry, transforms[0], other.geometry, transforms[1], request, result
            )
            if distance - pair.required < best[2]:
                best = (one.body, other.body, float(distance - pair.required))
        return best

    def _block(self, group: PairGroup, position: FloatArray) -> FloatArray:
        frames = self._tree.frames(position, group.joints)
        ends: dict[int, tuple[FloatArray, FloatArray]] = {}

        def segments(hulls: Sequence[int]) -> tuple[FloatArray, FloatArray]:
            for hull in hulls:
                if hull not in ends:
                    R, p = frames[self._joint[hull]]
                    ends[hull] = p + R @ self._a[hull], p + R @ self._b[hull]
            a = np.stack([ends[hull][0] for hull in hulls], axis=1)
            b = np.stack([ends[hull][1] for hull in hulls], axis=1)
            return a, b

        least = np.full(len(position), np.inf)
        rounds = group.rounds
        if rounds.first:
            distance = segment_distance(*segments(rounds.first), *segments(rounds.second))
            least = np.minimum(least, (distance - rounds.slack).min(axis=1))
        planes = group.planes
        if planes.hulls:
            a, b = segments(planes.hulls)
            height = np.minimum((a * planes.normal).sum(-1), (b * planes.normal).sum(-1))
            least = np.minimum(least, (height - planes.offset - planes.slack).min(axis=1))
        boxes = group.boxes
        if boxes.hulls:
            a, b = segments(boxes.hulls)
            R = np.stack([frames[j][0] for j in boxes.joints], axis=1) @ boxes.R
            p = np.stack(
                [
                    frames[j][1] + frames[j][0] @ x
                    for j, x in zip(boxes.joints, boxes.p, strict=True)
                ],
                axis=1,
            )
            local = [((x - p)[..., None, :] @ R)[..., 0, :] for x in (a, b)]
            # A ball around the segment first: most pairs are far apart.
            middle, reach = 0.5 * (local[0] + local[1]), 0.5 * np.linalg.norm(b - a, axis=-1)
            outside = np.maximum(np.abs(middle) - boxes.half, 0.0)
            margin = np.sqrt((outside * outside).sum(-1)) - reach - boxes.slack
            near = margin < np.maximum(0.0, np.minimum(least, 0.0)[:, None])
            rows, columns = np.nonzero(near)
            if len(rows):
                exact = box_distance(
                    local[0][rows, columns], local[1][rows, columns], boxes.half[columns]
                )
                margin[rows, columns] = exact - boxes.slack[columns]
            least = np.minimum(least, margin.min(axis=1))
        return least

    def _group(self, solids: Sequence[Solid], pairs: Sequence[Pair]) -> PairGroup:
        rounds: list[tuple[int, int, float]] = []
        boxes: list[tuple[int, int, FloatArray, FloatArray, FloatArray, float]] = []
        planes: list[tuple[int, FloatArray, float, float]] = []
        joints: set[int] = set()
        for pair in pairs:
            one, other = pair.first, pair.second
            # The one that is kept as it is: what stands, or else a box.
            if _keeps_form(solids[one]) and not _keeps_form(solids[other]):
                one, other = other, one
            solid = solids[other]
            joints |= {solids[one].joint, solid.joint}
            slack = float(self._radius[one]) + pair.required
            if isinstance(solid.geometry, coal.Halfspace):
                normal = solid.pose.rotation @ np.asarray(solid.geometry.n).ravel()
                offset = float(solid.geometry.d + normal @ solid.pose.translation)
                planes.append((one, normal, offset, slack))
            elif _keeps_form(solid):
                R, p, half = _box(solid)
                boxes.append((one, solid.joint, R, p, half, slack))
            else:
                rounds.append((one, other, slack + float(self._radius[other])))
        return PairGroup(
            frozenset(joints - {WORLD}) | {WORLD},
            _Rounds(
                tuple(r[0] for r in rounds),
                tuple(r[1] for r in rounds),
                np.array([r[2] for r in rounds]),
            ),
            _Boxes(
                tuple(x[0] for x in boxes),
                tuple(x[1] for x in boxes),
                np.array([x[2] for x in boxes]).reshape(-1, 3, 3),
                np.array([x[3] for x in boxes]).reshape(-1, 3),
                np.array([x[4] for x in boxes]).reshape(-1, 3),
                np.array([x[5] for x in boxes]),
            ),
            _Planes(
                tuple(x[0] for x in planes),
                np.array([x[1] for x in planes]).reshape(-1, 3),
                np.array([x[2] for x in planes]),
                np.array([x[3] for x in planes]),
            ),
        )


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


def _box(solid: Solid) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns rotation, centre and half sides of the box around a solid, in its joint's frame."""
    center, half = _bounds(solid.geometry)
    return solid.pose.rotation, np.asarray(solid.pose.act(center)), half


def _bounds(geometry: coal.CollisionGeometry) -> tuple[FloatArray, FloatArray]:
    """Returns centre and half sides of the box around a solid in its own frame [m]."""
    if isinstance(geometry, coal.Box):
        return np.zeros(3), np.array(geometry.halfSide).ravel()
    geometry.computeLocalAABB()
    low = np.array(geometry.aabb_local.min_).ravel()
    high = np.array(geometry.aabb_local.max_).ravel()
    return 0.5 * (low + high), 0.5 * (high - low)


def _hull(solid: Solid) -> tuple[FloatArray, FloatArray, float]:
    """Returns both ends, in its joint's frame, and the radius of a capsule around a solid [m].

    A cylinder lies within the capsule about its own axis, a box within that about its longest side's middle line with
    half the diagonal of the others as its radius. A half-space has none, and is never asked for it.
    """
    form = solid.geometry
    if isinstance(form, coal.Halfspace):
        return np.zeros(3), np.zeros(3), 0.0
    if isinstance(form, coal.Sphere):
        center = np.array(solid.pose.translation)
        return center, center, float(form.radius)
    if isinstance(form, coal.Capsule | coal.Cylinder):
        end = np.array([0.0, 0.0, form.halfLength])
        return np.array(solid.pose.act(end)), np.array(solid.pose.act(-end)), float(form.radius)
    center, half = _bounds(form)
    longest = int(np.argmax(half))
    end = np.zeros(3)
    end[longest] = half[longest]
    radius = float(np.linalg.norm(np.delete(half, longest)))
    return np.array(solid.pose.act(center + end)), np.array(solid.pose.act(center - end)), radius
