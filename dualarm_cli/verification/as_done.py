"""Job as a schedule did it: arms, order and pairing read off the schedule."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dualarm_cli.kinds import of_kinds
from dualarm_cli.model.job import ANY, AT_STANDS, Job, StopKey, Task
from dualarm_cli.model.schedule import Event, Schedule, Stage
from dualarm_cli.verification.tolerances import TOL


def job_as_done(schedule: Schedule, job: Job) -> Job:
    """Returns the job with arms, order and pairing as a schedule has them; a job that says all itself as it is.

    What is done besides, such as tool changes, are tasks as well, each before the next one that its arm does.
    A task that any arm may do is its first event's arm's, and stays any arm's where nobody did it. Whether that was
    allowed, complete and one after the other is for the checks of order and pairing.

    Args:
        schedule: who does what when.
        job: as its file leaves it.
    """
    changes = [task for kind in of_kinds("checks") for task in kind.added(schedule, job)]
    if job.is_decided:
        return replace(job, tasks=_with_changes(schedule, job, changes)) if changes else job
    arms = {arm.name for arm in job.cell.robot.arms}
    done: dict[tuple[str, str], Event] = {}
    for event in in_time(schedule.events):
        if event.arm in arms:
            done.setdefault((event.task, event.action), event)

    def first(task: Task) -> Event | None:
        found = [done[task.id, s.action] for s in task.stops if (task.id, s.action) in done]
        return min(found, key=lambda event: event.time, default=None)

    begun = [(task, first(task)) for task in (*job.tasks, *(task for _, task in changes))]
    begun.sort(key=lambda one: np.inf if one[1] is None else one[1].time)
    tasks = [
        replace(task, arm=event.arm) if task.arm == ANY and event is not None else task
        for task, event in begun
    ]
    decided = replace(job, tasks=tuple(tasks), order="given")
    if job.mode == "free":
        return decided
    return replace(decided, pairing=_pairing(schedule, decided))


def _with_changes(
    schedule: Schedule, job: Job, changes: Sequence[tuple[float, Task]]
) -> tuple[Task, ...]:
    """Returns the tasks in the file's order, what is done besides before what its arm begins next."""
    begun: dict[str, float] = {}
    for event in schedule.events:
        begun[event.task] = min(event.time, begun.get(event.task, np.inf))
    left, found = list(changes), list[Task]()
    for task in job.tasks:
        due = [
            change
            for change in left
            if change[1].arm == task.arm and change[0] <= begun.get(task.id, np.inf)
        ]
        left = [change for change in left if change not in due]
        found += [*(change for _, change in due), task]
    return (*found, *(change for _, change in left))


def is_change(event: Event, job: Job) -> bool:
    """Returns whether an event takes a tool or leaves one, of an arm that may: no task of the file."""
    return event.action in AT_STANDS and event.arm in job.cell.tool_changes


def in_time(events: Sequence[Event]) -> list[Event]:
    """Returns events by their time; those of one instant as they are listed."""
    return sorted(events, key=lambda event: event.time)


def events_by_stage(schedule: Schedule) -> list[list[Event]]:
    """Returns the events that belong to each stage: at most one of each arm.

    An event may lie on the border of two stages: it belongs to the first one that contains it, is its arm's or both
    arms', and comes after the stage of that arm's event before.
    """
    stages = schedule.stages
    found: list[list[Event]] = [[] for _ in stages]
    for arm in dict.fromkeys(event.arm for event in schedule.events):
        left = stages_of_arm(schedule, arm)
        for event in in_time([e for e in schedule.events if e.arm == arm]):
            place = next((n for n, k in enumerate(left) if contains(stages[k], event)), None)
            if place is not None:
                found[left[place]].append(event)
                left = left[place + 1 :]
    return found


def stages_of_arm(schedule: Schedule, arm: str) -> list[int]:
    """Returns the numbers of the stages of one arm and of both, from 0, one after the other.

    By their middles: of stages that do not overlap but for rounding, one without length is not put on the wrong side.
    """
    stages = schedule.stages
    own = [k for k, stage in enumerate(stages) if stage.arm in ("", arm)]
    return sorted(own, key=lambda k: stages[k].start + stages[k].end)


def contains(stage: Stage, event: Event) -> bool:
    """Returns whether a stage names an event's task and lasts from before it to the end of its dwell."""
    return (
        event.task in stage.tasks
        and stage.start - TOL.same_time <= event.time
        and event.time + event.dwell <= stage.end + TOL.same_time
    )


def _pairing(schedule: Schedule, job: Job) -> tuple[tuple[StopKey, ...], ...]:
    """Returns the job's targets stage by stage; the return and what nobody asked for are left out."""
    asked = {(task.arm, task.id, stop.action) for task in job.tasks for stop in task.stops}
    order = [arm.name for arm in job.cell.robot.arms]
    found: list[tuple[StopKey, ...]] = []
    for events in events_by_stage(schedule):
        keys = [(e.arm, e.task, e.action) for e in events]
        found.append(
            tuple(sorted((k for k in keys if k in asked), key=lambda key: order.index(key[0])))
        )
        # What is done once more is the order's to find.
        asked -= set(keys)
    while found and not found[-1]:
        found.pop()
    return tuple(found)
