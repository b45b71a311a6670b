"""Checks of assignment, order and times: arms, sequences, precedence, windows, dwells."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from dualarm_cli.model.dwell import Dwell
from dualarm_cli.model.job import Job, Task
from dualarm_cli.model.schedule import WORK_ENDS, Event, Schedule, Segment
from dualarm_cli.model.verification import Check
from dualarm_cli.verification.as_done import in_time, is_change
from dualarm_cli.verification.measuring.criteria import judge, not_checked
from dualarm_cli.verification.measuring.line_spans import LineSpan
from dualarm_cli.verification.measuring.tolerances import TOL
from dualarm_cli.verification.tool_checks import Worst


def check_arms(schedule: Schedule) -> Check:
    """Check that all work belongs to arms of the robot, and events to the arm's tool."""
    arms = schedule.robot.arms
    works = [("event", e) for e in schedule.events] + [("segment", s) for s in schedule.segments]
    unknown = [(f"{kind} of {item.task}", item.arm) for kind, item in works if item.arm not in arms]
    unknown += [
        (f"stage {number}", stage.arm)
        for number, stage in enumerate(schedule.stages, start=1)
        if stage.arm and stage.arm not in arms
    ]
    wrong_frames = [e for e in schedule.events if e.arm in arms and e.frame != f"{e.arm}_tcp"]
    where = f"all of {', '.join(arms)}"
    if unknown:
        work, arm = unknown[0]
        where = f"{work} names arm '{arm}'; the robot has {', '.join(arms)}"
    elif wrong_frames:
        event = wrong_frames[0]
        where = f"event of {event.task} names frame '{event.frame}'; it is {event.arm}_tcp"
    return judge("arms", len(unknown) + len(wrong_frames), 0, where)


def check_segments(schedule: Schedule) -> Check:
    """Check that each arm's segments follow without gap or overlap from start to end."""
    if not schedule.segments and not schedule.events:
        return not_checked("segments")
    worst = Worst(where="one after the other")
    for arm in schedule.robot.arms:
        clock = 0.0
        segments = sorted((s for s in schedule.segments if s.arm == arm), key=lambda s: s.start)
        for segment in segments:
            off = max(abs(clock - segment.start), segment.start - segment.end)
            worst.add(off, f"{arm} {segment.kind} of {segment.task} at {segment.start:.3f} s")
            clock = max(clock, segment.end)
        worst.add(clock - schedule.duration, f"{arm} arm works beyond the end")
        if segments:
            where = f"the {arm} arm has no segment from {clock:.3f} s to the end"
            worst.add(schedule.duration - clock, where)
    for event in schedule.events:
        beyond = event.time + event.dwell - schedule.duration
        worst.add(beyond, f"dwell of {event.task} ({event.action}) goes beyond the end")
    return worst.judge("segments", TOL.same_time)


def check_dwells(schedule: Schedule, job: Job) -> Check:
    """Check that every dwell is as long as the job requires, in each share."""
    worst = Worst()
    required = {key: stop.dwell for key, stop in job.stops_by_key().items()}
    events = {(e.arm, e.task, e.action): e for e in schedule.events}
    for key, event in events.items():
        short = required.get(key, Dwell()).total - event.dwell
        worst.add(short, f"{event.task} ({event.action}) dwells {event.dwell:g} s")
    stands = [s for s in schedule.segments if s.kind == "dwell"]
    for segment in stands:
        key = (segment.arm, segment.task, segment.action)
        off, what = _dwell_error(segment, events.get(key), required.get(key, Dwell()))
        worst.add(off, f"{segment.task} ({segment.action}) {what}")
    if schedule.segments:
        listed = {(s.arm, s.task, s.action) for s in stands}
        for key, event in events.items():
            if key not in listed:
                worst.add(event.dwell, f"{event.task} ({event.action}) has no dwell listed")
    # Rounding errors have a largest value too, which is no fault.
    fault = worst.where if worst.value > TOL.same_time else "as long as the job requires"
    return judge("dwells", worst.value, TOL.same_time, fault)


def _dwell_error(segment: Segment, event: Event | None, required: Dwell) -> tuple[float, str]:
    """Compare a listed dwell with its event, its shares and the job [s]."""
    if event is None:
        return np.inf, "stands still without an event"
    length = segment.end - segment.start
    errors = [
        (abs(segment.start - event.time), "does not stand still from its event on"),
        (
            abs(length - event.dwell),
            f"lasts {length:g} s, its event states {event.dwell:g} s",
        ),
    ]
    if segment.dwell is not None:
        errors.append(
            (abs(segment.dwell.total - length), "has shares that do not add up to its length")
        )
        errors += [
            (
                getattr(required, name) - getattr(segment.dwell, name),
                f"has too short a share: {name}",
            )
            for name in ("gripper", "settle", "handshake")
        ]
    return max(errors, key=lambda error: error[0])


