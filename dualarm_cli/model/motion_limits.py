"""Limits of joints and tools in stages and on lines, from care of tasks and parts.

An arm keeps the limits of its task and of the part that it holds. The platform keeps those of arms that hold a part,
because it moves the part as well.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np

from dualarm_cli.model.job import GIVES, TAKES, Job, Stop, StopKey, Task
from dualarm_cli.model.part_flow import NO_CARE, Care
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.records import dataclass


def is_slowed(job: Job) -> bool:
    """Check whether care or a tool speed limit slows the motion of a job."""
    return job.slows or job.tool_speed is not None


@dataclass(frozen=True)
class MotionLimits:
    """Limits of joints and tools in a stage or on a line."""

    joints: JointLimits
    """Limits of all joints."""
    caps: Mapping[str, float]
    """Speed limits of tool centre points [m/s], by arm; arms without one are missing."""
    care: tuple[tuple[str, Care], ...] = ()
    """Included care by arm, and of the platform as ""; a key of cached motions."""

    @classmethod
    def of(cls, job: Job, care: Mapping[str, Care] | None = None) -> MotionLimits:
        """Compute the limits of a job, under care of some arms."""
        return _limits(job, tuple(sorted((care or {}).items(), key=lambda item: item[0])))

    @classmethod
    def of_stage(cls, job: Job, stops: frozenset[StopKey]) -> MotionLimits:
        """Compute the limits of the transfers of a stage, by its stops."""
        return cls.of(job, care_of_stages(job).get(stops))


@lru_cache(maxsize=16)
def _limits(job: Job, care: tuple[tuple[str, Care], ...]) -> MotionLimits:
    robot, cap = job.cell.robot, job.tool_speed
    groups = {"": robot.platform} | {arm.name: arm.joints for arm in robot.arms}
    caps = {} if cap is None else {arm.name: cap for arm in robot.arms}
    if not care:
        return MotionLimits(job.limits, caps)
    speed, acceleration = np.ones((2, len(robot.joints)))
    for group, limit in care:
        columns = robot.columns(groups[group])
        speed[columns], acceleration[columns] = limit.speed, limit.acceleration
        if group and limit.tool_speed < np.inf:
            caps[group] = min(limit.tool_speed, caps.get(group, np.inf))
    return MotionLimits(job.limits.scaled(speed, acceleration), caps, care)


@lru_cache(maxsize=8)
def care_of_stages(job: Job) -> Mapping[frozenset[StopKey], Mapping[str, Care]]:
    """Collect the care on the transfers of each stage, by its stops.

    Care is by arm, and of the platform as "". An arm without a stop keeps the limits of its task between the task's
    stops. Stages without care are missing.
    """
    care: dict[frozenset[StopKey], Mapping[str, Care]] = {}
    last: dict[str, tuple[Task, Stop]] = {}
    for stage in job.stages() if job.slows else ():
        last |= stage
        kept = {}
        for arm, (task, stop) in last.items():
            if arm not in stage and stop is task.stops[-1]:
                continue
            at = task.care_before if arm in stage else task.care_after
            kept[arm] = at(stop.action)
            if stop.action in (GIVES if arm in stage else TAKES):
                kept[""] = kept[arm].stricter(kept.get("", NO_CARE))
        if any(limit.slows for limit in kept.values()):
            care[frozenset((arm, t.id, s.action) for arm, (t, s) in stage.items())] = kept
    return care
