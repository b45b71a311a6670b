"""The independent judge: it shares readers, nouns, pinocchio and coal with the planner, nothing else."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dualarm_cli.errors import Diagnostic, InputError
from dualarm_cli.model.job import Job
from dualarm_cli.model.schedule import Schedule, ScheduleRobot
from dualarm_cli.model.verification import Check, Verification
from dualarm_cli.verification.as_done import job_as_done
from dualarm_cli.verification.buffer_checks import check_buffers
from dualarm_cli.verification.clearance_checks import COLLISIONS, NOT_ASKED, check_clearance
from dualarm_cli.verification.conveyor_checks import check_conveyors, with_belts
from dualarm_cli.verification.handover_checks import check_handovers
from dualarm_cli.verification.line_spans import LineSpan, line_spans
from dualarm_cli.verification.motion_checks import (
    check_agreement,
    check_finite,
    check_limits,
    check_rest,
    check_time,
    not_checked,
)
from dualarm_cli.verification.order_checks import (
    check_arms,
    check_bound,
    check_dwells,
    check_ends,
    check_order,
    check_precedence,
    check_segments,
    check_windows,
)
from dualarm_cli.verification.path_checks import check_paths, check_torques
from dualarm_cli.verification.seam_checks import check_seams
from dualarm_cli.verification.stage_checks import check_pairing, check_segment_kinds, check_stages
from dualarm_cli.verification.tool_change_checks import check_tool_changes
from dualarm_cli.verification.tool_checks import (
    check_events,
    check_lines,
    check_platform_still,
    check_targets,
    check_tool_speed,
)
from dualarm_cli.verification.tool_model import ToolModel

OF_JOBS = (
    "events_at_targets",
    "order",
    "tool_changes",
    "precedence",
    "windows",
    "buffers",
    "pairing",
    "dwells",
    "start_posture",
    "return",
)
"""Checks of what only a job tells."""


def verify(schedule: Schedule, job: Job | None = None, *, clearance: bool = False) -> Verification:
    """Returns the judgement of a schedule.

    With a job, robot, base, tools and limits are the job's: what the schedule states of them is not believed.

    Args:
        schedule: what is to be judged.
        job: cell and tasks as read from their files; without it targets, order and start are not checked and
            robot and limits are those that the schedule states.
        clearance: whether the clearance of all bodies is proven over the whole motion, which the planner does not
            look at yet.

    Raises:
        InputError: the robot cannot be built, so that nothing can be measured, or the job is for another one.
    """
    # Absurd numbers overflow on their way to a finding; they are no reason for warnings or to stop.
    with np.errstate(all="ignore"):
        return _judged(schedule, job, clearance)


def _judged(schedule: Schedule, job: Job | None, clearance: bool) -> Verification:
    trajectory = schedule.trajectory
    numbers = [check_finite(trajectory)]
    if numbers[0].verdict == "passed":
        numbers.append(check_time(trajectory))
    if any(check.verdict == "failed" for check in numbers):
        return Verification(
            (*numbers, not_checked("everything else", "the numbers are not usable"))
        )
    if job is not None:
        schedule = replace(schedule, robot=_robot_of(job, trajectory.joints))
    model = ToolModel(schedule)
    known = _of_known_arms(schedule)
    # What needs an arm for every task takes the one that did it; whether it may have is for the check of the order.
    done = None if job is None else job_as_done(schedule, job)
    stated = known.events
    if done is not None:
        known = with_belts(known, done)
    # Where tools end on paths is judged with the paths, by their own tolerance.
    stops = known
    if job is not None:
        stops = replace(known, events=tuple(e for e in known.events if e.action != "path"))
    spans = () if done is None else line_spans(known, done, model)
    checks: list[Check] = [
        *numbers,
        *check_agreement(trajectory),
        *check_limits(trajectory, schedule.robot.limits.select(trajectory.joints)),
        check_rest(trajectory),
        check_arms(schedule),
        *check_events(stops, model),
        *check_lines(known, done, model),
        *check_conveyors(known, stated, done, model),
        *check_paths(schedule, done, model),
        *check_seams(schedule, done, model, spans),
        *check_handovers(known, done, model, spans),
        check_torques(schedule, done),
        check_platform_still(
            schedule, [(s.start, s.end, f"lines of {s.event.task}") for s in spans]
        ),
        check_tool_speed(schedule, schedule.robot.tool_speed, model),
        check_stages(schedule, job),
        check_segments(schedule),
        check_segment_kinds(known),
        check_bound(schedule),
        *_job_checks(schedule, job, done, spans),
    ]
    if not clearance:
        return Verification((*checks, not_checked(COLLISIONS, NOT_ASKED)))
    collisions, clearances = check_clearance(schedule, done)
    return Verification((*checks, collisions), clearances)


def _robot_of(job: Job, joints: tuple[str, ...]) -> ScheduleRobot:
    """Returns the robot, tools and limits that the job has.

    Raises:
        InputError: the job's robot has other joints than the schedule.
    """
    other = sorted(set(job.cell.robot.joints) ^ set(joints))
    if other:
        message = f"schedule and tasks are for different robots: {', '.join(other[:4])}"
        raise InputError([Diagnostic("schedule", 0, 0, "E301", message)])
    return ScheduleRobot.of_job(job)


def _of_known_arms(schedule: Schedule) -> Schedule:
    """Returns the schedule without the work of arms that the robot does not have."""
    arms = schedule.robot.arms
    return replace(
        schedule,
        events=tuple(event for event in schedule.events if event.arm in arms),
        segments=tuple(segment for segment in schedule.segments if segment.arm in arms),
    )


def _job_checks(
    schedule: Schedule, job: Job | None, done: Job | None, spans: Sequence[LineSpan]
) -> list[Check]:
    """Returns the checks of what only a job tells, as its file has it and as it was done."""
    if job is None or done is None:
        return [not_checked(name, "no task file was given (--tasks)") for name in OF_JOBS]
    return [
        check_targets(schedule, done),
        check_order(schedule, job),
        check_tool_changes(schedule, job),
        check_precedence(schedule, job, spans),
        check_windows(schedule, job),
        check_buffers(schedule, job),
        check_pairing(schedule, done, spans),
        check_dwells(schedule, done),
        *check_ends(schedule, job),
    ]


__all__ = ["verify"]
