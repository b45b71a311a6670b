"""What beginnings of orders may be continued with, cheapest first: only as many as there is room for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray

HALVINGS = 16
"""So often a threshold is halved to keep as many as there is room for."""


@dataclass(frozen=True)
class Continuations:
    """What nodes may be continued with, row by row, the cheapest first."""

    begin: IntArray
    """Where each row begins, and where all end, shape (rows + 1,)."""
    column: IntArray
    """Numbers of what they may be continued with, shape (k,)."""
    line: FloatArray
    """What that adds [s], each row by `step` above the one before it, so that all are in rising order, shape (k,)."""
    step: float

    @classmethod
    def of(cls, more: FloatArray, most: FloatArray) -> Continuations:
        """Sorts what is worth it.

        Args:
            more: what continuations add [s], shape (rows, m).
            most: how much they may add [s], shape (rows,).
        """
        row, column = np.nonzero(more < most[:, None])
        value = more[row, column].astype(np.float64)
        order = np.lexsort((value, row))
        begin = np.searchsorted(row, np.arange(len(more) + 1))
        step = 4.0 * (1.0 + float(np.abs(value).max(initial=0.0)))
        return cls(begin, column[order], value[order] + step * row, step)

    def counts(self, room: FloatArray, row: IntArray, most: int) -> tuple[IntArray, float]:
        """Returns how many of its cheapest continuations each label has room for, (n,), and how much less than it has.

        Args:
            room: what continuations may add to each label [s], shape (n,).
            row: the row of each label, shape (n,).
            most: how many there may be of all labels together; where there are more, all have less room.
        """

        def found(less: float) -> IntArray:
            wanted = np.clip(room - less, -0.5 * self.step, 0.5 * self.step) + self.step * row
            return np.searchsorted(self.line, wanted) - self.begin[row]

        counts = found(0.0)
        if counts.sum() <= most:
            return counts, 0.0
        low, high = 0.0, float(room.max()) + self.step
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if found(middle).sum() > most else (low, middle)
        return found(high), high
