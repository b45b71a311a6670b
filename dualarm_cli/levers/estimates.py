"""Estimated gain of levers: the pieces of the plan, re-timed under each changed job."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from dualarm_cli.errors import DualArmError
from dualarm_cli.files.source.value_paths import pointer_steps
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinematics.dynamics import limits_torques
from dualarm_cli.levers.changes import (
    BLEND,
    CLEARANCE,
    MASS,
    SIZES,
    Lever,
    documents_of,
    joint_name,
    joint_speeds,
    levers,
)
from dualarm_cli.levers.kept_plan import KeptPlan
from dualarm_cli.model.job import Job
from dualarm_cli.model.motion.trajectory import SAME_TIME
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.records import dataclass
from dualarm_cli.report.critical_path import retimed

ONLY_PLANNED = "only another plan shows it"
"""Reason of levers whose gain is not in the times of motions and dwells."""


@dataclass(frozen=True)
class Estimate:
    """Estimated gain of a lever."""

    lever: Lever
    """The lever."""
    gain: float | None
    """Cycle time of the plan less that of the re-timed plan [s]; None if not estimated."""
    reason: str = ""
    """Why it is not estimated; empty if it is."""


def estimated_levers(schedule: Schedule, job: Job, tasks: Path) -> list[Estimate]:
    """List the levers of a plan with their estimated gain, largest first.

    A frame keeps the better direction along each axis. Levers that are not estimated come last.

    Args:
        schedule: the plan.
        job: its job.
        tasks: its task file.
    """
    every = [*levers(documents_of(tasks)), *joint_speeds(job.cell.robot)]
    candidates = [lever for lever in every if _matters(lever, schedule, job)]
    return _ranked(estimated(schedule, job, tasks, candidates))


def estimated(
    schedule: Schedule, job: Job, tasks: Path, candidates: Sequence[Lever]
) -> list[Estimate]:
    """Estimate the gain of given levers, in their order.

    Args:
        schedule: the plan.
        job: its job.
        tasks: its task file.
        candidates: the levers.
    """
    kept = KeptPlan(schedule, job)
    lengths, reasons = [], {}
    for k, lever in enumerate(candidates):
        try:
            length = lengths_under(kept, lever, tasks)
        except DualArmError as error:
            reasons[k] = str(error)
            continue
        if isinstance(length, str):
            reasons[k] = length
        else:
            lengths.append((k, length))
    times = retimed(schedule, kept.pieces, np.array([row for _, row in lengths])) if lengths else ()
    gains = {
        k: schedule.duration - float(time) for (k, _), time in zip(lengths, times, strict=True)
    }
    alone = _gain_without_stages(kept)
    for k, lever in enumerate(candidates):
        is_free = lever.values == {"tasks:/mode": "free"} and reasons[k] == ONLY_PLANNED
        if is_free and alone is not None:
            gains[k], reasons[k] = alone, ""
    return [Estimate(lever, gains.get(k), reasons.get(k, "")) for k, lever in enumerate(candidates)]


def _gain_without_stages(kept: KeptPlan) -> float | None:
    """Estimate the gain of arms that no longer start stages together [s].

    None where more than the stages makes arms wait: a platform, rules of tasks, windows or parts.
    """
    schedule, job = kept.schedule, kept.job
    ruled = any(task.after or task.not_before > 0.0 for task in job.tasks)
    ruled = ruled or job.has_handovers or job.moves or bool(job.buffers)
    if schedule.robot.platform or ruled or not schedule.segments:
        return None
    busy = dict.fromkeys(schedule.robot.arms, 0.0)
    for piece in kept.pieces:
        busy[piece.group] += piece.length
    gain = schedule.duration - max(busy.values())
    return gain if gain > SAME_TIME else 0.0


def _matters(lever: Lever, schedule: Schedule, job: Job) -> bool:
    """Return whether a lever may change a plan."""
    if lever.name == MASS:
        return limits_torques(job.cell)
    if lever.name == BLEND:
        return any(stop.action == "move" for task in job.tasks for stop in task.stops)
    return lever.name != CLEARANCE or schedule.clearance_cost != 0.0


def lengths_under(kept: KeptPlan, lever: Lever, tasks: Path) -> np.ndarray | str:
    """Estimate the times of the plan's pieces under a lever, or return the reason against."""
    if lever.kind == "robot":
        changed = with_raised_limits(kept.job, lever)
    else:
        changed = load_job(tasks, tasks.name, lever.values)
    if not lever.is_modelled:
        return ONLY_PLANNED
    if not kept.is_modelled:
        return "parts on belts are met at other times then"
    lengths = kept.lengths(changed)
    return "a posture of the plan is out of reach then" if lengths is None else lengths


def with_raised_limits(job: Job, lever: Lever) -> Job:
    """Raise the limits of joints that a lever changes; reading the robot again would take longer."""
    robot = job.cell.robot
    raised = {(joint, "velocity") for joint in lever.faster}
    for key in lever.values:
        role, _, pointer = key.partition(":")
        *_, joint, rate = pointer_steps(pointer)
        raised.add((joint_name(role, joint), rate))
    factors = {
        rate: np.array([SIZES.faster if (name, rate) in raised else 1.0 for name in robot.joints])
        for rate in ("velocity", "acceleration", "jerk")
    }
    rates = {rate: factor * getattr(robot.limits, rate) for rate, factor in factors.items()}
    limits = replace(robot.limits, **rates)
    return replace(job, cell=replace(job.cell, robot=replace(robot, limits=limits)))


def _ranked(estimates: Sequence[Estimate]) -> list[Estimate]:
    best: dict[str, Estimate] = {}
    for estimate in estimates:
        name = estimate.lever.name
        if name not in best or _gain(estimate) > _gain(best[name]):
            best[name] = estimate
    return sorted(best.values(), key=lambda estimate: -_gain(estimate))


def _gain(estimate: Estimate) -> float:
    return -np.inf if estimate.gain is None else estimate.gain