def check_bound(schedule: Schedule) -> Check:
    """Check that the stated lower bound does not exceed the duration."""
    bound = schedule.lower_bound
    if bound is None:
        return not_checked("lower_bound")
    where = f"stated {bound:g} s, the schedule takes {schedule.duration:g} s"
    return judge("lower_bound", bound - schedule.duration, TOL.same_time, where)


def check_ends(schedule: Schedule, job: Job) -> list[Check]:
    """Check the start posture and, for a closed cycle, the return to it."""
    trajectory, sliding = schedule.trajectory, job.cell.robot.sliding
    checks = []
    if job.start == "free":
        checks.append(not_checked("start_posture"))
    else:
        posture = job.cell.robot.postures[job.start]
        order = [job.cell.robot.joints.index(name) for name in trajectory.joints]
        off = np.abs(trajectory.position[0] - posture[order])
        joint = trajectory.joints[int(np.argmax(off))]
        where, slides = f"{joint} from posture '{job.start}'", joint in sliding
        checks.append(
            judge("start_posture", float(off.max()), TOL.same_joints, where, slides=slides)
        )
    if not job.returns:
        return [*checks, not_checked("return")]
    off = np.abs(trajectory.position[-1] - trajectory.position[0])
    joint = trajectory.joints[int(np.argmax(off))]
    check = judge("return", float(off.max()), TOL.same_joints, joint, slides=joint in sliding)
    return [*checks, check]


def check_order(schedule: Schedule, job: Job) -> Check:
    """Check that all targets are done, by arms and in an order that the file allows.

    If the file decides arms and order, each arm's events are its targets in the file's order. If it leaves them open,
    every target is done once, and a task's targets are done by one allowed arm in direct succession. The tasks of a
    sequence are done by one arm in direct succession; with order: given each arm keeps the file's order.

    Args:
        schedule: the schedule to check.
        job: as in its file.
    """
    # Tool changes are no tasks of the file, and have their own checks.
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
        *(fault for arm, events in rows.items() for fault in _interrupted_tasks(arm, events, job)),
        *(_wrong_task_order(rows, job) if job.order == "given" else ()),
        *_broken_sequences(rows, job),
    ]
    where = faults[0] if faults else "every target once, by an allowed arm and in an allowed order"
    return judge("order", len(faults), 0, where)


def _check_given(schedule: Schedule, job: Job) -> Check:
    wrong = 0
    where = "every target, in the order of the file"
    for arm in job.cell.robot.arms:
        required = [(task.id, stop.action) for task, stop in job.stops_of(arm.name)]
        events = in_time([e for e in schedule.events if e.arm == arm.name])
        done = [(event.task, event.action) for event in events]
        if done != required:
            pairs = zip(
                required + [("nothing", "")] * len(done), [*done, ("nothing", "")], strict=False
            )
            first = next(((a, d) for a, d in pairs if a != d), (("nothing", ""), ("nothing", "")))
            wrong += 1
            due, did = (" ".join(entry).strip() for entry in first)
            where = f"{arm.name} arm: expected {due}, found {did}"
    return judge("order", wrong, 0, where)


def _wrong_counts(rows: dict[str, list[Event]], job: Job) -> list[str]:
    """List targets that are missing, repeated or in no task.

    A target that both arms follow is to be done by each.
    """
    required = Counter((task.id, stop.action) for task in job.tasks for stop in task.stops)
    done = Counter((event.task, event.action) for events in rows.values() for event in events)
    faults = [
        f"{task} {action} is not done"
        if not done[task, action]
        else f"{task} {action} is done {done[task, action]} times"
        for (task, action), times in required.items()
        if done[task, action] != times
    ]
    return faults + [
        f"{task} {action} is done, which no task requires"
        for task, action in done
        if (task, action) not in required
    ]


def _wrong_arms(rows: dict[str, list[Event]], job: Job) -> list[str]:
    """List tasks that several arms do, or an arm that is not allowed."""
    faults = []
    for task in job.tasks:
        arms = [arm for arm, events in rows.items() if any(e.task == task.id for e in events)]
        if task.alone:
            if arms and task.arm not in arms:
                faults.append(f"{task.id} is the {task.arm} arm's too, which does not do it")
        elif task.shared:
            faults += _wrong_share(rows, task)
        elif len(arms) > 1:
            faults.append(f"{task.id} is done by {' and '.join(arms)}; one arm does all of a task")
        elif arms and not task.allows(arms[0]):
            faults.append(f"{task.id} is the {task.arm} arm's, the {arms[0]} arm does it")
    return faults


def _wrong_share(rows: dict[str, list[Event]], task: Task) -> list[str]:
    """List the fault of a share of a task with several arms or a wrong one."""
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


