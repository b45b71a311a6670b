"""Clearance test of a cell by arm, by held parts, and on or off lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field, replace

import numpy as np

from dualarm_cli.collision.loads import Load, Loads
from dualarm_cli.collision.pair_groups import PairGroup
from dualarm_cli.collision.quick_test import QuickTest
from dualarm_cli.collision.rooms import PartRoom, rooms_of
from dualarm_cli.collision.scenes import ArmScene, Scene
from dualarm_cli.collision.solids import Pair
from dualarm_cli.compiled.pair_margins import Scenes
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray, distinct
from dualarm_cli.model.cell import Cell
from dualarm_cli.model.job import Job
from dualarm_cli.model.lying import may_touch
from dualarm_cli.records import dataclass

SLACK = 0.002
"""What stops keep beyond the required clearance, so that lines and motions near them keep theirs [m]."""


@dataclass(frozen=True)
class CellClearance:
    """The quick test of a cell; what arms hold are numbers of its `loads`."""

    test: QuickTest
    """Hulls and pairs."""
    arms: tuple[str, ...]
    """Names of the arms."""
    columns: tuple[tuple[int, ...], ...]
    """Columns of each arm's joints among the robot's."""
    loads: Loads
    """Numbering of everything that is ever held."""
    alone: str | None = None
    """The only arm that is tested, and not against the other one; None for all arms."""
    skew: float = 0.0
    """Delay of either arm with which motions have to be clear as well [s]."""
    rooms: tuple[PartRoom, ...] = ()
    """Rooms of parts that wait or lie at times."""
    scenes: tuple[Scene, ...] = ({},)
    """What lies when; nothing in the first one, unless it lies all the time."""
    listed: dict[tuple[int, str, bool, bool], tuple[PairGroup, Scenes]] = field(
        default_factory=dict, compare=False
    )
    """Cache of the pairs of each arm, with those that count in each scene.

    Keys: the arm, the name of its load, whether it is on a line, and whether these are the pairs that may touch.
    """

    @classmethod
    def of(
        cls,
        cell: Cell,
        carried: Sequence[tuple[str, str]],
        skew: float = 0.0,
        rooms: tuple[PartRoom, ...] = (),
    ) -> CellClearance:
        """Prepares a cell.

        Args:
            cell: of the data model.
            carried: arm and name of everything that an arm ever holds.
            skew: delay of either arm with which motions have to be clear as well [s].
            rooms: where parts wait or lie at times; none of them is taken before scenes say so.
        """
        arms = cell.robot.arms
        return cls(
            QuickTest(cell, carried, rooms),
            tuple(arm.name for arm in arms),
            tuple(tuple(cell.robot.columns(arm.joints)) for arm in arms),
            Loads(("", *dict.fromkeys(part for _, part in carried))),
            skew=skew,
            rooms=rooms,
        )

    @classmethod
    def of_job(cls, job: Job) -> CellClearance:
        """Prepares a job's cell with all that it carries and all rooms of its parts."""
        return cls.of(job.cell, job.carried(), job.skew, rooms_of(job))

    def in_scenes(self, scenes: tuple[Scene, ...]) -> CellClearance:
        """Returns the same test with what lies when."""
        return replace(self, scenes=scenes, listed={})

    def may_only_touch(self, held: IntArray) -> BoolArray:
        """Returns where what an arm holds counts only where it reaches into something, shape (n,).

        Args:
            held: what each arm holds, shape (n, arms).
        """
        found: BoolArray = np.any(self.loads.are_on_lines(held), axis=1)
        if self.rooms:
            for a in range(len(self.arms)):
                for number in distinct(held[:, a]).tolist():
                    load = self.loads.load(number)
                    if self._scenes(a, load, touching=True)[1].of(load.scene):
                        found |= held[:, a] == number
        return found

    def own_margins(
        self, a: int, position: FloatArray, held: IntArray, *, ground: bool = False
    ) -> FloatArray:
        """Returns the least margin of one arm from itself and all that is not the other arm [m], shape (n,).

        Args:
            a: which arm.
            position: all joints of the robot [rad], shape (n, columns).
            held: what it holds, shape (n,).
            ground: whether what it reaches into with a part on a line counts as well; that takes longer.
        """
        if self.alone not in (None, self.arms[a]):
            return np.full(len(position), np.inf)
        found = np.empty(len(position))
        scene, plain = self.loads.scenes(held), self.loads.in_first_scene(held)
        for number in distinct(plain).tolist():
            rows, load = np.flatnonzero(plain == number), self.loads.load(number)
            found[rows] = self._margins(a, load, position[rows], scene[rows])
            if not ground:
                continue
            groups = [self._margins(a, load, position[rows], scene[rows], touching=True)]
            if load.on_line:
                lying = self.test.ground(self.arms[a], load.name)
                groups.append(self.test.margins(lying, position[rows]))
            for margin in groups:
                # What only touches is as good as far away.
                found[rows] = np.where(margin < 0.0, np.minimum(found[rows], margin), found[rows])
        return found

    def _margins(
        self, a: int, load: Load, position: FloatArray, scene: IntArray, *, touching: bool = False
    ) -> FloatArray:
        """Returns the margins of one arm that holds one thing, in some scenes [m], shape (n,)."""
        if not self.rooms:
            if touching:
                return np.full(len(position), np.inf)
            return self.test.margins(self._own(a, load), position)
        group, scenes = self._scenes(a, load, touching=touching)
        if not len(scenes.listed):
            return np.full(len(position), np.inf)
        return self.test.margins(group, position, (scenes, scene))

    def _own(self, a: int, load: Load, *, touching: bool = False) -> PairGroup:
        arm = self.arms[a]
        if not touching:
            return self.test.own(arm, load.name, load.on_line)
        scenes = [scene.get(arm, ArmScene()) for scene in self.scenes]
        stops = [s for scene in scenes for s in (*scene.left.items(), *scene.here.items())]
        return self.test.touching(arm, load.name, stops)

    def _scenes(self, a: int, load: Load, *, touching: bool = False) -> tuple[PairGroup, Scenes]:
        """Return pairs of one arm, and those that count in each scene while it holds something."""
        key = a, load.name, load.on_line, touching
        if key not in self.listed:
            group = self._own(a, load, touching=touching)
            self.listed[key] = group, self._listed(self.arms[a], load, group, touching=touching)
        return self.listed[key]

    def _listed(self, arm: str, load: Load, group: PairGroup, *, touching: bool) -> Scenes:
        rooms = [self.test.room_of(pair) for pair in group.pairs]
        room = np.array([-1 if r is None else r for r in rooms], dtype=np.int64)
        part = np.array([self.test.carried_in(pair) for pair in group.pairs], dtype=np.bool_)
        part &= room >= 0
        tool = np.array([self.test.is_on_flange(pair, arm) for pair in group.pairs], dtype=np.bool_)
        holds = bool(self.test.part_in(arm, load.name))
        lists = []
        for scene in self.scenes:
            own = scene.get(arm, ArmScene())
            there = np.zeros(len(self.rooms) + 1, dtype=np.bool_)
            there[list(own.holding if holds else own.empty)] = True
            touched = np.zeros(len(there), dtype=np.bool_)
            if own.carries is not None:
                touched[:-1] = [may_touch(own.carries, r.task) for r in self.rooms]
            there[-1] = not touching
            counts = there[room] & np.where(part, touched[room] == touching, not touching)
            for r in {**own.left, **own.here}:
                on_line = load.on_line and r in own.here
                visits = [side[r] for side in (own.left, own.here) if r in side]
                for k in np.flatnonzero(there[room] & tool & (room == r)).tolist():
                    needed = min(self.test.needed(group.pairs[k], arm, one) for one in visits)
                    counts[k] = not on_line and group.pairs[k].required == needed
            lists.append(np.flatnonzero(counts))
        first = np.cumsum([0, *(len(row) for row in lists)])
        return Scenes(first, np.concatenate(lists))

    def cross_margins(self, position: FloatArray, held: IntArray) -> FloatArray:
        """Returns the least margin of one arm from the other [m], shape (n,).

        Args:
            position: all joints of the robot [rad], shape (n, columns).
            held: what each arm holds, shape (n, arms).
        """
        if self.alone:
            return np.full(len(position), np.inf)
        if len(self.loads.names) == 1:
            return self.test.margins(self.test.cross(), position)
        found = np.empty(len(position))
        plain = self.loads.off_lines(held)
        for numbers in np.unique(plain, axis=0):
            rows = np.flatnonzero((plain == numbers).all(axis=1))
            found[rows] = self.test.margins(self._cross(numbers), position[rows])
        return found

    def _cross(self, held: IntArray) -> PairGroup:
        """Return the pairs of one arm with the other while each holds something, shape (arms,)."""
        loads = dict(zip(self.arms, map(self.loads.load, held.tolist()), strict=True))
        carried = {arm: load.name for arm, load in loads.items()}
        handed = frozenset(arm for arm, load in loads.items() if load.is_handed)
        return self.test.cross(carried, handed)

    def nearest(self, position: FloatArray, held: IntArray) -> tuple[str, str, float]:
        """Returns the two bodies that have the least margin, and it [m]; by coal.

        Args:
            position: all joints of the robot [rad], shape (columns,).
            held: what each arm holds, shape (arms,).
        """
        return self.test.nearest(position, self._pairs(held))

    def lacking(self, position: FloatArray, held: IntArray) -> list[tuple[str, str, float]]:
        """Returns all pairs of bodies that lack clearance, each with its margin [m], worst first; by coal.

        Args:
            position: all joints of the robot [rad], shape (columns,).
            held: what each arm holds, shape (arms,).
        """
        return self.test.lacking(position, self._pairs(held))

    def _pairs(self, held: IntArray) -> list[Pair]:
        """Return all pairs that must keep apart while each arm holds something, shape (arms,)."""
        found = [] if self.alone else list(self._cross(held).pairs)
        for a, (arm, number) in enumerate(zip(self.arms, held.tolist(), strict=True)):
            if self.alone not in (None, arm):
                continue
            load = self.loads.load(number)
            found += self.own_pairs(a, number)
            found += self.own_pairs(a, number, touching=True)
            found += self.test.ground(arm, load.name).pairs if load.on_line else ()
        return found

    def own_pairs(self, a: int, number: int, *, touching: bool = False) -> Sequence[Pair]:
        """Return the pairs of one arm, but with the other one, while it holds something.

        Args:
            a: which arm.
            number: what it holds.
            touching: whether only those of parts that may touch are returned, or all others.
        """
        load = self.loads.load(number)
        if not self.rooms:
            return () if touching else self._own(a, load).pairs
        group, scenes = self._scenes(a, load, touching=touching)
        return [group.pairs[k] for k in scenes.of(load.scene)]

    def margins(self, position: FloatArray, held: IntArray) -> FloatArray:
        """Returns the least margin of everything from everything [m], shape (n,); arguments as of `cross_margins`."""
        found = self.cross_margins(position, held)
        for a in range(len(self.arms)):
            found = np.minimum(found, self.own_margins(a, position, held[:, a], ground=True))
        return found
