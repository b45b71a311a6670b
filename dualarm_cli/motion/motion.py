"""Motion of decided stages: every transfer, line, dwell and wait of every joint group."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, replace
from itertools import groupby

import numpy as np

from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job
from dualarm_cli.model.schedule import SegmentKind, WaitReason
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.motion.bent_transfers import detour_pieces, moving_detour
from dualarm_cli.motion.builder import Motion, MotionBuilder
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

ROUNDS = 3
"""So often arms are held back for their parts: where one stands on the way anyway, that takes some of it up."""
ALIKE, ROUNDING = 2e-3, 1e-12
"""Waits that differ by less are for the same, as parts are met a little later than they could be, or one but for
rounding [s]."""


@dataclass(frozen=True)
class StageWaits:
    """What is waited for."""

    common: float = 0.0
    """How long all wait together before the stage begins [s]."""
    reasons: Mapping[str, WaitReason] = field(default_factory=dict)
    """Why, by arm."""
    held: Mapping[str, float] = field(default_factory=dict)
    """How long one arm waits in the stage before it leaves, so that both meet their parts [s], by arm."""


def waiting_for_tasks(plans: Sequence[StagePlan]) -> list[dict[str, ArmStop]]:
    """Returns by stage the arms without a stop in it whose next task comes after one not yet over, with its first stop.

    Args:
        plans: all stages in order.
    """
    last = {one.task.id: k for k, plan in enumerate(plans) for one in plan.stops.values()}
    following: dict[str, ArmStop] = {}
    found: list[dict[str, ArmStop]] = []
    for k, plan in reversed(list(enumerate(plans))):
        found.append(
            {
                name: one
                for name, one in following.items()
                if name not in plan.stops
                and one.stop.action == one.task.stops[0].action
                and any(last.get(other, -1) >= k for other in one.task.after)
            }
        )
        following |= plan.stops
    return found[::-1]


def stage_waits(
    plan: StagePlan,
    arrivals: Callable[[Mapping[str, float]], dict[str, float]],
    arms: Sequence[str],
    clock: float | None,
) -> StageWaits:
    """Returns what a stage waits for.

    All wait together, so that in the stage itself everything stays as it is. Only where both arms meet parts on
    conveyors does one of them wait in the stage, and does so also where the stage is looked at by itself. What would
    come too late for its part comes too late: the planner sees it from the event.

    Args:
        plan: the stage.
        arrivals: when tools are at their targets, from the stage's begin [s], where arms are held back by so much.
        arms: names of all arms.
        clock: when the stage could begin [s]; None for a stage by itself, which has no time to wait for.
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
    held: dict[str, float] = {}
    there = arrivals(held)
    if len(meets) > 1:
        for _ in range(ROUNDS):
            spare = {name: at - there[name] for name, at in meets.items()}
            least = min(spare.values())
            if max(spare.values()) - least <= ROUNDING:
                break
            held = {name: held.get(name, 0.0) + more - least for name, more in spare.items()}
            there = arrivals(held)
    if clock is None:
        return StageWaits(held=held)
    due: dict[str, tuple[float, WaitReason]] = {
        name: (opens[name] - clock - there[name], "window") for name in opens
    }
    for name, at in meets.items():
        early = at - clock - there[name]
        if name not in due or early >= due[name][0]:
            due[name] = early, "conveyor"
    wait = max(0.0, *(early for early, _ in due.values()))
    reasons: dict[str, WaitReason] = {
        name: due[name][1] if name in due and wait - due[name][0] <= ALIKE else "partner"
        for name in arms
    }
    return StageWaits(wait, reasons, held)


@dataclass(frozen=True)
class Move:
    """A stretch in which a group moves, or stands for one reason."""

    motion: Trajectory
    """What its joints do."""
    reason: WaitReason = ""
    """Why it stands; empty where it moves."""


