"""Clearance test of a cell, by arm, held objects and kind of motion.

Held objects are numbers of `Loads`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field, replace

import numpy as np

from dualarm_cli.collision.pair_groups import PairGroup
from dualarm_cli.collision.quick_test import QuickTest
from dualarm_cli.collision.rooms import PartRoom, rooms_of
from dualarm_cli.collision.scenes import ArmScene, Scene
from dualarm_cli.collision.solids import Pair
from dualarm_cli.compiled.pair_margins import Scenes
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray, distinct
from dualarm_cli.model.cell import Cell, Held
from dualarm_cli.model.job import Job
from dualarm_cli.model.lying import may_touch
from dualarm_cli.records import dataclass

SLACK = 0.002
"""Additional clearance of stops, for nearby lines and motions [m]."""
LEVER = 0.3
"""Length with which the lack of an angle counts as a lack of clearance [m]."""


@dataclass(frozen=True)
class Load:
    """Tool and part held by an arm, with their treatment in collision checks."""

    name: str
    """Name of the held object, see `Held.name`; empty for nothing."""
    on_line: bool = False
    """Whether it is on a stop's lines, where the part may touch standing objects."""
    is_handed: bool = False
    """Whether the object is handed over.

    The other tool and its load may touch it then.
    """
    scene: int = 0
    """Index of the scene."""


