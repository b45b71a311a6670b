"""One stage and all that other ways of its arms are measured by."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dualarm_cli.collision.clearance import CellClearance
from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.planning.bent_transfers import detour_pieces
from dualarm_cli.planning.curves import Missing, ToolTimes
from dualarm_cli.planning.stage_plan import Detour, StagePlan
from dualarm_cli.planning.stage_samples import (
    ArmWay,
    StageSamples,
    combined,
)
from dualarm_cli.planning.transfers import PLATFORM
from dualarm_cli.timing import TimingSolver

SPARE = 0.004
"""What curves keep beyond the required clearance, for what is between their points [m]."""


@dataclass(frozen=True)
class StageContext:
    """One stage and all that its ways are measured by."""

    model: CellModel
    """The job's cell."""
    job: Job
    """What is to be done."""
    cell: CellClearance
    """Hulls and pairs."""
    plan: StagePlan
    """The stage."""
    samples: StageSamples
    """Its motion."""
    ways: dict[str, ArmWay]
    """What each arm does in it."""
    platform: Trajectory | None
    """What the platform does in it; None where there is none."""
    timing: TimingSolver
    """How transfers and curves are timed."""
    seed: int
    """Of what is tried at random."""

    def way_by(self, name: str, detour: Detour) -> ArmWay:
        """Returns an arm's way by a posture."""
        limits = self.job.cell.robot.limits.scaled(self.job.speed)
        columns = {arm: self.model.arms[arm].columns for arm in self.model.arms}
        if self.platform is not None:
            columns[PLATFORM] = self.model.platform_columns
        plan = replace(self.plan, detours={name: detour})
        pieces = detour_pieces(
            self.model,
            plan,
            name,
            columns,
            limits,
            self.timing,
            self.job.tool_speed,
            self.platform,
        )
        base = self.ways[name]
        rows = [piece.at(np.arange(0.0, piece.duration, self.samples.step))[0] for piece in pieces]
        out = np.concatenate([base.q[:1], *rows])
        # A line begins when the platform is there as well.
        wait = max(0, self._platform_arrival() - len(out))
        lines = base.arrival if base.meets is None else base.meets
        rest = base.q[lines:]
        q = np.concatenate([out, np.repeat(rest[:1], wait, axis=0), rest])
        held = np.concatenate([np.full(len(out) + wait, base.held[0]), base.held[lines:]])
        there = len(out) + wait
        return ArmWay(q, held, there, None if base.meets is None else there)

    def _platform_arrival(self) -> int:
        turned = self.samples.position[:, self.model.platform_columns]
        moves = np.flatnonzero((turned[1:] != turned[:-1]).any(axis=1))
        return int(moves[-1]) + 1 if len(moves) else 0


def missing_clearance(
    context: StageContext, name: str, way: ArmWay, points: FloatArray, with_other: bool
) -> Missing:
    """Returns what curves of an arm lack of the clearance beside what all others do about then.

    Args:
        context: the stage.
        name: the arm.
        way: what is known of how it gets along a curve.
        points: of that curve [rad], shape (s, n).
        with_other: whether the other arm counts.
    """
    stage, instants = _meanwhile(context, name, way, points)
    a = context.cell.arms.index(name)

    def missing(curves: FloatArray) -> FloatArray:
        rows = _beside(context, name, stage.position[instants], curves)
        held = np.tile(stage.held[instants], (len(curves), 1))
        margin = context.cell.own_margins(a, rows, held[:, a])
        if with_other:
            margin = np.minimum(margin, context.cell.cross_margins(rows, held))
        lack: FloatArray = np.maximum(SPARE - margin, 0.0).reshape(curves.shape[:2])
        # The ends are what they are.
        return lack[:, 1:-1].mean(axis=1)

    return missing


def tool_times(
    context: StageContext, name: str, way: ArmWay, points: FloatArray
) -> ToolTimes | None:
    """Returns how long an arm's tool needs at least along curves under its cap; None without one.

    Arguments as of `missing_clearance`.
    """
    cap = context.job.tool_speed
    if cap is None:
        return None
    stage, instants = _meanwhile(context, name, way, points)

    def times(curves: FloatArray) -> FloatArray:
        rows = _beside(context, name, stage.position[instants], curves)
        tip = context.model.tool_position(name, rows).reshape(*curves.shape[:2], 3)
        length: FloatArray = np.linalg.norm(np.diff(tip, axis=1), axis=2).sum(axis=1)
        return length / cap

    return times


def _meanwhile(
    context: StageContext, name: str, way: ArmWay, points: FloatArray
) -> tuple[StageSamples, IntArray]:
    """Returns a stage with another way of an arm, and about when in it the arm is at points (s, 7) of its curve."""
    stage = combined(context.model, context.samples, {**context.ways, name: way}, {})
    moving = way.q[: way.arrival + 1]
    far = np.abs(moving[None] - points[:, None]).max(axis=2)
    instants: IntArray = np.maximum.accumulate(np.argmin(far, axis=1))
    return stage, instants


def _beside(context: StageContext, name: str, others: FloatArray, curves: FloatArray) -> FloatArray:
    """Returns all joints with an arm on curves (c, s, 7) and all others at (s, columns), shape (c s, columns) [rad]."""
    rows = np.tile(others, (len(curves), 1))
    rows[:, context.model.arms[name].columns] = curves.reshape(-1, curves.shape[-1])
    return rows
