"""Checks of what happens when: arms, segments, dwells, start and end."""

from __future__ import annotations

import numpy as np

from dualarm_cli.model.job import Dwell, Job
from dualarm_cli.model.schedule import Event, Schedule, Segment
from dualarm_cli.model.verification import Check
from dualarm_cli.verification import tolerances as tol
from dualarm_cli.verification.motion_checks import judge, not_checked


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
    return judge("arms", len(found) + len(other), 0, "", where)


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
    stands = [s for s in schedule.segments if s.kind == "dwell"]
    for segment in stands:
        key = (segment.arm, segment.task, segment.action)
        off, what = _dwell_error(segment, events.get(key), asked.get(key, Dwell()))
        if off > worst:
            worst, where = off, f"{segment.task} ({segment.action}) {what}"
    if schedule.segments:
        listed = {(s.arm, s.task, s.action) for s in stands}
        for key, event in events.items():
            if event.dwell > worst and key not in listed:
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
