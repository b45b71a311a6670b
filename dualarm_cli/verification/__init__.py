"""Independent verifier of schedules.

It shares readers, the data model, pinocchio and coal with the planner, nothing else.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Protocol, TypeVar

import numpy as np

from dualarm_cli.errors import Diagnostic, InputError
from dualarm_cli.kinds import of_kinds
from dualarm_cli.model.job import WITHIN_TOLERANCE, Job
from dualarm_cli.model.schedule import Event, Schedule, ScheduleRobot
from dualarm_cli.model.verification import COLLISIONS, Check, Verification
from dualarm_cli.verification.as_done import job_as_done
from dualarm_cli.verification.care_checks import check_care
from dualarm_cli.verification.clearance_checks import (
    check_clearance,
    check_shapes,
)
from dualarm_cli.verification.delay_checks import arm_delays, check_skew
from dualarm_cli.verification.grasp_checks import check_grasps
from dualarm_cli.verification.kind_checks import Evidence, Subject
from dualarm_cli.verification.measuring.criteria import NO_TASKS, not_checked
from dualarm_cli.verification.measuring.line_spans import line_spans
from dualarm_cli.verification.measuring.tool_model import ToolModel
from dualarm_cli.verification.motion_checks import (
    check_agreement,
    check_finite,
    check_limits,
    check_rest,
    check_time,
)
from dualarm_cli.verification.order_checks import (
    check_arms,
    check_bound,
    check_dwells,
    check_ends,
    check_order,
    check_precedence,
    check_segments,
    check_signals,
    check_windows,
)
from dualarm_cli.verification.stage_checks import (
    check_pairing,
    check_segment_kinds,
    check_stages,
)
from dualarm_cli.verification.tool_checks import (
    check_events,
    check_lines,
    check_platform_still,
    check_stands,
    check_targets,
    check_tool_speed,
)
from dualarm_cli.verification.torque_checks import check_torques

S = TypeVar("S")
T = TypeVar("T")


class Both(Protocol):
    """Caller of two functions without arguments, in turn or in parallel."""

    def __call__(self, first: Callable[[], S], second: Callable[[], T], /) -> tuple[S, T]:
        """Call both functions and return their results."""


def in_turn(first: Callable[[], S], second: Callable[[], T]) -> tuple[S, T]:
    """Call two functions one after the other."""
    return first(), second()


def verify(
    schedule: Schedule,
    job: Job | None = None,
    *,
    clearance: bool = False,
    both: Both = in_turn,
) -> Verification:
    """Verify a schedule.

    With a job, robot, base, tools and limits are the job's, whatever the schedule states.

    Args:
        schedule: the schedule to verify.
        job: cell and tasks as read from their files; without it targets, order and start are not checked and
            robot and limits are those that the schedule states.
        clearance: whether the clearance of all bodies is proven over the whole motion.
        both: caller of two independent functions, in parallel if there is a second core.

    Raises:
        InputError: the robot cannot be built, or the job is for another robot.
    """
    # Absurd numbers may overflow before a check fails on them: no reason for warnings or to stop.
    with np.errstate(all="ignore"):
        return _verify(schedule, job, clearance, both)


def _verify(schedule: Schedule, job: Job | None, clearance: bool, both: Both) -> Verification:
    numbers = [check_finite(schedule.motion)]
    if numbers[0].verdict == "passed":
        numbers.append(check_time(schedule.motion))
    if any(check.verdict == "failed" for check in numbers):
        return Verification(
            (
                *numbers,
                not_checked("everything else"),
            )
        )
    trajectory = schedule.trajectory
    if job is not None:
        schedule = replace(schedule, robot=_robot_of(job, trajectory.joints))
        # With blending the job requires only a part of its lines to be straight and of its paths to be sharp.
        job = schedule.blending.straight(job)
    model = ToolModel(schedule)
    known_arms_only = _only_known_arms(schedule)
    # Every task gets the arm that did it; whether that arm was allowed is for the check of the order.
    done = None if job is None else job_as_done(schedule, job)
    stated = known_arms_only.events
    if done is not None:
        known_arms_only = _with_target_velocities(known_arms_only, done)
    # Events with tolerances of their own are judged by the checks of their kind of work.
    stops = known_arms_only
    if job is not None:
        events = (e for e in known_arms_only.events if e.action not in WITHIN_TOLERANCE)
        stops = replace(known_arms_only, events=tuple(events))
    spans = () if done is None else line_spans(known_arms_only, done, model)
    evidence = Evidence(schedule, known_arms_only, stated, job, done, model, spans)
    if not clearance:
        rest = not_checked(COLLISIONS)
        return Verification((*numbers, *_checks(evidence, stops), rest))
    (collisions, clearances), (checks, delays) = both(
        lambda: check_clearance(schedule, done, spans),
        lambda: (
            _checks(evidence, stops),
            () if done is None else arm_delays(schedule, done, spans),
        ),
    )
    if done is not None:
        checks += [collisions, *check_shapes(done), *check_skew(done, delays)]
    else:
        checks.append(collisions)
    return Verification((*numbers, *checks), clearances, delays)


def _checks(evidence: Evidence, stops: Schedule) -> list[Check]:
    """Run all checks but that of clearance.

    Args:
        evidence: the schedule and what was measured of it.
        stops: the schedule without events that have tolerances of their own.
    """
    schedule, known_arms_only, job, done = (
        evidence.schedule,
        evidence.known_arms_only,
        evidence.job,
        evidence.done,
    )
    model, spans, trajectory = evidence.model, evidence.spans, schedule.trajectory
    sliding = schedule.robot.sliding
    return [
        *check_agreement(trajectory, sliding),
        *check_limits(trajectory, schedule.robot.limits.select(trajectory.joints), sliding),
        *check_torques(schedule, done),
        check_rest(trajectory, sliding),
        check_arms(schedule),
        *check_events(stops, model),
        *check_lines(known_arms_only, done, model),
        *_kind_checks("lines", evidence),
        *_kind_checks("work", evidence),
        check_platform_still(schedule, spans),
        check_tool_speed(schedule, schedule.robot.tool_speed, model),
        check_stages(schedule, job),
        check_segments(schedule),
        check_segment_kinds(known_arms_only),
        check_bound(schedule),
        *_job_checks(evidence),
    ]


def _robot_of(job: Job, joints: tuple[str, ...]) -> ScheduleRobot:
    """Return the job's robot, tools and limits.

    Raises:
        InputError: the job's robot has other joints than the schedule.
    """
    differences = sorted(set(job.cell.robot.joints) ^ set(joints))
    if differences:
        message = f"schedule and tasks are for different robots: {', '.join(differences[:4])}"
        raise InputError([Diagnostic("schedule", 0, 0, "E301", message)])
    return ScheduleRobot.of_job(job)


def _only_known_arms(schedule: Schedule) -> Schedule:
    """Leave out the work of arms that the robot lacks."""
    arms = schedule.robot.arms
    return replace(
        schedule,
        events=tuple(event for event in schedule.events if event.arm in arms),
        segments=tuple(segment for segment in schedule.segments if segment.arm in arms),
    )


def _with_target_velocities(schedule: Schedule, job: Job) -> Schedule:
    """Replace the velocities of events by those of the job's targets."""
    stops = job.stops_by_key()

    def with_velocity(event: Event) -> Event:
        stop = stops.get((event.arm, event.task, event.action))
        return replace(event, velocity=(0.0,) * 3 if stop is None else stop.velocity)

    return replace(schedule, events=tuple(with_velocity(event) for event in schedule.events))


