"""Whether the postures of one stage keep clear, in the terms of those who choose them one by one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dualarm_cli.collision.clearance import SLACK
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.planning.holding import Holding
from dualarm_cli.redundancy.problem import Place, StopPosture

PLACES: tuple[Place, ...] = ("approach", "target", "retract")
LAST: tuple[Place, ...] = ("retract",)
"""Where both arms are in the end, even if one of them has waited for the other; in a hand-over they do not."""


@dataclass(frozen=True)
class KeepClear:
    """One stage of a job's holding."""

    model: CellModel
    """The job's cell."""
    holding: Holding
    """What has to keep clear."""
    stage: int
    """Number of the stage."""

    @property
    def at_once(self) -> tuple[Place, ...]:
        """Places of their stops at which both arms are at the same time, whoever has waited."""
        return PLACES if self.holding.handing[self.stage] else LAST

    def test(
        self,
        arm: str,
        position: FloatArray,
        angles: FloatArray,
        active: Mapping[str, object],
        others: Mapping[str, StopPosture] | None = None,
    ) -> Callable[[FloatArray, Place], BoolArray]:
        """Returns a test of one arm's postures with the platform at a position.

        Against itself and what stands still; against the other arm only where that one does nothing in this stage, or
        its posture is given.

        Args:
            arm: its name.
            position: all joints before the stage [rad], shape (n,).
            angles: where the platform is, shape (k,).
            active: the arms that have something to do.
            others: the other arm's posture, if it is decided.
        """
        cell, decided = self.holding.cell, others or {}
        a = cell.arms.index(arm)
        columns = self.model.arms[arm].columns
        met = [
            name for name in cell.arms if name != arm and (name not in active or name in decided)
        ]

        def clear(q: FloatArray, place: Place) -> BoolArray:
            rows = np.tile(position, (len(q), 1))
            rows[:, self.model.platform_columns] = angles
            for name, posture in decided.items():
                rows[:, self.model.arms[name].columns] = _joints(posture, place)
            rows[:, columns] = q
            held = np.tile(self._held(place), (len(q), 1))
            own = cell.own_margins(a, rows, held[:, a], ground=place == "target")
            free = np.asarray(own >= SLACK)
            if met:
                left = np.flatnonzero(free)
                free[left] = cell.cross_margins(rows[left], held[left]) >= SLACK
            return free

        return clear

    def yaws(self, arm: str) -> FloatArray:
        """Returns the turns about an arm's tool that are tried [rad], shape (y,): at which its part fits."""
        return self.holding.yaws[self.stage, arm]

    def margins(
        self, arm: str, position: FloatArray, angles: FloatArray, q: FloatArray, place: Place
    ) -> tuple[FloatArray, FloatArray]:
        """Returns all joints (n, columns) [rad] with one arm at q (n, 7), and its own least margins there [m], (n,)."""
        rows = np.tile(position, (len(q), 1))
        rows[:, self.model.platform_columns] = angles
        rows[:, self.model.arms[arm].columns] = q
        a = self.holding.cell.arms.index(arm)
        held = np.full(len(q), self._held(place)[a])
        return rows, self.holding.cell.own_margins(a, rows, held)

    def nearest(self, arm: str, position: FloatArray, place: Place) -> tuple[str, str, float]:
        """Returns what one arm is nearest to at all joints (columns,), with the margin [m]; not the other arm."""
        cell = self.holding.cell
        number = int(self._held(place)[cell.arms.index(arm)])
        group = cell.test.own(arm, cell.part_of(number), bool(number % 2))
        return cell.test.nearest(position, group.pairs)

    def apart(
        self,
        position: FloatArray,
        angles: FloatArray,
        postures: Mapping[str, StopPosture],
        places: Sequence[Place] = PLACES,
    ) -> bool:
        """Returns whether the arms keep clear of each other at some places of their stops."""
        if len(postures) < 2:
            return True
        rows = np.tile(position, (len(places), 1))
        rows[:, self.model.platform_columns] = angles
        for name, posture in postures.items():
            rows[:, self.model.arms[name].columns] = [_joints(posture, p) for p in places]
        held = np.array([self._held(place) for place in places])
        return bool((self.holding.cell.cross_margins(rows, held) >= SLACK).all())

    def all_apart(self, rows: Mapping[Place, FloatArray]) -> BoolArray:
        """Returns whether the arms keep clear of each other in all of some places of a stop, shape (k,).

        Args:
            rows: by place, all joints of the robot [rad], shape (k, columns).
        """
        free = np.ones(len(next(iter(rows.values()))), dtype=np.bool_)
        if len(self.model.arms) < 2:
            return free
        for place, position in rows.items():
            held = np.tile(self._held(place), (len(position), 1))
            free &= self.holding.cell.cross_margins(position, held) >= SLACK
        return free

    def _held(self, place: Place) -> IntArray:
        """Returns what each arm holds at a place of its stop, shape (arms,)."""
        if place == "target":
            held: IntArray = self.holding.at_targets[self.stage]
            return held
        holding = self.holding.before if place == "approach" else self.holding.after
        row: IntArray = holding[self.stage]
        return row


def _joints(posture: StopPosture, place: Place) -> FloatArray:
    joints: FloatArray = getattr(posture, f"q_{place}")
    return joints
