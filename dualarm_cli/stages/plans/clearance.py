"""Fast collision test of postures and straight moves for the sequence search."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dualarm_cli.collision.clearance import SLACK
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.postures.holding import Holding
from dualarm_cli.records import dataclass

SAMPLES = 8
"""Number of samples between the ends of a move."""
ALIKE, LIKE = 0.15, 0.5
"""Largest joint distances at which a no-good applies [rad].

The first applies to stops alone, the second to a move.
"""


@dataclass(frozen=True)
class NoGood:
    """No-good: stage that collided when timed, or its cost of clearance."""

    stage: int
    """Index of the stage; the number of stages for the return."""
    columns: tuple[int, ...]
    """Columns of the joints compared: one arm and platform, or all."""
    start: FloatArray | None
    """Joints before the stage [rad], shape (columns,); None if irrelevant."""
    arrival: FloatArray
    """Joints after the transfer [rad], shape (columns,)."""
    cost: float = np.inf
    """Extra duration compared with straight moves [s]; infinite if blocked."""


@dataclass(frozen=True)
class SequenceClearance:
    """Fast collision test of a cell for the stages of a sequence."""

    holding: Holding
    """Cell with its hulls and pairs, and the loads of the arms by stage."""
    platform_columns: tuple[int, ...]
    """Columns of the platform's joints."""
    rest: FloatArray
    """Default joints of the robot [rad], shape (columns,)."""
    turns: bool
    """Whether the platform joint is a decision."""
    no_goods: tuple[NoGood, ...] = ()
    """Excluded stages whose postures and straight moves pass the fast test."""
    settled: frozenset[int] = frozenset()
    """Fixed-stop stages that only the exact test decides.

    The fast test cleared no candidate.
    """

    def positions(self, angle: FloatArray, joints: Sequence[FloatArray | None]) -> FloatArray:
        """Assemble all joints of the robot [rad], shape (n, columns).

        Args:
            angle: platform angles [rad], shape (n,).
            joints: joints of each arm [rad], shape (n, 7), or None for its default.
        """
        position = np.tile(self.rest, (len(angle), 1))
        if self.turns:
            position[:, self.platform_columns[0]] = angle
        for columns, q in zip(self.holding.cell.columns, joints, strict=True):
            if q is not None:
                position[:, list(columns)] = q
        return position

    @property
    def coming(self) -> IntArray:
        """Index of the held part by arm on each stage's approaches, shape (n, arms)."""
        return self.holding.cell.loads.at_stops(self.holding.before, self.holding.is_handover)

    @property
    def leaving(self) -> IntArray:
        """Index of the held part by arm on each stage's retracts, shape (n, arms)."""
        return self.holding.cell.loads.at_stops(self.holding.after, self.holding.is_handover)

    def arm_free(
        self, a: int, angle: FloatArray, q: FloatArray, held: int, spare: float = SLACK
    ) -> BoolArray:
        """Return whether one arm is clear of itself and its surroundings, shape (n,).

        Args:
            a: index of the arm.
            angle: platform angles [rad], shape (n,).
            q: joints of the arm [rad], shape (n, 7).
            held: index of the held part.
            spare: margin beyond the required clearance [m].
        """
        joints: list[FloatArray | None] = [None] * len(self.holding.cell.arms)
        joints[a] = q
        position = self.positions(angle, joints)
        return np.asarray(
            self.holding.cell.arm_margins(a, position, np.full(len(q), held)) >= spare
        )

    def along(self, start: FloatArray, end: FloatArray) -> FloatArray:
        """Interpolate SAMPLES configurations on every straight move [rad], shape (n SAMPLES, columns).

        Args:
            start: all joints [rad], shape (n, columns).
            end: all joints [rad], shape (n, columns).
        """
        fraction = (np.arange(SAMPLES) + 1.0) / (SAMPLES + 1.0)
        samples = start[:, None] + fraction[:, None] * (end - start)[:, None]
        return samples.reshape(-1, start.shape[1])

    def no_good_costs(self, stage: int, start: FloatArray, arrival: FloatArray) -> FloatArray:
        """Return the no-good costs of moves into a stage [s], shape (n,).

        Args:
            stage: its number, or the number of stages for the return.
            start: joints before the moves [rad], shape (n, columns).
            arrival: joints after the moves [rad], shape (n, columns).
        """
        costs = np.zeros(len(start))
        for no_good in self.no_goods:
            if no_good.stage != stage:
                continue
            columns = list(no_good.columns)
            matches = np.abs(arrival - no_good.arrival)[:, columns].max(axis=1) <= (
                ALIKE if no_good.start is None else LIKE
            )
            if no_good.start is not None:
                matches &= np.abs(start - no_good.start)[:, columns].max(axis=1) <= LIKE
            costs[matches] = np.maximum(costs[matches], no_good.cost)
        return costs
