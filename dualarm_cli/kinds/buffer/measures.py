"""Fill levels of buffers over a schedule."""

from __future__ import annotations

from typing import Any

from dualarm_cli.kinds.reporting import KindMeasures
from dualarm_cli.model.job import GIVES, Job
from dualarm_cli.model.schedule import Event, Schedule, Segment

SAME_INSTANT = 1e-6
"""Tolerance of equal instants [s]."""


def buffer_rows(schedule: Schedule, job: Job) -> dict[str, dict[str, Any]]:
    """Measure each buffer: occupied places, and times empty and full [s].

    A place is occupied from the event that puts a part there until the end of the dwell of its pick.

    Args:
        schedule: with events.
        job: its job.
    """
    rows = {}
    for name, buffer in job.buffers.items():
        changes = sorted(
            (event.time, 1) if event.action in GIVES else (event.time + event.dwell, -1)
            for event in _at(schedule, job, name)
        )
        level, clock = buffer.initial, 0.0
        most, empty, full = level, 0.0, 0.0
        for time, change in [*changes, (schedule.duration, 0)]:
            empty += (time - clock) * (level == 0)
            full += (time - clock) * (level == buffer.capacity)
            level, clock = level + change, time
            most = max(most, level)
        rows[name] = {
            "capacity": buffer.capacity,
            "initial": buffer.initial,
            "final": level,
            "most": most,
            "empty": empty,
            "full": full,
        }
    return rows


def buffer_lines(report: dict[str, Any]) -> list[str]:
    """Describe the fill level of each buffer."""
    return [
        f"buffer {name}: at most {use['most']} of {use['capacity']}, empty {use['empty']:.2f} s, "
        f"full {use['full']:.2f} s, {use['initial']} at the start, {use['final']} at the end"
        for name, use in report["buffers"].items()
    ]


def served_by(wait: Segment, schedule: Schedule, job: Job) -> Event | None:
    """Find the event that ended a wait for a part or room.

    None if unknown.

    It is the last event of the needed kind whose dwell was over by then.
    """
    stops = job.stops_by_key()
    events = [
        event
        for event in schedule.events
        if (event.arm, event.task, event.action) == (wait.arm, wait.task, wait.action)
    ]
    stop = stops.get((wait.arm, wait.task, wait.action))
    if not events or stop is None or not stop.buffer:
        return None
    due = events[0].time + SAME_INSTANT
    giving = [
        event
        for event in _at(schedule, job, stop.buffer)
        if event.action != wait.action and event.arm != wait.arm and event.time + event.dwell <= due
    ]
    return max(giving, key=lambda event: event.time + event.dwell, default=None)


def _at(schedule: Schedule, job: Job, name: str) -> list[Event]:
    """List the events at a buffer."""
    stops = job.stops_by_key()
    keys = {key for key, stop in stops.items() if stop.buffer == name}
    return [e for e in schedule.events if (e.arm, e.task, e.action) in keys]


MEASURES = KindMeasures(
    "waits", {"buffers": buffer_rows}, buffer_lines, waits={"buffer": served_by}
)