@dataclass(frozen=True)
class Loads:
    """Numbering of loads in arrays, by name within each scene."""

    names: tuple[str, ...]
    """Names of all objects that may be held: nothing, then tools, then parts."""

    @property
    def _per_scene(self) -> int:
        return 4 * len(self.names)

    def number(self, name: str, *, on_line: bool = False) -> int:
        """Return the number of a load in the first scene."""
        return 2 * self.names.index(name) + on_line

    def load(self, number: int) -> Load:
        """Decode the number of a load."""
        scene, plain = divmod(number, self._per_scene)
        is_handed, place = divmod(plain // 2, len(self.names))
        return Load(self.names[place], plain % 2 == 1, is_handed == 1, scene)

    def nothing(self, *shape: int) -> IntArray:
        """Return the numbers of empty arms in the first scene."""
        return np.full(shape, self.number(""), dtype=np.int64)

    def in_scenes(self, numbers: IntArray, scenes: IntArray) -> IntArray:
        """Return the numbers of loads of the first scene in other scenes."""
        return numbers + self._per_scene * scenes

    def scenes(self, numbers: IntArray) -> IntArray:
        """Return the scenes of loads."""
        return numbers // self._per_scene

    def in_first_scene(self, numbers: IntArray) -> IntArray:
        """Return the numbers of loads in the first scene."""
        return numbers % self._per_scene

    def off_lines(self, numbers: IntArray) -> IntArray:
        """Return the numbers of loads off lines, in the first scene."""
        return self.in_first_scene(numbers) // 2 * 2

    def on_lines(self, numbers: IntArray) -> IntArray:
        """Return the numbers of loads on lines."""
        return numbers | 1

    def are_on_lines(self, numbers: IntArray) -> BoolArray:
        """Check which loads are on lines."""
        return np.asarray(numbers % 2 == 1)

    def at_stops(self, numbers: IntArray, handing: BoolArray) -> IntArray:
        """Return the numbers of loads at stops and on the lines there.

        Args:
            numbers: numbers of loads off lines, shape (..., arms).
            handing: where a part is handed over, shape (...).
        """
        handed = numbers + 2 * len(self.names)
        return np.where(handing[..., None], handed, self.on_lines(numbers))

    def fuller(self, before: IntArray, after: IntArray) -> IntArray:
        """Return the numbers of the larger loads.

        A tool with a part exceeds the tool.
        """
        return np.maximum(before, after)


@dataclass(frozen=True)
class CellClearance:
    """Quick clearance test of a cell; held objects are numbers of its `loads`."""

    test: QuickTest
    """Hulls and pairs of solids."""
    arms: tuple[str, ...]
    """Names of the arms."""
    columns: tuple[tuple[int, ...], ...]
    """Columns of each arm's joints among the robot's."""
    loads: Loads
    """Numbering of all objects that may be held."""
    alone: str | None = None
    """Only arm that is tested, without the other arm; None for all arms."""
    skew: float = 0.0
    """Delay of either arm at which motions must keep clearance [s]."""
    rooms: tuple[PartRoom, ...] = ()
    """Rooms of parts that wait or lie."""
    scenes: tuple[Scene, ...] = ({},)
    """Parts that lie in each scene; without others, the first scene is empty."""
    upright: Mapping[tuple[str, str], tuple[FloatArray, float]] = field(default_factory=dict)
    """Vertical tool axis and its largest angle [rad], by arm and name of its load."""
    listed: dict[tuple[int, str, bool, bool], tuple[PairGroup, Scenes]] = field(
        default_factory=dict, compare=False
    )
    """Cache of each arm's pairs, with the indices that are tested in each scene.

    Keys: arm, name of its load, whether it is on a line, and whether these are the pairs that may touch.
    """

    @classmethod
    def of(
        cls,
        cell: Cell,
        carried: Sequence[tuple[str, str]],
        skew: float = 0.0,
        rooms: tuple[PartRoom, ...] = (),
    ) -> CellClearance:
        """Prepare the test of a cell.

        Args:
            cell: cell of the data model.
            carried: arm and name of every object that an arm may hold.
            skew: delay of either arm at which motions must keep clearance [s].
            rooms: rooms of parts that wait or lie; all are empty until scenes are given.
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
        """Prepare the test of a job's cell, with all its parts and their rooms."""
        upright = {
            (arm.name, Held(task.tool, task.part).name): (np.array(task.upright), task.tilt)
            for task in job.tasks
            for arm in job.cell.robot.arms
            if task.tilt < np.inf and task.upright is not None and task.allows(arm.name)
        }
        clearance = cls.of(job.cell, job.carried(), job.skew, rooms_of(job))
        return replace(clearance, upright=upright)

    def in_scenes(self, scenes: tuple[Scene, ...]) -> CellClearance:
        """Return the same test with given scenes."""
        return replace(self, scenes=scenes, listed={})

    def may_only_touch(self, held: IntArray) -> BoolArray:
        """Find the rows in which an arm's load may touch but not overlap, shape (n,).

        Args:
            held: loads of the arms, shape (n, arms).
        """
        rows: BoolArray = np.any(self.loads.are_on_lines(held), axis=1)
        if self.rooms:
            for a in range(len(self.arms)):
                for number in distinct(held[:, a]).tolist():
                    load = self.loads.load(number)
                    if self._scenes(a, load, touching=True)[1].of(load.scene):
                        rows |= held[:, a] == number
        return rows

    def arm_margins(
        self, a: int, position: FloatArray, held: IntArray, *, ground: bool = False
    ) -> FloatArray:
        """Compute the least margin of an arm without the other arm [m], shape (n,).

        Args:
            a: index of the arm.
            position: all joints of the robot [rad], shape (n, columns).
            held: its loads, shape (n,).
            ground: whether overlaps of a part on a line are tested as well; that takes longer.
        """
        if self.alone not in (None, self.arms[a]):
            return np.full(len(position), np.inf)
        margins = np.empty(len(position))
        scene, plain = self.loads.scenes(held), self.loads.in_first_scene(held)
        for number in distinct(plain).tolist():
            rows, load = np.flatnonzero(plain == number), self.loads.load(number)
            margins[rows] = self._margins(a, load, position[rows], scene[rows])
            if not ground:
                continue
            groups = [self._margins(a, load, position[rows], scene[rows], touching=True)]
            if load.on_line:
                lying = self.test.ground(self.arms[a], load.name)
                groups.append(self.test.margins(lying, position[rows]))
            for overlap in groups:
                # Contact without overlap is allowed.
                margins[rows] = np.where(
                    overlap < 0.0, np.minimum(margins[rows], overlap), margins[rows]
                )
        if self.upright:
            margins = np.minimum(margins, LEVER * self.spare_tilt(a, position, held))
        return margins

    def spare_tilt(self, a: int, position: FloatArray, held: IntArray) -> FloatArray:
        """Compute how much further an arm's load may lean [rad], shape (n,); infinite without a limit.

        The arguments are those of `arm_margins`.
        """
        spare = np.full(len(position), np.inf)
        plain = self.loads.off_lines(held)
        for number in distinct(plain).tolist():
            key = self.arms[a], self.loads.load(number).name
            if key in self.upright:
                rows, (axis, tilt) = np.flatnonzero(plain == number), self.upright[key]
                spare[rows] = tilt - self.test.leaning(key[0], axis, position[rows])
        return spare

    def least_spare_tilt(self, position: FloatArray, held: IntArray) -> tuple[str, float]:
        """Find the arm whose load may lean least beyond one posture, and that angle [rad].

        The arguments are those of `cross_margins`, one row each.
        """
        spare = [self.spare_tilt(a, position, held[:, a])[0] for a in range(len(self.arms))]
        least = int(np.argmin(spare))
        return self.arms[least], float(spare[least])

    def _margins(
        self, a: int, load: Load, position: FloatArray, scene: IntArray, *, touching: bool = False
    ) -> FloatArray:
        """Compute the margins of an arm with one load in given scenes [m], shape (n,)."""
        if not self.rooms:
            if touching:
                return np.full(len(position), np.inf)
            return self.test.margins(self._arm_pairs(a, load), position)
        group, scenes = self._scenes(a, load, touching=touching)
        if not len(scenes.listed):
            return np.full(len(position), np.inf)
        return self.test.margins(group, position, (scenes, scene))

    def _arm_pairs(self, a: int, load: Load, *, touching: bool = False) -> PairGroup:
        arm = self.arms[a]
        if not touching:
            return self.test.arm_pairs(arm, load.name, load.on_line)
        scenes = [scene.get(arm, ArmScene()) for scene in self.scenes]
        stops = [s for scene in scenes for s in (*scene.left.items(), *scene.here.items())]
        return self.test.touching(arm, load.name, stops)

    def _scenes(self, a: int, load: Load, *, touching: bool = False) -> tuple[PairGroup, Scenes]:
        """Return the pairs of an arm with a load, selected for each scene."""
        key = a, load.name, load.on_line, touching
        if key not in self.listed:
            group = self._arm_pairs(a, load, touching=touching)
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
            arm_scene = scene.get(arm, ArmScene())
            is_there = np.zeros(len(self.rooms) + 1, dtype=np.bool_)
            is_there[list(arm_scene.holding if holds else arm_scene.empty)] = True
            touched = np.zeros(len(is_there), dtype=np.bool_)
            if arm_scene.carries is not None:
                touched[:-1] = [may_touch(arm_scene.carries, r.task) for r in self.rooms]
            is_there[-1] = not touching
            counts = is_there[room] & np.where(part, touched[room] == touching, not touching)
            for r in {**arm_scene.left, **arm_scene.here}:
                on_line = load.on_line and r in arm_scene.here
                visits = [side[r] for side in (arm_scene.left, arm_scene.here) if r in side]
                for k in np.flatnonzero(is_there[room] & tool & (room == r)).tolist():
                    needed = min(self.test.needed(group.pairs[k], arm, visit) for visit in visits)
                    counts[k] = not on_line and group.pairs[k].required == needed
            lists.append(np.flatnonzero(counts))
        first = np.cumsum([0, *(len(row) for row in lists)])
        return Scenes(first, np.concatenate(lists))

    def cross_margins(self, position: FloatArray, held: IntArray) -> FloatArray:
        """Compute the least margin between the arms [m], shape (n,).

        Args:
            position: all joints of the robot [rad], shape (n, columns).
            held: loads of the arms, shape (n, arms).
        """
        if self.alone:
            return np.full(len(position), np.inf)
        if len(self.loads.names) == 1:
            return self.test.margins(self.test.cross(), position)
        margins = np.empty(len(position))
        plain = self.loads.off_lines(held)
        for numbers in np.unique(plain, axis=0):
            rows = np.flatnonzero((plain == numbers).all(axis=1))
            margins[rows] = self.test.margins(self._cross(numbers), position[rows])
        return margins

    def _cross(self, held: IntArray) -> PairGroup:
        """Return the pairs between the arms with given loads, shape (arms,)."""
        loads = dict(zip(self.arms, map(self.loads.load, held.tolist()), strict=True))
        carried = {arm: load.name for arm, load in loads.items()}
        handed = frozenset(arm for arm, load in loads.items() if load.is_handed)
        return self.test.cross(carried, handed)

    def nearest(self, position: FloatArray, held: IntArray) -> tuple[str, str, float]:
        """Find the pair of bodies with the least margin [m], by coal.

        Args:
            position: all joints of the robot [rad], shape (columns,).
            held: loads of the arms, shape (arms,).
        """
        return self.test.nearest(position, self._pairs(held))

    def lacking(self, position: FloatArray, held: IntArray) -> list[tuple[str, str, float]]:
        """List the pairs of bodies without clearance, with margins [m], worst first; by coal.

        Args:
            position: all joints of the robot [rad], shape (columns,).
            held: loads of the arms, shape (arms,).
        """
        return self.test.lacking(position, self._pairs(held))

    def _pairs(self, held: IntArray) -> list[Pair]:
        """List all tested pairs for given loads, shape (arms,)."""
        pairs = [] if self.alone else list(self._cross(held).pairs)
        for a, (arm, number) in enumerate(zip(self.arms, held.tolist(), strict=True)):
            if self.alone not in (None, arm):
                continue
            load = self.loads.load(number)
            pairs += self.arm_pairs(a, number)
            pairs += self.arm_pairs(a, number, touching=True)
            pairs += self.test.ground(arm, load.name).pairs if load.on_line else ()
        return pairs

    def arm_pairs(self, a: int, number: int, *, touching: bool = False) -> Sequence[Pair]:
        """Return the pairs of an arm with a load, without the other arm.

        Args:
            a: index of the arm.
            number: its load.
            touching: whether to return the pairs that may touch, or all others.
        """
        load = self.loads.load(number)
        if not self.rooms:
            return () if touching else self._arm_pairs(a, load).pairs
        group, scenes = self._scenes(a, load, touching=touching)
        return [group.pairs[k] for k in scenes.of(load.scene)]

    def margins(self, position: FloatArray, held: IntArray) -> FloatArray:
        """Compute the least margin of all pairs [m], shape (n,); arguments as of `cross_margins`."""
        margins = self.cross_margins(position, held)
        for a in range(len(self.arms)):
            margins = np.minimum(margins, self.arm_margins(a, position, held[:, a], ground=True))
        return margins
