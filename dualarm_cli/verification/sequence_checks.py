"""Checks of what happens when: order, pairing, dwells, start and end."""

from __future__ import annotations

import numpy as np

from dualarm_cli.model.job import Dwell, Job, StopKey
from dualarm_cli.model.schedule import Event, Schedule, Segment
from dualarm_cli.model.verification import Check
from dualarm_cli.verification import tolerances as tol
from dualarm_cli.verification.motion_checks import judge, not_checked


def check_arms(schedule: Schedule) -> Check:
    """Checks that everything is done by an arm that the robot has."""
    known = schedule.robot.arms
    works = [("event", e) for e in schedule.events] + [("segment", s) for s in schedule.segments]
    strangers = [(kind, work) for kind, work in works if work.arm not in known]
    where = f"all of {', '.join(known)}"
    if strangers:
        kind, work = strangers[0]
        where = f"{kind} of {work.task} names arm '{work.arm}'; the robot has {', '.join(known)}"
    return judge("arms", len(strangers), 0, "", where)


def check_order(schedule: Schedule, job: Job) -> Check:
    """Checks that each arm's events are the job's targets, all of them, in the given order."""
    wrong = 0
    where = "every target, in the order of the file"
    for arm in job.cell.robot.arms:
        asked = [(task.id, stop.action) for task, stop in job.stops_of(arm.name)]
        events = sorted((e for e in schedule.events if e.arm == arm.name), key=lambda e: e.time)
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


def check_stages(schedule: Schedule) -> Check:
    """Checks that stages follow one another from the start of the motion to its end."""
    if not schedule.stages:
        return not_checked("stages", "the schedule lists none")
    worst, where = 0.0, "one after the other"
    clock = 0.0
    for number, stage in enumerate(schedule.stages, start=1):
        if abs(stage.start - clock) > worst:
            worst = abs(stage.start - clock)
            where = f"stage {number} does not start where the one before ends"
        if stage.start - stage.end > worst:
            worst, where = stage.start - stage.end, f"stage {number} ends before it starts"
        clock = stage.end
    if abs(clock - schedule.duration) > worst:
        worst, where = abs(clock - schedule.duration), "the last stage does not end the motion"
    return judge("stages", worst, tol.SAME_TIME, "s", where)


def check_pairing(schedule: Schedule, job: Job) -> Check:
    """Checks that paired targets fall into one stage, which both arms start together."""
    worst, where = 0.0, "both arms start every stage together"
    times = {(e.arm, e.task, e.action): e.time for e in schedule.events}
    starts: dict[StopKey, float] = {}
    for segment in schedule.segments:
        key = (segment.arm, segment.task, segment.action)
        starts[key] = min(segment.start, starts.get(key, np.inf))
    asked = job.stages()
    for number, work in enumerate(asked, start=1):
        if number > len(schedule.stages):
            return judge("pairing", np.inf, tol.SAME_TIME, "s", f"stage {number} is missing")
        stage = schedule.stages[number - 1]
        keys = [(arm, task.id, stop.action) for arm, (task, stop) in work.items()]
        for key in keys:
            time = times.get(key, np.inf)
            outside = max(stage.start - time, time - stage.end)
            if outside > worst:
                worst, where = outside, f"{key[1]} ({key[2]}) is outside stage {number}"
        begun = [starts[key] for key in keys if key in starts]
        apart = max(begun, default=0.0) - min(begun, default=0.0)
        if apart > worst:
            worst, where = apart, f"the arms do not start stage {number} together"
    wrong = _wrong_tasks(schedule, [[task.id for task, _ in work.values()] for work in asked])
    if wrong and worst <= tol.SAME_TIME:
        return judge("pairing", np.inf, tol.SAME_TIME, "s", wrong)
    return judge("pairing", worst, tol.SAME_TIME, "s", where)


def _wrong_tasks(schedule: Schedule, asked: list[list[str]]) -> str:
    """Returns which stage names other tasks than the job has there, or an empty string.

    A stage beyond the job's, the return to the start, works on none.
    """
    for number, stage in enumerate(schedule.stages, start=1):
        due = asked[number - 1] if number <= len(asked) else []
        # Both arms may follow one path: it is one task.
        if sorted(stage.tasks) != sorted(due) and set(stage.tasks) != set(due):
            said, wanted = (", ".join(names) or "no task" for names in (stage.tasks, due))
            return f"stage {number} names {said}; the tasks are {wanted}"
    return ""


