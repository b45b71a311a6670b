"""Checks of hand-overs: who holds the part when, where the tools are then, and that they stand still."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.model.job import Job, Task
from dualarm_cli.model.schedule import Event, Schedule
from dualarm_cli.model.verification import Check
from dualarm_cli.records import dataclass
from dualarm_cli.verification.criteria import NO_TASKS, Criterion, not_checked
from dualarm_cli.verification.dense_times import dense_times
from dualarm_cli.verification.kind_checks import KindChecks, Touch
from dualarm_cli.verification.line_spans import LineSpan, spans_of
from dualarm_cli.verification.tolerances import TOL
from dualarm_cli.verification.tool_checks import Worst
from dualarm_cli.verification.tool_model import ToolModel, rotation_angle

NO_HANDOVERS = "the job has no hand-overs"
CRITERIA = {
    "handover_order": Criterion(
        "s",
        "Time by which an event of a hand-over comes too early.",
        NO_HANDOVERS,
    ),
    "handover_grip": Criterion(
        "m, rad", "Distance or angle of the taking tool from its grip on the part.", NO_HANDOVERS
    ),
    "handover_still": Criterion(
        "m, rad", "Motion of a tool while the other one grips or leaves.", NO_HANDOVERS
    ),
}


@dataclass(frozen=True)
class HandoverSpan:
    """When a part goes from arm to arm, as a schedule has it."""

    giving: Task
    """The giver's share of the task."""
    taking: Task
    """The taker's."""
    give: Event
    """The giver lets go from here on."""
    take: Event
    """The taker grips from here on."""
    start: float
    """When the taker begins its approach [s]."""
    end: float
    """When the giver's retract is over [s]."""


def handover_spans(job: Job, spans: Sequence[LineSpan]) -> list[HandoverSpan]:
    """Returns the hand-overs of which a schedule has each event once.

    Args:
        job: as it was done.
        spans: of the job's stops.
    """
    found = []
    for giving, taking in _shares(job):
        gives = spans_of(spans, giving.arm, giving.id, "give")
        takes = spans_of(spans, taking.arm, taking.id, "take")
        if len(gives) != 1 or len(takes) != 1:
            continue  # `check_handovers` says so
        [give], [take] = gives, takes
        found.append(HandoverSpan(giving, taking, give.event, take.event, take.start, give.end))
    return found


def check_handovers(
    schedule: Schedule, job: Job | None, model: ToolModel, spans: Sequence[LineSpan]
) -> list[Check]:
    """Checks every hand-over of the job.

    The taking tool grips where the file says, the giving arm stands still from when the taking one begins its approach
    until it has let go, the taking one from its grip until the giving one is away; the giver lets go only when the
    taker has gripped, and all of it lies between the pick and the place.

    Args:
        schedule: with finite numbers and rising times.
        job: as it was done; without it nothing is known of hand-overs.
        model: where the tools are.
        spans: of the job's stops.
    """
    if job is None or not job.has_handovers:
        return [not_checked(name, NO_TASKS if job is None else "") for name in CRITERIA]
    order, grip, still = Worst(), Worst(), Worst()
    for giving, taking in _shares(job):
        if wrong := _wrong_events(schedule, giving, taking):
            order.add(np.inf, wrong)
    for span in handover_spans(job, spans):
        _judge_order(schedule, span, order)
        _judge_grip(schedule, span, model, grip)
        name = span.giving.id
        times = (span.start, span.give.time + span.give.dwell)
        _judge_still(schedule, span.giving.arm, times, model, still, f"{name}: the giving")
        times = (span.take.time, span.end)
        _judge_still(schedule, span.taking.arm, times, model, still, f"{name}: the taking")
    nothing = "no hand-over has its events"
    return [
        order.judge("handover_order", TOL.same_time, nothing),
        grip.judge("handover_grip", TOL.pose_distance, nothing),
        still.judge("handover_still", TOL.pose_distance, nothing),
    ]


def _shares(job: Job) -> list[tuple[Task, Task]]:
    """Returns the giver's and the taker's share of every hand-over."""
    takers = {t.id: t for t in job.tasks if t.handover and t.stops[0].action == "take"}
    givers = [t for t in job.tasks if t.handover and t.stops[0].action == "pick"]
    return [(task, takers[task.id]) for task in givers]


