"""Checks of who does what in which order: targets, arms, sequences, precedence, windows."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

from dualarm_cli.model.job import Job, Task
from dualarm_cli.model.schedule import Event, Schedule
from dualarm_cli.model.verification import Check
from dualarm_cli.verification import tolerances as tol
from dualarm_cli.verification.as_done import in_time
from dualarm_cli.verification.line_spans import LineSpan
from dualarm_cli.verification.motion_checks import judge, not_checked
from dualarm_cli.verification.tool_change_checks import is_change
from dualarm_cli.verification.tool_checks import Worst


def check_order(schedule: Schedule, job: Job) -> Check:
    """Checks that all of the job's targets are done, by whom and in which order the file allows.

    Where the file says all, each arm's events are its targets in the file's order. Where it leaves arms or order open,
    every target is done once, those of a task by one arm that may, one right after the other; the tasks of a sequence
    by one arm right after one another; with order: given each arm's tasks in the file's order.

    Args:
        schedule: what is judged.
        job: as its file leaves it.
    """
    # Tool changes are no tasks of the file: they have a check of their own.
    events = tuple(event for event in schedule.events if not is_change(event, job))
    schedule = replace(schedule, events=events)
    if job.is_decided:
        return _check_given(schedule, job)
    rows = {
        arm.name: in_time([e for e in schedule.events if e.arm == arm.name])
        for arm in job.cell.robot.arms
    }
    faults = [
        *_wrong_counts(rows, job),
        *_wrong_arms(rows, job),
        *(fault for arm, events in rows.items() for fault in _torn(arm, events, job)),
        *(_against_the_file(rows, job) if job.order == "given" else ()),
        *_broken_sequences(rows, job),
    ]
    where = faults[0] if faults else "every target once, by an arm and in an order that may be"
    return judge("order", len(faults), 0, "", where)


def _check_given(schedule: Schedule, job: Job) -> Check:
    wrong = 0
    where = "every target, in the order of the file"
    for arm in job.cell.robot.arms:
        asked = [(task.id, stop.action) for task, stop in job.stops_of(arm.name)]
        events = in_time([e for e in schedule.events if e.arm == arm.name])
        done = [(event.task, event.action) for event in events]
        if done != asked:
            pairs = zip(
                asked + [("nothing", "")] * len(done), [*done, ("nothing", "")], strict=False
            )
            first = next(((a, d) for a, d in pairs if a != d), (("nothing", ""), ("nothing", "")))
            wrong += 1
            due, did = (" ".join(entry).strip() for entry in first)
            where = f"{arm.name} arm: {due} is due, {did} is done"
    return judge("order", wrong, 0, "", where)


def _wrong_counts(rows: dict[str, list[Event]], job: Job) -> list[str]:
    """Returns what is not done exactly once, by both arms where both follow, and what nobody asked for."""
    asked = Counter((task.id, stop.action) for task in job.tasks for stop in task.stops)
    done = Counter((event.task, event.action) for events in rows.values() for event in events)
    faults = [
        f"{task} {action} is not done"
        if not done[task, action]
        else f"{task} {action} is done {done[task, action]} times"
        for (task, action), times in asked.items()
        if done[task, action] != times
    ]
    return faults + [
        f"{task} {action} is done, which no task asks for"
        for task, action in done
        if (task, action) not in asked
    ]


def _wrong_arms(rows: dict[str, list[Event]], job: Job) -> list[str]:
    """Returns which tasks are done by several arms, or by one that may not."""
    faults = []
    for task in job.tasks:
        arms = [arm for arm, events in rows.items() if any(e.task == task.id for e in events)]
        if task.handover is not None:
            faults += _wrong_share(rows, task)
        elif task.alone:
            if arms and task.arm not in arms:
                faults.append(f"{task.id} is the {task.arm} arm's too, which does not do it")
        elif len(arms) > 1:
            faults.append(f"{task.id} is done by {' and '.join(arms)}; one arm does all of a task")
        elif arms and not task.allows(arms[0]):
            faults.append(f"{task.id} is the {task.arm} arm's, the {arms[0]} arm does it")
    return faults


def _wrong_share(rows: dict[str, list[Event]], task: Task) -> list[str]:
    """Returns that an arm's share of a hand-over is done by several arms, or by one that may not."""
    actions = {stop.action for stop in task.stops}
    arms = [
        arm
        for arm, events in rows.items()
        if any(e.task == task.id and e.action in actions for e in events)
    ]
    share = " and ".join(stop.action for stop in task.stops)
    if len(arms) > 1:
        return [f"{task.id}: {share} are done by {' and '.join(arms)}; one arm does both"]
    if arms and not task.allows(arms[0]):
        return [f"{task.id}: {share} are the {task.arm} arm's, the {arms[0]} arm does them"]
    return []


