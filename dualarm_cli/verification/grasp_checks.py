"""Grasps of parts, measured from the tool's poses at the stops of their tasks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from dualarm_cli.model.job import Job, PoseTarget, Task
from dualarm_cli.model.schedule import Event, Schedule
from dualarm_cli.model.verification import Check
from dualarm_cli.verification.measuring.criteria import judge
from dualarm_cli.verification.measuring.tolerances import TOL
from dualarm_cli.verification.tool_checks import pose_error


def with_measured_grasps(schedule: Schedule, job: Job) -> Job:
    """Decide open grasps of a job by the tool's poses in a schedule.

    A task gets the grasp whose targets its events miss least; of equal ones the stated one. Both shares of a hand-over
    get the same pair of grasps.

    Args:
        schedule: with the events of all arms.
        job: as in its file.
    """
    if not any(task.grasps for task in job.tasks):
        return job
    shares: dict[str, list[Task]] = {}
    for task in job.tasks:
        if task.grasps:
            shares.setdefault(task.id, []).append(task)
    chosen: dict[tuple[str, str], Task] = {}
    for name, tasks in shares.items():
        events = [_events_of(schedule, task) for task in tasks]
        choices = zip(*(task.grasps for task in tasks), strict=True)
        for choice in min(choices, key=partial(_miss, events)):
            chosen[name, choice.stops[0].action] = choice
    decided = (t.by_grasp(chosen[t.id, t.stops[0].action]) if t.grasps else t for t in job.tasks)
    return replace(job, tasks=tuple(decided))


def check_grasps(schedule: Schedule, job: Job) -> list[Check]:
    """Check that tasks pick and place, or give, by one allowed grasp, the stated one.

    Args:
        schedule: the schedule to check.
        job: as in its file.
    """
    grasped = [task for task in job.tasks if task.grasp is not None or task.grasps]
    wide = [task for task in job.tasks if task not in grasped and job.cell.width(task.part)]
    ids = {task.id for task in grasped}
    wrong = [
        f"{event.task} ({event.action}): grasp {event.grasp} of a part without grasps"
        for event in schedule.events
        if event.grasp and event.task not in ids
    ]
    if not grasped and not wide and not wrong:
        return []
    for task in grasped:
        by_grasp = {_name(choice): choice for choice in task.grasps or (task,)}
        used: list[set[str]] = []
        for event in _events_of(schedule, task):
            used.append({n for n, t in by_grasp.items() if _error(t, [event]) <= TOL.pose_distance})
            if event.grasp not in used[-1]:
                measured = " or ".join(sorted(used[-1])) or "no allowed grasp"
                stated = event.grasp or "none"
                wrong.append(f"{event.task} ({event.action}): {stated} stated, {measured} measured")
            else:
                wrong += _wrong_width(job, by_grasp[event.grasp], event)
        if used and all(used) and not set.intersection(*used):
            first, last = task.stops[0].action, task.stops[-1].action
            done = "given" if last == "give" else "placed"
            wrong.append(f"{task.id} is not {done} by the grasp of its {first}")
    for task in wide:
        for event in _events_of(schedule, task):
            wrong += _wrong_width(job, task, event)
    where = "; ".join(wrong[:3]) or "at every pick and place"
    return [judge("grasps", float(len(wrong)), 0.0, where)]


def _wrong_width(job: Job, task: Task, event: Event) -> list[str]:
    """Say that jaws close to another width than the part's, or do not open to it."""
    width, where = job.cell.width(task.part), f"{event.task} ({event.action})"
    if abs(event.width - width) > TOL.pose_distance:
        return [f"{where}: {1e3 * event.width:g} mm wide instead of {1e3 * width:g} mm"]
    is_arm = event.arm in job.cell.tools
    if is_arm and not job.cell.opens_to(event.arm, task.tool, width):
        return [f"{where}: the {event.arm} tool does not open to {1e3 * width:g} mm"]
    return []


def _miss(events: Sequence[Sequence[Event]], choice: Sequence[Task]) -> tuple[float, bool]:
    """Measure the largest error of events from a choice, and whether it is not stated.

    Args:
        events: of each share, one for a task without a hand-over.
        choice: the shares with one grasp, or one pair.
    """
    shares = list(zip(choice, events, strict=True))
    stated = all(event.grasp == _name(task) for task, of_share in shares for event in of_share[:1])
    return max(_error(task, of_share) for task, of_share in shares), not stated


def _name(task: Task) -> str:
    return "" if task.grasp is None else task.grasp.name


def _events_of(schedule: Schedule, task: Task) -> Sequence[Event]:
    """List the events at the stops of a task; in a hand-over those of one share."""
    actions = [stop.action for stop in task.stops]
    return [e for e in schedule.events if e.task == task.id and e.action in actions]


def _error(task: Task, events: Sequence[Event]) -> float:
    """Measure the largest error of events from a task's targets [m, rad], beyond their freedoms."""
    worst = 0.0
    stops = {stop.action: stop for stop in task.stops}
    for event in events:
        target = stops[event.action].met(event.time).target if event.action in stops else None
        if isinstance(target, PoseTarget):
            worst = max(worst, pose_error(target.pose, target, event.pose))
    return worst if np.isfinite(worst) else np.inf
