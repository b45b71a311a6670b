"""Spans of time in which arms hold parts and tools, or follow lines."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from dualarm_cli.model.job import AT_STANDS, GIVES, LYING, TAKES, Job
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.verification.measuring.line_spans import LineSpan

Span = tuple[float, float]
"""Start and end of a span [s]."""


class Carried(Protocol):
    """Part or changed tool that an arm may carry."""

    @property
    def carrier(self) -> str:
        """Arm."""

    @property
    def body(self) -> str:
        """Name of the part."""

    @property
    def tool(self) -> str:
        """Changed tool that it is, or that grips it; empty for none."""

    @property
    def bolted(self) -> bool:
        """Whether it is a changed tool."""


def carrying_spans(
    schedule: Schedule, job: Job, solid: Carried, task: str | None = None
) -> list[Span]:
    """List the spans in which an arm carries a part or a tool [s].

    A part is carried from its pick or hand-over to its release, or to the end of the motion. A tool is carried from the
    start, if it is mounted, and from each time that it is taken, until it is left or to the end.

    Args:
        schedule: with the events of all arms.
        job: each task with the arm that did it.
        solid: of the part or the tool.
        task: selects the spans of one task; None selects all.
    """
    arm, end = solid.carrier, float(schedule.trajectory.time[-1])
    tasks = tasks_moving(solid, job) if task is None else {task}
    spans = []
    if solid.bolted:
        events = [e for e in schedule.events if e.arm == arm and e.task in tasks]
        begins = [e.time for e in events if e.action in TAKES]
        if job.cell.start_tool(arm) == solid.tool:
            begins.append(float(schedule.trajectory.time[0]))
        releases = [(e.time, e.changes_held) for e in events if e.action in GIVES]
        for begin in begins:
            spans.append((begin, min((over for at, over in releases if at >= begin), default=end)))
        return spans
    for event in schedule.events:
        if event.arm != arm or event.task not in tasks or event.action not in TAKES:
            continue
        ends = [
            e.changes_held
            for e in schedule.events
            if (e.arm, e.task) == (arm, event.task) and e.action in GIVES and e.time >= event.time
        ]
        spans.append((event.changes_held, min(ends, default=end)))
    return spans


def tasks_moving(solid: Carried, job: Job) -> set[str]:
    """List the tasks that move a part or change a tool."""
    return {
        task.id
        for task in job.tasks
        if (task.arm, task.tool) == (solid.carrier, solid.tool)
        and (task.is_change if solid.bolted else task.part == solid.body)
    }


def spans_on_lines(job: Job, solid: Carried, spans: Sequence[LineSpan]) -> list[Span]:
    """List the spans in which a part's carrier follows lines or dwells [s].

    The spans are sorted and disjoint.
    """
    tasks, actions = tasks_moving(solid, job), AT_STANDS if solid.bolted else LYING
    joined: list[Span] = []
    for start, end in sorted(
        (span.start, span.end)
        for span in spans
        if span.event.arm == solid.carrier
        and span.event.task in tasks
        and span.event.action in actions
    ):
        if joined and start <= joined[-1][1]:
            joined[-1] = (joined[-1][0], max(end, joined[-1][1]))
        else:
            joined.append((start, end))
    return joined


def overlaps(spans_a: Sequence[Span], spans_b: Sequence[Span]) -> list[Span]:
    """Intersect two lists of spans."""
    both = [(max(a, c), min(b, d)) for a, b in spans_a for c, d in spans_b]
    return [(start, end) for start, end in both if start < end]


def without(spans: Sequence[Span], holes: Sequence[Span]) -> list[Span]:
    """Subtract sorted, separate spans from others."""
    remaining = []
    for start, end in spans:
        begin = start
        for a, b in holes:
            if a < end and b > begin:
                if a > begin:
                    remaining.append((begin, a))
                begin = max(begin, b)
        if begin < end:
            remaining.append((begin, end))
    return remaining
