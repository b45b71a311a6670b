"""Which postures and moves of a sequence keep clear of everything, by the quick test."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dualarm_cli.collision.quick_test import QuickTest
from dualarm_cli.geometry.arrays import BoolArray, FloatArray

SLACK = 0.004
"""What stops keep beyond the required clearance, so that lines and motions near them keep theirs [m]."""
SAMPLES = 8
"""Postures along a move, between its ends."""


@dataclass(frozen=True)
class Clearance:
    """The quick test of a cell, asked in the search's terms."""

    test: QuickTest
    """Hulls and pairs."""
    names: tuple[str, ...]
    """The arms in the problem's order."""
    columns: tuple[tuple[int, ...], ...]
    """Columns of each arm's joints among the robot's."""
    platform_columns: tuple[int, ...]
    """Columns of the platform's joints."""
    rest: FloatArray
    """All joints of the robot where nothing else is said [rad], shape (columns,)."""
    turns: bool
    """Whether the platform's one joint is turned."""

    def positions(self, angle: FloatArray, joints: Sequence[FloatArray | None]) -> FloatArray:
        """Returns all joints of the robot [rad], shape (n, columns).

        Args:
            angle: platform angles [rad], shape (n,).
            joints: of each arm [rad], shape (n, 7), or None for where it rests.
        """
        position = np.tile(self.rest, (len(angle), 1))
        if self.turns:
            position[:, self.platform_columns[0]] = angle
        for columns, q in zip(self.columns, joints, strict=True):
            if q is not None:
                position[:, list(columns)] = q
        return position

    def arm_free(self, a: int, angle: FloatArray, q: FloatArray) -> BoolArray:
        """Returns where one arm keeps clear of itself and of all that is not the other arm, shape (n,)."""
        joints: list[FloatArray | None] = [None] * len(self.columns)
        joints[a] = q
        margins = self.test.margins(self.test.own[self.names[a]], self.positions(angle, joints))
        return np.asarray(margins >= SLACK)

    def free(self, position: FloatArray) -> BoolArray:
        """Returns where everything keeps clear of everything, for all joints (n, columns); shape (n,)."""
        free = np.ones(len(position), dtype=np.bool_)
        for group in (self.test.cross, *self.test.own.values()):
            rows = np.flatnonzero(free)
            free[rows] = self.test.margins(group, position[rows]) >= SLACK
        return free

    def moves_free(self, start: FloatArray, end: FloatArray) -> tuple[BoolArray, BoolArray]:
        """Returns where each arm's straight move keeps clear of all but the other arm, and where of that, (n,) each.

        SAMPLES postures on the way are looked at.

        Args:
            start: all joints [rad], shape (n, columns).
            end: all joints [rad], shape (n, columns).
        """
        share = (np.arange(SAMPLES) + 1.0) / (SAMPLES + 1.0)
        way = (start[:, None] + share[:, None] * (end - start)[:, None]).reshape(-1, start.shape[1])
        own = np.ones(len(way), dtype=np.bool_)
        for group in self.test.own.values():
            own &= self.test.margins(group, way) >= 0.0
        cross = self.test.margins(self.test.cross, way) >= 0.0
        shape = (len(start), SAMPLES)
        free = (np.asarray(found.reshape(shape).all(axis=1)) for found in (own, cross))
        one, other = free
        return one, other
