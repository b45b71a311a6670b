"""Quick collision test of many postures with capsules around solids; it is conservative."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache

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
from dualarm_cli.geometry.elementary import arctan2
from dualarm_cli.geometry.products import norm, product
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
    """Margin at a line's outer end from which a tool keeps its clearance [m].

    It is the tool's margin from its
    own part. With less, the tool may touch the part while it is off the lines."""
    sure: float = 5e-4
    """Margin of boxes from which it counts as the true one [m]."""
    doubted: float = 0.004
    """Margin of solids in wider hulls below which it is refined [m].

    Boxes refine it first, then coal, and only in
    postures where all else is collision-free."""


QUICK = QuickSettings()

Places = Callable[[int, int], coal.Transform3s]
"""Place of a solid, by its number, in a posture, by its row."""


OVERLAP = 3e-4
"""Allowed overlap of a part with its support by rounding [m].

It is less than the verifier's tolerance.
"""


class QuickTest:
    """Capsules around all moving solids of a cell, with pairs grouped by moving joints."""

    def __init__(
        self,
        cell: Cell,
        carried: Sequence[tuple[str, str]] = (),
        rooms: Sequence[PartRoom] = (),
    ) -> None:
        """Prepare the test of a cell.

        Args:
            cell: cell of the data model.
            carried: arm and name of every object that an arm may hold, see `Held.name`.
            rooms: rooms of parts that wait or lie.
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

    def arm_pairs(self, arm: str, part: str = "", on_line: bool = False) -> PairGroup:
        """Return the pairs that move only with one arm's joints or the platform's.

        Args:
            arm: name of the arm.
            part: name of its load, or empty.
            on_line: whether it is on a line, where a part may touch standing bodies, as well as a tool
                that is taken or left.
        """
        key = ("own", arm, part, "line" if on_line else "")
        if key not in self._groups:
            self._groups[key] = self._grouped(self._arm_pairs(arm, part, on_line))
        return self._groups[key]

    def ground(self, arm: str, part: str) -> PairGroup:
        """Return the pairs of a load and standing bodies that may touch on lines.

        Args:
            arm: arm that holds it.
            part: name of the load.
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

    def _arm_pairs(self, arm: str, part: str, on_line: bool) -> list[Pair]:
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
        """Return the pairs between the arms.

        Args:
            parts: name of each arm's load, by arm.
            handed: arms whose part is handed over: the other tool and its load may touch it.
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
        """Return the pairs of an arm and lying parts that may touch.

        They must not overlap.

        Args:
            arm: the arm.
            part: name of its load.
            stops: stops of the arm, each with the room of its part.
        """
        pairs = [p for p in self._arm_pairs(arm, part, on_line=False) if p.second in self._room_of]
        rows = [(pair, -OVERLAP) for pair in pairs if self.carried_in(pair)]
        for room, visit in stops:
            tool_pairs = [p for p in pairs if self.room_of(p) == room and self.is_on_flange(p, arm)]
            rows += [(pair, self.needed(pair, arm, visit)) for pair in tool_pairs]
        distinct_pairs = dict.fromkeys(
            replace(pair, required=least) for pair, least in rows if least < 0.0
        )
        key = ("touching", *distinct_pairs)
        if key not in self._groups:
            self._groups[key] = self._grouped(list(distinct_pairs))
        return self._groups[key]

    def part_in(self, arm: str, held: str) -> str:
        """Return the part in a load; empty for none."""
        return self._held[arm][held].part

    def room_of(self, pair: Pair) -> int | None:
        """Return the room of a pair's second solid, or None."""
        return self._room_of.get(pair.second)

    def carried_in(self, pair: Pair) -> bool:
        """Check whether a pair's first solid is a carried part."""
        solid = self._solids[pair.first]
        return bool(solid.carrier) and not solid.bolted

    def is_on_flange(self, pair: Pair, arm: str) -> bool:
        """Check whether a pair's first solid is fixed to an arm's flange and is no part."""
        return self._solids[pair.first].joint == self._flanges[
            arm
        ].parentJoint and not self.carried_in(pair)

    def drifting(
        self, room: int, arm: str, part: str, position: FloatArray, shift: FloatArray
    ) -> tuple[FloatArray, list[Pair]]:
        """Compute the margins of an arm from a moving part, by pair, shape (q, n) [m].

        Small margins are computed by coal.

        Args:
            room: index of the part's room.
            arm: name of the arm.
            part: name of its load.
            position: all joints of the robot [rad], shape (n, columns).
            shift: displacement of the room, in the frame of the root link [m], shape (n, 3).
        """
        pairs = [p for p in self._arm_pairs(arm, part, on_line=False) if self.room_of(p) == room]
        frames = self._tree.frames(position, {self._solids[pair.first].joint for pair in pairs})
        margins = np.full((len(pairs), len(position)), np.inf)
        for k, pair in enumerate(pairs):
            solid, lying = self._solids[pair.first], self._solids[pair.second]
            R, p = frames[solid.joint]
            R_joint = np.einsum("ijn,kj->ikn", R, self._tree.R_joint_own[solid.joint])
            middle = np.einsum("ikn,k->in", R_joint, np.asarray(solid.pose.act(_middle(solid)))) + p
            lying_middle = np.asarray(lying.pose.act(_middle(lying))) + shift
            gap = np.sqrt(np.square(middle.T - lying_middle).sum(axis=1))
            gap -= solid.geometry.aabb_radius + lying.geometry.aabb_radius + pair.required
            margins[k] = gap
            for row in np.flatnonzero(gap < QUICK.enough).tolist():
                place = pin.SE3(R_joint[..., row], p[:, row]) * solid.pose
                moved = pin.SE3(lying.pose.rotation, lying.pose.translation + shift[row])
                margins[k, row] = _distance(solid, lying, (place, moved)) - pair.required
        return margins, pairs

    def labels(self, pair: Pair) -> tuple[str, str]:
        """Return the names of a pair's bodies for users."""
        return self._solids[pair.first].label, self._solids[pair.second].label

    def needed(self, pair: Pair, arm: str, visit: Visit) -> float:
        """Compute the distance that a tool keeps from the part at its stop [m].

        It applies while the tool is off the lines of the stop.

        It is the required distance if the tool keeps it at the outer end of the line there. Otherwise the tool may
        touch the part, and penetrate it no deeper than at that end.
        """
        task, stop = visit
        key = pair.first, pair.second, arm, task.id, stop.action
        if key not in self._needed:
            assert isinstance(stop.target, PoseTarget)  # a part lies there
            pose, (length, line) = stop.target.pose, stop.lines[stop.action != "pick"]
            T_root_tcp = self._cell.base.actInv(pose) * line.back(pose.rotation, length)
            T_joint_tcp = self._flanges[arm].placement * self._cell.tools[arm].tcp
            solid, part = self._solids[pair.first], self._solids[pair.second]
            at_end = _distance(
                solid, part, (T_root_tcp * T_joint_tcp.actInv(solid.pose), part.pose)
            )
            least = min(at_end, 0.0) - OVERLAP
            self._needed[key] = pair.required if at_end - pair.required >= QUICK.apart else least
        return self._needed[key]

    def leaning(self, arm: str, axis: FloatArray, position: FloatArray) -> FloatArray:
        """Compute the angles of a tool axis from the vertical [rad], shape (n,).

        Args:
            arm: name of the arm.
            axis: unit vector in the tool's frame, shape (3,).
            position: all joints of the robot [rad], shape (n, columns).
        """
        flange = self._flanges[arm]
        R_joint_tool = product(flange.placement.rotation, self._cell.tools[arm].tcp.rotation)
        along_joint = product(self._tree.R_joint_own[flange.parentJoint].T, R_joint_tool, axis)
        R, _ = self._tree.frames(position, {flange.parentJoint})[flange.parentJoint]
        along = product(np.moveaxis(R, -1, 0), along_joint)
        up = self._cell.base.rotation[2]
        return arctan2(norm(np.cross(up, along), axis=1), product(along, up))

    def margins(
        self, group: PairGroup, position: FloatArray, scenes: tuple[Scenes, IntArray] | None = None
    ) -> FloatArray:
        """Compute a lower bound of the group's least margin [m], shape (n,).

        The margin is distance minus required clearance.

        Args:
            group: pairs of this test.
            position: all joints of the robot [rad], shape (n, columns).
            scenes: pairs that are tested in each scene, and the scene of each row; None for all pairs.
        """
        sure, rough = pair_margins(self._steps, group.arrays, position, QUICK.enough, scenes)
        if len(rough):
            self._look_closer(group, position, sure, rough)
        return np.minimum(sure, rough.min(axis=0, initial=np.inf)) - QUICK.rounded

    def nearest(self, position: FloatArray, pairs: Sequence[Pair]) -> tuple[str, str, float]:
        """Find the pair of bodies with the least margin [m], by coal.

        Args:
            position: all joints of the robot [rad], shape (columns,).
            pairs: pairs of this test's groups; infinite without pairs.
        """
        return min(self._bodies(position, pairs), key=_margin_of, default=("", "", np.inf))

    def lacking(self, position: FloatArray, pairs: Sequence[Pair]) -> list[tuple[str, str, float]]:
        """List the pairs of bodies with a negative margin [m], worst first; by coal.

        Args:
            position: all joints of the robot [rad], shape (columns,).
            pairs: pairs of this test's groups.
        """
        margins: dict[tuple[str, str], float] = {}
        for body_a, body_b, margin in self._bodies(position, pairs):
            if margin < 0.0:
                margins[body_a, body_b] = min(margin, margins.get((body_a, body_b), 0.0))
        return sorted(((*names, margin) for names, margin in margins.items()), key=_margin_of)

    def _bodies(
        self, position: FloatArray, pairs: Sequence[Pair]
    ) -> Iterator[tuple[str, str, float]]:
        """Iterate over pairs: names of bodies and margin [m] at a position (columns,)."""
        frames = self._tree.frames(position[None], {s.joint for s in self._solids})
        places = self._places(frames)
        for pair in pairs:
            solid_a, solid_b = self._solids[pair.first], self._solids[pair.second]
            yield solid_a.label, solid_b.label, self._margin(pair, places, 0)

    def _movers_of(self, pair: Pair) -> set[str]:
        return self._moved_by[pair.first] | self._moved_by[pair.second]

    def _carries(self, pair: Pair, parts: Mapping[str, str]) -> bool:
        """Check whether all parts and changed tools of a pair are held."""
        solids = (self._solids[pair.first], self._solids[pair.second])
        return all(
            s.is_held(self._held[s.carrier][parts.get(s.carrier, "")]) for s in solids if s.carrier
        )

    def _is_handed(self, pair: Pair, arms: frozenset[str]) -> bool:
        """Check whether a pair is a handed-over part and the other arm's tool, hand or load."""
        solid_a, solid_b = self._solids[pair.first], self._solids[pair.second]
        tools = {f"{arm}_tool" for arm in self.arms}.union(*self._cell.robot.hands.values())
        return any(
            a.carrier in arms and a.carrier != b.carrier and (b.carrier or b.body in tools)
            for a, b in ((solid_a, solid_b), (solid_b, solid_a))
        )

    def _may_lie(self, pair: Pair, held: Held) -> bool:
        """Check whether a pair is a load that may lie, and a standing body."""
        solids = (self._solids[pair.first], self._solids[pair.second])
        lies = any(s.carrier and (held.docking or not s.bolted) for s in solids)
        return lies and any(s.joint == WORLD and not s.lying for s in solids)

    def _look_closer(
        self, group: PairGroup, position: FloatArray, sure: FloatArray, rough: FloatArray
    ) -> None:
        """Refine the margins of doubtful rough pairs, if all other pairs are collision-free.

        Args:
            group: pairs of this test.
            position: all joints of the robot [rad], shape (n, columns).
            sure: least margins of the other pairs [m], shape (n,).
            rough: margins of the rough pairs [m], shape (r, n).
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
            # For boxes that hardly overlap, or lack clearance, the true margin may be slightly larger.
            sure_from = np.where(boxes.required[which] < 0.0, 0.0, QUICK.sure)
            doubted[at] = (rough[at] < sure_from) & (gap > -QUICK.overlaps)
        certain = np.where(doubted[:, rows], np.inf, rough[:, rows]).min(axis=0)
        certain = np.minimum(certain, sure[rows])
        remaining = np.flatnonzero((doubted[:, rows] & (rough[:, rows] < certain)).any(axis=0))
        places = self._places(frames)
        for k, row, least in zip(
            remaining.tolist(), rows[remaining].tolist(), certain[remaining].tolist(), strict=True
        ):
            numbers = np.flatnonzero(doubted[:, row])
            # Stop when no remaining margin can be the least.
            for number in numbers[np.argsort(rough[numbers, row], kind="stable")].tolist():
                if rough[number, row] >= least:
                    break
                rough[number, row] = self._margin(group.rough[number], places, k)
                least = min(least, rough[number, row])

    def _places(self, frames: Mapping[int, tuple[FloatArray, FloatArray]]) -> Places:
        """Return the place of a solid in one of n postures, computed once and kept."""

        @cache
        def turns_and_points(number: int) -> tuple[FloatArray, FloatArray]:
            solid = self._solids[number]
            R, p = frames[solid.joint]
            R_joint = product(np.moveaxis(R, -1, 0), self._tree.R_joint_own[solid.joint].T)
            turned = product(R_joint, solid.pose.translation)
            return product(R_joint, solid.pose.rotation), np.moveaxis(p, -1, 0) + turned

        @cache
        def place(number: int, row: int) -> coal.Transform3s:
            R, p = turns_and_points(number)
            return coal.Transform3s(R[row], p[row])

        return place

    def _margin(self, pair: Pair, places: Places, row: int) -> float:
        """Compute the margin of a pair in one of n postures, by coal [m]."""
        first, second = pair.first, pair.second
        distance = solid_distance(
            self._solids[first], places(first, row), self._solids[second], places(second, row)
        )
        return distance - pair.required

    def _grouped(self, pairs: Sequence[Pair]) -> PairGroup:
        return pair_group(self._solids, self._hulls, self._tree, pairs)


def _distance(solid: Solid, other_solid: Solid, places: Sequence[pin.SE3]) -> float:
    """Compute the distance of two solids at two places [m], by coal."""
    transform, other_transform = (
        coal.Transform3s(place.rotation, place.translation) for place in places
    )
    return solid_distance(solid, transform, other_solid, other_transform)


def _middle(solid: Solid) -> FloatArray:
    return np.asarray(solid.geometry.aabb_center, dtype=np.float64).ravel()


def _movers(model: pin.Model, solid: Solid, members: dict[str, set[str]]) -> set[str]:
    """Find the arms whose joints move a solid."""
    arms, joint = set(), solid.joint
    while joint != WORLD:
        arms |= {arm for arm, joints in members.items() if model.names[joint] in joints}
        joint = model.parents[joint]
    return arms


def _margin_of(pair: tuple[str, str, float]) -> float:
    return pair[2]
