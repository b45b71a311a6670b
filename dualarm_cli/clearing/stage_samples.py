"""A stage at many instants: everybody's joints and what the arms hold, and whether all of it is collision-free."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from dualarm_cli.collision.clearance import CellClearance
from dualarm_cli.effort import ClearanceSettings
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray, distinct
from dualarm_cli.geometry.products import norm
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job
from dualarm_cli.model.joint_motion import SAME_TIME
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.motion.bent_transfers import Missing, ToolTimes, curved_transfer
from dualarm_cli.motion.builder import Motion
from dualarm_cli.motion.transfers import Drive
from dualarm_cli.motion.waiting import transfer_ends
from dualarm_cli.postures.holding import Holding
from dualarm_cli.postures.stage_plan import Detour, StagePlan
from dualarm_cli.records import dataclass
from dualarm_cli.timing import TimingSolver

STEP = 0.004
"""Time between the instants at full speed, but for stages of minutes [s]."""
KEPT = 0.0005
"""What is asked for beyond the required clearance, for what is between the instants [m]."""
NEAR = 0.008
"""Between two instants of which one has less than this to spare it is looked at more closely [m]; times their number
where instants have been left out between the two."""

Margins = Callable[[FloatArray, IntArray], FloatArray]
"""Margins [m], shape (n,), of joints (n, columns) [rad] with what the arms hold, shape (n, arms)."""


@dataclass(frozen=True)
class StageSamples:
    """One stage at t instants a step apart."""

    position: FloatArray
    """All joints [rad], shape (t, columns)."""
    held: IntArray
    """What each arm holds, shape (t, arms)."""
    step: float = STEP
    """Time between the instants [s]."""
    before: StageSamples | None = None
    """The stage before it, where an arm that is late still is; None: it still stands at its start."""

    def delayed(self, columns: Sequence[int], a: int, rows: int) -> StageSamples:
        """Return the stage with one arm some instants late, until that is done as well.

        Args:
            columns: of the arm's joints.
            a: the arm's number.
            rows: how many instants.
        """
        led = () if self.before is None else (self.before,)
        rows_now = np.minimum(np.arange(len(self.position) + rows), len(self.position) - 1)
        skipped = sum(len(one.position) for one in led) - rows
        rows_late = np.maximum(np.arange(len(rows_now)) + skipped, 0)
        position, held = self.position[rows_now], self.held[rows_now]
        own = np.concatenate([one.position for one in (*led, self)])[:, columns]
        position[:, columns] = own[rows_late]
        held[:, a] = np.concatenate([one.held[:, a] for one in (*led, self)])[rows_late]
        return StageSamples(position, held, self.step)


@dataclass(frozen=True)
class ArmMotion:
    """What one arm does in a stage, by itself."""

    q: FloatArray
    """Its joints [rad], shape (t, 7)."""
    held: IntArray
    """What it holds, shape (t,)."""
    arrival: int
    """Number of the instant at which its transfer is over."""
    meets: int | None = None
    """In a hand-over the instant at which the lines of both begin, when the other one has arrived as well."""

    @property
    def end(self) -> int:
        """Number of the instant after which it does not move."""
        return last_motion(self.q)


def stage_samples(motion: Motion, number: int, stage: int, holding: Holding) -> StageSamples:
    """Returns one stage of a motion.

    Args:
        motion: of some stages.
        number: which of them.
        stage: its number in the job, that of the return being the number of all others.
        holding: what the arms hold.
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
        if holding.handing[stage]:
            continue
        start, end = _on_lines(motion, [arm], this.start, this.end)
        # With no approach (or no retract) the part lies where it is picked (or placed) at that very instant as well.
        first = start - SAME_TIME if start == event.time else start + SAME_TIME
        inside = (time >= first) & (time <= end - SAME_TIME)
        held[inside, a] = holding.cell.loads.on_lines(held[inside, a])
    if stage <= last and holding.handing[stage]:
        # Both at once: from where the taking tool approaches until the giving one is away.
        start, end = _on_lines(motion, holding.cell.arms, this.start, this.end)
        inside = (time >= start - SAME_TIME) & (time <= end + SAME_TIME)
        held[inside] = holding.cell.loads.at_stops(
            held[inside], np.ones(int(inside.sum()), dtype=np.bool_)
        )
    return StageSamples(motion.trajectory.at(time)[0], held, step)


