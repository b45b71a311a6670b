"""Collision test of one stage's postures, for solvers that choose them one by one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from dualarm_cli.collision.clearance import SLACK
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.postures import StopProblem
from dualarm_cli.postures.holding import Holding
from dualarm_cli.postures.problem import POSTURES, Place, StopPosture
from dualarm_cli.postures.stop_batch import StopBatch
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal

PLACES: tuple[Place, ...] = ("approach", "target", "retract")


@dataclass(frozen=True)
class KeepClear:
    """One stage of a job's holding."""

    model: CellModel
    """The job's cell."""
    holding: Holding
    """What has to be collision-free."""
    stage: int
    """Number of the stage."""

    @property
    def at_once(self) -> tuple[Place, ...]:
        """Places of their stops at which both arms are at the same time, whoever has waited."""
        return PLACES if self.holding.handing[self.stage] else ("retract",)

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
        return cell.test.nearest(position, cell.own_pairs(cell.arms.index(arm), number))

    def apart(
        self,
        position: FloatArray,
        angles: FloatArray,
        postures: Mapping[str, StopPosture],
        places: Sequence[Place] = PLACES,
    ) -> bool:
        """Returns whether the arms are clear of each other at some places of their stops."""
        if len(postures) < 2:
            return True
        rows = np.tile(position, (len(places), 1))
        rows[:, self.model.platform_columns] = angles
        for name, posture in postures.items():
            rows[:, self.model.arms[name].columns] = [_joints(posture, p) for p in places]
        held = np.array([self._held(place) for place in places])
        return bool((self.holding.cell.cross_margins(rows, held) >= SLACK).all())

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


NAMES = {
    "approach": "where its approach starts",
    "target": "at the target",
    "retract": "where its retract ends",
}


@dataclass(frozen=True)
class _Best:
    """The posture at one place that keeps farthest from everything."""

    margin: float
    position: FloatArray
    angle: float


def angles_looked_at(model: CellModel, position: FloatArray) -> FloatArray:
    """Returns platform positions to look at, the present one first, shape (m, k)."""
    here = position[model.platform_columns]
    if not model.platform.is_chosen:
        return here[None]
    _, low, high = model.platform_around(position)
    step = model.platform.spacing(POSTURES.clear_scan_step, low, high)
    return np.concatenate([here, np.arange(low, high + 1e-9, step)])[:, None]


def explain_touching(
    keep: KeepClear,
    arm: str,
    position: FloatArray,
    angles: FloatArray,
    problems: list[StopProblem],
) -> Refusal | None:
    """Returns what one arm, whatever the other does, is too near to at a place of its stop; None for nothing.

    Args:
        keep: what has to be collision-free in the stage.
        arm: its name.
        position: all joints before the stage [rad], shape (n,).
        angles: platform positions that are looked at, shape (m, k).
        problems: the arm's stop at each of them.
    """
    for place in PLACES:
        best: _Best | None = None
        for angle, problem in zip(angles, problems, strict=True):
            q = _postures(problem, place)
            if not len(q):
                continue
            rows, margin = keep.margins(arm, position, angle, q, place)
            k = int(np.argmax(margin))
            if best is None or margin[k] > best.margin:
                best = _Best(float(margin[k]), rows[k], float(angle[0]) if len(angle) else 0.0)
        if best is None or best.margin >= SLACK:
            continue
        one, other, margin_there = keep.nearest(arm, best.position, place)
        stands = [_with_platform(keep.model, best.angle)] if keep.model.platform.is_chosen else []
        more = {
            "where": NAMES[place],
            "one": one,
            "other": other,
            "platform": stands,
        }
        missing = max(0.0, -margin_there)
        return Refusal("every_posture_touches", arm=arm, measured=missing, more=more)
    return None


def _with_platform(model: CellModel, position: float) -> Refusal:
    """Returns where a platform of one joint stands, as a part of a message [rad or m]."""
    if model.platform.is_rail:
        return Refusal("with_platform_place", more={"millimetres": 1e3 * position + 0.0})
    return Refusal("with_platform", more={"degrees": np.degrees(position) + 0.0})


def _postures(problem: StopProblem, place: Place) -> FloatArray:
    """Returns joints within limits at a place, over branches, arm angles and yaws, shape (k, n)."""
    batch = StopBatch((problem,))
    if problem.configurations is not None:
        return problem.configurations if place == "target" else np.empty((0, len(problem.start)))
    yaw = problem.yaw[:: max(1, len(problem.yaw) // POSTURES.scan_yaws)]
    depth = {"approach": problem.approach, "target": 0.0, "retract": problem.retract}[place]
    zero = np.zeros(len(yaw), dtype=np.int64)
    poses = batch.poses(zero, zero, yaw)
    postures = problem.arm.postures(poses.R, poses.p - poses.z * depth)
    return problem.arm.nearest_turns(postures.q, problem.start)
