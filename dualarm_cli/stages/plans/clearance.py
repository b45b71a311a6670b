"""Collision test of a sequence's postures and moves, by the quick test."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dualarm_cli.collision.clearance import SLACK, CellClearance
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.records import dataclass

SAMPLES = 8
"""Postures along a move, between its ends."""
ALIKE, LIKE = 0.15, 0.5
"""Stages whose joints that matter are all nearer than this to those of a no-good are as that: by their stops alone,
or by a move [rad]."""


@dataclass(frozen=True)
class NoGood:
    """A stage that turned out to collide when it was timed, whatever was tried, or at what cost it does."""

    stage: int
    """Its number, or the number of stages for the return."""
    columns: tuple[int, ...]
    """Joints that matter: of one arm and the platform, or all."""
    start: FloatArray | None
    """All joints before it [rad], shape (columns,); None where what comes before does not matter."""
    arrival: FloatArray
    """All joints after the transfer [rad], shape (columns,)."""
    cost: float = np.inf
    """How much longer it takes than straight moves [s]."""


@dataclass(frozen=True)
class SequenceClearance:
    """The quick test of a cell, asked in the search's terms."""

    cell: CellClearance
    """Hulls and pairs."""
    platform_columns: tuple[int, ...]
    """Columns of the platform's joints."""
    rest: FloatArray
    """All joints of the robot by default [rad], shape (columns,)."""
    turns: bool
    """Whether the platform's one joint is turned."""
    before: IntArray
    """What each arm holds before each stage's targets, shape (n, arms)."""
    after: IntArray
    """What each arm holds after them, shape (n, arms)."""
    handing: BoolArray
    """In which stages a part is handed over: both arms are there at once, and neither waits elsewhere, shape (n,)."""
    no_goods: tuple[NoGood, ...] = ()
    """Stages that are not possible although postures and straight moves are."""
    pace: float = 1.0
    """How much slower than at full speed everything moves."""
    settled: frozenset[int] = frozenset()
    """Stages whose stops stay as they are, for an exact test to decide: the quick one has found nothing that is
    collision-free by as much as it asks for."""

    def positions(self, angle: FloatArray, joints: Sequence[FloatArray | None]) -> FloatArray:
        """Returns all joints of the robot [rad], shape (n, columns).

        Args:
            angle: platform angles [rad], shape (n,).
            joints: of each arm [rad], shape (n, 7), or None for where it rests.
        """
        position = np.tile(self.rest, (len(angle), 1))
        if self.turns:
            position[:, self.platform_columns[0]] = angle
        for columns, q in zip(self.cell.columns, joints, strict=True):
            if q is not None:
                position[:, list(columns)] = q
        return position

    @property
    def at_targets(self) -> IntArray:
        """What each arm holds at each stage's targets, shape (n, arms)."""
        loads = self.cell.loads
        return loads.at_stops(loads.fuller(self.before, self.after), self.handing)

    @property
    def coming(self) -> IntArray:
        """What each arm holds on each stage's approaches, shape (n, arms)."""
        return self.cell.loads.at_stops(self.before, self.handing)

    @property
    def leaving(self) -> IntArray:
        """What each arm holds on each stage's retracts, shape (n, arms)."""
        return self.cell.loads.at_stops(self.after, self.handing)

    def arm_free(
        self, a: int, angle: FloatArray, q: FloatArray, held: int, spare: float = SLACK
    ) -> BoolArray:
        """Returns where one arm is clear of itself and of all that is not the other arm, shape (n,).

        Args:
            a: which arm.
            angle: platform angles [rad], shape (n,).
            q: its joints [rad], shape (n, 7).
            held: what it holds.
            spare: margin beyond the clearance that is asked for [m].
        """
        joints: list[FloatArray | None] = [None] * len(self.cell.arms)
        joints[a] = q
        position = self.positions(angle, joints)
        return np.asarray(self.cell.own_margins(a, position, np.full(len(q), held)) >= spare)

    def along(self, start: FloatArray, end: FloatArray) -> FloatArray:
        """Returns SAMPLES postures on every straight move, shape (n SAMPLES, columns) [rad].

        Args:
            start: all joints [rad], shape (n, columns).
            end: all joints [rad], shape (n, columns).
        """
        share = (np.arange(SAMPLES) + 1.0) / (SAMPLES + 1.0)
        way = start[:, None] + share[:, None] * (end - start)[:, None]
        return way.reshape(-1, start.shape[1])

    def no_good_costs(self, stage: int, start: FloatArray, arrival: FloatArray) -> FloatArray:
        """Returns what moves into a stage like no-goods cost [s], shape (n,).

        Args:
            stage: its number, or the number of stages for the return.
            start: all joints before them [rad], shape (n, columns).
            arrival: all joints after them [rad], shape (n, columns).
        """
        found = np.zeros(len(start))
        for no_good in self.no_goods:
            if no_good.stage != stage:
                continue
            columns = list(no_good.columns)
            like = np.abs(arrival - no_good.arrival)[:, columns].max(axis=1) <= (
                ALIKE if no_good.start is None else LIKE
            )
            if no_good.start is not None:
                like &= np.abs(start - no_good.start)[:, columns].max(axis=1) <= LIKE
            found[like] = np.maximum(found[like], no_good.cost)
        return found
