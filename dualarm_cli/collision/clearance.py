"""What keeps clear in a cell, asked by arm, by what each arm holds, and on or off its lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dualarm_cli.collision.quick_test import QuickTest
from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.model.cell import Cell

SLACK = 0.002
"""What stops keep beyond the required clearance, so that lines and motions near them keep theirs [m]."""


@dataclass(frozen=True)
class CellClearance:
    """The quick test of a cell.

    What an arm holds is a number: twice the place of its name in `parts`, and one more on a stop's lines, where a part
    need not keep clear of what stands still.
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
    """Whether arms have to keep clear of one another; else each is looked at by itself."""

    @classmethod
    def of(cls, cell: Cell, carried: Sequence[tuple[str, str]]) -> CellClearance:
        """Prepares a cell.

        Args:
            cell: the noun.
            carried: arm and name of everything that an arm ever holds.

        Raises:
            InputError: a mesh that cannot be used.
        """
        arms = cell.robot.arms
        return cls(
            QuickTest(cell, carried),
            tuple(arm.name for arm in arms),
            tuple(tuple(cell.robot.columns(arm.joints)) for arm in arms),
            ("", *dict.fromkeys(part for _, part in carried)),
        )

    def held(self, part: str, on_line: bool = False) -> int:
        """Returns the number of what an arm holds."""
        return 2 * self.parts.index(part) + on_line

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
        found = np.full(len(position), np.inf)
        for number in np.unique(held).tolist():
            rows = np.flatnonzero(held == number)
            group = self.test.own(self.arms[a], self.parts[number // 2], bool(number % 2))
            found[rows] = self.test.margins(group, position[rows])
            if ground and number % 2:
                lying = self.test.ground(self.arms[a], self.parts[number // 2])
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
        found = np.full(len(position), np.inf)
        parts = held // 2
        for numbers in np.unique(parts, axis=0):
            rows = np.flatnonzero((parts == numbers).all(axis=1))
            carried = {
                arm: self.parts[k] for arm, k in zip(self.arms, numbers.tolist(), strict=True)
            }
            found[rows] = self.test.margins(self.test.cross(carried), position[rows])
        return found

    def nearest(self, position: FloatArray, held: IntArray) -> tuple[str, str, float]:
        """Returns the two bodies that have the least margin, and it [m]; by coal.

        Args:
            position: all joints of the robot [rad], shape (columns,).
            held: what each arm holds, shape (arms,).
        """
        parts = [self.parts[number // 2] for number in held.tolist()]
        groups = [self.test.cross(dict(zip(self.arms, parts, strict=True)))]
        groups += [
            self.test.own(arm, part, bool(number % 2))
            for arm, part, number in zip(self.arms, parts, held.tolist(), strict=True)
        ]
        groups += [
            self.test.ground(arm, part)
            for arm, part, number in zip(self.arms, parts, held.tolist(), strict=True)
            if number % 2
        ]
        return self.test.nearest(position, [pair for group in groups for pair in group.pairs])

    def margins(self, position: FloatArray, held: IntArray) -> FloatArray:
        """Returns the least margin of everything from everything [m], shape (n,); arguments as of `cross_margins`."""
        found = self.cross_margins(position, held)
        for a in range(len(self.arms)):
            found = np.minimum(found, self.own_margins(a, position, held[:, a], ground=True))
        return found
