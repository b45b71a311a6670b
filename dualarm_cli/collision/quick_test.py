"""A quick test of many postures: moving solids in round hulls, all pairs in arrays; what it calls free is free."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeVar

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from dualarm_cli.collision.hulls import Hulls
from dualarm_cli.collision.pair_groups import (
    ROUNDED,
    Boxes,
    Capsules,
    Frames,
    PairGroup,
    Rounds,
    Singles,
    pair_group,
)
from dualarm_cli.collision.reach import can_meet
from dualarm_cli.collision.solids import (
    WORLD,
    Pair,
    Solid,
    cell_solids,
    pairs_that_must_keep_apart,
)
from dualarm_cli.collision.tree import JointTree
from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.model.cell import Cell, Held

T = TypeVar("T", bound=np.floating[Any])

TINY = 1e-18
"""Squared lengths below this are points [m²]."""
PARALLEL = 1e-12
"""Squared sine of the angle between segments below which they are taken as parallel."""


def dot(a: NDArray[T], b: NDArray[T]) -> NDArray[T]:
    """Returns the scalar products of vectors (3, ...), broadcast, shape (...)."""
    product: NDArray[T] = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return product


def segment_distance(a: FloatArray, b: FloatArray, c: FloatArray, d: FloatArray) -> FloatArray:
    """Returns the distance of segments a-b from segments c-d [m], shape (...); exact up to rounding.

    The squared distance is a convex quadratic of both parameters: its minimum is the free one clamped, once along
    either segment ([Ericson2004] 5.1.9).

    Args:
        a: ends of the first segments [m], shape (3, ...), broadcast with the others.
        b: their other ends.
        c: ends of the second segments.
        d: their other ends.
    """
    u, v, w = b - a, d - c, a - c
    uu, vv, uv = dot(u, u), dot(v, v), dot(u, v)
    uw, vw = dot(u, w), dot(v, w)
    denominator = uu * vv - uv * uv
    with np.errstate(divide="ignore", invalid="ignore"):
        slanted = denominator > PARALLEL * uu * vv
        s = np.where(slanted, (uv * vw - vv * uw) / denominator, 0.0)
        s = np.clip(s, 0.0, 1.0)
        t = np.where(vv > TINY, (uv * s + vw) / vv, 0.0)
        t = np.clip(t, 0.0, 1.0)
        s = np.where(uu > TINY, (uv * t - uw) / uu, 0.0)
        s = np.clip(s, 0.0, 1.0)
    apart = w + s * u - t * v
    return np.sqrt(dot(apart, apart))


def box_distance(a: FloatArray, b: FloatArray, half: FloatArray) -> FloatArray:
    """Returns the distance of segments a-b from boxes about the origin [m], shape (...); exact up to rounding.

    Half the derivative of the squared distance along the segment rises, and is linear between the places where the
    segment crosses the planes of the sides: it is zero on the straight line between the last of them where it is
    negative and the first where it is not. Inside, the distance is minus the depth there.

    Args:
        a: ends in the box's frame [m], shape (3, ...).
        b: other ends.
        half: half sides of the box [m], shape (3, ...).
    """
    u = b - a
    low, high = np.zeros(u.shape[1:]), np.ones(u.shape[1:])
    at_low, at_high = _slope(a, u, half, low), _slope(a, u, half, high)
    with np.errstate(divide="ignore", invalid="ignore"):
        crossings = [(side - a) / u for side in (half, -half)]
    for x in (x for crossing in crossings for x in crossing):
        # What is not between is neither; comparisons with NaN are false.
        between = (x > low) & (x < high)
        slope = _slope(a, u, half, np.where(between, x, low))
        rises = between & (slope >= 0.0)
        falls = between & (slope < 0.0)
        high, at_high = np.where(rises, x, high), np.where(rises, slope, at_high)
        low, at_low = np.where(falls, x, low), np.where(falls, slope, at_low)
    with np.errstate(divide="ignore", invalid="ignore"):
        x = low - at_low * (high - low) / (at_high - at_low)
    x = np.where(at_low >= 0.0, low, np.where(at_high <= 0.0, high, x))
    return point_box(a + x * u, half)


def _slope(a: FloatArray, u: FloatArray, half: FloatArray, x: FloatArray) -> FloatArray:
    """Returns half the derivative of the squared distance of a + x u from boxes, shape (...)."""
    point = a + x * u
    return dot(u, point - np.clip(point, -half, half))


def point_box(x: FloatArray, half: FloatArray) -> FloatArray:
    """Returns the signed distance of points (3, ...) from boxes about the origin [m], shape (...)."""
    beyond = np.abs(x) - half
    outside = np.maximum(beyond, 0.0)
    return np.sqrt(dot(outside, outside)) + np.minimum(beyond.max(axis=0), 0.0)


ENOUGH = 0.01
"""Margins that balls around two solids show to be greater than this are not looked at more closely [m]."""


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


def _round_margins(pairs: Rounds, center: Singles, half: Singles) -> Singles:
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
    boxes: Boxes, frame: tuple[Singles, Singles], center: Singles, half: Singles
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


def _seen(boxes: Boxes, R: Singles, x: Singles) -> Singles:
    """Returns vectors (3, ..., n) along the axes of boxes, of that shape, for rotations (3, 3, n) of their joint."""
    if boxes.joint != WORLD:
        x = np.stack([dot(R[:, k], x) for k in range(3)])
    if boxes.axes is None:
        return x
    found: Singles = (boxes.axes @ x.reshape(3, -1)).reshape(x.shape)
    return found


BLOCK = 100_000
"""Pairs in postures that are tested at a time: their arrays stay in the cache."""
LEAST_ROWS, MOST_ROWS = 128, 1024
"""Postures that are tested at a time at least and at most."""
OVERLAP = 3e-4
"""How far a part may reach into what it lies on by rounding [m]; less than the verifier lets pass."""
OVERLAPS = 1e-3
"""Boxes that no axis shows to overlap by less are looked at by coal [m]."""
SURE = 5e-4
"""Margins of boxes that are greater are as good as true ones [m]."""
DOUBTED = 0.004
"""Margins below this of solids in wider hulls are computed by coal, if all else is collision-free [m]."""


class QuickTest:
    """Round hulls of all moving solids of a cell, and its pairs by which joints move them."""

    def __init__(self, cell: Cell, carried: Sequence[tuple[str, str]] = ()) -> None:
        """Prepares a cell.

        Args:
            cell: of the data model.
            carried: arm and name of everything that an arm ever holds, see `Held.name`.
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
        self._single = self._tree.single()
        self._hulls = Hulls.of(self._solids, self._tree)
        self._capsules = Capsules.of(self._solids, self._hulls)
        self._held = {arm.name: cell.all_held(arm.name) for arm in robot.arms}
        members = {arm.name: set(arm.joints) for arm in robot.arms}
        self.arms = tuple(members)
        """Names of the arms."""
        self._moved_by = [_movers(model, solid, members) for solid in self._solids]
        self._groups: dict[tuple[str, ...], PairGroup] = {}

    def own(self, arm: str, part: str = "", on_line: bool = False) -> PairGroup:
        """Returns the pairs that one arm's joints or only the platform's move.

        Args:
            arm: its name.
            part: name of what it holds, if anything.
            on_line: whether it is on one of a stop's lines: there a part may touch what stands still, and a tool that
                is being taken or left.
        """
        key = ("own", arm, part, "line" if on_line else "")
        if key not in self._groups:
            self._groups[key] = self._grouped(self._own_pairs(arm, part, on_line))
        return self._groups[key]

    def ground(self, arm: str, part: str) -> PairGroup:
        """Returns the pairs of what an arm holds with what stands still that on lines may touch, not overlap.

        Args:
            arm: what holds it.
            part: its name.
        """
        key = ("ground", arm, part)
        if key not in self._groups:
            self._groups[key] = self._grouped(
                [
                    replace(pair, required=-OVERLAP)
                    for pair in self._pairs
                    if self._movers_of(pair) == {arm}
                    and self._carries(pair, {arm: part})
                    and self._may_lie(pair, self._held[arm][part])
                ]
            )
        return self._groups[key]

    def _own_pairs(self, arm: str, part: str, on_line: bool) -> list[Pair]:
        return [
            pair
            for pair in self._pairs
            if self._movers_of(pair) <= {arm}
            and self._carries(pair, {arm: part})
            and not (on_line and self._may_lie(pair, self._held[arm][part]))
        ]

    def cross(
        self, parts: Mapping[str, str] | None = None, handed: frozenset[str] = frozenset()
    ) -> PairGroup:
        """Returns the pairs of one arm with the other.

        Args:
            parts: name of what each arm holds, if anything, by arm.
            handed: arms whose part is being handed over: the other tool, and what that carries, may touch it.
        """
        carried = parts or {}
        key = ("cross", *(carried.get(arm, "") for arm in self.arms), "handed", *sorted(handed))
        if key not in self._groups:
            self._groups[key] = self._grouped(
                [
                    pair
                    for pair in self._pairs
                    if len(self._movers_of(pair)) == 2
                    and self._carries(pair, carried)
                    and not self._is_handed(pair, handed)
                ]
            )
        return self._groups[key]

    def margins(self, group: PairGroup, position: FloatArray) -> FloatArray:
        """Returns a bound below the least of distance less required clearance over a group's pairs [m], shape (n,).

        Args:
            group: of this test.
            position: all joints of the robot [rad], shape (n, columns).
        """
        return self.margins_of([group], position)[0]

    def margins_of(self, groups: Sequence[PairGroup], position: FloatArray) -> FloatArray:
        """Returns the margins of g groups [m], shape (g, n); quicker than one group after the other.

        Args:
            groups: of this test.
            position: all joints of the robot [rad], shape (n, columns).
        """
        least = np.full((len(groups), len(position)), np.inf)
        pairs = max((len(group.pairs) for group in groups), default=0)
        if pairs:
            rows = min(max(LEAST_ROWS, BLOCK // pairs), MOST_ROWS)
            for k in range(0, len(position), rows):
                self._block(groups, position[k : k + rows], least[:, k : k + rows])
        return least

    def nearest(self, position: FloatArray, pairs: Sequence[Pair]) -> tuple[str, str, float]:
        """Returns the two bodies of some pairs that have the least margin, and it [m]; by coal.

        Args:
            position: all joints of the robot [rad], shape (columns,).
            pairs: of this test's groups; infinite where there is none.
        """
        return min(self._bodies(position, pairs), key=_margin_of, default=("", "", np.inf))

    def lacking(self, position: FloatArray, pairs: Sequence[Pair]) -> list[tuple[str, str, float]]:
        """Returns all pairs of bodies with a negative margin, and that [m], worst first; by coal.

        Args:
            position: all joints of the robot [rad], shape (columns,).
            pairs: of this test's groups.
        """
        found: dict[tuple[str, str], float] = {}
        for one, other, margin in self._bodies(position, pairs):
            if margin < 0.0:
                found[one, other] = min(margin, found.get((one, other), 0.0))
        return sorted(((*names, margin) for names, margin in found.items()), key=_margin_of)

    def _bodies(
        self, position: FloatArray, pairs: Sequence[Pair]
    ) -> Iterator[tuple[str, str, float]]:
        """Iterates over pairs as the names of their bodies with the margin [m] at one position (columns,)."""
        frames = self._tree.frames(position[None], {s.joint for s in self._solids})
        for pair in pairs:
            one, other = self._solids[pair.first], self._solids[pair.second]
            yield one.label, other.label, self._margin(pair, frames, 0)

    def _movers_of(self, pair: Pair) -> set[str]:
        return self._moved_by[pair.first] | self._moved_by[pair.second]

    def _carries(self, pair: Pair, parts: Mapping[str, str]) -> bool:
        """Returns whether all parts and changed tools of a pair are held."""
        solids = (self._solids[pair.first], self._solids[pair.second])
        return all(
            s.is_held(self._held[s.carrier][parts.get(s.carrier, "")]) for s in solids if s.carrier
        )

    def _is_handed(self, pair: Pair, arms: frozenset[str]) -> bool:
        """Returns whether a pair is a part that goes from arm to arm, and the other's tool or what that carries."""
        one, other = self._solids[pair.first], self._solids[pair.second]
        tools = {f"{arm}_tool" for arm in self.arms}
        return any(
            a.carrier in arms and a.carrier != b.carrier and (b.carrier or b.body in tools)
            for a, b in ((one, other), (other, one))
        )

    def _may_lie(self, pair: Pair, held: Held) -> bool:
        """Returns whether a pair is something held that may lie on things, and something that stands still."""
        solids = (self._solids[pair.first], self._solids[pair.second])
        lies = any(s.carrier and (held.docking or not s.bolted) for s in solids)
        return lies and any(s.joint == WORLD for s in solids)

    def _block(self, groups: Sequence[PairGroup], position: FloatArray, least: FloatArray) -> None:
        """Puts margins of g groups at n postures into `least`, shape (g, n)."""
        joints = frozenset().union(*(group.joints for group in groups))
        frames = self._single.frames(position.astype(np.float32), joints)
        center, half = self._capsules.placed(frames, joints, len(position))
        for k, group in enumerate(groups):
            if not group.pairs:
                continue
            margins = pair_margins(group, frames, center, half)
            if group.rough.any():
                self._look_closer(group, frames, position, margins)
            least[k] = margins.min(axis=0)

    def _look_closer(
        self, group: PairGroup, frames: Frames, position: FloatArray, margins: Singles
    ) -> None:
        """Puts true margins in the place of doubted ones (q, n) at n postures, where all else is collision-free."""
        sure = margins[~group.rough].min(axis=0, initial=np.inf) >= 0.0
        doubted = group.rough[:, None] & (margins < DOUBTED) & sure
        boxes = group.both_boxes
        which, row = np.nonzero(doubted[boxes.number])
        if len(which):
            pair, gap = boxes.number[which], boxes.gaps(which, frames, row)
            own = (gap - boxes.required[which] - ROUNDED).astype(np.float32)
            margins[pair, row] = np.maximum(margins[pair, row], own)
            # Between boxes that hardly overlap, or are apart by less than required, it may be a little more.
            doubted[pair, row] = (margins[pair, row] < SURE) & (gap > -OVERLAPS)
        if doubted.any():
            self._ask_coal(group, position, margins, doubted)

    def _ask_coal(
        self, group: PairGroup, position: FloatArray, margins: Singles, doubted: BoolArray
    ) -> None:
        rows = np.flatnonzero(doubted.any(axis=0))
        frames = self._tree.frames(position[rows], group.joints)
        for k, row in enumerate(rows.tolist()):
            least = margins[~doubted[:, row], row].min(initial=np.inf)
            numbers = np.flatnonzero(doubted[:, row])
            # Until none that is left can be the least.
            for number in numbers[np.argsort(margins[numbers, row])].tolist():
                if margins[number, row] >= least:
                    break
                margins[number, row] = self._margin(group.pairs[number], frames, k) - ROUNDED
                least = min(least, margins[number, row])

    def _margin(
        self, pair: Pair, frames: Mapping[int, tuple[FloatArray, FloatArray]], row: int
    ) -> float:
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

    def _grouped(self, pairs: Sequence[Pair]) -> PairGroup:
        return pair_group(self._solids, self._hulls, self._capsules, self._tree, pairs)


def _movers(model: pin.Model, solid: Solid, members: dict[str, set[str]]) -> set[str]:
    """Returns the arms whose joints move a solid."""
    found, joint = set(), solid.joint
    while joint != WORLD:
        found |= {arm for arm, joints in members.items() if model.names[joint] in joints}
        joint = model.parents[joint]
    return found


def _margin_of(pair: tuple[str, str, float]) -> float:
    return pair[2]
