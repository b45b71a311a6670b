"""What is collision-free in a cell, asked by arm, by what each arm holds, and on or off its lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field, replace

import numpy as np

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
    """The quick test of a cell.

    What an arm holds is a number: twice the place of its name in `parts`, and one more on a stop's lines, where a part
    need not be clear of what stands still. In a hand-over twice the number of parts are added: the other arm's tool,
    and what that holds, may touch the part then. What lies meanwhile adds `size` times the number of the scene.
    """

    test: QuickTest
    """Hulls and pairs."""
    arms: tuple[str, ...]
    """Names of the arms."""
    columns: tuple[tuple[int, ...], ...]
    """Columns of each arm's joints among the robot's."""
    parts: tuple[str, ...]
    """Names of all that is ever held, see `Held.name`; the first one is nothing, tools come before parts in them."""
    alone: str | None = None
    """The only arm that is tested, and not against the other one; None for all arms."""
    skew: float = 0.0
    """Delay of either arm with which motions have to be clear as well [s]."""
    rooms: tuple[PartRoom, ...] = ()
    """Rooms of parts that wait or lie at times."""
    scenes: tuple[Scene, ...] = ({},)
    """What lies when; nothing in the first one, unless it lies all the time."""
    listed: dict[tuple[int, int, bool], tuple[PairGroup, Scenes]] = field(
        default_factory=dict, compare=False
    )
    """Pairs, and those that count in each scene, by arm, what it holds, and whether they are those that may touch."""

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
            ("", *dict.fromkeys(part for _, part in carried)),
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

    @property
    def size(self) -> int:
        """Number of the numbers of what an arm may hold in one scene."""
        return 4 * len(self.parts)

    def held(self, part: str, on_line: bool = False) -> int:
        """Returns the number of what an arm holds."""
        return 2 * self.parts.index(part) + on_line

    def at_stops(self, held: IntArray, handing: BoolArray) -> IntArray:
        """Returns the numbers of what arms hold at their stops and on the lines there.

        Args:
            held: what they hold, shape (..., arms).
            handing: where a part is handed over, shape (...).
        """
        numbers: IntArray = np.where(handing[..., None], held + 2 * len(self.parts), held | 1)
        return numbers

    def may_only_touch(self, held: IntArray) -> BoolArray:
        """Returns where what an arm holds counts only where it reaches into something, shape (n,).

        Args:
            held: what each arm holds, shape (n, arms).
        """
        found: BoolArray = (held % 2 == 1).any(axis=1)
        if self.rooms:
            for a in range(len(self.arms)):
                for number in distinct(held[:, a]).tolist():
                    if self._scenes(a, number, touching=True)[1].of(number // self.size):
                        found |= held[:, a] == number
        return found

    def part_of(self, number: int) -> str:
        """Returns the part of a number."""
        return self.parts[(number % self.size // 2) % len(self.parts)]

    def is_handed(self, number: int) -> bool:
        """Returns whether the part of a number is being handed over."""
        return number % self.size >= 2 * len(self.parts)

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
        scene, base = held // self.size, held % self.size
        for number in distinct(base).tolist():
            rows = np.flatnonzero(base == number)
            found[rows] = self._margins(a, number, position[rows], scene[rows])
            if not ground:
                continue
            groups = [self._margins(a, number, position[rows], scene[rows], touching=True)]
            if number % 2:
                lying = self.test.ground(self.arms[a], self.part_of(number))
                groups.append(self.test.margins(lying, position[rows]))
            for margin in groups:
                # What only touches is as good as far away.
                found[rows] = np.where(margin < 0.0, np.minimum(found[rows], margin), found[rows])
        return found

    def _margins(
        self, a: int, number: int, position: FloatArray, scene: IntArray, *, touching: bool = False
    ) -> FloatArray:
        """Returns the margins of one arm that holds one thing, in some scenes [m], shape (n,)."""
        if not self.rooms:
            if touching:
                return np.full(len(position), np.inf)
            return self.test.margins(self._own(a, number), position)
        group, scenes = self._scenes(a, number, touching=touching)
        if not len(scenes.listed):
            return np.full(len(position), np.inf)
        return self.test.margins(group, position, (scenes, scene))

    def _own(self, a: int, number: int, *, touching: bool = False) -> PairGroup:
        arm, part = self.arms[a], self.part_of(number)
        if not touching:
            return self.test.own(arm, part, bool(number % 2))
        scenes = [scene.get(arm, ArmScene()) for scene in self.scenes]
        stops = [s for scene in scenes for s in (*scene.left.items(), *scene.here.items())]
        return self.test.touching(arm, part, stops)

    def _scenes(self, a: int, number: int, *, touching: bool = False) -> tuple[PairGroup, Scenes]:
        """Returns pairs of one arm, and those that count in each scene while it holds something."""
        key = a, number % self.size, touching
        if key not in self.listed:
            group = self._own(a, number, touching=touching)
            self.listed[key] = group, self._listed(self.arms[a], number, group, touching=touching)
        return self.listed[key]

    def _listed(self, arm: str, number: int, group: PairGroup, *, touching: bool) -> Scenes:
        rooms = [self.test.room_of(pair) for pair in group.pairs]
        room = np.array([-1 if r is None else r for r in rooms], dtype=np.int64)
        part = np.array([self.test.carried_in(pair) for pair in group.pairs], dtype=np.bool_)
        part &= room >= 0
        tool = np.array([self.test.is_on_flange(pair, arm) for pair in group.pairs], dtype=np.bool_)
        holds = bool(self.test.part_in(arm, self.part_of(number)))
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
                on_line = bool(number % 2) and r in own.here
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
        if len(self.parts) == 1:
            return self.test.margins(self.test.cross(), position)
        found = np.empty(len(position))
        parts = held % self.size // 2
        for numbers in np.unique(parts, axis=0):
            rows = np.flatnonzero((parts == numbers).all(axis=1))
            group = self._cross([2 * number for number in numbers.tolist()])
            found[rows] = self.test.margins(group, position[rows])
        return found

    def _cross(self, numbers: Sequence[int]) -> PairGroup:
        """Returns the pairs of one arm with the other while they hold things of some numbers."""
        by_arm = dict(zip(self.arms, numbers, strict=True))
        carried = {arm: self.part_of(number) for arm, number in by_arm.items()}
        handed = frozenset(arm for arm, number in by_arm.items() if self.is_handed(number))
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
        """Returns all pairs that must keep apart while the arms hold things of some numbers, shape (arms,)."""
        parts = [self.part_of(number) for number in held.tolist()]
        found = [] if self.alone else list(self._cross(held.tolist()).pairs)
        for a, (arm, part, number) in enumerate(zip(self.arms, parts, held.tolist(), strict=True)):
            if self.alone not in (None, arm):
                continue
            found += self.own_pairs(a, number)
            found += self.own_pairs(a, number, touching=True)
            found += self.test.ground(arm, part).pairs if number % 2 else ()
        return found

    def own_pairs(self, a: int, number: int, *, touching: bool = False) -> Sequence[Pair]:
        """Returns the pairs of one arm, but with the other one, while it holds something.

        Args:
            a: which arm.
            number: what it holds.
            touching: whether only those of parts that may touch are asked for, or all others.
        """
        if not self.rooms:
            return () if touching else self._own(a, number).pairs
        group, scenes = self._scenes(a, number, touching=touching)
        return [group.pairs[k] for k in scenes.of(number // self.size)]

    def margins(self, position: FloatArray, held: IntArray) -> FloatArray:
        """Returns the least margin of everything from everything [m], shape (n,); arguments as of `cross_margins`."""
        found = self.cross_margins(position, held)
        for a in range(len(self.arms)):
            found = np.minimum(found, self.own_margins(a, position, held[:, a], ground=True))
        return found
