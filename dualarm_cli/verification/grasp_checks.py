"""Grasps of parts, measured from the tool's poses at picks and places."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from dualarm_cli.model.job import Job, PoseTarget, Task
from dualarm_cli.model.schedule import Event, Schedule
from dualarm_cli.model.verification import Check
from dualarm_cli.verification.measuring.criteria import judge
from dualarm_cli.verification.measuring.tolerances import TOL
from dualarm_cli.verification.tool_checks import pose_error


def with_measured_grasps(schedule: Schedule, job: Job) -> Job:
    """Decide open grasps of a job by the tool's poses in a schedule.

    A task gets the grasp whose targets its events miss least; of equal ones the stated one.

    Args:
        schedule: with the events of all arms.
        job: as in its file.
    """
    if not any(task.grasps for task in job.tasks):
        return job
    events = _events_by_task(schedule)

    def measured(task: Task) -> Task:
        if not task.grasps:
            return task
        task_events = events.get(task.id, ())
        stated = task_events[0].grasp if task_events else ""
        best = min(task.grasps, key=lambda t: (_error(t, task_events), _name(t) != stated))
        return task.by_grasp(best)

    return replace(job, tasks=tuple(map(measured, job.tasks)))


def check_grasps(schedule: Schedule, job: Job) -> list[Check]:
    """Check that tasks pick and place by one allowed grasp, the stated one.

    Args:
        schedule: the schedule to check.
        job: as in its file.
    """
    grasped = [task for task in job.tasks if task.grasp is not None or task.grasps]
    ids = {task.id for task in grasped}
    wrong = [
        f"{event.task} ({event.action}): grasp {event.grasp} of a part without grasps"
        for event in schedule.events
        if event.grasp and event.task not in ids
    ]
    if not grasped and not wrong:
        return []
    events = _events_by_task(schedule)
    for task in grasped:
        by_grasp = {_name(choice): choice for choice in task.grasps or (task,)}
        used: list[set[str]] = []
        for event in events.get(task.id, ()):
            used.append({n for n, t in by_grasp.items() if _error(t, [event]) <= TOL.pose_distance})
            if event.grasp not in used[-1]:
                measured = " or ".join(sorted(used[-1])) or "no allowed grasp"
                stated = event.grasp or "none"
                wrong.append(f"{event.task} ({event.action}): {stated} stated, {measured} measured")
        if used and all(used) and not set.intersection(*used):
            wrong.append(f"{task.id} is not placed by the grasp of its pick")
    where = "; ".join(wrong[:3]) or "at every pick and place"
    return [judge("grasps", float(len(wrong)), 0.0, where)]


def _name(task: Task) -> str:
    return "" if task.grasp is None else task.grasp.name


def _events_by_task(schedule: Schedule) -> Mapping[str, Sequence[Event]]:
    """Collect the events of each task at targets of grasps."""
    events: dict[str, list[Event]] = {}
    for event in schedule.events:
        if event.action in ("pick", "place", "move"):
            events.setdefault(event.task, []).append(event)
    return events


def _error(task: Task, events: Sequence[Event]) -> float:
    """Measure the largest error of events from a task's targets [m, rad], beyond their freedoms."""
    worst = 0.0
    stops = {stop.action: stop for stop in task.stops}
    for event in events:
        target = stops[event.action].met(event.time).target if event.action in stops else None
        if isinstance(target, PoseTarget):
            worst = max(worst, pose_error(target.pose, target, event.pose))
    return worst if np.isfinite(worst) else np.inf