def moves_to_lines(
    drive: Drive,
    plan: StagePlan,
    name: str,
    transfers: Transfers,
    platform_end: float,
    held: float = 0.0,
) -> list[Move]:
    """Returns what a group does from a stage's start until its lines begin, or until it has returned.

    Args:
        drive: of the job.
        plan: the stage.
        name: the group.
        transfers: the stage's straight transfers.
        platform_end: when the platform is there, counted from the stage's start [s].
        held: how long it stands first, for what a conveyor brings [s].
    """
    index, joints = drive.columns[name], drive.joints(name)
    late = plan.waits.get(name, 0.0)
    moves = [Move(hold(joints, plan.start[index], late), "shared_zone")] if late > 0.0 else []
    if held > 0.0:
        moves.insert(0, Move(hold(joints, plan.start[index], held), "conveyor"))
        late += held
    if name in plan.detours and plan.detours[name].rates is not None:
        # Its line begins when the platform is there as well.
        least = platform_end - late if name in plan.stops else 0.0
        moves += [Move(piece) for piece in moving_detour(drive, plan, name, least)]
    elif name in plan.detours:
        pieces = detour_pieces(drive, plan, name, transfers.motion.get(PLATFORM))
        moves += [Move(piece) for piece in pieces]
        # Its line begins when the platform is there as well.
        rest = platform_end - (late + sum(piece.duration for piece in pieces))
        if name in plan.stops and rest > 0.0:
            moves.append(Move(hold(joints, plan.arrival[index], rest), "platform"))
    elif name in transfers.motion:
        motion = transfers.motion[name]
        # An arm whose line begins where it is stands until the platform is there.
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
    """Returns the motion of the decided stages under every limit of the job.

    Args:
        model: the job's cell.
        job: what is to be done.
        plans: its stages in order.
        timing: how transfers and lines are timed.
        cache: motions timed so far, added to.
        clock: when the first stage begins [s], for windows of tasks; the motion itself is from 0. None for a stage by
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
            held: Mapping[str, float], plan: StagePlan = plan, transfers: Transfers = transfers
        ) -> dict[str, float]:
            alone = MotionBuilder()
            _add_stage(alone, drive, plan, transfers, held, {})
            return {event.arm: event.time for event in alone.events}

        now = None if clock is None else clock + begin
        waits = stage_waits(plan, arrivals, list(model.arms), now)
        _wait(record, drive, plan, waits)
        _add_stage(record, drive, plan, transfers, waits.held, after)
        record.stages[-1] = replace(record.stages[-1], start=begin)
    for name, index in drive.columns.items():
        if not record.pieces[name]:
            # Nothing ever moves: a free start that is also the end.
            record.add(name, hold(drive.joints(name), plans[-1].end[index], 0.0))
    return record.build(job.cell.robot)


def _transfers(drive: Drive, before: StagePlan | None, plan: StagePlan) -> Transfers:
    """Returns the transfers of a stage, in motion where they come from and lead to lines that are passed in motion."""
    rates = rates_between(drive, before, plan)
    if plan.through or giver_and_taker(plan.stops) is not None:
        return transfers_in_motion(drive, plan, rates)
    passed = (
        (name, *(None if rate is None else rate.tobytes() for rate in own))
        for name, own in rates.items()
    )
    key: Key = (*plan.stops, plan.start.tobytes(), plan.arrival.tobytes(), *passed)
    if key not in drive.cache.transfers:
        drive.cache.transfers[key] = transfers_within_tool_speed(drive, plan, rates)
    return drive.cache.transfers[key]


def _wait(record: MotionBuilder, drive: Drive, plan: StagePlan, waits: StageWaits) -> None:
    """Lets all joints stand before a stage begins, so that in the stage itself everything stays as it is."""
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
    held: Mapping[str, float],
    after: Mapping[str, ArmStop],
) -> None:
    """Appends one stage: transfers, then each arm's lines and dwell, then waiting for the others.

    `after` has the next stops of arms that wait for a task to be over.
    """
    begin, ends = record.clock, dict.fromkeys(drive.columns, 0.0)
    kind: SegmentKind = "transfer" if plan.stops else "return"
    for name in drive.columns:
        there = ends.get(PLATFORM, 0.0)
        moves = moves_to_lines(drive, plan, name, transfers, there, held.get(name, 0.0))
        for reason, run in groupby(moves, key=lambda move: move.reason):
            pieces = [move.motion for move in run]
            for piece in pieces:
                record.add(name, piece)
            start = ends[name]
            ends[name] += sum(piece.duration for piece in pieces)
            if name != PLATFORM and ends[name] > start:
                span = begin + start, begin + ends[name]
                what = "wait" if reason else kind
                record.add_segment(name, what, plan.stops.get(name), *span, reason)
    arrived = dict(ends)
    pair = giver_and_taker(plan.stops)
    if pair is not None:
        ends |= add_handover(record, drive, plan, pair, ends)
    else:
        over = {
            name: ends[name] + stop_duration(drive, plan, arm_stop)
            for name, arm_stop in plan.stops.items()
        }
        latest = begin + max((ends | over).values())
        for name, arm_stop in plan.stops.items():
            clock = begin + ends[name]
            ends[name] = add_stop(record, drive, plan, arm_stop, clock, latest) - begin
    length = max(ends.values())
    for name, index in drive.columns.items():
        # What leaves in motion is the last, up to rounding.
        passing = (name, "retract") in plan.passes or name in plan.through
        if ends[name] < length and not passing:
            record.add(name, hold(drive.joints(name), plan.end[index], length - ends[name]))
            if name != PLATFORM:
                span = begin + ends[name], begin + length
                why: WaitReason = "after" if name in after else "partner"
                record.add_segment(name, "wait", after.get(name), *span, why)
    record.clock = begin + length
    # In a hand-over the one that comes last decides, not the one that leaves last.
    last = ends if pair is None else arrived
    critical = max(plan.stops, key=lambda name: last[name], default="")
    record.stages.append(stage_of(drive.model, plan, transfers, begin, record.clock, critical))
