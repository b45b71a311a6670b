"""Comparison of a schedule file's robot with its URDF and the job's."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pinocchio as pin

from dualarm_cli.model.job import Job
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.model.schedule import Schedule, ScheduleRobot
from dualarm_cli.model.verification import Check
from dualarm_cli.verification.criteria import judge
from dualarm_cli.verification.tolerances import TOL
from dualarm_cli.verification.tool_model import ToolModel

USABLE = ("finite", "time")
"""Checks that a schedule has to pass to be of any use."""
SHOWN = 2
"""Differences that a message names."""


def check_robot(schedule: Schedule, job: Job | None = None) -> Check:
    """Compare a schedule file's robot with its URDF, or with the job's.

    The verifier judges the motion by the job's robot; exports and pages use what the file states.

    Args:
        schedule: as read from its file; what it leaves out is not compared.
        job: of the schedule, if it is known.

    Raises:
        InputError: the robot cannot be built.
    """
    if job is None:
        found, whose = [*_beside_chains(schedule)], "of the URDF"
    else:
        found, whose = [*_beside_job(schedule.robot, ScheduleRobot.of_job(job))], "of the job"
    more = f" and {len(found) - SHOWN} more" if len(found) > SHOWN else ""
    where = "; ".join(found[:SHOWN]) + more if found else f"that {whose}"
    return judge("robot", len(found), 0, where)


def _beside_chains(schedule: Schedule) -> Iterator[str]:
    """Yield the arms whose joints are not those between the platform and their flange."""
    robot, model = schedule.robot, ToolModel(schedule)
    for name, arm in robot.arms.items():
        chain = tuple(joint for joint in model.joints(name) if joint not in robot.platform)
        if arm.joints:
            if not robot.platform:
                # It may have been left out; its joints come first.
                chain = chain[-len(arm.joints) :]
            yield from _joints(f"{name} arm", arm.joints, chain, "of those up to its flange")


def _beside_job(stated: ScheduleRobot, known: ScheduleRobot) -> Iterator[str]:
    """Yield what a file states otherwise than the job has it."""
    if set(stated.arms) != set(known.arms):
        yield f"arms: {', '.join(stated.arms)}; the job has {', '.join(known.arms)}"
    for name, own in known.arms.items():
        arm = stated.arms.get(name, own)
        if arm.flange != own.flange:
            yield f"{name} arm: its flange is {arm.flange}; the job's is {own.flange}"
        if arm.joints:
            yield from _joints(f"{name} arm", arm.joints, own.joints, "of the job's")
        if not _same_pose(arm.tcp, own.tcp):
            yield f"{name} arm: its tool centre point is not the job's"
    if any(arm.joints for arm in stated.arms.values()):
        yield from _joints("platform", stated.platform, known.platform, "of the job's")
    if not _same_pose(stated.base, known.base):
        yield "base: its pose is not the job's"
    if stated.tool_speed is not None and stated.tool_speed != known.tool_speed:
        own_speed = "none" if known.tool_speed is None else f"{known.tool_speed:g}"
        yield f"tool_speed: {stated.tool_speed:g}; the job's is {own_speed}"
    yield from _limits(stated.limits, known.limits.select(stated.limits.joints))


def _joints(
    what: str, stated: tuple[str, ...], known: tuple[str, ...], whose: str
) -> Iterator[str]:
    """Yield the first superfluous, missing or misplaced joint."""
    extra = [joint for joint in stated if joint not in known]
    missing = [joint for joint in known if joint not in stated]
    if extra:
        yield f"{what}: its joint {extra[0]} is none {whose}"
    elif missing:
        yield f"{what}: it lacks joint {missing[0]} {whose}"
    elif stated != known:
        yield f"{what}: its joints have another order than {whose.removeprefix('of ')}"


def _limits(stated: JointLimits, known: JointLimits) -> Iterator[str]:
    says = np.array([source != "unstated" for source in stated.source])
    for what in ("lower", "upper", "velocity", "acceleration", "jerk"):
        values, own = getattr(stated, what), getattr(known, what)
        same = np.isclose(values, own, rtol=TOL.same_stated, atol=0.0)
        for k in np.flatnonzero(~same & (says | np.isfinite(values))):
            yield f"{what} limit of {stated.joints[k]}: {values[k]:g}; the job's is {own[k]:g}"


def _same_pose(one: pin.SE3, other: pin.SE3) -> bool:
    return bool(np.abs(one.homogeneous - other.homogeneous).max() <= TOL.same_stated)


def unusable(
    schedule: Schedule, job: Job | None, failures: Sequence[Check], names: Sequence[str] = USABLE
) -> Check | None:
    """Return the first failed check that makes a schedule unusable, or None.

    Args:
        schedule: with the robot that its file states.
        job: of its task file.
        failures: of the verifier.
        names: checks that have to pass, beside that of the robot.
    """
    found = [check for check in failures if check.name in names]
    if not found and (robot := check_robot(schedule, job)).verdict == "failed":
        return robot
    return found[0] if found else None