def check_segments(schedule: Schedule) -> Check:
    """Checks that what each arm does follows on without gap or overlap, from start to end."""
    if not schedule.segments and not schedule.events:
        return not_checked("segments", "the schedule lists none")
    worst, where = 0.0, "one after the other"
    for arm in schedule.robot.arms:
        clock = 0.0
        own = sorted((s for s in schedule.segments if s.arm == arm), key=lambda s: s.start)
        for segment in own:
            off = max(abs(clock - segment.start), segment.start - segment.end)
            if off > worst:
                worst = off
                where = f"{arm} {segment.kind} of {segment.task} at {segment.start:.3f} s"
            clock = max(clock, segment.end)
        if clock - schedule.duration > worst:
            worst, where = clock - schedule.duration, f"{arm} arm works beyond the end"
        if own and schedule.duration - clock > worst:
            worst = schedule.duration - clock
            where = f"nothing is said of the {arm} arm from {clock:.3f} s to the end"
    for event in schedule.events:
        beyond = event.time + event.dwell - schedule.duration
        if beyond > worst:
            worst, where = beyond, f"dwell of {event.task} ({event.action}) goes beyond the end"
    return judge("segments", worst, tol.SAME_TIME, "s", where)


def check_dwells(schedule: Schedule, job: Job) -> Check:
    """Checks that every tool stands still for as long as the job asks, and for what it asks."""
    worst, where = 0.0, "as long as asked"
    asked = {key: stop.dwell for key, stop in job.stops_by_key().items()}
    events = {(e.arm, e.task, e.action): e for e in schedule.events}
    for key, event in events.items():
        short = asked.get(key, Dwell()).total - event.dwell
        if short > worst:
            worst, where = short, f"{event.task} ({event.action}) dwells {event.dwell:g} s"
    stands = {(s.arm, s.task, s.action): s for s in schedule.segments if s.kind == "dwell"}
    for key, segment in stands.items():
        off, what = _dwell_error(segment, events.get(key), asked.get(key, Dwell()))
        if off > worst:
            worst, where = off, f"{segment.task} ({segment.action}) {what}"
    if schedule.segments:
        for key, event in events.items():
            if event.dwell > worst and key not in stands:
                worst, where = event.dwell, f"{event.task} ({event.action}) has no dwell listed"
    return judge("dwells", worst, tol.SAME_TIME, "s", where)


def _dwell_error(segment: Segment, event: Event | None, asked: Dwell) -> tuple[float, str]:
    """Returns how far a listed dwell is from its event, from its shares and from the job [s]."""
    if event is None:
        return np.inf, "stands still without an event"
    length = segment.end - segment.start
    errors = [
        (abs(segment.start - event.time), "does not stand still from its event on"),
        (
            abs(length - event.dwell),
            f"is listed with {length:g} s, its event with {event.dwell:g} s",
        ),
    ]
    if segment.dwell is not None:
        errors.append((abs(segment.dwell.total - length), "has shares that are not its length"))
        errors += [
            (getattr(asked, name) - getattr(segment.dwell, name), f"has too short a share: {name}")
            for name in ("gripper", "settle", "handshake")
        ]
    return max(errors, key=lambda error: error[0])


def check_bound(schedule: Schedule) -> Check:
    """Checks that the stated lower bound is not above the schedule's own duration."""
    bound = schedule.lower_bound
    if bound is None:
        return not_checked("lower_bound", "none is stated")
    where = f"stated {bound:g} s, the schedule takes {schedule.duration:g} s"
    return judge("lower_bound", bound - schedule.duration, tol.SAME_TIME, "s", where)


def check_ends(schedule: Schedule, job: Job) -> list[Check]:
    """Checks the start posture and, for a closed cycle, that the motion returns to it."""
    trajectory = schedule.trajectory
    checks = []
    if job.start == "free":
        checks.append(not_checked("start_posture", "start: free leaves it to the planner"))
    else:
        posture = job.cell.robot.postures[job.start]
        order = [job.cell.robot.joints.index(name) for name in trajectory.joints]
        off = np.abs(trajectory.position[0] - posture[order])
        where = f"{trajectory.joints[int(np.argmax(off))]} from posture '{job.start}'"
        checks.append(judge("start_posture", float(off.max()), tol.SAME_JOINTS, "rad", where))
    if not job.returns:
        return [*checks, not_checked("return", "return: false")]
    off = np.abs(trajectory.position[-1] - trajectory.position[0])
    where = trajectory.joints[int(np.argmax(off))]
    return [*checks, judge("return", float(off.max()), tol.SAME_JOINTS, "rad", where)]
