"""Sampled stages: joints and held parts of both arms over time, and their collision check."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from dualarm_cli.collision.clearance import CellClearance
from dualarm_cli.effort import ClearanceSettings
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray, distinct
from dualarm_cli.geometry.products import norm
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job
from dualarm_cli.model.motion.trajectory import SAME_TIME, Trajectory
from dualarm_cli.motion.builder import Motion
from dualarm_cli.motion.curved_transfers import Missing, ToolTimes, detour_pieces
from dualarm_cli.motion.transfers import Drive
from dualarm_cli.motion.waiting import transfer_ends
from dualarm_cli.postures.holding import Holding
from dualarm_cli.postures.stage_plan import Detour, StagePlan
from dualarm_cli.records import dataclass
from dualarm_cli.timing import TimingSolver

STEP = 0.004
"""Sampling interval at full speed, except for stages of minutes [s]."""
KEPT = 0.0005
"""Extra clearance for the motion between samples [m]."""
NEAR = 0.008
"""Margin below which the interval between two samples is refined [m].

It grows in proportion to the number of samples that were skipped between the two."""

Margins = Callable[[FloatArray, IntArray], FloatArray]
"""Function from joints (n, columns) [rad] and held parts to margins (n,) [m]."""


@dataclass(frozen=True)
class StageSamples:
    """Stage sampled at t equidistant times."""

    position: FloatArray
    """All joints [rad], shape (t, columns)."""
    held: IntArray
    """Index of the held part by arm, shape (t, arms)."""
    step: float = STEP
    """Sampling interval [s]."""
    before: StageSamples | None = None
    """Previous stage, in which a late arm still moves.

    None: a late arm stands at its start.
    """

    def delayed(self, columns: Sequence[int], a: int, rows: int) -> StageSamples:
        """Delay one arm by a number of samples; the other arm stands at the end.

        Args:
            columns: columns of the arm's joints.
            a: index of the arm.
            rows: delay in samples.
        """
        earlier = () if self.before is None else (self.before,)
        rows_now = np.minimum(np.arange(len(self.position) + rows), len(self.position) - 1)
        skipped = sum(len(stage.position) for stage in earlier) - rows
        rows_late = np.maximum(np.arange(len(rows_now)) + skipped, 0)
        position, held = self.position[rows_now], self.held[rows_now]
        arm_position = np.concatenate([stage.position for stage in (*earlier, self)])[:, columns]
        position[:, columns] = arm_position[rows_late]
        held[:, a] = np.concatenate([stage.held[:, a] for stage in (*earlier, self)])[rows_late]
        return StageSamples(position, held, self.step)


@dataclass(frozen=True)
class ArmMotion:
    """Sampled motion of one arm in a stage."""

    q: FloatArray
    """Joints of the arm [rad], shape (t, n)."""
    held: IntArray
    """Index of the held part, shape (t,)."""
    arrival: int
    """Index of the sample at the end of the transfer."""
    meets: int | None = None
    """Index of the sample at which the lines of a hand-over begin; None without a hand-over."""

    @property
    def end(self) -> int:
        """Index of the last sample of motion."""
        return last_motion(self.q)


def stage_samples(motion: Motion, number: int, stage: int, holding: Holding) -> StageSamples:
    """Sample one stage of a motion.

    Args:
        motion: motion of several stages.
        number: index of the stage in the motion.
        stage: index of the stage in the job; the return is the last one.
        holding: parts held by the arms.
    """
    this = motion.stages[number]
    step = max(STEP * holding.pace, (this.end - this.start) / 20_000)
    count = max(2, int(np.ceil((this.end - this.start) / step - 1e-9)) + 1)
    time = np.minimum(this.start + step * np.arange(count), this.end)
    held = np.empty((count, len(holding.cell.arms)), dtype=np.int64)
    last = len(holding.before) - 1
    for a, arm in enumerate(holding.cell.arms):
        if stage > last:
            held[:, a] = holding.after[last, a]
            continue
        held[:, a] = holding.before[stage, a]
        event = motion.event_of.get((number, arm))
        if event is None:
            continue
        held[time >= event.changes_held - SAME_TIME, a] = holding.after[stage, a]
        if holding.is_handover[stage]:
            continue
        start, end = _on_lines(motion, [arm], this.start, this.end)
        # Without an approach (or retract) the part still lies at its place at the instant of the pick (or place).
        first = start - SAME_TIME if start == event.time else start + SAME_TIME
        inside = (time >= first) & (time <= end - SAME_TIME)
        held[inside, a] = holding.cell.loads.on_lines(held[inside, a])
    if stage <= last and holding.is_handover[stage]:
        # Both tools hold the part from the taking approach until the end of the giving retract.
        start, end = _on_lines(motion, holding.cell.arms, this.start, this.end)
        inside = (time >= start - SAME_TIME) & (time <= end + SAME_TIME)
        held[inside] = holding.cell.loads.at_stops(
            held[inside], np.ones(int(inside.sum()), dtype=np.bool_)
        )
    return StageSamples(motion.trajectory.clamped(time)[0], held, step)


def _on_lines(motion: Motion, arms: Sequence[str], start: float, end: float) -> tuple[float, float]:
    """Return the time span of the arms' lines within a stage [s]; empty if none."""
    parts = motion.lines_within(arms, start, end)
    return min((p.start for p in parts), default=np.inf), max(
        (p.end for p in parts), default=-np.inf
    )


