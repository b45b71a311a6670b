"""Checks of hand-overs: order of grips, poses of the tools, and tools at rest."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.model.job import Job, Task
from dualarm_cli.model.schedule import Event, Schedule
from dualarm_cli.model.verification import Check
from dualarm_cli.records import dataclass
from dualarm_cli.verification.kind_checks import KindChecks, Touch
from dualarm_cli.verification.measuring.criteria import NO_TASKS, Criterion, not_checked
from dualarm_cli.verification.measuring.dense_times import dense_times
from dualarm_cli.verification.measuring.line_spans import LineSpan, spans_of
from dualarm_cli.verification.measuring.tolerances import TOL
from dualarm_cli.verification.measuring.tool_model import ToolModel, rotation_angle
from dualarm_cli.verification.tool_checks import Worst

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
    """Hand-over of a part from arm to arm in a schedule."""

    giving: Task
    """Task of the giving arm."""
    taking: Task
    """Task of the taking arm."""
    give: Event
    """Event at which the giving arm begins to let go."""
    take: Event
    """Event at which the taking arm begins to grip."""
    start: float
    """Start of the taking arm's approach [s]."""
    end: float
    """End of the giving arm's retract [s]."""


def handover_spans(job: Job, spans: Sequence[LineSpan]) -> list[HandoverSpan]:
    """List the hand-overs that have exactly one give and one take event.

    Args:
        job: as done.
        spans: of the job's stops.
    """
    handovers = []
    for giving, taking in _paired_tasks(job):
        gives = spans_of(spans, giving.arm, giving.id, "give")
        takes = spans_of(spans, taking.arm, taking.id, "take")
        if len(gives) != 1 or len(takes) != 1:
            continue  # `check_handovers` reports it
        [give], [take] = gives, takes
        handovers.append(HandoverSpan(giving, taking, give.event, take.event, take.start, give.end))
    return handovers


def check_handovers(
    schedule: Schedule, job: Job | None, model: ToolModel, spans: Sequence[LineSpan]
) -> list[Check]:
    """Check every hand-over of the job.

    The taking tool has the grip of the file. The giving arm stands still from the start of the taking arm's approach
    until it has let go, the taking arm from its grip until the end of the other's retract. The giving arm lets go only
    after the grip, and the hand-over lies between pick and place.

    Args:
        schedule: with finite numbers and rising times.
        job: as done; None for no check of hand-overs.
        model: kinematics of the tools.
        spans: of the job's stops.
    """
    if job is None or not job.has_handovers:
        return [not_checked(name, NO_TASKS if job is None else "") for name in CRITERIA]
    order, grip, still = Worst(), Worst(), Worst()
    for giving, taking in _paired_tasks(job):
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


def _paired_tasks(job: Job) -> list[tuple[Task, Task]]:
    """Pair the giving and taking tasks of every hand-over."""
    takers = {t.id: t for t in job.tasks if t.handover and t.stops[0].action == "take"}
    givers = [t for t in job.tasks if t.handover and t.stops[0].action == "pick"]
    return [(task, takers[task.id]) for task in givers]


def _events(schedule: Schedule, task: Task, action: str) -> list[Event]:
    return [e for e in schedule.events if (e.arm, e.task, e.action) == (task.arm, task.id, action)]


def _wrong_events(schedule: Schedule, giving: Task, taking: Task) -> str:
    """Describe a missing, repeated or wrongly assigned event of a hand-over, if any."""
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
    """Add the times by which events of a hand-over come too early [s]."""
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
    """Add the errors of the taking tool's grip at both events [m, rad]."""
    work = span.giving.handover
    assert work is not None  # hand-overs have one
    for time, what in ((span.take.time, "grips"), (span.give.time, "holds it")):
        [q] = schedule.trajectory.clamped(np.array([time]))[0]
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
    """Add the largest motion of a tool between two instants [m, rad]."""
    start, end = times
    if not end > start:
        return
    instants = dense_times(schedule.trajectory.time, start, end)
    R, p = model.poses(arm, schedule.trajectory.clamped(instants)[0])
    turned: FloatArray = rotation_angle(product(R[0].T, R))
    off = np.maximum(norm(p - p[0], axis=1), turned)
    k = int(np.argmax(off))
    worst.add(float(off[k]), f"{what} tool moves, {arm} arm at {instants[k]:.4f} s")


def handover_touches(job: Job, spans: Sequence[LineSpan]) -> list[Touch]:
    """List the contacts that hand-overs allow.

    The part may touch the other arm's tool and hand, and itself as held by that arm.

    Args:
        job: as done.
        spans: of the job's stops.
    """
    touches = []
    for span in handover_spans(job, spans):
        giver, taker = span.giving.arm, span.taking.arm
        given, taken = (giver, span.giving.part), (taker, span.taking.part)
        hands = job.cell.robot.hands
        pairs = [(given, taken)]
        for part, arm in ((given, taker), (taken, giver)):
            pairs += [(part, ("", body)) for body in (f"{arm}_tool", *hands[arm])]
        for pair in pairs:
            touches.append(Touch(frozenset(pair), span.start, span.end, gripped=True))
    return touches


CHECKS = KindChecks(
    {"work": lambda case: check_handovers(case.known_arms_only, case.done, case.model, case.spans)},
    CRITERIA,
    handover_touches,
)
