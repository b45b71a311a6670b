"""Checks of who does what, when and in which order: targets, arms, sequences, precedence, windows, dwells."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from dualarm_cli.model.job import Dwell, Job, Task
from dualarm_cli.model.schedule import WORK_ENDS, Event, Schedule, Segment
from dualarm_cli.model.verification import Check
from dualarm_cli.verification.as_done import in_time, is_change
from dualarm_cli.verification.criteria import judge, not_checked
from dualarm_cli.verification.line_spans import LineSpan
from dualarm_cli.verification.tolerances import TOL
from dualarm_cli.verification.tool_checks import Worst


def check_arms(schedule: Schedule) -> Check:
    """Checks that everything is done by an arm that the robot has, and that events are about that arm's own tool."""
    known = schedule.robot.arms
    works = [("event", e) for e in schedule.events] + [("segment", s) for s in schedule.segments]
    found = [(f"{kind} of {work.task}", work.arm) for kind, work in works if work.arm not in known]
    found += [
        (f"stage {number}", stage.arm)
        for number, stage in enumerate(schedule.stages, start=1)
        if stage.arm and stage.arm not in known
    ]
    other = [e for e in schedule.events if e.arm in known and e.frame != f"{e.arm}_tcp"]
    where = f"all of {', '.join(known)}"
    if found:
        what, arm = found[0]
        where = f"{what} names arm '{arm}'; the robot has {', '.join(known)}"
    elif other:
        where = f"event of {other[0].task} names frame '{other[0].frame}'; it is {other[0].arm}_tcp"
    return judge("arms", len(found) + len(other), 0, where)


def check_segments(schedule: Schedule) -> Check:
    """Checks that what each arm does follows on without gap or overlap, from start to end."""
    if not schedule.segments and not schedule.events:
        return not_checked("segments")
    worst = Worst(where="one after the other")
    for arm in schedule.robot.arms:
        clock = 0.0
        own = sorted((s for s in schedule.segments if s.arm == arm), key=lambda s: s.start)
        for segment in own:
            off = max(abs(clock - segment.start), segment.start - segment.end)
            worst.add(off, f"{arm} {segment.kind} of {segment.task} at {segment.start:.3f} s")
            clock = max(clock, segment.end)
        worst.add(clock - schedule.duration, f"{arm} arm works beyond the end")
        if own:
            where = f"the {arm} arm has no segment from {clock:.3f} s to the end"
            worst.add(schedule.duration - clock, where)
    for event in schedule.events:
        beyond = event.time + event.dwell - schedule.duration
        worst.add(beyond, f"dwell of {event.task} ({event.action}) goes beyond the end")
    return worst.judge("segments", TOL.same_time)


def check_dwells(schedule: Schedule, job: Job) -> Check:
    """Checks that every tool stands still for as long as the job asks, and for what it asks."""
    worst = Worst()
    asked = {key: stop.dwell for key, stop in job.stops_by_key().items()}
    events = {(e.arm, e.task, e.action): e for e in schedule.events}
    for key, event in events.items():
        short = asked.get(key, Dwell()).total - event.dwell
        worst.add(short, f"{event.task} ({event.action}) dwells {event.dwell:g} s")
    stands = [s for s in schedule.segments if s.kind == "dwell"]
    for segment in stands:
        key = (segment.arm, segment.task, segment.action)
        off, what = _dwell_error(segment, events.get(key), asked.get(key, Dwell()))
        worst.add(off, f"{segment.task} ({segment.action}) {what}")
    if schedule.segments:
        listed = {(s.arm, s.task, s.action) for s in stands}
        for key, event in events.items():
            if key not in listed:
                worst.add(event.dwell, f"{event.task} ({event.action}) has no dwell listed")
    # Rounding has a largest value too, and nothing to say of it.
    fault = worst.where if worst.value > TOL.same_time else "as long as the job requires"
    return judge("dwells", worst.value, TOL.same_time, fault)


def _dwell_error(segment: Segment, event: Event | None, asked: Dwell) -> tuple[float, str]:
    """Returns how far a listed dwell is from its event, from its shares and from the job [s]."""
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
            (getattr(asked, name) - getattr(segment.dwell, name), f"has too short a share: {name}")
            for name in ("gripper", "settle", "handshake")
        ]
    return max(errors, key=lambda error: error[0])


