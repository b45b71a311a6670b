"""Comparison of a schedule file's robot with its URDF and the job's."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pinocchio as pin

from dualarm_cli.model.job import Job
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.model.schedule import Schedule, ScheduleRobot
from dualarm_cli.model.verification import Check
from dualarm_cli.verification.measuring.criteria import judge
from dualarm_cli.verification.measuring.tolerances import TOL
from dualarm_cli.verification.measuring.tool_model import ToolModel

USABLE = ("finite", "time")
"""Checks that a usable schedule has to pass."""
MAX_NAMED = 2
"""Maximum number of differences in a message."""


def check_robot(schedule: Schedule, job: Job | None = None) -> Check:
    """Compare a schedule file's robot with its URDF, or with the job's.

    The verifier judges the motion by the job's robot; exports and pages use what the file states.

    Args:
        schedule: as read from its file; omitted values are not compared.
        job: of the schedule, or None.

    Raises:
        InputError: the robot cannot be built.
    """
    if job is None:
        differences, reference = [*_differences_from_urdf(schedule)], "of the URDF"
    else:
        differences, reference = (
            [*_differences_from_job(schedule.robot, ScheduleRobot.of_job(job))],
            "of the job",
        )
    details = f" and {len(differences) - MAX_NAMED} more" if len(differences) > MAX_NAMED else ""
    where = "; ".join(differences[:MAX_NAMED]) + details if differences else f"that {reference}"
    return judge("robot", len(differences), 0, where)


def _differences_from_urdf(schedule: Schedule) -> Iterator[str]:
    """Yield the arms whose joints are not those between the platform and their flange."""
    robot, model = schedule.robot, ToolModel(schedule)
    for name, arm in robot.arms.items():
        chain = tuple(joint for joint in model.joints(name) if joint not in robot.platform)
        if arm.joints:
            if not robot.platform:
                # It may have been left out; its joints come first.
                chain = chain[-len(arm.joints) :]
            yield from _joints(f"{name} arm", arm.joints, chain, "of those up to its flange")


def _differences_from_job(stated: ScheduleRobot, actual: ScheduleRobot) -> Iterator[str]:
    """Yield the differences of a file's robot from the job's."""
    if set(stated.arms) != set(actual.arms):
        yield f"arms: {', '.join(stated.arms)}; the job has {', '.join(actual.arms)}"
    for name, job_arm in actual.arms.items():
        arm = stated.arms.get(name, job_arm)
        if arm.flange != job_arm.flange:
            yield f"{name} arm: its flange is {arm.flange}; the job's is {job_arm.flange}"
        if arm.joints:
            yield from _joints(f"{name} arm", arm.joints, job_arm.joints, "of the job's")
        if not _same_pose(arm.tcp, job_arm.tcp):
            yield f"{name} arm: its tool centre point is not the job's"
    if any(arm.joints for arm in stated.arms.values()):
        yield from _joints("platform", stated.platform, actual.platform, "of the job's")
    if not _same_pose(stated.base, actual.base):
        yield "base: its pose is not the job's"
    if stated.tool_speed is not None and stated.tool_speed != actual.tool_speed:
        own_speed = "none" if actual.tool_speed is None else f"{actual.tool_speed:g}"
        yield f"tool_speed: {stated.tool_speed:g}; the job's is {own_speed}"
    shared = [joint for joint in stated.limits.joints if joint in actual.limits.joints]
    yield from _limits(stated.limits.select(shared), actual.limits.select(shared))


def _joints(
    subject: str, stated: tuple[str, ...], actual: tuple[str, ...], reference: str
) -> Iterator[str]:
    """Yield the first superfluous, missing or misplaced joint."""
    extra = [joint for joint in stated if joint not in actual]
    missing = [joint for joint in actual if joint not in stated]
    if extra:
        yield f"{subject}: its joint {extra[0]} is none {reference}"
    elif missing:
        yield f"{subject}: it lacks joint {missing[0]} {reference}"
    elif stated != actual:
        yield f"{subject}: its joints have another order than {reference.removeprefix('of ')}"


def _limits(stated: JointLimits, actual: JointLimits) -> Iterator[str]:
    is_stated = np.array([source != "unstated" for source in stated.source], dtype=bool)
    for quantity in ("lower", "upper", "velocity", "acceleration", "jerk"):
        values, actual_values = getattr(stated, quantity), getattr(actual, quantity)
        same = np.isclose(values, actual_values, rtol=TOL.same_stated, atol=0.0)
        for k in np.flatnonzero(~same & (is_stated | np.isfinite(values))):
            yield f"{quantity} limit of {stated.joints[k]}: {values[k]:g}; the job's is {actual_values[k]:g}"


def _same_pose(pose_a: pin.SE3, pose_b: pin.SE3) -> bool:
    return bool(np.abs(pose_a.homogeneous - pose_b.homogeneous).max() <= TOL.same_stated)


def unusable(
    schedule: Schedule, job: Job | None, failures: Sequence[Check], names: Sequence[str] = USABLE
) -> Check | None:
    """Return the first failed check that makes a schedule unusable, or None.

    Args:
        schedule: with the robot that its file states.
        job: of its task file.
        failures: of the verifier.
        names: checks that have to pass, in addition to that of the robot.
    """
    failed = [check for check in failures if check.name in names]
    if not failed and (robot := check_robot(schedule, job)).verdict == "failed":
        return robot
    return failed[0] if failed else None