def _torn(arm: str, events: list[Event], job: Job) -> list[str]:
    """Returns which of an arm's tasks are not done from their first target to their last, one right after the other."""
    numbers: dict[str, list[int]] = {}
    for number, event in enumerate(events):
        numbers.setdefault(event.task, []).append(number)
    faults = []
    for task in job.tasks:
        own = numbers.get(task.id, [])
        actions = [stop.action for stop in task.stops]
        ranks = [actions.index(a) for k in own if (a := events[k].action) in actions]
        if ranks != sorted(ranks):
            late, early = (actions[rank] for rank in next(_descents(ranks)))
            faults.append(f"{arm} arm: {task.id} {late} is done before {task.id} {early}")
        between = [k for k in range(own[0], own[-1]) if k not in own] if own else []
        if between:
            other = events[between[0]]
            faults.append(f"{arm} arm: {other.task} {other.action} is done within {task.id}")
    return faults


def _against_the_file(rows: dict[str, list[Event]], job: Job) -> list[str]:
    """Returns which arms do tasks in another order than the file's."""
    place = {task.id: number for number, task in enumerate(job.tasks)}
    names = list(place)
    faults = []
    for arm, events in rows.items():
        places = [place[name] for name in _task_order(events) if name in place]
        for late, early in list(_descents(places))[:1]:
            faults.append(
                f"{arm} arm: {names[late]} is done before {names[early]}, not as order: given has it"
            )
    return faults


def _broken_sequences(rows: dict[str, list[Event]], job: Job) -> list[str]:
    """Returns which sequences several arms do, or one arm not one right after the other."""
    orders = {arm: _task_order(events) for arm, events in rows.items()}
    faults = []
    for names in job.sequences:
        doers = [next((arm for arm in orders if name in orders[arm]), "") for name in names]
        if "" in doers:
            continue  # a task that nobody does is named as such
        for one, other, by, then in zip(names, names[1:], doers, doers[1:], strict=False):
            if by != then:
                faults.append(
                    f"{one} and {other} are of one sequence; {by} does the one, {then} the other"
                )
                break
            following = orders[by][orders[by].index(one) + 1 :][:1]
            if following != [other]:
                did = following[0] if following else "nothing"
                faults.append(f"{by} arm: {other} is due right after {one}, {did} is done")
                break
    return faults


def _task_order(events: list[Event]) -> list[str]:
    """Returns the tasks of events in the order in which they are begun."""
    return list(dict.fromkeys(event.task for event in events))


def _descents(numbers: list[int]) -> Iterator[tuple[int, int]]:
    """Returns the neighbours of which the later one is smaller."""
    return ((a, b) for a, b in pairwise(numbers) if b < a)


def check_precedence(schedule: Schedule, job: Job, spans: Sequence[LineSpan]) -> Check:
    """Checks that no task begins before those are over that are to be done before.

    A task begins with its first approach, where it has one, and is over once its last tool has dwelt and retracted.

    Args:
        schedule: what is judged.
        job: as its file leaves it.
        spans: of the job's stops.
    """
    if not any(task.after for task in job.tasks):
        return not_checked("precedence", "no task is to come after another")
    begin: dict[str, float] = {}
    over: dict[str, float] = {}
    for span in spans:
        name = span.event.task
        begin[name] = min(span.start, begin.get(name, span.start))
        over[name] = max(span.end, over.get(name, span.end))
    # A path is on its way before its event, which is its end; that it is the path is for the check of paths.
    for s in schedule.segments:
        if s.kind == "path":
            begin[s.task] = min(s.start, begin.get(s.task, s.start))
    worst = Worst(where="every task after those that are to be done before")
    for task, name in ((one.id, name) for one in job.tasks for name in one.after):
        # What nobody does is the order's to find.
        if task in begin and name in over:
            where = f"{task} begins at {begin[task]:.3f} s, {name} is over at {over[name]:.3f} s"
            worst.add(over[name] - begin[task], where)
    return worst.judge("precedence", tol.SAME_TIME, "s", "none of the tasks concerned is done")


def check_windows(schedule: Schedule, job: Job) -> Check:
    """Checks that tools are at first targets no earlier, and at last ones no later, than tasks allow.

    Args:
        schedule: what is judged.
        job: its tasks.
    """
    tasks = [task for task in job.tasks if _has_window(task)]
    if not tasks:
        return not_checked("windows", "no task has not_before or not_after")
    times: dict[str, list[float]] = {}
    for event in schedule.events:
        times.setdefault(event.task, []).append(event.time)
    worst = Worst(where="every task in its time")
    for task in tasks:
        if task.id not in times:
            continue  # what nobody does is the order's to find
        first, last = min(times[task.id]), max(times[task.id])
        early = f"{task.id} is begun at {first:.3f} s, not_before is {task.not_before:g} s"
        late = f"{task.id} ends at {last:.3f} s, not_after is {task.not_after:g} s"
        worst.add(task.not_before - first, early)
        worst.add(last - task.not_after, late)
    return worst.judge("windows", tol.SAME_TIME, "s", "no task with a window is done")


def _has_window(task: Task) -> bool:
    return task.not_before > 0.0 or math.isfinite(task.not_after)