def _events(schedule: Schedule, task: Task, action: str) -> list[Event]:
    return [e for e in schedule.events if (e.arm, e.task, e.action) == (task.arm, task.id, action)]


def _wrong_events(schedule: Schedule, giving: Task, taking: Task) -> str:
    """Returns which event of a hand-over is not there once, or by whom it should not be, or an empty string."""
    for task in (giving, taking):
        for stop in task.stops:
            count = len(_events(schedule, task, stop.action))
            if count != 1:
                times = "not done" if count == 0 else f"done {count} times"
                return f"{task.id}: {stop.action} by the {task.arm} arm is {times}"
    if giving.arm == taking.arm:
        return f"{giving.id}: the {giving.arm} arm gives and takes"
    return ""


def _judge_order(schedule: Schedule, span: HandoverSpan, worst: Worst) -> None:
    """Adds by how much an event of a hand-over comes too early [s]."""
    name, gripped = span.giving.id, span.take.time + span.take.dwell
    worst.add(
        gripped - span.give.time,
        f"{name}: the {span.giving.arm} arm lets go at {span.give.time:.4f} s, the {span.taking.arm} arm has gripped "
        f"at {gripped:.4f} s",
    )
    picked = [e.time + e.dwell for e in _events(schedule, span.giving, "pick")]
    placed = [e.time for e in _events(schedule, span.taking, "place")]
    for time in picked:
        where = f"{name}: handed over from {span.start:.4f} s on, picked at {time:.4f} s"
        worst.add(time - span.start, where)
    for time in placed:
        where = f"{name}: placed at {time:.4f} s, handed over until {span.end:.4f} s"
        worst.add(span.end - time, where)


def _judge_grip(schedule: Schedule, span: HandoverSpan, model: ToolModel, worst: Worst) -> None:
    """Adds how far the taking tool is from its grip when it grips, and when the giver lets go [m, rad]."""
    work = span.giving.handover
    assert work is not None  # it has one, as a hand-over
    for time, what in ((span.take.time, "grips"), (span.give.time, "holds it")):
        [q] = schedule.trajectory.at(np.array([time]))[0]
        off = (model.pose(span.giving.arm, q) * work.grip).actInv(model.pose(span.taking.arm, q))
        error = max(float(norm(off.translation)), float(rotation_angle(off.rotation)))
        worst.add(
            error, f"{span.giving.id}: where the {span.taking.arm} arm {what} at {time:.4f} s"
        )


def _judge_still(
    schedule: Schedule,
    arm: str,
    times: tuple[float, float],
    model: ToolModel,
    worst: Worst,
    what: str,
) -> None:
    """Adds how far a tool moves or turns between two instants [m, rad]."""
    start, end = times
    if not end > start:
        return
    instants = dense_times(schedule.trajectory.time, start, end)
    R, p = model.poses(arm, schedule.trajectory.at(instants)[0])
    turned: FloatArray = rotation_angle(product(R[0].T, R))
    off = np.maximum(norm(p - p[0], axis=1), turned)
    k = int(np.argmax(off))
    worst.add(float(off[k]), f"{what} tool moves, {arm} arm at {instants[k]:.4f} s")


def handover_touches(job: Job, spans: Sequence[LineSpan]) -> list[Touch]:
    """Returns when a part that goes from arm to arm may touch the other arm's tool, and itself as that one holds it.

    Args:
        job: as it was done.
        spans: of the job's stops.
    """
    found = []
    for span in handover_spans(job, spans):
        giver, taker = span.giving.arm, span.taking.arm
        given, taken = (giver, span.giving.part), (taker, span.taking.part)
        tools = {arm: ("", f"{arm}_tool") for arm in (giver, taker)}
        for pair in ((given, taken), (given, tools[taker]), (taken, tools[giver])):
            found.append(Touch(frozenset(pair), span.start, span.end, gripped=True))
    return found


CHECKS = KindChecks(
    {"work": lambda case: check_handovers(case.known_arms_only, case.done, case.model, case.spans)},
    CRITERIA,
    handover_touches,
)
