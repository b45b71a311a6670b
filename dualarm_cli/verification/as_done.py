"""Job as a schedule did it: arms, order and pairing read off the schedule."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dualarm_cli.kinds import of_kinds
from dualarm_cli.model.job import ANY, AT_STANDS, Job, StopKey, Task
from dualarm_cli.model.schedule import Event, Schedule, Stage
from dualarm_cli.verification.grasp_checks import with_measured_grasps
from dualarm_cli.verification.measuring.tolerances import TOL


def job_as_done(schedule: Schedule, job: Job) -> Job:
    """Decide the grasps, arms, order and pairing of a job as in a schedule.

    Added work, such as tool changes, becomes tasks too, each before the next task of its arm. A task that any arm may
    do gets the arm of its first event, and stays open if it has none. Whether this is allowed and complete is for the
    checks of order and pairing. A job that is decided keeps its order.

    Args:
        schedule: with the events of all arms.
        job: as in its file.
    """
    job = with_measured_grasps(schedule, job)
    changes = [task for kind in of_kinds("checks") for task in kind.added(schedule, job)]
    if job.is_decided:
        return replace(job, tasks=_with_changes(schedule, job, changes)) if changes else job
    arms = {arm.name for arm in job.cell.robot.arms}
    first_events: dict[tuple[str, str], Event] = {}
    for event in in_time(schedule.events):
        if event.arm in arms:
            first_events.setdefault((event.task, event.action), event)

    def first_event(task: Task) -> Event | None:
        events = [
            first_events[task.id, s.action]
            for s in task.stops
            if (task.id, s.action) in first_events
        ]
        return min(events, key=lambda event: event.time, default=None)

    started = [(task, first_event(task)) for task in (*job.tasks, *(task for _, task in changes))]
    started.sort(key=lambda item: np.inf if item[1] is None else item[1].time)
    tasks = [
        replace(task, arm=event.arm) if task.arm == ANY and event is not None else task
        for task, event in started
    ]
    decided = replace(job, tasks=tuple(tasks), order="given")
    if job.mode == "free":
        return decided
    return replace(decided, pairing=_pairing(schedule, decided))


def _with_changes(
    schedule: Schedule, job: Job, changes: Sequence[tuple[float, Task]]
) -> tuple[Task, ...]:
    """Insert added tasks before the next task that their arm begins."""
    start_times: dict[str, float] = {}
    for event in schedule.events:
        start_times[event.task] = min(event.time, start_times.get(event.task, np.inf))
    remaining, ordered = list(changes), list[Task]()
    for task in job.tasks:
        due = [
            change
            for change in remaining
            if change[1].arm == task.arm and change[0] <= start_times.get(task.id, np.inf)
        ]
        remaining = [change for change in remaining if change not in due]
        ordered += [*(change for _, change in due), task]
    return (*ordered, *(change for _, change in remaining))


def is_change(event: Event, job: Job) -> bool:
    """Return whether an event is a tool change, which is no task of the file."""
    return event.action in AT_STANDS and event.arm in job.cell.tool_changes


def in_time(events: Sequence[Event]) -> list[Event]:
    """Sort events by time, stably."""
    return sorted(events, key=lambda event: event.time)


def events_by_stage(schedule: Schedule) -> list[list[Event]]:
    """Assign events to stages, at most one of each arm.

    An event may lie on the border of two stages: it belongs to the first one that contains it, is its arm's or both
    arms', and comes after the stage of that arm's event before.
    """
    stages = schedule.stages
    events_of_stage: list[list[Event]] = [[] for _ in stages]
    for arm in dict.fromkeys(event.arm for event in schedule.events):
        remaining = stages_of_arm(schedule, arm)
        for event in in_time([e for e in schedule.events if e.arm == arm]):
            place = next((n for n, k in enumerate(remaining) if contains(stages[k], event)), None)
            if place is not None:
                events_of_stage[remaining[place]].append(event)
                remaining = remaining[place + 1 :]
    return events_of_stage


def stages_of_arm(schedule: Schedule, arm: str) -> list[int]:
    """List the numbers of an arm's stages and of common ones, from 0, in time order.

    Sorted by their middles, so that rounding does not misplace a stage without length.
    """
    stages = schedule.stages
    numbers = [k for k, stage in enumerate(stages) if stage.arm in ("", arm)]
    return sorted(numbers, key=lambda k: stages[k].start + stages[k].end)


def contains(stage: Stage, event: Event) -> bool:
    """Return whether a stage names an event's task and contains its dwell."""
    return (
        event.task in stage.tasks
        and stage.start - TOL.same_time <= event.time
        and event.time + event.dwell <= stage.end + TOL.same_time
    )


def _pairing(schedule: Schedule, job: Job) -> tuple[tuple[StopKey, ...], ...]:
    """List the job's targets stage by stage, without the return and surplus work."""
    required = {(task.arm, task.id, stop.action) for task in job.tasks for stop in task.stops}
    order = [arm.name for arm in job.cell.robot.arms]
    pairing: list[tuple[StopKey, ...]] = []
    for events in events_by_stage(schedule):
        keys = [(e.arm, e.task, e.action) for e in events]
        pairing.append(
            tuple(sorted((k for k in keys if k in required), key=lambda key: order.index(key[0])))
        )
        # Repeated targets are for the check of the order.
        required -= set(keys)
    while pairing and not pairing[-1]:
        pairing.pop()
    return tuple(pairing)