def _interrupted_tasks(arm: str, events: list[Event], job: Job) -> list[str]:
    """List an arm's tasks whose targets are out of order or interrupted."""
    numbers: dict[str, list[int]] = {}
    for number, event in enumerate(events):
        numbers.setdefault(event.task, []).append(number)
    faults = []
    for task in job.tasks:
        places = numbers.get(task.id, [])
        actions = [stop.action for stop in task.stops]
        ranks = [actions.index(a) for k in places if (a := events[k].action) in actions]
        if ranks != sorted(ranks):
            late, early = (actions[rank] for rank in next(_descents(ranks)))
            faults.append(f"{arm} arm: {task.id} {late} is done before {task.id} {early}")
        between = [k for k in range(places[0], places[-1]) if k not in places] if places else []
        if between:
            event_between = events[between[0]]
            faults.append(
                f"{arm} arm: {event_between.task} {event_between.action} is done within {task.id}"
            )
    return faults


def _wrong_task_order(rows: dict[str, list[Event]], job: Job) -> list[str]:
    """List the arms that do not keep the file's order of tasks."""
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
    """List sequences that several arms do, or that are interrupted."""
    orders = {arm: _task_order(events) for arm, events in rows.items()}
    faults = []
    for names in job.sequences:
        doers = [next((arm for arm in orders if name in orders[arm]), "") for name in names]
        if "" in doers:
            continue  # a missing task is a fault of its own
        for task, next_task, arm, next_arm in zip(names, names[1:], doers, doers[1:], strict=False):
            if arm != next_arm:
                faults.append(
                    f"{task} and {next_task} belong to one sequence, but are done by {arm} and {next_arm}"
                )
                break
            following = orders[arm][orders[arm].index(task) + 1 :][:1]
            if following != [next_task]:
                did = following[0] if following else "nothing"
                faults.append(
                    f"{arm} arm: {next_task} must follow {task} directly, but {did} is done"
                )
                break
    return faults


def _task_order(events: list[Event]) -> list[str]:
    """List the tasks of events in the order in which they begin."""
    return list(dict.fromkeys(event.task for event in events))


def _descents(numbers: list[int]) -> Iterator[tuple[int, int]]:
    """List neighbours in which the later number is smaller."""
    return ((a, b) for a, b in pairwise(numbers) if b < a)


def check_precedence(schedule: Schedule, job: Job, spans: Sequence[LineSpan]) -> Check:
    """Check that no task begins before the end of those in its `after`.

    A task begins with its first approach, or at its first target, and ends when its last tool has dwelt and retracted.

    Args:
        schedule: the schedule to check.
        job: as in its file.
        spans: of the job's stops.
    """
    if not any(task.after for task in job.tasks):
        return not_checked("precedence")
    started: dict[str, float] = {}
    finished: dict[str, float] = {}
    for span in spans:
        name = span.event.task
        started[name] = min(span.start, started.get(name, span.start))
        finished[name] = max(span.end, finished.get(name, span.end))
    # Paths and seams begin before their event; whether they are followed is for the checks of their kind.
    for s in schedule.segments:
        if s.kind in WORK_ENDS:
            started[s.task] = min(s.start, started.get(s.task, s.start))
    worst = Worst(where="every task begins after those in its `after`")
    for task, name in ((later.id, name) for later in job.tasks for name in later.after):
        # Missing tasks are for the check of the order.
        if task in started and name in finished:
            where = (
                f"{task} begins at {started[task]:.3f} s, {name} is over at {finished[name]:.3f} s"
            )
            worst.add(finished[name] - started[task], where)
    return worst.judge("precedence", TOL.same_time, "none of the tasks concerned is done")


def check_windows(schedule: Schedule, job: Job) -> Check:
    """Check that tasks are done within their windows.

    Args:
        schedule: the schedule to check.
        job: its tasks.
    """
    tasks = [task for task in job.tasks if _has_window(task)]
    if not tasks:
        return not_checked("windows")
    times: dict[str, list[float]] = {}
    for event in schedule.events:
        times.setdefault(event.task, []).append(event.time)
    worst = Worst(where="every task within its window")
    for task in tasks:
        if task.id not in times:
            continue  # missing tasks are for the check of the order
        first, last = min(times[task.id]), max(times[task.id])
        early = f"{task.id} is begun at {first:.3f} s, not_before is {task.not_before:g} s"
        late = f"{task.id} ends at {last:.3f} s, not_after is {task.not_after:g} s"
        worst.add(task.not_before - first, early)
        worst.add(last - task.not_after, late)
    return worst.judge("windows", TOL.same_time, "no task with a window is done")


def check_signals(schedule: Schedule, job: Job) -> list[Check]:
    """Check that every event sets the signal of its task.

    Args:
        schedule: the schedule to check.
        job: its tasks, each with the arm that did it.
    """
    stops = job.stops_by_key()
    wrong, named = [], False
    for event in schedule.events:
        stop = stops.get((event.arm, event.task, event.action))
        required = "" if stop is None else stop.signal
        named |= bool(required or event.signal)
        if event.signal != required:
            what = f"{event.signal or 'none'} instead of {required or 'none'}"
            wrong.append(f"{event.task} ({event.action}) sets {what}")
    where = "; ".join(wrong[:3]) or "at every event"
    return [judge("signals", float(len(wrong)), 0.0, where)] if named else []


def _has_window(task: Task) -> bool:
    return task.not_before > 0.0 or math.isfinite(task.not_after)
