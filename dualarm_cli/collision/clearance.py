"""What is collision-free in a cell, asked by arm, by what each arm holds, and on or off its lines."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dualarm_cli.collision.pair_groups import PairGroup
from dualarm_cli.collision.quick_test import QuickTest
from dualarm_cli.collision.solids import Pair
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray, distinct
from dualarm_cli.model.cell import Cell
from dualarm_cli.records import dataclass

SLACK = 0.002
"""What stops keep beyond the required clearance, so that lines and motions near them keep theirs [m]."""


@dataclass(frozen=True)
class CellClearance:
    """The quick test of a cell.

    What an arm holds is a number: twice the place of its name in `parts`, and one more on a stop's lines, where a part
    need not be clear of what stands still. In a hand-over twice the number of parts are added: the other arm's tool,
    and what that holds, may touch the part then.
    """

    test: QuickTest
    """Hulls and pairs."""
    arms: tuple[str, ...]
    """Names of the arms."""
    columns: tuple[tuple[int, ...], ...]
    """Columns of each arm's joints among the robot's."""
    parts: tuple[str, ...]
    """Names of all that is ever held, see `Held.name`; the first one is nothing, tools come before parts in them."""
    crossing: bool = True
    """Whether arms have to be clear of one another; else each is looked at by itself."""
    skew: float = 0.0
    """Delay of either arm with which motions have to be clear as well [s]."""

    @classmethod
    def of(cls, cell: Cell, carried: Sequence[tuple[str, str]], skew: float = 0.0) -> CellClearance:
        """Prepares a cell.

        Args:
            cell: of the data model.
            carried: arm and name of everything that an arm ever holds.
            skew: delay of either arm with which motions have to be clear as well [s].
        """
        arms = cell.robot.arms
        return cls(
            QuickTest(cell, carried),
            tuple(arm.name for arm in arms),
            tuple(tuple(cell.robot.columns(arm.joints)) for arm in arms),
            ("", *dict.fromkeys(part for _, part in carried)),
            skew=skew,
        )

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

    def part_of(self, number: int) -> str:
        """Returns the part of a number."""
        return self.parts[(number // 2) % len(self.parts)]

    def is_handed(self, number: int) -> bool:
        """Returns whether the part of a number is being handed over."""
        return number >= 2 * len(self.parts)

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
        if len(self.parts) == 1:
            return self.test.margins(self.test.own(self.arms[a]), position)
        found = np.empty(len(position))
        for number in distinct(held).tolist():
            rows = np.flatnonzero(held == number)
            group = self.test.own(self.arms[a], self.part_of(number), bool(number % 2))
            found[rows] = self.test.margins(group, position[rows])
            if ground and number % 2:
                lying = self.test.ground(self.arms[a], self.part_of(number))
                margin = self.test.margins(lying, position[rows])
                # What only touches is as good as far away.
                found[rows] = np.where(margin < 0.0, np.minimum(found[rows], margin), found[rows])
        return found

    def cross_margins(self, position: FloatArray, held: IntArray) -> FloatArray:
        """Returns the least margin of one arm from the other [m], shape (n,).

        Args:
            position: all joints of the robot [rad], shape (n, columns).
            held: what each arm holds, shape (n, arms).
        """
        if not self.crossing:
            return np.full(len(position), np.inf)
        if len(self.parts) == 1:
            return self.test.margins(self.test.cross(), position)
        found = np.empty(len(position))
        parts = held // 2
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
        groups = [self._cross(held.tolist())]
        groups += [
            self.test.own(arm, part, bool(number % 2))
            for arm, part, number in zip(self.arms, parts, held.tolist(), strict=True)
        ]
        groups += [
            self.test.ground(arm, part)
            for arm, part, number in zip(self.arms, parts, held.tolist(), strict=True)
            if number % 2
        ]
        return [pair for group in groups for pair in group.pairs]

    def margins(self, position: FloatArray, held: IntArray) -> FloatArray:
        """Returns the least margin of everything from everything [m], shape (n,); arguments as of `cross_margins`."""
        found = self.cross_margins(position, held)
        for a in range(len(self.arms)):
            found = np.minimum(found, self.own_margins(a, position, held[:, a], ground=True))
        return found
