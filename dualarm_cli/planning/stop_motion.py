"""What arms do at their stops, piece by piece: lines, dwells, hand-overs, and what is recorded of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job, Stop
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.model.schedule import Event, Segment, SegmentKind, Stage, WaitReason
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.planning.lines import solve_line
from dualarm_cli.planning.motion_words import event_of
from dualarm_cli.planning.stage_plan import ArmStop, StagePlan
from dualarm_cli.planning.tracking import Tracked
from dualarm_cli.planning.transfers import Transfers
from dualarm_cli.timing import TimingSolver
from dualarm_cli.timing.composition import hold

Key = tuple[str | int | bytes, ...]
"""All that something depends on."""


@dataclass(frozen=True)
class Known:
    """What has been timed already in one job, so that it is not timed again where other stages are mended."""

    lines: dict[Key, tuple[Stop, Trajectory]] = field(default_factory=dict)
    """Lines, with their stop, lest another one takes its identity."""
    transfers: dict[Key, Transfers] = field(default_factory=dict)
    """Straight transfers of stages."""


@dataclass
class Recorder:
    """Pieces of motion per joint group, and what they mean, while stages are added."""

    pieces: dict[str, list[Trajectory]]
    segments: dict[str, list[Segment]]
    known: Known
    events: list[Event] = field(default_factory=list)
    stages: list[Stage] = field(default_factory=list)
    clock: float = 0.0


def add_handover(
    record: Recorder,
    model: CellModel,
    job: Job,
    plan: StagePlan,
    pair: tuple[ArmStop, ArmStop],
    ends: Mapping[str, float],
    limits: JointLimits,
    timing: TimingSolver,
) -> dict[str, float]:
    """Appends a hand-over from where both tools are there; returns when each arm is done with it [s].

    The taking arm approaches and grips while the giving one stands still, which then lets go and retracts while the
    taking one does.

    Args:
        record: what is planned so far.
        model: the job's cell.
        job: what is to be done.
        plan: the stage.
        pair: the giving and the taking arm's stop.
        ends: when each group is where its lines begin, from the stage's start [s].
        limits: what the joints may do.
        timing: how lines are timed.
    """
    begin, giver, taker = record.clock, *pair
    there = max(ends.values())

    def wait(arm_stop: ArmStop, start: float, end: float) -> None:
        if end <= start:
            return
        arm = model.arms[arm_stop.arm]
        stands = hold(arm.arm.joints, plan.arrival[arm.columns], end - start)
        record.pieces[arm_stop.arm].append(stands)
        add_segment(record, arm_stop.arm, "wait", arm_stop, start, end, "partner")

    clock = begin + there
    wait(taker, begin + ends[taker.arm], clock)
    gripped = add_stop(record, model, job, plan, taker, clock, limits, timing)
    wait(giver, begin + ends[giver.arm], gripped)
    away = add_stop(record, model, job, plan, giver, gripped, limits, timing)
    return {taker.arm: gripped - begin, giver.arm: away - begin}


def add_stop(
    record: Recorder,
    model: CellModel,
    job: Job,
    plan: StagePlan,
    arm_stop: ArmStop,
    clock: float,
    limits: JointLimits,
    timing: TimingSolver,
) -> float:
    """Appends approach, dwell and retract of one arm; returns when they are over [s].

    Args:
        record: what is planned so far.
        model: the job's cell.
        job: what is to be done.
        plan: the stage.
        arm_stop: what the arm does in it.
        clock: when it begins [s].
        limits: what the joints may do.
        timing: how lines are timed.
    """
    name = arm_stop.arm
    arm, stop, pieces = model.arms[name], arm_stop.stop, record.pieces[name]
    own = limits.select(arm.arm.joints)

    def line(which: str) -> Trajectory:
        key = (which, *_line_key(model, plan, arm_stop))
        if key not in record.known.lines:
            timed = solve_line(arm_stop, which, own, job.tool_speed, timing)
            record.known.lines[key] = arm_stop.stop, timed
        return record.known.lines[key][1]

    def add(piece: Trajectory, kind: SegmentKind) -> None:
        nonlocal clock
        pieces.append(piece)
        add_segment(record, name, kind, arm_stop, clock, clock + piece.duration)
        clock += piece.duration

    if arm_stop.tracked is not None:
        return _add_tracked(record, model, plan, arm_stop, arm_stop.tracked, clock)
    if stop.approach > 0:
        add(line("approach"), "approach")
    record.events.append(event_of(model, plan, arm_stop, clock))
    if stop.dwell.total > 0:
        add(hold(arm.arm.joints, arm_stop.posture.q_target, stop.dwell.total), "dwell")
    if stop.retract > 0:
        add(line("retract"), "retract")
    return clock


def _add_tracked(
    record: Recorder,
    model: CellModel,
    plan: StagePlan,
    arm_stop: ArmStop,
    tracked: Tracked,
    clock: float,
) -> float:
    """Appends a stop on a conveyor, ramps with the lines beside them; returns when it is over [s]."""
    name = arm_stop.arm
    reached, left = clock + tracked.reached, clock + tracked.left
    over = clock + tracked.motion.duration
    record.pieces[name].append(tracked.motion)
    add_segment(record, name, "approach", arm_stop, clock, reached)
    record.events.append(event_of(model, plan, arm_stop, reached))
    if left > reached:
        add_segment(record, name, "dwell", arm_stop, reached, left)
    add_segment(record, name, "retract", arm_stop, left, over)
    return over


def _line_key(model: CellModel, plan: StagePlan, arm_stop: ArmStop) -> Key:
    """Returns all that the lines of a stop depend on: its target, where the platform is then, and how it is made."""
    made, seen = arm_stop.posture, arm_stop.problem
    numbers = (
        plan.arrival[model.platform_columns],
        seen.start,
        made.q_target,
        [made.target, made.yaw, made.branch, made.psi_target, made.psi_approach, made.psi_retract],
    )
    return arm_stop.arm, id(arm_stop.stop), np.concatenate(numbers).tobytes()


def add_segment(
    record: Recorder,
    name: str,
    kind: SegmentKind,
    arm_stop: ArmStop | None,
    start: float,
    end: float,
    reason: WaitReason = "",
) -> None:
    """Notes what an arm does between two instants.

    Args:
        record: what is planned so far.
        name: the arm.
        kind: what it does.
        arm_stop: the stop that it belongs to; None for none.
        start: when it begins [s].
        end: when it ends [s].
        reason: why it waits, if it does.
    """
    task = arm_stop.task.id if arm_stop else ""
    action = arm_stop.stop.action if arm_stop else ""
    dwell = arm_stop.stop.dwell if arm_stop and kind == "dwell" else None
    record.segments[name].append(Segment(name, kind, task, action, start, end, dwell, reason))
