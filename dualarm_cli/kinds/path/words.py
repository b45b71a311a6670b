"""What a reader is told of paths: how they are followed, why they cannot be, methods that there are not."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

import numpy as np

from dualarm_cli.kinds.path.context import PathContext
from dualarm_cli.kinds.path.motion import FollowedPath, Refused, Remedy
from dualarm_cli.kinematics.whole_body import Reached
from dualarm_cli.model.job import Job, Task
from dualarm_cli.model.path_work import PathWork
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.model.trajectory import Trajectory

AT_LIMIT = 2e-3
"""Distance from its limit at which a joint is called at it [rad]."""
SLOWED = 1.001
"""Durations longer by this factor are worth a word."""
REMEDIES: Mapping[Remedy, str] = {
    "slower": "lower its speed, acceleration or jerk, or choose another method (--redundancy)",
    "other": "move the path or turn the tool, begin near another posture (posture:), or choose another method "
    "(--redundancy)",
    "clear": "move the path or what is in its way, begin near another posture (posture:), or choose another method "
    "(--redundancy)",
    "tolerance": "raise its tolerance, or choose another method (--redundancy)",
}
"""What a reader may do about a refusal."""


def path_job_notes(job: Job, method: str, trajectory: Trajectory) -> list[str]:
    """Returns what a reader must know of a job with paths as a whole.

    Args:
        job: with paths.
        method: of its stops.
        trajectory: its motion.
    """
    notes = []
    columns = job.cell.robot.columns(job.cell.robot.platform)
    if method == "fixed" and np.ptp(trajectory.position[:, columns], axis=0).max(initial=0.0) > 0.0:
        notes.append(
            "--platform fixed holds the platform between paths; where they begin, and on paths of methods for the "
            "whole body, it turns (--redundancy arm_angle: only to where they begin)"
        )
    sections = [section for section in job.sections() if section[0].path is not None]
    for one, other in pairwise(sections):
        arms = [{task.arm for task in section} for section in (one, other)]
        if not arms[0] & arms[1]:
            notes.append(
                f"paths {one[0].id} and {other[0].id} are followed one after the other; write both tools' ways into "
                "one path (left:, right:) to follow them together"
            )
    return notes


def path_notes(
    context: PathContext, task: str, work: PathWork, found: FollowedPath, name: str
) -> list[str]:
    """Returns what a reader must know of how a path is followed."""
    notes = []
    cap, speed = context.job.tool_speed, work.speed * context.job.speed
    if cap is not None and cap < speed:
        notes.append(
            f"{task}: followed at {cap:g} m/s, the cap on the tools' speed, not at {speed:g} m/s"
        )
    if found.trajectory.duration > found.asked * SLOWED:
        notes.append(
            f"{task}: eases off where the joints' limits ask for it, {found.trajectory.duration:.3f} s "
            f"instead of {found.asked:.3f} s"
        )
    if corners := len(work.corners()):
        stops = "stops at one corner" if corners == 1 else f"stops at {corners} corners"
        notes.append(
            f"{task}: the tool {stops}; arcs and splines in their place would keep it moving"
        )
    if name.startswith("virtual_spring"):
        missing = [arm for arm in work.paths if arm not in work.critical_points]
        if missing:
            notes.append(
                f"{task}: critical points of {' and '.join(missing)} are assumed: below the shoulder by the length of "
                "the upper arm"
            )
    return notes


def why_not(
    section: tuple[Task, ...],
    work: PathWork,
    name: str,
    refusals: list[Refused],
    nearest: Reached,
    limits: JointLimits,
) -> str:
    """Returns why a path cannot be followed: the start from which most of it could be."""
    arms = " and ".join(task.arm for task in section)
    head = f"{work.place}: task '{section[0].id}' ({arms}): "
    if not refusals:
        near = f" near posture '{work.posture}'" if work.posture else ""
        return (
            f"{head}no configuration within the joints' limits{near} has the tools where the path begins: at best they "
            f"are {nearest.distance * 1e3:.1f} mm and {np.rad2deg(nearest.angle):.1f} deg away"
            f"{_limit_words(nearest, limits)}; move the path, or turn the tool, or name another posture"
        )
    best = max(refusals, key=lambda one: one.share)
    tried = "any of its starts" if len(refusals) == 1 else f"any of {len(refusals)} starts"
    return f"{head}{name} cannot follow it from {tried}; {best.reason}; {_remedy(best, work)}"


def _limit_words(nearest: Reached, limits: JointLimits) -> str:
    """Returns which joints are at their limits, or nothing."""
    room = np.minimum(nearest.q - limits.lower, limits.upper - nearest.q)
    names = [name for name, left in zip(limits.joints, room, strict=True) if left < AT_LIMIT]
    return f", {', '.join(names)} at a limit" if names else ""


def _remedy(refused: Refused, work: PathWork) -> str:
    """Returns what a reader may do about a refusal."""
    if refused.remedy == "slower" and not work.slower:
        return f"allow it to be slower (slower: allowed), {REMEDIES['slower']}"
    # Where the file allows less speed, that has been tried.
    return REMEDIES["other" if refused.remedy == "slower" else refused.remedy]
