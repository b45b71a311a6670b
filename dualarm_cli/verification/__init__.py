"""The independent judge: it shares readers, nouns and pinocchio with the planner, nothing else."""

from __future__ import annotations

from dualarm_cli.errors import Diagnostic, InputError
from dualarm_cli.model.job import Job
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.model.verification import Check, Verification
from dualarm_cli.verification.motion_checks import (
    check_agreement,
    check_finite,
    check_limits,
    check_rest,
    check_time,
    not_checked,
)
from dualarm_cli.verification.sequence_checks import (
    check_dwells,
    check_ends,
    check_order,
    check_pairing,
    check_segments,
)
from dualarm_cli.verification.tool_checks import (
    check_events,
    check_lines,
    check_platform_still,
    check_targets,
    check_tool_speed,
)
from dualarm_cli.verification.tool_model import ToolModel

COLLISIONS = "this version does not check collisions"


def verify(schedule: Schedule, job: Job | None = None) -> Verification:
    """Returns the judgement of a schedule.

    Args:
        schedule: what is to be judged; its own statements are not believed where the job knows better.
        job: cell and tasks as read from their files; without it targets, order and start are not checked and
            the limits are those that the schedule states.

    Raises:
        InputError: the schedule's robot cannot be built, so that nothing can be measured.
    """
    trajectory = schedule.trajectory
    numbers = [check_finite(trajectory)]
    if numbers[0].verdict == "passed":
        numbers.append(check_time(trajectory))
    if any(check.verdict == "failed" for check in numbers):
        return Verification(
            (*numbers, not_checked("everything else", "the numbers are not usable"))
        )
    model = ToolModel(schedule)
    cap = job.tool_speed if job else schedule.robot.tool_speed
    checks: list[Check] = [
        *numbers,
        *check_agreement(trajectory),
        *check_limits(trajectory, _limits(schedule, job)),
        check_rest(trajectory),
        *check_events(schedule, model),
        *check_lines(schedule, job, model),
        check_platform_still(schedule),
        check_tool_speed(schedule, cap, model),
        check_segments(schedule),
        *_job_checks(schedule, job),
        not_checked("collisions", COLLISIONS),
    ]
    return Verification(tuple(checks))


def _limits(schedule: Schedule, job: Job | None) -> JointLimits:
    """Returns the limits in the trajectory's order: the job's, or the schedule's own.

    Raises:
        InputError: the job's robot has other joints.
    """
    joints = schedule.trajectory.joints
    if job is None:
        return schedule.robot.limits.select(joints)
    limits = job.cell.robot.limits
    if set(limits.joints) != set(joints):
        other = sorted(set(limits.joints) ^ set(joints))
        message = f"schedule and tasks are for different robots: {', '.join(other[:4])}"
        raise InputError([Diagnostic("schedule", 0, 0, "E301", message)])
    return limits.scaled(job.speed).select(joints)


def _job_checks(schedule: Schedule, job: Job | None) -> list[Check]:
    names = ("events_at_targets", "order", "pairing", "dwells", "start_posture", "return")
    if job is None:
        return [not_checked(name, "no task file was given (--tasks)") for name in names]
    return [
        check_targets(schedule, job),
        check_order(schedule, job),
        check_pairing(schedule, job),
        check_dwells(schedule, job),
        *check_ends(schedule, job),
    ]


__all__ = ["verify"]