def arm_motions(
    model: CellModel, motion: Motion, number: int, samples: StageSamples
) -> dict[str, ArmMotion]:
    """Split sampled joints into the motion of each arm.

    Args:
        model: the cell.
        motion: motion of several stages.
        number: index of the stage in the motion.
        samples: samples of that stage.
    """
    timed_stage = motion.stages[number]
    motions: dict[str, ArmMotion] = {}
    for a, (name, arm) in enumerate(model.arms.items()):
        segments = [part for part in motion.segments if part.arm == name]
        ends = transfer_ends(segments, timed_stage.start, timed_stage.end + samples.step)
        arrival = round((max(ends, default=timed_stage.start) - timed_stage.start) / samples.step)
        arrival = min(arrival, len(samples.position) - 1)
        motions[name] = ArmMotion(samples.position[:, arm.columns], samples.held[:, a], arrival)
    span = timed_stage.start - SAME_TIME, timed_stage.end + SAME_TIME
    if any(part.action == "give" and span[0] <= part.start <= span[1] for part in motion.segments):
        # The early arm waits; its wait does not belong to the lines.
        meets = max(motion.arrival for motion in motions.values())
        motions = {name: replace(motion, meets=meets) for name, motion in motions.items()}
    return motions


def combined(
    model: CellModel,
    samples: StageSamples,
    motions: Mapping[str, ArmMotion],
    delays: Mapping[str, int],
) -> StageSamples:
    """Combine arm motions, some of them delayed, into one sampled stage.

    Args:
        model: the cell.
        samples: samples of the original stage, used for the platform.
        motions: motion of every arm.
        delays: delay of each arm in samples.
    """
    motions = {name: _late(motion, delays.get(name, 0)) for name, motion in motions.items()}
    if all(motion.meets is not None for motion in motions.values()):
        met = max(motion.arrival for motion in motions.values())
        motions = {name: _meeting(motion, met) for name, motion in motions.items()}
    length = max(*(motion.end + 1 for motion in motions.values()), 2)
    length = max(length, last_motion(samples.position[:, model.platform_columns]) + 1)
    rows = np.minimum(np.arange(length), len(samples.position) - 1)
    position = samples.position[rows]
    held = np.empty((length, len(motions)), dtype=np.int64)
    for a, (name, motion) in enumerate(motions.items()):
        rows = np.minimum(np.arange(length), len(motion.q) - 1)
        position[:, model.arms[name].columns] = motion.q[rows]
        held[:, a] = motion.held[rows]
    return StageSamples(position, held, samples.step, samples.before)


def _late(motion: ArmMotion, delay: int) -> ArmMotion:
    """Delay an arm motion by a number of samples."""
    if not delay:
        return motion
    meets = None if motion.meets is None else motion.meets + delay
    rows = np.maximum(np.arange(len(motion.q) + delay) - delay, 0)
    return ArmMotion(motion.q[rows], motion.held[rows], motion.arrival + delay, meets)


def _meeting(motion: ArmMotion, met: int) -> ArmMotion:
    """Extend the wait before a hand-over so that the lines begin at sample `met`."""
    assert motion.meets is not None  # called for hand-overs only
    wait = np.full(met - motion.arrival, motion.arrival)
    rows = np.concatenate([np.arange(motion.arrival), wait, np.arange(motion.meets, len(motion.q))])
    return ArmMotion(motion.q[rows], motion.held[rows], motion.arrival, met)


def is_clear(cell: CellClearance, samples: StageSamples) -> bool:
    """Return whether a stage is collision-free."""
    return bool(which_are_clear(cell, [samples])[0])


