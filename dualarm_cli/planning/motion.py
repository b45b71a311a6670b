"""From decided stages to motion: every transfer, line, dwell and wait of every joint group."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import groupby

from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.model.schedule import Event, Segment, SegmentKind, Stage, WaitReason
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.planning.bent_transfers import path_pieces
from dualarm_cli.planning.motion_words import at_knot, stage_of
from dualarm_cli.planning.stage_moves import moves_to_lines
from dualarm_cli.planning.stage_plan import ArmStop, StagePlan, giver_and_taker
from dualarm_cli.planning.stage_waits import StageWaits, stage_waits, waiting_for_tasks
from dualarm_cli.planning.stop_motion import (
    Key,
    Known,
    Recorder,
    add_handover,
    add_segment,
    add_stop,
)
from dualarm_cli.planning.transfers import (
    PLATFORM,
    Transfers,
    transfers_within_tool_speed,
)
from dualarm_cli.planning.waiting import with_ends
from dualarm_cli.timing import TimingSolver
from dualarm_cli.timing.composition import concatenate, hold, merge


@dataclass(frozen=True)
class Motion:
    """A job's whole motion and what is said to happen in it."""

    trajectory: Trajectory
    """All joints of the robot."""
    stages: tuple[Stage, ...]
    """In time order."""
    segments: tuple[Segment, ...]
    """Arm by arm, in time order."""
    events: tuple[Event, ...]
    """In time order."""


def realise(
    model: CellModel,
    job: Job,
    plans: list[StagePlan],
    timing: TimingSolver,
    known: Known | None = None,
    *,
    windows: bool = True,
    clock: float = 0.0,
) -> Motion:
    """Returns the motion of the decided stages under every limit of the job.

    Args:
        model: the job's cell.
        job: what is to be done.
        plans: its stages in order.
        timing: how transfers and lines are timed.
        known: what is timed already; what is new is added.
        windows: whether stages wait for windows of their tasks to open; a stage by itself has no time to wait for.
        clock: when the first stage begins [s], for its windows; the motion itself is from 0.
    """
    robot = job.cell.robot
    limits = robot.limits.scaled(job.speed)
    columns = {PLATFORM: model.platform_columns} if robot.platform else {}
    columns |= {name: arm.columns for name, arm in model.arms.items()}
    record = Recorder(
        {name: [] for name in columns},
        {name: [] for name in model.arms},
        Known() if known is None else known,
    )
    for plan, after in zip(plans, waiting_for_tasks(plans), strict=True):
        key: Key = (*plan.stops, plan.start.tobytes(), plan.arrival.tobytes())
        if key not in record.known.transfers:
            record.known.transfers[key] = transfers_within_tool_speed(
                model, plan, columns, limits, timing, job.tool_speed
            )
        transfers = record.known.transfers[key]
        begin = record.clock

        def arrivals(
            held: Mapping[str, float], plan: StagePlan = plan, transfers: Transfers = transfers
        ) -> dict[str, float]:
            alone = Recorder({n: [] for n in columns}, {n: [] for n in model.arms}, record.known)
            _add_stage(alone, model, job, plan, transfers, columns, limits, timing, held, {})
            return {event.arm: event.time for event in alone.events}

        waits = stage_waits(plan, arrivals, list(model.arms), clock + begin if windows else None)
        _wait(record, plan, waits, columns, limits.joints)
        _add_stage(record, model, job, plan, transfers, columns, limits, timing, waits.held, after)
        record.stages[-1] = replace(record.stages[-1], start=begin)
    for name, index in columns.items():
        if not record.pieces[name]:
            # Nothing ever moves: a free start that is also the end.
            joints = tuple(robot.joints[i] for i in index)
            record.pieces[name].append(hold(joints, plans[-1].end[index], 0.0))
    trajectory = merge([concatenate(record.pieces[name]) for name in columns], joints=robot.joints)
    events = [at_knot(event, trajectory.time) for event in record.events]
    return Motion(
        trajectory,
        tuple(record.stages),
        with_ends([part for name in record.segments for part in record.segments[name]], events),
        tuple(sorted(events, key=lambda event: (event.time, event.arm))),
    )


def _wait(
    record: Recorder,
    plan: StagePlan,
    waits: StageWaits,
    columns: Mapping[str, list[int]],
    joints: tuple[str, ...],
) -> None:
    """Lets all joints stand before a stage begins, so that in the stage itself everything stays as it is."""
    if waits.common <= 0.0:
        return
    for name, index in columns.items():
        group = tuple(joints[i] for i in index)
        record.pieces[name].append(hold(group, plan.start[index], waits.common))
        if name != PLATFORM:
            span = record.clock, record.clock + waits.common
            add_segment(record, name, "wait", plan.stops.get(name), *span, waits.reasons[name])
    record.clock += waits.common


def _add_stage(
    record: Recorder,
    model: CellModel,
    job: Job,
    plan: StagePlan,
    transfers: Transfers,
    columns: Mapping[str, list[int]],
    limits: JointLimits,
    timing: TimingSolver,
    held: Mapping[str, float],
    after: Mapping[str, ArmStop],
) -> None:
    """Appends one stage: transfers, then each arm's lines and dwell, then waiting for the others.

    `after` has the next stops of arms that wait for a task to be over.
    """
    begin, ends = record.clock, dict.fromkeys(columns, 0.0)
    together = {}
    if plan.path is not None:
        together = path_pieces(model, plan, columns, limits, timing, job.tool_speed)
    kind: SegmentKind = "transfer" if plan.stops else "return"
    for name in columns:
        moves = moves_to_lines(
            model,
            plan,
            name,
            transfers,
            together,
            ends.get(PLATFORM, 0.0),
            columns,
            limits,
            timing,
            job.tool_speed,
            held.get(name, 0.0),
        )
        for reason, run in groupby(moves, key=lambda move: move.reason):
            pieces = [move.motion for move in run]
            record.pieces[name] += pieces
            start = ends[name]
            ends[name] += sum(piece.duration for piece in pieces)
            if name != PLATFORM and ends[name] > start:
                span = begin + start, begin + ends[name]
                what = "wait" if reason else kind
                add_segment(record, name, what, plan.stops.get(name), *span, reason)
    arrived = dict(ends)
    pair = giver_and_taker(plan.stops)
    if pair is not None:
        ends |= add_handover(record, model, job, plan, pair, ends, limits, timing)
    else:
        for name, arm_stop in plan.stops.items():
            clock = begin + ends[name]
            end = add_stop(record, model, job, plan, arm_stop, clock, limits, timing)
            ends[name] = end - begin
    length = max(ends.values())
    for name, index in columns.items():
        if ends[name] < length:
            names = tuple(model.cell.robot.joints[i] for i in index)
            record.pieces[name].append(hold(names, plan.end[index], length - ends[name]))
            if name != PLATFORM:
                span = begin + ends[name], begin + length
                why: WaitReason = "after" if name in after else "partner"
                add_segment(record, name, "wait", after.get(name), *span, why)
    record.clock = begin + length
    # In a hand-over the one that comes last decides, not the one that leaves last.
    last = ends if pair is None else arrived
    critical = max(plan.stops, key=lambda name: last[name], default="")
    record.stages.append(stage_of(model, plan, transfers, begin, record.clock, critical))
