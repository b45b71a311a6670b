"""Collision test of one stage's postures, for solvers that plan stage by stage."""

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
"""Places of a stop in the order of motion."""


@dataclass(frozen=True)
class StageCollisionTest:
    """Collision test of one stage."""

    model: CellModel
    """The job's cell."""
    holding: Holding
    """Loads of the arms and clearance of the cell."""
    stage: int
    """Number of the stage."""

    @property
    def common_places(self) -> tuple[Place, ...]:
        """Places of the stops at which both arms are at the same time."""
        return PLACES if self.holding.is_handover[self.stage] else ("retract",)

    def test(
        self,
        arm: str,
        position: FloatArray,
        angles: FloatArray,
        active: Mapping[str, object],
        others: Mapping[str, StopPosture] | None = None,
    ) -> Callable[[FloatArray, Place], BoolArray]:
        """Create a collision test of one arm's postures at a platform position.

        The arm is tested against itself and the fixed cell, and against the other arm if that is idle in this stage or
        its posture is given.

        Args:
            arm: name of the arm.
            position: all joints before the stage [rad], shape (n,).
            angles: platform position, shape (k,).
            active: arms with a stop in the stage.
            others: the other arm's posture, if it is decided.
        """
        cell, decided = self.holding.cell, others or {}
        a = cell.arms.index(arm)
        columns = self.model.arms[arm].columns
        tested_arms = [
            name for name in cell.arms if name != arm and (name not in active or name in decided)
        ]

        def is_collision_free(q: FloatArray, place: Place) -> BoolArray:
            rows = np.tile(position, (len(q), 1))
            rows[:, self.model.platform_columns] = angles
            for name, posture in decided.items():
                rows[:, self.model.arms[name].columns] = _joints(posture, place)
            rows[:, columns] = q
            loads = np.tile(self._loads(place), (len(q), 1))
            margins = cell.arm_margins(a, rows, loads[:, a], ground=place == "target")
            is_free = np.asarray(margins >= SLACK)
            if tested_arms:
                remaining = np.flatnonzero(is_free)
                is_free[remaining] = cell.cross_margins(rows[remaining], loads[remaining]) >= SLACK
            return is_free

        return is_collision_free

    def yaws(self, arm: str) -> FloatArray:
        """Return the yaws of an arm's tool at which its part fits [rad], shape (y,)."""
        return self.holding.yaws[self.stage, arm]

    def margins(
        self, arm: str, position: FloatArray, angles: FloatArray, q: FloatArray, place: Place
    ) -> tuple[FloatArray, FloatArray]:
        """Compute one arm's least margins [m], (n,), at joints q (n, 7).

        The first result is all joints [rad], (n, columns).
        """
        rows = np.tile(position, (len(q), 1))
        rows[:, self.model.platform_columns] = angles
        rows[:, self.model.arms[arm].columns] = q
        a = self.holding.cell.arms.index(arm)
        loads = np.full(len(q), self._loads(place)[a])
        return rows, self.holding.cell.arm_margins(a, rows, loads)

    def nearest(self, arm: str, position: FloatArray, place: Place) -> tuple[str, str, float]:
        """Find the nearest pair of one arm's bodies, without the other arm, and its margin [m]."""
        cell = self.holding.cell
        number = int(self._loads(place)[cell.arms.index(arm)])
        return cell.test.nearest(position, cell.arm_pairs(cell.arms.index(arm), number))

    def arms_clear(
        self,
        position: FloatArray,
        angles: FloatArray,
        postures: Mapping[str, StopPosture],
        places: Sequence[Place] = PLACES,
    ) -> bool:
        """Return whether the arms are clear of each other at places of their stops."""
        if len(postures) < 2:
            return True
        rows = np.tile(position, (len(places), 1))
        rows[:, self.model.platform_columns] = angles
        for name, posture in postures.items():
            rows[:, self.model.arms[name].columns] = [_joints(posture, p) for p in places]
        loads = np.array([self._loads(place) for place in places])
        return bool((self.holding.cell.cross_margins(rows, loads) >= SLACK).all())

    def _loads(self, place: Place) -> IntArray:
        """Return the load of each arm at a place of its stop, shape (arms,)."""
        if place == "target":
            loads: IntArray = self.holding.at_targets[self.stage]
            return loads
        holding = self.holding.before if place == "approach" else self.holding.after
        row: IntArray = holding[self.stage]
        return row


def _joints(posture: StopPosture, place: Place) -> FloatArray:
    joints: FloatArray = getattr(posture, f"q_{place}")
    return joints


PLACE_NAMES = {
    "approach": "where its approach starts",
    "target": "at the target",
    "retract": "where its retract ends",
}


@dataclass(frozen=True)
class _Best:
    """Posture with the greatest margin at one place."""

    margin: float
    position: FloatArray
    angle: float


def scanned_angles(model: CellModel, position: FloatArray) -> FloatArray:
    """List platform positions to scan, the present one first, shape (m, k)."""
    present = position[model.platform_columns]
    if not model.platform.is_chosen:
        return present[None]
    _, low, high = model.platform_around(position)
    step = model.platform.spacing(POSTURES.clear_scan_step, low, high)
    return np.concatenate([present, np.arange(low, high + 1e-9, step)])[:, None]


def explain_collision(
    keep: StageCollisionTest,
    arm: str,
    position: FloatArray,
    angles: FloatArray,
    problems: list[StopProblem],
) -> Refusal | None:
    """Explain a place of one arm's stop at which every posture collides, or return None.

    The other arm is left out.

    Args:
        keep: collision test of the stage.
        arm: name of the arm.
        position: all joints before the stage [rad], shape (n,).
        angles: scanned platform positions, shape (m, k).
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
        body_a, body_b, margin_there = keep.nearest(arm, best.position, place)
        stands = [_with_platform(keep.model, best.angle)] if keep.model.platform.is_chosen else []
        details = {
            "where": PLACE_NAMES[place],
            "body_a": body_a,
            "body_b": body_b,
            "platform": stands,
        }
        missing = max(0.0, -margin_there)
        return Refusal("every_posture_touches", arm=arm, measured=missing, data=details)
    return None


def _with_platform(model: CellModel, position: float) -> Refusal:
    """Describe the position of a platform of one joint [rad or m] in a message."""
    if model.platform.is_rail:
        return Refusal("with_platform_place", data={"millimetres": 1e3 * position + 0.0})
    return Refusal("with_platform", data={"degrees": np.degrees(position) + 0.0})


def _postures(problem: StopProblem, place: Place) -> FloatArray:
    """Sample joints within limits at a place [rad], shape (k, n)."""
    batch = StopBatch((problem,))
    if problem.configurations is not None:
        return problem.configurations if place == "target" else np.empty((0, len(problem.start)))
    yaw = problem.yaw[:: max(1, len(problem.yaw) // POSTURES.scan_yaws)]
    lengths = {"approach": (problem.approach, 0.0), "retract": (0.0, problem.retract)}
    shift = np.array(lengths.get(place, (0.0, 0.0)))[:, None]
    zero = np.zeros(len(yaw), dtype=np.int64)
    poses = batch.poses(zero, zero, yaw)
    postures = problem.arm.postures(poses.R, poses.p + (poses.outward * shift).sum(axis=1))
    return problem.arm.nearest_turns(postures.q, problem.start)