def which_are_clear(cell: CellClearance, stages: Sequence[StageSamples]) -> BoolArray:
    """Return which of s stages are collision-free, shape (s,)."""
    clear = _arms_apart(cell, stages)
    for margins in [_arm_margins(cell, a) for a in range(len(cell.arms))]:
        remaining = np.flatnonzero(clear).tolist()
        clear[remaining] = _keep_margins(cell, [stages[k] for k in remaining], margins)
    return clear


def apart(cell: CellClearance, samples: StageSamples) -> bool:
    """Return whether the arms are clear of each other."""
    return bool(_arms_apart(cell, [samples])[0])


def _arms_apart(cell: CellClearance, stages: Sequence[StageSamples]) -> BoolArray:
    """Return which of s stages keep the arms apart, including late arms, shape (s,)."""
    clear = _keep_margins(cell, stages, cell.cross_margins)
    for k in np.flatnonzero(clear & (cell.skew > 0.0)).tolist():
        rows = int(np.ceil(cell.skew / stages[k].step))
        shifts = distinct(np.ceil(np.linspace(0.0, rows, -(-rows // 4) + 1))[1:])
        clear[k] = all(
            _keep_margins(cell, [stages[k].delayed(columns, a, int(shift))], cell.cross_margins)[0]
            for shift in shifts[::-1]
            for a, columns in enumerate(cell.columns)
        )
    return clear


def alone_clear(cell: CellClearance, samples: StageSamples, a: int) -> bool:
    """Return whether one arm is clear of itself and its surroundings, ignoring the other."""
    return bool(_keep_margins(cell, [samples], _arm_margins(cell, a))[0])


def _arm_margins(cell: CellClearance, a: int) -> Margins:
    def margins(position: FloatArray, held: IntArray) -> FloatArray:
        return cell.arm_margins(a, position, held[:, a], ground=True)

    return margins


def _keep_margins(
    cell: CellClearance, stages: Sequence[StageSamples], margins: Margins
) -> BoolArray:
    """Return which of s stages keep all margins, shape (s,).

    Every eighth sample is checked first, then all samples near small margins and changes of held parts, then
    interpolated configurations between samples with small margins.
    """
    clear, coarse, between = np.ones(len(stages), dtype=np.bool_), 8, 8
    if not len(stages):
        return clear
    position = np.concatenate([stage.position for stage in stages])
    held = np.concatenate([stage.held for stage in stages])
    length = np.array([len(stage.position) for stage in stages])
    last = np.cumsum(length) - 1
    stage = np.repeat(np.arange(len(stages)), length)
    within = np.arange(len(position)) - (last - length + 1)[stage]

    def measure(rows: IntArray, q: FloatArray, numbers: IntArray) -> FloatArray:
        measured = margins(q, numbers)
        clear[stage[rows[measured < KEPT]]] = False
        return measured

    rows = np.flatnonzero((within % coarse == 0) | (within == length[stage] - 1))
    margin = np.full(len(position), np.inf)
    margin[rows] = measure(rows, position[rows], held[rows])
    first, second = rows[:-1], rows[1:]
    close = np.minimum(margin[first], margin[second]) < NEAR * (second - first)
    # Bodies that may touch have no distance margin: only penetration counts.
    close |= (held[first] != held[second]).any(axis=1) | cell.may_only_touch(held[first])
    close &= (stage[first] == stage[second]) & clear[stage[first]]
    steps = (first[close, None] + np.arange(1, coarse)).ravel()
    rows = steps[steps < np.repeat(second[close], coarse - 1)]
    margin[rows] = measure(rows, position[rows], held[rows])
    tight = np.flatnonzero(np.minimum(margin[:-1], margin[1:]) < NEAR)
    tight = tight[(stage[tight] == stage[tight + 1]) & clear[stage[tight]]]
    # Interpolate linearly between two samples.
    fraction = ((np.arange(between) + 1.0) / (between + 1.0))[None, :, None]
    between_samples = (
        position[tight, None] + fraction * (position[tight + 1] - position[tight])[:, None]
    )
    rows = np.repeat(tight, between)
    measure(rows, between_samples.reshape(-1, position.shape[1]), held[rows])
    return clear


def last_motion(position: FloatArray) -> int:
    """Return the index after which the joints (t, columns) stand still."""
    moves = np.flatnonzero(np.abs(np.diff(position, axis=0)).max(axis=1, initial=0.0) > 0.0)
    return int(moves[-1]) + 1 if len(moves) else 0


@dataclass(frozen=True)
class StageContext:
    """Stage with the data that its repairs need."""

    model: CellModel
    """The job's cell."""
    job: Job
    """Tasks and limits."""
    cell: CellClearance
    """Collision model: hulls and pairs."""
    plan: StagePlan
    """The stage."""
    samples: StageSamples
    """Sampled motion of the stage."""
    motions: dict[str, ArmMotion]
    """Sampled motion by arm."""
    platform: Trajectory | None
    """Trajectory of the platform; None without one."""
    timing: TimingSolver
    """Solver that times transfers and curves."""
    seed: int
    """Seed of the curve search."""
    settings: ClearanceSettings
    """Settings of the repairs."""

    @cached_property
    def drive(self) -> Drive:
        """Drive under the limits of the stage."""
        return Drive.of(self.model, self.job, self.timing).to(self.plan)

    def detoured(self, name: str, detour: Detour) -> ArmMotion:
        """Time one arm's motion along a detour."""
        plan = replace(self.plan, detours={name: detour})
        pieces = detour_pieces(self.drive, plan, name, self.platform)
        base = self.motions[name]
        rows = [
            piece.clamped(np.arange(0.0, piece.duration, self.samples.step))[0] for piece in pieces
        ]
        transfer = np.concatenate([base.q[:1], *rows])
        # A line begins when arm and platform have arrived.
        wait = max(0, self._platform_arrival() - len(transfer))
        lines = base.arrival if base.meets is None else base.meets
        after_arrival = base.q[lines:]
        q = np.concatenate([transfer, np.repeat(after_arrival[:1], wait, axis=0), after_arrival])
        held = np.concatenate([np.full(len(transfer) + wait, base.held[0]), base.held[lines:]])
        arrival = len(transfer) + wait
        return ArmMotion(q, held, arrival, None if base.meets is None else arrival)

    def _platform_arrival(self) -> int:
        turned = self.samples.position[:, self.model.platform_columns]
        moves = np.flatnonzero((turned[1:] != turned[:-1]).any(axis=1))
        return int(moves[-1]) + 1 if len(moves) else 0


def missing_clearance(
    context: StageContext, name: str, motion: ArmMotion, points: FloatArray, with_other: bool
) -> Missing:
    """Return a function that measures the mean clearance deficit of curves [m].

    Args:
        context: the stage.
        name: the arm.
        motion: estimated motion of the arm along a curve.
        points: points of that curve [rad], shape (s, n).
        with_other: whether clearance to the other arm counts.
    """
    stage, instants = _meanwhile(context, name, motion, points)
    a = context.cell.arms.index(name)

    def missing(curves: FloatArray) -> FloatArray:
        rows = _beside(context, name, stage.position[instants], curves)
        held = np.tile(stage.held[instants], (len(curves), 1))
        margin = context.cell.arm_margins(a, rows, held[:, a])
        if with_other:
            margin = np.minimum(margin, context.cell.cross_margins(rows, held))
        lack: FloatArray = np.maximum(context.settings.curve_spare - margin, 0.0).reshape(
            curves.shape[:2]
        )
        # The ends are fixed.
        return lack[:, 1:-1].mean(axis=1)

    return missing


def tool_times(
    context: StageContext, name: str, motion: ArmMotion, points: FloatArray
) -> ToolTimes | None:
    """Return a function of the least travel time of curves [s]; None without a limit.

    The arguments are those of `missing_clearance`.
    """
    cap = context.drive.caps.get(name)
    if cap is None:
        return None
    stage, instants = _meanwhile(context, name, motion, points)

    def times(curves: FloatArray) -> FloatArray:
        rows = _beside(context, name, stage.position[instants], curves)
        tip = context.model.tool_position(name, rows).reshape(*curves.shape[:2], 3)
        length: FloatArray = norm(np.diff(tip, axis=1), axis=2).sum(axis=1)
        return length / cap

    return times


def _meanwhile(
    context: StageContext, name: str, motion: ArmMotion, points: FloatArray
) -> tuple[StageSamples, IntArray]:
    """Combine the stage with an arm motion and find the sample nearest to each point."""
    stage = combined(context.model, context.samples, {**context.motions, name: motion}, {})
    moving = motion.q[: motion.arrival + 1]
    far = np.abs(moving[None] - points[:, None]).max(axis=2)
    instants: IntArray = np.maximum.accumulate(np.argmin(far, axis=1))
    return stage, instants


def _beside(context: StageContext, name: str, others: FloatArray, curves: FloatArray) -> FloatArray:
    """Insert an arm's curves (c, s, n) into all joints, shape (c s, columns) [rad]."""
    rows = np.tile(others, (len(curves), 1))
    rows[:, context.model.arms[name].columns] = curves.reshape(-1, curves.shape[-1])
    return rows