def check_bound(schedule: Schedule) -> Check:
    """Checks that the stated lower bound is not above the schedule's own duration."""
    bound = schedule.lower_bound
    if bound is None:
        return not_checked("lower_bound")
    where = f"stated {bound:g} s, the schedule takes {schedule.duration:g} s"
    return judge("lower_bound", bound - schedule.duration, TOL.same_time, where)


def check_ends(schedule: Schedule, job: Job) -> list[Check]:
    """Checks the start posture and, for a closed cycle, that the motion returns to it."""
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
    found = judge("return", float(off.max()), TOL.same_joints, joint, slides=joint in sliding)
    return [*checks, found]


def check_order(schedule: Schedule, job: Job) -> Check:
    """Checks that all of the job's targets are done, by whom and in which order the file allows.

    Where the file says all, each arm's events are its targets in the file's order. Where it leaves arms or order open,
    every target is done once, those of a task by one arm that may, one right after the other; the tasks of a sequence
    by one arm right after one another; with order: given each arm's tasks in the file's order.

    Args:
        schedule: what is judged.
        job: as its file leaves it.
    """
    # What no task of the file asks for has a check of its own.
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
    where = faults[0] if faults else "every target once, by an allowed arm and in an allowed order"
    return judge("order", len(faults), 0, where)


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
            where = f"{arm.name} arm: expected {due}, found {did}"
    return judge("order", wrong, 0, where)


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
    """Returns that an arm's share of a task is done by several arms, or by one that may not."""
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
                    f"{one} and {other} belong to one sequence, but are done by {by} and {then}"
                )
                break
            following = orders[by][orders[by].index(one) + 1 :][:1]
            if following != [other]:
                did = following[0] if following else "nothing"
                faults.append(f"{by} arm: {other} must follow {one} directly, but {did} is done")
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
        return not_checked("precedence")
    begin: dict[str, float] = {}
    over: dict[str, float] = {}
    for span in spans:
        name = span.event.task
        begin[name] = min(span.start, begin.get(name, span.start))
        over[name] = max(span.end, over.get(name, span.end))
    # Work on the way may begin before the first event; that it is this work is for the checks of its kind.
    for s in schedule.segments:
        if s.kind in WORK_ENDS:
            begin[s.task] = min(s.start, begin.get(s.task, s.start))
    worst = Worst(where="every task begins after those in its `after`")
    for task, name in ((one.id, name) for one in job.tasks for name in one.after):
        # What nobody does is the order's to find.
        if task in begin and name in over:
            where = f"{task} begins at {begin[task]:.3f} s, {name} is over at {over[name]:.3f} s"
            worst.add(over[name] - begin[task], where)
    return worst.judge("precedence", TOL.same_time, "none of the tasks concerned is done")


def check_windows(schedule: Schedule, job: Job) -> Check:
    """Checks that tools are at first targets no earlier, and at last ones no later, than tasks allow.

    Args:
        schedule: what is judged.
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
            continue  # what nobody does is the order's to find
        first, last = min(times[task.id]), max(times[task.id])
        early = f"{task.id} is begun at {first:.3f} s, not_before is {task.not_before:g} s"
        late = f"{task.id} ends at {last:.3f} s, not_after is {task.not_after:g} s"
        worst.add(task.not_before - first, early)
        worst.add(last - task.not_after, late)
    return worst.judge("windows", TOL.same_time, "no task with a window is done")


def check_signals(schedule: Schedule, job: Job) -> list[Check]:
    """Checks that every event sets the signal of its task; nothing where there are none.

    Args:
        schedule: what is judged.
        job: its tasks, each with the arm that did it.
    """
    stops = job.stops_by_key()
    wrong, named = [], False
    for event in schedule.events:
        stop = stops.get((event.arm, event.task, event.action))
        asked = "" if stop is None else stop.signal
        named |= bool(asked or event.signal)
        if event.signal != asked:
            what = f"{event.signal or 'none'} instead of {asked or 'none'}"
            wrong.append(f"{event.task} ({event.action}) sets {what}")
    where = "; ".join(wrong[:3]) or "at every event"
    return [judge("signals", float(len(wrong)), 0.0, where)] if named else []


def _has_window(task: Task) -> bool:
    return task.not_before > 0.0 or math.isfinite(task.not_after)
