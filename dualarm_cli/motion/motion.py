"""Motion of decided stages: transfers, lines, dwells and waits of every joint group."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, replace
from itertools import groupby

import numpy as np

from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.schedule import SegmentKind, WaitReason
from dualarm_cli.motion.builder import Motion, MotionBuilder
from dualarm_cli.motion.curved_transfers import detour_pieces, moving_detour
from dualarm_cli.motion.stop_motion import (
    add_handover,
    add_stop,
    rates_between,
    stage_of,
    stop_duration,
    time_lines,
    transfers_in_motion,
)
from dualarm_cli.motion.transfers import (
    PLATFORM,
    Drive,
    Key,
    MotionCache,
    Transfers,
    transfers_within_tool_speed,
)
from dualarm_cli.postures.stage_plan import ArmStop, StagePlan, giver_and_taker
from dualarm_cli.records import dataclass
from dualarm_cli.timing import TimingSolver
from dualarm_cli.timing.composition import hold

MAX_ROUNDS = 3
"""Maximum number of corrections of the delays with which arms meet moving parts.

An arm that waits for the platform absorbs a part of its delay.
"""
SAME_WAIT, ROUNDING = 2e-3, 1e-12
"""Difference of waits that have the same cause, and rounding of equal waits [s].

Parts on conveyors are met slightly later than they could be.
"""


@dataclass(frozen=True)
class StageWaits:
    """Waits of a stage, with reasons."""

    common: float = 0.0
    """Wait of all groups before the stage begins [s]."""
    reasons: Mapping[str, WaitReason] = field(default_factory=dict)
    """Reason of the wait, by arm."""
    delays: Mapping[str, float] = field(default_factory=dict)
    """Delays within the stage with which both arms meet their parts [s]."""


def waiting_for_tasks(plans: Sequence[StagePlan]) -> list[dict[str, ArmStop]]:
    """List the arms that wait for a task, by stage, with their next stop.

    Args:
        plans: all stages in order.
    """
    last = {arm_stop.task.id: k for k, plan in enumerate(plans) for arm_stop in plan.stops.values()}
    following: dict[str, ArmStop] = {}
    waiting: list[dict[str, ArmStop]] = []
    for k, plan in reversed(list(enumerate(plans))):
        waiting.append(
            {
                name: arm_stop
                for name, arm_stop in following.items()
                if name not in plan.stops
                and arm_stop.stop.action == arm_stop.task.stops[0].action
                and any(last.get(name_after, -1) >= k for name_after in arm_stop.task.after)
            }
        )
        following |= plan.stops
    return waiting[::-1]


def stage_waits(
    plan: StagePlan,
    arrivals: Callable[[Mapping[str, float]], dict[str, float]],
    arms: Sequence[str],
    clock: float | None,
) -> StageWaits:
    """Compute the waits of a stage.

    All groups wait before the stage, so that the stage itself does not change. Only if both arms meet parts on
    conveyors, one of them is delayed within the stage, even if the stage is planned by itself. A part that is missed
    stays missed: the planner detects it from the event.

    Args:
        plan: the stage.
        arrivals: times of tools at their targets, from the stage's begin [s], for given delays.
        arms: names of all arms.
        clock: earliest start of the stage [s]; None for a stage by itself, which has no absolute time.
    """
    meets = {
        name: stop.stop.belt.at
        for name, stop in plan.stops.items()
        if stop.tracked is not None and stop.stop.belt is not None
    }
    opens = {
        name: stop.task.not_before
        for name, stop in plan.stops.items()
        if stop.stop.action == stop.task.stops[0].action and stop.task.not_before > (clock or 0.0)
    }
    if not meets and (clock is None or not opens):
        return StageWaits()
    delays: dict[str, float] = {}
    reached = arrivals(delays)
    if len(meets) > 1:
        for _ in range(MAX_ROUNDS):
            margins = {name: at - reached[name] for name, at in meets.items()}
            least = min(margins.values())
            if max(margins.values()) - least <= ROUNDING:
                break
            delays = {
                name: delays.get(name, 0.0) + slack - least for name, slack in margins.items()
            }
            reached = arrivals(delays)
    if clock is None:
        return StageWaits(delays=delays)
    lead_times: dict[str, tuple[float, WaitReason]] = {
        name: (opens[name] - clock - reached[name], "window") for name in opens
    }
    for name, at in meets.items():
        early = at - clock - reached[name]
        if name not in lead_times or early >= lead_times[name][0]:
            lead_times[name] = early, "conveyor"
    wait = max(0.0, *(early for early, _ in lead_times.values()))
    reasons: dict[str, WaitReason] = {
        name: lead_times[name][1]
        if name in lead_times and wait - lead_times[name][0] <= SAME_WAIT
        else "partner"
        for name in arms
    }
    return StageWaits(wait, reasons, delays)


@dataclass(frozen=True)
class Move:
    """Motion of a group, or a wait with one reason."""

    motion: Trajectory
    """Motion of its joints."""
    reason: WaitReason = ""
    """Reason of a wait; empty for a motion."""


def moves_to_lines(
    drive: Drive,
    plan: StagePlan,
    name: str,
    transfers: Transfers,
    platform_end: float,
    conveyor_wait: float = 0.0,
) -> list[Move]:
    """List the moves of a group until its line begins or the return ends.

    Args:
        drive: of the job.
        plan: the stage.
        name: the group.
        transfers: the stage's straight transfers.
        platform_end: arrival of the platform, from the stage's start [s].
        conveyor_wait: initial wait for a part on a conveyor [s].
    """
    index, joints = drive.columns[name], drive.joints(name)
    delay = plan.waits.get(name, 0.0)
    moves = [Move(hold(joints, plan.start[index], delay), "shared_zone")] if delay > 0.0 else []
    if conveyor_wait > 0.0:
        moves.insert(0, Move(hold(joints, plan.start[index], conveyor_wait), "conveyor"))
        delay += conveyor_wait
    if name in plan.detours and plan.detours[name].rates is not None:
        # The line may begin only after the platform has arrived.
        least = platform_end - delay if name in plan.stops else 0.0
        moves += [Move(piece) for piece in moving_detour(drive, plan, name, least)]
    elif name in plan.detours:
        pieces = detour_pieces(drive, plan, name, transfers.motion.get(PLATFORM))
        moves += [Move(piece) for piece in pieces]
        # The line may begin only after the platform has arrived.
        remaining = platform_end - (delay + sum(piece.duration for piece in pieces))
        if name in plan.stops and remaining > 0.0:
            moves.append(Move(hold(joints, plan.arrival[index], remaining), "platform"))
    elif name in transfers.motion:
        motion = transfers.motion[name]
        # An arm that need not move waits for the platform before its line.
        moves.append(Move(motion, "platform" if _stands(motion) else ""))
    return moves


def _stands(motion: Trajectory) -> bool:
    return bool((motion.position == motion.position[0]).all() and not np.any(motion.velocity))


def realise(
    model: CellModel,
    job: Job,
    plans: list[StagePlan],
    timing: TimingSolver,
    cache: MotionCache | None = None,
    *,
    clock: float | None = 0.0,
) -> Motion:
    """Build the motion of decided stages under all limits of the job.

    Args:
        model: the job's cell.
        job: job with its tasks and limits.
        plans: stages in order.
        timing: solver for transfers and lines.
        cache: motions timed so far, added to.
        clock: start of the first stage [s], for windows of tasks; the motion itself is from 0. None for a stage by
            itself, which waits for no window.
    """
    drive = Drive.of(model, job, timing, cache)
    time_lines(drive, plans)
    record = MotionBuilder({name: [] for name in drive.columns})
    before: StagePlan | None = None
    for plan, after in zip(plans, waiting_for_tasks(plans), strict=True):
        transfers = _transfers(drive, before, plan)
        before = plan
        begin = record.clock

        def arrivals(
            delays: Mapping[str, float], plan: StagePlan = plan, transfers: Transfers = transfers
        ) -> dict[str, float]:
            alone = MotionBuilder()
            _add_stage(alone, drive, plan, transfers, delays, {})
            return {event.arm: event.time for event in alone.events}

        now = None if clock is None else clock + begin
        waits = stage_waits(plan, arrivals, list(model.arms), now)
        _wait(record, drive, plan, waits)
        _add_stage(record, drive, plan, transfers, waits.delays, after)
        record.stages[-1] = replace(record.stages[-1], start=begin)
    for name, index in drive.columns.items():
        if not record.pieces[name]:
            # A group without motion, as with a free start that is also the end.
            record.add(name, hold(drive.joints(name), plans[-1].end[index], 0.0))
    return record.build(job.cell.robot)


def _transfers(drive: Drive, before: StagePlan | None, plan: StagePlan) -> Transfers:
    """Time the transfers of a stage, in motion next to blended lines."""
    rates, drive = rates_between(drive, before, plan), drive.to(plan)
    if plan.through or giver_and_taker(plan.stops) is not None:
        return transfers_in_motion(drive, plan, rates)
    passed = (
        (name, *(None if rate is None else rate.tobytes() for rate in pair))
        for name, pair in rates.items()
    )
    key: Key = (drive.care, *plan.stops, plan.start.tobytes(), plan.arrival.tobytes(), *passed)
    if key not in drive.cache.transfers:
        drive.cache.transfers[key] = transfers_within_tool_speed(drive, plan, rates)
    return drive.cache.transfers[key]


def _wait(record: MotionBuilder, drive: Drive, plan: StagePlan, waits: StageWaits) -> None:
    """Insert a wait of all joints before a stage."""
    if waits.common <= 0.0:
        return
    for name, index in drive.columns.items():
        record.add(name, hold(drive.joints(name), plan.start[index], waits.common))
        if name != PLATFORM:
            span = record.clock, record.clock + waits.common
            record.add_segment(name, "wait", plan.stops.get(name), *span, waits.reasons[name])
    record.clock += waits.common


def _add_stage(
    record: MotionBuilder,
    drive: Drive,
    plan: StagePlan,
    transfers: Transfers,
    delays: Mapping[str, float],
    after: Mapping[str, ArmStop],
) -> None:
    """Append a stage: transfers, then each arm's lines and dwell, then waits.

    `after` has the next stops of arms that wait for a task to finish.
    """
    begin, ends = record.clock, dict.fromkeys(drive.columns, 0.0)
    kind: SegmentKind = "transfer" if plan.stops else "return"
    for name in drive.columns:
        platform_end = ends.get(PLATFORM, 0.0)
        moves = moves_to_lines(drive, plan, name, transfers, platform_end, delays.get(name, 0.0))
        for reason, run in groupby(moves, key=lambda move: move.reason):
            pieces = [move.motion for move in run]
            for piece in pieces:
                record.add(name, piece)
            start = ends[name]
            ends[name] += sum(piece.duration for piece in pieces)
            if name != PLATFORM and ends[name] > start:
                span = begin + start, begin + ends[name]
                segment_kind = "wait" if reason else kind
                record.add_segment(name, segment_kind, plan.stops.get(name), *span, reason)
    arrived = dict(ends)
    pair = giver_and_taker(plan.stops)
    if pair is not None:
        ends |= add_handover(record, drive, plan, pair, ends)
    else:
        stop_ends = {
            name: ends[name] + stop_duration(drive, plan, arm_stop)
            for name, arm_stop in plan.stops.items()
        }
        latest = begin + max((ends | stop_ends).values())
        for name, arm_stop in plan.stops.items():
            clock = begin + ends[name]
            ends[name] = add_stop(record, drive, plan, arm_stop, clock, latest) - begin
    duration = max(ends.values())
    for name, index in drive.columns.items():
        # A group that departs in motion ends last, except for rounding.
        passing = (name, "retract") in plan.passes or name in plan.through
        if ends[name] < duration and not passing:
            record.add(name, hold(drive.joints(name), plan.end[index], duration - ends[name]))
            if name != PLATFORM:
                span = begin + ends[name], begin + duration
                idle_reason: WaitReason = "after" if name in after else "partner"
                record.add_segment(name, "wait", after.get(name), *span, idle_reason)
    record.clock = begin + duration
    # In a hand-over the last arrival decides, not the last departure.
    last = ends if pair is None else arrived
    critical = max(plan.stops, key=lambda name: last[name], default="")
    record.stages.append(stage_of(drive.model, plan, transfers, begin, record.clock, critical))
