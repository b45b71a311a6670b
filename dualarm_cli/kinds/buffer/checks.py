"""Check of buffers: at every instant a part for every pick, and room for every place."""

from __future__ import annotations

from dualarm_cli.model.job import Job
from dualarm_cli.model.schedule import Event, Schedule
from dualarm_cli.model.verification import Check
from dualarm_cli.records import dataclass
from dualarm_cli.verification.criteria import NO_TASKS, Criterion, judge, not_checked
from dualarm_cli.verification.kind_checks import KindChecks
from dualarm_cli.verification.tolerances import TOL


@dataclass(frozen=True)
class _Change:
    """An instant at which parts or room of a buffer change."""

    time: float
    """When [s]."""
    parts: int
    """By how many the parts change that can be taken."""
    taken: int
    """By how many the places change that are not free."""
    event: Event
    """What does it."""


def check_buffers(schedule: Schedule, job: Job | None) -> Check:
    """Checks that every pick finds a part in its buffer, and every place room.

    A place has its room from its event on, and its part can be taken when its dwell is over; a pick takes its part at
    its event, and its room is free when its dwell is over. Of what is at one instant what gives comes first.

    Args:
        schedule: what is judged: its events.
        job: its tasks and buffers; None where there is no task file.
    """
    if job is None:
        return not_checked("buffers", NO_TASKS)
    if not any(stop.buffer for task in job.tasks for stop in task.stops):
        return not_checked("buffers")
    rows = _changes(schedule, job)
    if not any(rows.values()):
        return not_checked("buffers", "none of the tasks concerned is done")
    faults = [fault for name, own in rows.items() for fault in _faults(name, own, job)]
    faults.sort()
    where = faults[0][1] if faults else "a part for every pick, and room for every place"
    return judge("buffers", len(faults), 0, where)


def _changes(schedule: Schedule, job: Job) -> dict[str, list[_Change]]:
    """Returns what changes each buffer."""
    stops = job.stops_by_key()
    found: dict[str, list[_Change]] = {name: [] for name in job.buffers}
    for event in schedule.events:
        # Who may do what is for the check of the order: here it counts whichever arm does it.
        stop = next(
            (s for (_, t, a), s in stops.items() if (t, a) == (event.task, event.action)), None
        )
        if stop is None or stop.buffer not in found:
            continue
        over = event.time + event.dwell
        puts = event.action == "place"
        found[stop.buffer] += (
            [_Change(event.time, 0, 1, event), _Change(over, 1, 0, event)]
            if puts
            else [_Change(event.time, -1, 0, event), _Change(over, 0, -1, event)]
        )
    return found


def _faults(name: str, changes: list[_Change], job: Job) -> list[tuple[float, str]]:
    """Returns when a part is taken that is not there, or put where there is no room, and in words."""
    buffer = job.buffers[name]
    parts = taken = buffer.initial
    found = []
    for change in _in_time(changes):
        parts, taken = parts + change.parts, taken + change.taken
        event = change.event
        who = f"at {event.time:.3f} s the {event.arm} arm's {event.task} {event.action}"
        if change.parts < 0 and parts < 0:
            what = f"takes a part from an empty buffer: {parts + 1} can be taken"
            found.append((event.time, f"buffer {name}: {who} {what} (capacity {buffer.capacity})"))
        if change.taken > 0 and taken > buffer.capacity:
            what = f"has no room: {taken - 1} of {buffer.capacity} places are taken"
            found.append((event.time, f"buffer {name}: {who} {what}"))
    return found


def _in_time(changes: list[_Change]) -> list[_Change]:
    """Returns changes by their time; of those that differ by rounding first what gives a part or room."""

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
