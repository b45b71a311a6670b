"""Check of buffers: a part for every pick, and room for every place."""

from __future__ import annotations

from dualarm_cli.model.job import Job
from dualarm_cli.model.schedule import Event, Schedule
from dualarm_cli.model.verification import Check
from dualarm_cli.records import dataclass
from dualarm_cli.verification.kind_checks import KindChecks
from dualarm_cli.verification.measuring.criteria import NO_TASKS, Criterion, judge, not_checked
from dualarm_cli.verification.measuring.tolerances import TOL


@dataclass(frozen=True)
class _Change:
    """Change of a buffer's parts or free places at an instant."""

    time: float
    """Time [s]."""
    parts: int
    """Change of the number of parts that can be taken."""
    taken: int
    """Change of the number of occupied places."""
    event: Event
    """Event that causes the change."""


def check_buffers(schedule: Schedule, job: Job | None) -> Check:
    """Check that picks find a part in their buffers, and places room.

    A place occupies its room from its event on, and its part can be taken after its dwell. A pick takes its part at its
    event, and its room is free after its dwell. At equal times, additions come first.

    Args:
        schedule: the schedule.
        job: its tasks and buffers; None without a task file.
    """
    if job is None:
        return not_checked("buffers", NO_TASKS)
    if not any(stop.buffer for task in job.tasks for stop in task.stops):
        return not_checked("buffers")
    rows = _changes(schedule, job)
    if not any(rows.values()):
        return not_checked("buffers", "none of the tasks concerned is done")
    faults = [fault for name, changes in rows.items() for fault in _faults(name, changes, job)]
    faults.sort()
    detail = faults[0][1] if faults else "a part for every pick, and room for every place"
    return judge("buffers", len(faults), 0, detail)


def _changes(schedule: Schedule, job: Job) -> dict[str, list[_Change]]:
    """List the changes of each buffer."""
    stops = job.stops_by_key()
    changes: dict[str, list[_Change]] = {name: [] for name in job.buffers}
    for event in schedule.events:
        # The check of the order judges which arm may do it: here any arm counts.
        stop = next(
            (s for (_, t, a), s in stops.items() if (t, a) == (event.task, event.action)), None
        )
        if stop is None or stop.buffer not in changes:
            continue
        end = event.time + event.dwell
        puts = event.action == "place"
        changes[stop.buffer] += (
            [_Change(event.time, 0, 1, event), _Change(end, 1, 0, event)]
            if puts
            else [_Change(event.time, -1, 0, event), _Change(end, 0, -1, event)]
        )
    return changes


def _faults(name: str, changes: list[_Change], job: Job) -> list[tuple[float, str]]:
    """List picks without a part and places without room, with their times [s]."""
    buffer = job.buffers[name]
    parts = taken = buffer.initial
    faults = []
    for change in _in_time(changes):
        parts, taken = parts + change.parts, taken + change.taken
        event = change.event
        who = f"at {event.time:.3f} s the {event.arm} arm's {event.task} {event.action}"
        if change.parts < 0 and parts < 0:
            what = f"takes a part from an empty buffer: {parts + 1} can be taken"
            faults.append((event.time, f"buffer {name}: {who} {what} (capacity {buffer.capacity})"))
        if change.taken > 0 and taken > buffer.capacity:
            what = f"has no room: {taken - 1} of {buffer.capacity} places are taken"
            faults.append((event.time, f"buffer {name}: {who} {what}"))
    return faults


def _in_time(changes: list[_Change]) -> list[_Change]:
    """Sort changes by time.

    Within the tolerance, those that add a part or room come first.
    """

    def due(change: _Change) -> float:
        gives = change.parts > 0 or change.taken < 0
        return change.time - (TOL.same_time if gives else 0.0)

    return sorted(changes, key=due)


CRITERIA = {
    "buffers": Criterion(
        "",
        "Picks from an empty buffer, and places into a full one.",
        "no task uses a buffer",
    )
}
CHECKS = KindChecks({"parts": lambda case: [check_buffers(case.schedule, case.job)]}, CRITERIA)
