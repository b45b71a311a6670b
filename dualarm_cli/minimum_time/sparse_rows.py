"""Rows of a sparse linear program, collected piece by piece and sorted by stage."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray


@dataclass
class Rows:
    """Rows of `matrix @ x <= bound`, collected piece by piece."""

    row: list[IntArray] = field(default_factory=list)
    column: list[IntArray] = field(default_factory=list)
    value: list[FloatArray] = field(default_factory=list)
    bound: list[FloatArray] = field(default_factory=list)
    stage: list[IntArray] = field(default_factory=list)
    count: int = 0

    def add(
        self, columns: IntArray, values: FloatArray, bound: FloatArray, stage: IntArray
    ) -> None:
        """Appends m rows: columns and values (m, w), bounds and stages (m,); columns of -1 do not count."""
        rows = np.broadcast_to(np.arange(len(bound))[:, None] + self.count, columns.shape)
        used = (columns >= 0) & (values != 0.0)
        self.row.append(rows[used])
        self.column.append(columns[used])
        self.value.append(values[used])
        self.bound.append(bound)
        self.stage.append(stage)
        self.count += len(bound)

    def by_stage(self) -> Program:
        """Returns all rows in order of their stages."""
        stage = np.concatenate(self.stage)
        order = np.argsort(stage, kind="stable")
        place = np.empty_like(order)
        place[order] = np.arange(len(order))
        row = place[np.concatenate(self.row)]
        entries = np.argsort(row, kind="stable")
        return Program(
            row[entries],
            np.concatenate(self.column)[entries],
            np.concatenate(self.value)[entries],
            np.concatenate(self.bound)[order],
            stage[order],
        )


@dataclass(frozen=True)
class Program:
    """Rows in order of their stages."""

    row: IntArray
    """Row of each entry, ascending."""
    column: IntArray
    """Column of each entry."""
    value: FloatArray
    """Value of each entry."""
    bound: FloatArray
    """Bound of each row."""
    stage: IntArray
    """Stage of each row, ascending."""

    def within(self, first: int, past: int) -> tuple[IntArray, IntArray, FloatArray, FloatArray]:
        """Returns entries (rows counted from 0) and bounds of the stages from first to before past."""
        low, high = np.searchsorted(self.stage, [first, past])
        begin, end = np.searchsorted(self.row, [low, high])
        entries = slice(begin, end)
        return (
            self.row[entries] - low,
            self.column[entries],
            self.value[entries],
            self.bound[low:high],
        )
