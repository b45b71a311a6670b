"""A quick test of many postures: moving solids in round hulls; what it calls free is free."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import coal
import numpy as np
import pinocchio as pin

from dualarm_cli.collision.pair_groups import Hulls, PairGroup, pair_group
from dualarm_cli.collision.reach import Reach
from dualarm_cli.collision.rooms import PartRoom
from dualarm_cli.collision.solids import (
    WORLD,
    Pair,
    Solid,
    cell_solids,
    pairs_that_must_keep_apart,
    pairs_with_lying,
    solid_distance,
)
from dualarm_cli.collision.tree import JointTree
from dualarm_cli.compiled.pair_margins import Scenes, pair_margins
from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.geometry.products import product
from dualarm_cli.model.cell import Cell, Held
from dualarm_cli.model.job import PoseTarget
from dualarm_cli.model.lying import Visit
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class QuickSettings:
    """Thresholds of the quick collision test."""

    enough: float = 0.01
    """Margin of bounding balls above which a pair is not examined further [m]."""
    overlaps: float = 1e-3
    """Overlap of boxes up to which coal computes the true margin [m]."""
    rounded: float = 1e-9
    """Rounding allowance that is subtracted from margins [m]."""
    apart: float = 0.003
    """Margin at a line's outer end from which a tool keeps its clearance [m]. It is the tool's margin from its
    own part. With less, the tool may touch the part while it is off the lines."""
    sure: float = 5e-4
    """Margin of boxes from which it counts as the true one [m]."""
    doubted: float = 0.004
    """Margin of solids in wider hulls below which it is refined [m]. Boxes refine it first, then coal, and only in
    postures where all else is collision-free."""


QUICK = QuickSettings()


OVERLAP = 3e-4
"""How far a part may reach into what it lies on by rounding [m]; less than the verifier lets pass."""


class QuickTest:
    """Round hulls of all moving solids of a cell, and its pairs by which joints move them."""

    def __init__(
        self,
        cell: Cell,
        carried: Sequence[tuple[str, str]] = (),
        rooms: Sequence[PartRoom] = (),
    ) -> None:
        """Prepares a cell.

        Args:
            cell: of the data model.
            carried: arm and name of everything that an arm ever holds, see `Held.name`.
            rooms: where parts wait or lie at times.
        """
        robot = cell.robot
        model = pin.buildModelFromXML(robot.urdf)
        self._tree = JointTree.of(model, robot.joints)
        self._solids = cell_solids(cell, model, carried)
        reach = Reach(model)
        self._pairs = [
            pair
            for pair in pairs_that_must_keep_apart(model, self._solids, cell)
            if reach.can_meet(
                self._solids[pair.first], self._solids[pair.second], pair, QUICK.enough
            )
        ]
        first = len(self._solids)
        for room in rooms:
            self._solids += room.solids(cell)
        lying = range(first, len(self._solids))
        room_of = [k for k, room in enumerate(rooms) for _ in room.shapes]
        self._room_of = dict(zip(lying, room_of, strict=True))
        self._pairs += [
            pair
            for pair in pairs_with_lying(self._solids, lying, cell)
            if reach.can_meet(
                self._solids[pair.first], self._solids[pair.second], pair, QUICK.enough
            )
        ]
        self._steps = self._tree.steps()
        self._hulls = Hulls.of(self._solids, self._tree)
        self._held = {arm.name: cell.all_held(arm.name) for arm in robot.arms}
        members = {arm.name: set(arm.joints) for arm in robot.arms}
        self.arms = tuple(members)
        """Names of the arms."""
        self._cell, self._flanges = (
            cell,
            {
                arm.name: model.frames[model.getFrameId(arm.flange, pin.FrameType.BODY)]
                for arm in robot.arms
            },
        )
        self._moved_by = [_movers(model, solid, members) for solid in self._solids]
        self._groups: dict[tuple[object, ...], PairGroup] = {}
        self._needed: dict[tuple[object, ...], float] = {}

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

    def touching(self, arm: str, part: str, stops: Iterable[tuple[int, Visit]]) -> PairGroup:
        """Returns the pairs of an arm's part and tool with parts that lie, which may touch but not overlap.

        Args:
            arm: what holds it.
            part: name of what it holds.
            stops: the arm's, each with the room of the part there.
        """
        pairs = [p for p in self._own_pairs(arm, part, on_line=False) if p.second in self._room_of]
        rows = [(pair, -OVERLAP) for pair in pairs if self.carried_in(pair)]
        for room, visit in stops:
            own = [p for p in pairs if self.room_of(p) == room and self.is_on_flange(p, arm)]
            rows += [(pair, self.needed(pair, arm, visit)) for pair in own]
        found = dict.fromkeys(replace(pair, required=least) for pair, least in rows if least < 0.0)
        key = ("touching", *found)
        if key not in self._groups:
            self._groups[key] = self._grouped(list(found))
        return self._groups[key]

    def part_in(self, arm: str, held: str) -> str:
        """Returns the part of what an arm holds by its name; empty for none."""
        return self._held[arm][held].part

    def room_of(self, pair: Pair) -> int | None:
        """Returns the number of the room that a pair's second solid is part of; None for none."""
        return self._room_of.get(pair.second)

    def carried_in(self, pair: Pair) -> bool:
        """Returns whether a pair's first solid is a part that an arm carries."""
        solid = self._solids[pair.first]
        return bool(solid.carrier) and not solid.bolted

    def is_on_flange(self, pair: Pair, arm: str) -> bool:
        """Returns whether a pair's first solid is fixed to an arm's flange and no part."""
        return self._solids[pair.first].joint == self._flanges[
            arm
        ].parentJoint and not self.carried_in(pair)

    def drifting(
        self, room: int, arm: str, part: str, position: FloatArray, shift: FloatArray
    ) -> tuple[FloatArray, list[Pair]]:
        """Returns the margins of one arm from a part that moves, pair by pair, shape (q, n) [m]; by coal where near.

        Args:
            room: number of the part's room.
            arm: its name.
            part: name of what it holds.
            position: all joints of the robot [rad], shape (n, columns).
            shift: of the room, in the frame of the root link [m], shape (n, 3).
        """
        pairs = [p for p in self._own_pairs(arm, part, on_line=False) if self.room_of(p) == room]
        frames = self._tree.frames(position, {self._solids[pair.first].joint for pair in pairs})
        found = np.full((len(pairs), len(position)), np.inf)
        for k, pair in enumerate(pairs):
            one, other = self._solids[pair.first], self._solids[pair.second]
            R, p = frames[one.joint]
            R_joint = np.einsum("ijn,kj->ikn", R, self._tree.R_joint_own[one.joint])
            middle = np.einsum("ikn,k->in", R_joint, np.asarray(one.pose.act(_middle(one)))) + p
            there = np.asarray(other.pose.act(_middle(other))) + shift
            apart = np.sqrt(np.square(middle.T - there).sum(axis=1))
            apart -= one.geometry.aabb_radius + other.geometry.aabb_radius + pair.required
            found[k] = apart
            for row in np.flatnonzero(apart < QUICK.enough).tolist():
                place = pin.SE3(R_joint[..., row], p[:, row]) * one.pose
                moved = pin.SE3(other.pose.rotation, other.pose.translation + shift[row])
                found[k, row] = _distance(one, other, (place, moved)) - pair.required
        return found, pairs

    def labels(self, pair: Pair) -> tuple[str, str]:
        """Returns what a person calls the two bodies of a pair."""
        return self._solids[pair.first].label, self._solids[pair.second].label

    def needed(self, pair: Pair, arm: str, visit: Visit) -> float:
        """Returns the distance that a tool keeps from the part at its stop while it is off the lines there [m].

        The required one, if the tool has it where the line there begins or ends; else the tool may touch the part, and
        reach into it no deeper than there.
        """
        task, stop = visit
        key = pair.first, pair.second, arm, task.id, stop.action
        if key not in self._needed:
            assert isinstance(stop.target, PoseTarget)  # a part lies there
            line = stop.approach if stop.action == "pick" else stop.retract
            T_tcp_end = pin.SE3(np.eye(3), np.array([0.0, 0.0, -line]))
            T_root_tcp = self._cell.base.actInv(stop.target.pose) * T_tcp_end
            T_joint_tcp = self._flanges[arm].placement * self._cell.tools[arm].tcp
            solid, part = self._solids[pair.first], self._solids[pair.second]
            there = _distance(solid, part, (T_root_tcp * T_joint_tcp.actInv(solid.pose), part.pose))
            least = min(there, 0.0) - OVERLAP
            self._needed[key] = pair.required if there - pair.required >= QUICK.apart else least
        return self._needed[key]

    def margins(
        self, group: PairGroup, position: FloatArray, scenes: tuple[Scenes, IntArray] | None = None
    ) -> FloatArray:
        """Returns a bound below the least of distance less required clearance over a group's pairs [m], shape (n,).

        Args:
            group: of this test.
            position: all joints of the robot [rad], shape (n, columns).
            scenes: which pairs count in which scene, and the scene of each row; None: all pairs.
        """
        sure, rough = pair_margins(self._steps, group.arrays, position, QUICK.enough, scenes)
        if len(rough):
            self._look_closer(group, position, sure, rough)
        return np.minimum(sure, rough.min(axis=0, initial=np.inf)) - QUICK.rounded

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
        return lies and any(s.joint == WORLD and not s.lying for s in solids)

    def _look_closer(
        self, group: PairGroup, position: FloatArray, sure: FloatArray, rough: FloatArray
    ) -> None:
        """Puts true margins in the place of doubted ones of rough pairs, where all else is collision-free.

        Args:
            group: of this test.
            position: all joints of the robot [rad], shape (n, columns).
            sure: least margins of the pairs that are not rough [m], shape (n,).
            rough: margins of those that are [m], shape (r, n).
        """
        doubted = (rough < QUICK.doubted) & (sure >= 0.0)
        rows = np.flatnonzero(doubted.any(axis=0))
        if not len(rows):
            return
        frames = self._tree.frames(position[rows], group.joints)
        boxes = group.both_boxes
        which, place = np.nonzero(doubted[np.ix_(boxes.number, rows)])
        if len(which):
            at = boxes.number[which], rows[place]
            gap = boxes.gaps(which, frames, place)
            rough[at] = np.maximum(rough[at], gap - boxes.required[which])
            # Between boxes that hardly overlap, or are apart by less than required, it may be a little more.
            sure_from = np.where(boxes.required[which] < 0.0, 0.0, QUICK.sure)
            doubted[at] = (rough[at] < sure_from) & (gap > -QUICK.overlaps)
        known = np.where(doubted[:, rows], np.inf, rough[:, rows]).min(axis=0)
        known = np.minimum(known, sure[rows])
        left = np.flatnonzero((doubted[:, rows] & (rough[:, rows] < known)).any(axis=0))
        for k, row, least in zip(
            left.tolist(), rows[left].tolist(), known[left].tolist(), strict=True
        ):
            numbers = np.flatnonzero(doubted[:, row])
            # Until none that is left can be the least.
            for number in numbers[np.argsort(rough[numbers, row], kind="stable")].tolist():
                if rough[number, row] >= least:
                    break
                rough[number, row] = self._margin(group.rough[number], frames, k)
                least = min(least, rough[number, row])

    def _margin(
        self, pair: Pair, frames: Mapping[int, tuple[FloatArray, FloatArray]], row: int
    ) -> float:
        """Returns distance less required clearance of one pair in one of n postures, by coal [m]."""
        places = []
        for number in (pair.first, pair.second):
            solid = self._solids[number]
            R, p = frames[solid.joint]
            R_joint = product(R[..., row], self._tree.R_joint_own[solid.joint].T)
            places.append(
                pin.SE3(
                    product(R_joint, solid.pose.rotation),
                    p[:, row] + product(R_joint, solid.pose.translation),
                )
            )
        one, other = self._solids[pair.first], self._solids[pair.second]
        return _distance(one, other, places) - pair.required

    def _grouped(self, pairs: Sequence[Pair]) -> PairGroup:
        return pair_group(self._solids, self._hulls, self._tree, pairs)


def _distance(one: Solid, other: Solid, places: Sequence[pin.SE3]) -> float:
    """Returns how far two solids are apart at two places [m], by coal."""
    here, there = (coal.Transform3s(place.rotation, place.translation) for place in places)
    return solid_distance(one, here, other, there)


def _middle(solid: Solid) -> FloatArray:
    return np.asarray(solid.geometry.aabb_center, dtype=np.float64).ravel()


def _movers(model: pin.Model, solid: Solid, members: dict[str, set[str]]) -> set[str]:
    """Returns the arms whose joints move a solid."""
    found, joint = set(), solid.joint
    while joint != WORLD:
        found |= {arm for arm, joints in members.items() if model.names[joint] in joints}
        joint = model.parents[joint]
    return found


def _margin_of(pair: tuple[str, str, float]) -> float:
    return pair[2]
