"""Checks of what happens when: order, pairing, dwells, start and end."""

from __future__ import annotations

import numpy as np

from dualarm_cli.model.job import Job
from dualarm_cli.model.schedule import Schedule
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
            where = f"{arm.name} arm: {' '.join(first[0])} is due, {' '.join(first[1])} is done"
    return judge("order", wrong, 0, "", where)


def check_pairing(schedule: Schedule, job: Job) -> Check:
    """Checks that stages follow one another and that paired targets fall into one stage."""
    worst, where = 0.0, "both arms start every stage together"
    clock = 0.0
    for number, stage in enumerate(schedule.stages, start=1):
        gap = abs(stage.start - clock)
        if gap > worst:
            worst, where = gap, f"stage {number} does not start where the one before ends"
        clock = stage.end
    if abs(clock - schedule.duration) > worst:
        worst, where = abs(clock - schedule.duration), "the last stage does not end the motion"
    times = {(e.arm, e.task, e.action): e.time for e in schedule.events}
    for number, work in enumerate(job.stages(), start=1):
        if number > len(schedule.stages):
            return judge("pairing", np.inf, tol.SAME_TIME, "s", f"stage {number} is missing")
        stage = schedule.stages[number - 1]
        for arm, (task, stop) in work.items():
            time = times.get((arm, task.id, stop.action), np.inf)
            outside = max(stage.start - time, time - stage.end)
            if outside > worst:
                worst, where = outside, f"{task.id} ({stop.action}) is outside stage {number}"
    return judge("pairing", worst, tol.SAME_TIME, "s", where)


def check_segments(schedule: Schedule) -> Check:
    """Checks that no arm does two things at once, and nothing outside the motion."""
    if not schedule.segments and not schedule.events:
        return not_checked("segments", "the schedule lists none")
    worst, where = 0.0, "one after the other"
    for arm in schedule.robot.arms:
        clock = 0.0
        own = sorted((s for s in schedule.segments if s.arm == arm), key=lambda s: s.start)
        for segment in own:
            overlap = max(clock - segment.start, segment.start - segment.end)
            if overlap > worst:
                worst = overlap
                where = f"{arm} {segment.kind} of {segment.task} at {segment.start:.3f} s"
            clock = max(clock, segment.end)
        if clock - schedule.duration > worst:
            worst, where = clock - schedule.duration, f"{arm} arm works beyond the end"
    for event in schedule.events:
        beyond = event.time + event.dwell - schedule.duration
        if beyond > worst:
            worst, where = beyond, f"dwell of {event.task} ({event.action}) goes beyond the end"
    return judge("segments", worst, tol.SAME_TIME, "s", where)


def check_dwells(schedule: Schedule, job: Job) -> Check:
    """Checks that every tool stands still for as long as the job asks."""
    worst, where = 0.0, "as long as asked"
    asked = {key: stop.dwell.total for key, stop in job.stops_by_key().items()}
    for event in schedule.events:
        short = asked.get((event.arm, event.task, event.action), 0.0) - event.dwell
        if short > worst:
            worst, where = short, f"{event.task} ({event.action}) dwells {event.dwell:g} s"
    return judge("dwells", worst, tol.SAME_TIME, "s", where)


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
