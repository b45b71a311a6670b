"""Messages about paths: notes on followed ones, reasons for refused ones."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from itertools import pairwise

import numpy as np

from dualarm_cli.kinds.path.context import PathContext
from dualarm_cli.kinds.path.motion import FollowedPath, Refused, Remedy
from dualarm_cli.kinematics.whole_body import Reached
from dualarm_cli.model.job import Job, Task
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.process_work import PathWork
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.notes import NoteTable
from dualarm_cli.refusals import Refusal

AT_LIMIT = 2e-3
"""Distance from its limit below which a joint is called at it [rad]."""
SLOWED = 1.001
"""Ratio of durations above which a note is given."""
REMEDIES: Mapping[Remedy, tuple[str, ...]] = {
    "slower": ("allow_slower", "lower_speed", "method"),
    "limit": ("move_path", "other_posture"),
    "other": ("move_path", "other_posture", "method"),
    "clear": ("move_path_or_obstacle", "other_posture", "method"),
    "tolerance": ("tolerance", "method"),
}
"""Remedies for each cause of a refusal."""


_note = NoteTable(
    "paths",
    platform_turns="platform fixed holds the platform between paths; where they begin, and on paths of "
    "methods for the whole body, it turns (redundancy arm_angle: only to where they begin)",
    in_turn="paths {first} and {then} are followed one after the other; write both tools' curves into one path "
    "(left:, right:) to follow them together",
    capped="{task}: followed at {cap:g} m/s, the limit of the tools' speed, instead of {speed:g} m/s",
    slowed="{task}: takes {duration:.3f} s instead of {requested:.3f} s, because of the joints' limits",
    corners="{task}: the tool stops at {corners:one corner|# corners}; give a (larger) `blend`, or arcs or "
    "splines, to keep it moving",
    critical_points="{task}: critical points of {arms:* and } are assumed: below the shoulder by the length of "
    "the upper arm",
)
"""Notes on plans with paths."""


def path_job_notes(job: Job, method: str, trajectory: Trajectory) -> list[str]:
    """List notes on a job with paths as a whole.

    Args:
        job: with paths.
        method: of its stops.
        trajectory: its motion.
    """
    notes: list[str] = []
    columns = job.cell.robot.columns(job.cell.robot.platform)
    if method == "fixed" and np.ptp(trajectory.position[:, columns], axis=0).max(initial=0.0) > 0.0:
        notes.append(_note("platform_turns"))
    sections = [section for section in job.sections() if section[0].path is not None]
    for first, second in pairwise(sections):
        if not {task.arm for task in first} & {task.arm for task in second}:
            notes.append(_note("in_turn", first=first[0].id, then=second[0].id))
    return notes


def path_notes(context: PathContext, task: str, path: FollowedPath, name: str) -> list[str]:
    """List notes on a followed path and its method."""
    note = partial(_note, task=task)
    notes, work = list[str](), path.work
    cap, speed = context.job.tool_speed, work.speed * context.job.speed
    if cap is not None and cap < speed:
        notes.append(note("capped", cap=cap, speed=speed))
    if path.trajectory.duration > path.requested_duration * SLOWED:
        notes.append(
            note("slowed", duration=path.trajectory.duration, requested=path.requested_duration)
        )
    if corners := work.corners():
        notes.append(note("corners", corners=corners))
    missing = [arm for arm in work.paths if arm not in work.critical_points]
    if missing and name.startswith("virtual_spring"):
        notes.append(note("critical_points", arms=missing))
    return notes


def why_not(
    section: tuple[Task, ...],
    work: PathWork,
    name: str,
    refusals: list[Refused],
    nearest: Reached,
    limits: JointLimits,
) -> Refusal:
    """Explain why a path cannot be followed, by the start that gets farthest."""
    subject = work.place, section[0].id, " and ".join(task.arm for task in section)
    details: dict[str, object]
    if not refusals:
        room = np.minimum(nearest.q - limits.lower, limits.upper - nearest.q)
        joints = [
            name for name, distance in zip(limits.joints, room, strict=True) if distance < AT_LIMIT
        ]
        details = {
            "near": [Refusal("near_posture", data={"posture": work.posture})] * bool(work.posture),
            "mm": nearest.distance * 1e3,
            "degrees": np.rad2deg(nearest.angle),
            "at_limit": [Refusal("joints_at_limit", data={"joints": joints})] * bool(joints),
        }
        return Refusal("path_out_of_reach", *subject, nearest.distance, data=details)
    best = max(refusals, key=lambda refused: refused.share)
    # Lower speed was tried already if the file allows it.
    helps: Remedy = "other" if best.remedy == "slower" and work.slower else best.remedy
    details = {"method": name, "causes": refusals, "cause": best.reason}
    return Refusal("path_not_followed", *subject, remedy=REMEDIES[helps], data=details)