def _kind_checks(subject: Subject, evidence: Evidence) -> list[Check]:
    """Run the checks of one subject by all kinds of work."""
    judges = [kind.judge[subject] for kind in of_kinds("checks") if subject in kind.judge]
    return [check for judge in judges for check in judge(evidence)]


def _job_checks(evidence: Evidence) -> list[Check]:
    """Run the checks that need a job."""
    schedule, job, done, spans = evidence.schedule, evidence.job, evidence.done, evidence.spans
    if job is None or done is None:
        first, second, third = (
            [not_checked(name, NO_TASKS) for name in run]
            for run in (
                ("events_at_targets", "stands_at_events", "order"),
                ("precedence", "windows"),
                ("pairing", "dwells", "start_posture", "return"),
            )
        )
    else:
        first = [
            check_targets(schedule, done),
            check_stands(schedule, done),
            check_order(schedule, job),
        ]
        second = [check_precedence(schedule, job, spans), check_windows(schedule, job)]
        third = [check_pairing(schedule, done, spans), check_dwells(schedule, done)]
        third += [*check_ends(schedule, job), *check_signals(schedule, done)]
        third += check_grasps(schedule, job)
        third += check_care(schedule, done, evidence.model)
    return [
        *first,
        *_kind_checks("order", evidence),
        *second,
        *_kind_checks("parts", evidence),
        *third,
    ]


__all__ = ["verify"]