def _on_lines(motion: Motion, arms: Sequence[str], start: float, end: float) -> tuple[float, float]:
    """Returns when arms are on the lines of their stops in a stage from start to end [s]; an empty span for never."""
    parts = motion.lines_within(arms, start, end)
    return min((p.start for p in parts), default=np.inf), max(
        (p.end for p in parts), default=-np.inf
    )


def arm_motions(
    model: CellModel, motion: Motion, number: int, samples: StageSamples
) -> dict[str, ArmMotion]:
    """Returns what each arm does in one stage of a motion.

    Args:
        model: the cell.
        motion: of some stages.
        number: which of them.
        samples: of that stage.
    """
    this = motion.stages[number]
    motions: dict[str, ArmMotion] = {}
    for a, (name, arm) in enumerate(model.arms.items()):
        own = [part for part in motion.segments if part.arm == name]
        ends = transfer_ends(own, this.start, this.end + samples.step)
        arrival = round((max(ends, default=this.start) - this.start) / samples.step)
        arrival = min(arrival, len(samples.position) - 1)
        motions[name] = ArmMotion(samples.position[:, arm.columns], samples.held[:, a], arrival)
    span = this.start - SAME_TIME, this.end + SAME_TIME
    if any(part.action == "give" and span[0] <= part.start <= span[1] for part in motion.segments):
        # Whoever is early waits: that is part of neither's lines.
        meets = max(motion.arrival for motion in motions.values())
        motions = {name: replace(motion, meets=meets) for name, motion in motions.items()}
    return motions


def combined(
    model: CellModel,
    samples: StageSamples,
    motions: Mapping[str, ArmMotion],
    delays: Mapping[str, int],
) -> StageSamples:
    """Returns a stage with other motions of its arms, some of them late.

    Args:
        model: the cell.
        samples: of the stage as it was, for the platform.
        motions: of every arm.
        delays: instants that an arm waits before it leaves, by arm.
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
        own = np.minimum(np.arange(length), len(motion.q) - 1)
        position[:, model.arms[name].columns] = motion.q[own]
        held[:, a] = motion.held[own]
    return StageSamples(position, held, samples.step, samples.before)


def _late(motion: ArmMotion, delay: int) -> ArmMotion:
    """Returns an arm's motion some instants later."""
    if not delay:
        return motion
    meets = None if motion.meets is None else motion.meets + delay
    rows = np.maximum(np.arange(len(motion.q) + delay) - delay, 0)
    return ArmMotion(motion.q[rows], motion.held[rows], motion.arrival + delay, meets)


def _meeting(motion: ArmMotion, met: int) -> ArmMotion:
    """Returns an arm's motion in which its lines begin at an instant not before its arrival."""
    assert motion.meets is not None  # asked for only in hand-overs
    wait = np.full(met - motion.arrival, motion.arrival)
    rows = np.concatenate([np.arange(motion.arrival), wait, np.arange(motion.meets, len(motion.q))])
    return ArmMotion(motion.q[rows], motion.held[rows], motion.arrival, met)


def is_clear(cell: CellClearance, samples: StageSamples) -> bool:
    """Returns whether everything is clear of everything in a stage."""
    return bool(which_are_clear(cell, [samples])[0])


def which_are_clear(cell: CellClearance, stages: Sequence[StageSamples]) -> BoolArray:
    """Returns in which of s stages everything is clear of everything, shape (s,)."""
    kept = _which_are_apart(cell, stages)
    for margins in [_own(cell, a) for a in range(len(cell.arms))]:
        left = np.flatnonzero(kept).tolist()
        kept[left] = _kept(cell, [stages[k] for k in left], margins)
    return kept


def apart(cell: CellClearance, samples: StageSamples) -> bool:
    """Returns whether the arms are clear of each other."""
    return bool(_which_are_apart(cell, [samples])[0])


def _which_are_apart(cell: CellClearance, stages: Sequence[StageSamples]) -> BoolArray:
    """Returns in which of s stages the arms are clear of each other, also with one as late as it may be."""
    kept = _kept(cell, stages, cell.cross_margins)
    for k in np.flatnonzero(kept & (cell.skew > 0.0)).tolist():
        rows = int(np.ceil(cell.skew / stages[k].step))
        shifts = distinct(np.ceil(np.linspace(0.0, rows, -(-rows // 4) + 1))[1:])
        kept[k] = all(
            _kept(cell, [stages[k].delayed(columns, a, int(shift))], cell.cross_margins)[0]
            for shift in shifts[::-1]
            for a, columns in enumerate(cell.columns)
        )
    return kept


def alone_clear(cell: CellClearance, samples: StageSamples, a: int) -> bool:
    """Returns whether one arm is clear of itself and of all that is not the other arm."""
    return bool(_kept(cell, [samples], _own(cell, a))[0])


def _own(cell: CellClearance, a: int) -> Margins:
    def margins(position: FloatArray, held: IntArray) -> FloatArray:
        return cell.own_margins(a, position, held[:, a], ground=True)

    return margins


def _kept(cell: CellClearance, stages: Sequence[StageSamples], margins: Margins) -> BoolArray:
    """Returns in which of s stages all margins are kept, shape (s,).

    At every eighth instant first, then at all of them about those that have little to spare, or between which what
    is held changes, and then between these.
    """
    kept, coarse, between = np.ones(len(stages), dtype=np.bool_), 8, 8
    if not len(stages):
        return kept
    position = np.concatenate([stage.position for stage in stages])
    held = np.concatenate([stage.held for stage in stages])
    length = np.array([len(stage.position) for stage in stages])
    last = np.cumsum(length) - 1
    stage = np.repeat(np.arange(len(stages)), length)
    within = np.arange(len(position)) - (last - length + 1)[stage]

    def looked_at(rows: IntArray, q: FloatArray, numbers: IntArray) -> FloatArray:
        found = margins(q, numbers)
        kept[stage[rows[found < KEPT]]] = False
        return found

    rows = np.flatnonzero((within % coarse == 0) | (within == length[stage] - 1))
    margin = np.full(len(position), np.inf)
    margin[rows] = looked_at(rows, position[rows], held[rows])
    first, second = rows[:-1], rows[1:]
    close = np.minimum(margin[first], margin[second]) < NEAR * (second - first)
    # What may touch counts only where it reaches into something: how far it is from that says nothing.
    close |= (held[first] != held[second]).any(axis=1) | cell.may_only_touch(held[first])
    close &= (stage[first] == stage[second]) & kept[stage[first]]
    steps = (first[close, None] + np.arange(1, coarse)).ravel()
    rows = steps[steps < np.repeat(second[close], coarse - 1)]
    margin[rows] = looked_at(rows, position[rows], held[rows])
    tight = np.flatnonzero(np.minimum(margin[:-1], margin[1:]) < NEAR)
    tight = tight[(stage[tight] == stage[tight + 1]) & kept[stage[tight]]]
    # Between two instants joints are taken to go straight.
    share = ((np.arange(between) + 1.0) / (between + 1.0))[None, :, None]
    motion = position[tight, None] + share * (position[tight + 1] - position[tight])[:, None]
    rows = np.repeat(tight, between)
    looked_at(rows, motion.reshape(-1, position.shape[1]), held[rows])
    return kept


def last_motion(position: FloatArray) -> int:
    """Returns the number of the instant after which nothing moves, of joints (t, columns)."""
    moves = np.flatnonzero(np.abs(np.diff(position, axis=0)).max(axis=1, initial=0.0) > 0.0)
    return int(moves[-1]) + 1 if len(moves) else 0


@dataclass(frozen=True)
class StageContext:
    """One stage and all that its motions are measured by."""

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
    motions: dict[str, ArmMotion]
    """What each arm does in it."""
    platform: Trajectory | None
    """What the platform does in it; None where there is none."""
    timing: TimingSolver
    """How transfers and curves are timed."""
    seed: int
    """Of what is tried at random."""
    settings: ClearanceSettings
    """Numbers of the repairs."""

    def detoured(self, name: str, detour: Detour) -> ArmMotion:
        """Returns an arm's motion along a curve."""
        drive = Drive.of(self.model, self.job, self.timing)
        plan = replace(self.plan, detours={name: detour})
        piece = curved_transfer(drive, plan, name, self.platform)
        base = self.motions[name]
        rows = piece.at(np.arange(0.0, piece.duration, self.samples.step))[0]
        out = np.concatenate([base.q[:1], rows])
        # A line begins when the platform is there as well.
        wait = max(0, self._platform_arrival() - len(out))
        lines = base.arrival if base.meets is None else base.meets
        rest = base.q[lines:]
        q = np.concatenate([out, np.repeat(rest[:1], wait, axis=0), rest])
        held = np.concatenate([np.full(len(out) + wait, base.held[0]), base.held[lines:]])
        there = len(out) + wait
        return ArmMotion(q, held, there, None if base.meets is None else there)

    def _platform_arrival(self) -> int:
        turned = self.samples.position[:, self.model.platform_columns]
        moves = np.flatnonzero((turned[1:] != turned[:-1]).any(axis=1))
        return int(moves[-1]) + 1 if len(moves) else 0


def missing_clearance(
    context: StageContext, name: str, motion: ArmMotion, points: FloatArray, with_other: bool
) -> Missing:
    """Returns what curves of an arm lack of the clearance beside what all others do about then.

    Args:
        context: the stage.
        name: the arm.
        motion: what is known of how it gets along a curve.
        points: of that curve [rad], shape (s, n).
        with_other: whether the other arm counts.
    """
    stage, instants = _meanwhile(context, name, motion, points)
    a = context.cell.arms.index(name)

    def missing(curves: FloatArray) -> FloatArray:
        rows = _beside(context, name, stage.position[instants], curves)
        held = np.tile(stage.held[instants], (len(curves), 1))
        margin = context.cell.own_margins(a, rows, held[:, a])
        if with_other:
            margin = np.minimum(margin, context.cell.cross_margins(rows, held))
        lack: FloatArray = np.maximum(context.settings.curve_spare - margin, 0.0).reshape(
            curves.shape[:2]
        )
        # The ends are what they are.
        return lack[:, 1:-1].mean(axis=1)

    return missing


def tool_times(
    context: StageContext, name: str, motion: ArmMotion, points: FloatArray
) -> ToolTimes | None:
    """Returns how long an arm's tool needs at least along curves under its cap; None without one.

    Arguments as of `missing_clearance`.
    """
    cap = context.job.tool_speed
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
    """Returns a stage with another motion of an arm, and about when in it the arm is at points (s, 7) of its curve."""
    stage = combined(context.model, context.samples, {**context.motions, name: motion}, {})
    moving = motion.q[: motion.arrival + 1]
    far = np.abs(moving[None] - points[:, None]).max(axis=2)
    instants: IntArray = np.maximum.accumulate(np.argmin(far, axis=1))
    return stage, instants


def _beside(context: StageContext, name: str, others: FloatArray, curves: FloatArray) -> FloatArray:
    """Returns all joints with an arm on curves (c, s, 7) and all others at (s, columns), shape (c s, columns) [rad]."""
    rows = np.tile(others, (len(curves), 1))
    rows[:, context.model.arms[name].columns] = curves.reshape(-1, curves.shape[-1])
    return rows
