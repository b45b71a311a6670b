"""Outer ends of lines and targets of moves that tools pass in motion: how fast, what limits it, and what it saves."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.job import Job, PoseTarget, Stop
from dualarm_cli.model.schedule import Event, Schedule, Segment
from dualarm_cli.motion.waiting import MOVES, SAME_TIME
from dualarm_cli.timing.spline import largest_rates
from dualarm_cli.verification.tool_model import ToolModel

AT_REST = 1e-6
"""Joints that are slower stand, but for the rounding of instants [rad/s or m/s]."""
INSTANTS = 200
"""Instants at which a tool is looked at beyond the straight part of a line."""


@dataclass(frozen=True)
class Corner:
    """The outer end of a line's straight part, or the target of a move, which a tool passes in motion."""

    arm: str
    """left or right."""
    task: str
    """Id of the task."""
    action: str
    """What is done at the target, such as pick or place."""
    line: str
    """approach or retract; empty for a target."""
    time: float
    """When the tool is there [s]."""
    speed: float
    """How fast it is there [m/s]."""
    joint: str
    """The joint that is nearest to one of its limits in the transfer beside it, of a target the one that leaves it."""
    limit: str
    """Which limit that is: velocity, acceleration or jerk."""
    beside: float
    """How far the tool leaves the line in the part of it that need not be straight; of a target, how far beside it the
    tool passes [m]."""


def corners(schedule: Schedule, job: Job) -> list[Corner]:
    """Returns the corners of a schedule in order of time.

    Args:
        schedule: a planned one.
        job: what it was planned for, its lines whole.
    """
    model, found = ToolModel(schedule), []
    stops = job.stops_by_key()
    whole = {key: {"approach": s.approach, "retract": s.retract} for key, s in stops.items()}
    for arm in schedule.robot.arms:
        parts = sorted((p for p in schedule.segments if p.arm == arm), key=lambda p: p.start)
        for k, part in enumerate(parts):
            if part.kind not in ("approach", "retract"):
                continue
            out = part.kind == "retract"
            beside = parts[k + 1 : k + 2] if out else parts[max(0, k - 1) : k]
            time = part.end if out else part.start
            if not beside or beside[0].kind not in MOVES or not _moves(schedule, arm, time):
                continue
            length = whole.get((arm, part.task, part.action), {}).get(part.kind, 0.0)
            joint, limit = _limiting(schedule, arm, beside[0])
            found.append(
                Corner(
                    arm,
                    part.task,
                    part.action,
                    part.kind,
                    time,
                    _speed(schedule, model, arm, time),
                    joint,
                    limit,
                    _beside(schedule, model, (part, beside[0]), length),
                )
            )
        starts = [part.start for part in parts]
        for event in schedule.events:
            if (event.arm, event.action) != (arm, "move"):
                continue
            first = bisect_left(starts, event.time - SAME_TIME)
            last = bisect_right(starts, event.time + SAME_TIME)
            begun = [part for part in parts[first:last] if part.kind in MOVES]
            if begun and _moves(schedule, arm, event.time):
                speed = _speed(schedule, model, arm, event.time)
                limiting = _limiting(schedule, arm, begun[0])
                named = event.task, event.action, ""
                off = _off_target(event, stops.get((arm, event.task, event.action)))
                found.append(Corner(arm, *named, event.time, speed, *limiting, off))
    return sorted(found, key=lambda corner: (corner.time, corner.arm))


def blending_rows(schedule: Schedule, job: Job) -> dict[str, Any] | None:
    """Returns what blending did, JSON-ready; None where tools stop at lines' outer ends."""
    if schedule.blend_gain is None:
        return None
    found = corners(schedule, job)
    stopping = schedule.duration + schedule.blend_gain
    return {
        "gain": schedule.blend_gain,
        "share": schedule.blend_gain / stopping if stopping > 0.0 else 0.0,
        "largest_deviation": max((one.beside for one in found if one.line), default=0.0),
        "corners": [asdict(corner) for corner in found],
    }


def _off_target(event: Event, stop: Stop | None) -> float:
    """Returns how far a tool is from its target at an event [m]."""
    if stop is None or not isinstance(stop.target, PoseTarget):
        return 0.0
    return float(np.linalg.norm(event.pose.translation - stop.target.pose.translation))


def _columns(schedule: Schedule, arm: str) -> list[int]:
    return [schedule.trajectory.joints.index(name) for name in schedule.robot.arms[arm].joints]


def _moves(schedule: Schedule, arm: str, time: float) -> bool:
    velocity = schedule.trajectory.at(np.array([time]))[1][0, _columns(schedule, arm)]
    return bool(np.abs(velocity).max() > AT_REST)


def _speed(schedule: Schedule, model: ToolModel, arm: str, time: float) -> float:
    """Returns a tool's speed at an instant [m/s], by a central difference."""
    step = 1e-5
    _, p = model.poses(arm, schedule.trajectory.at(np.array([time - step, time + step]))[0])
    return float(np.linalg.norm(p[1] - p[0]) / (2.0 * step))


def _limiting(schedule: Schedule, arm: str, part: Segment) -> tuple[str, str]:
    """Returns the joint that uses the largest share of a limit in a part, and which limit it is."""
    limits = schedule.robot.limits.select(schedule.robot.arms[arm].joints)
    motion = schedule.trajectory
    low, high = np.searchsorted(motion.time, (part.start - 1e-9, part.end + 1e-9))
    rows, columns = slice(int(low), int(high)), _columns(schedule, arm)
    rates = largest_rates(
        motion.time[rows], motion.velocity[rows][:, columns], motion.acceleration[rows][:, columns]
    )
    # Times: by how much the part could be played faster for each limit alone.
    shares = np.stack(
        [
            rates[0] / limits.velocity,
            np.sqrt(rates[1] / limits.acceleration),
            np.cbrt(rates[2] / limits.jerk),
        ]
    )
    which, joint = np.unravel_index(int(np.argmax(shares)), shares.shape)
    return limits.joints[int(joint)], ("velocity", "acceleration", "jerk")[int(which)]


def _beside(
    schedule: Schedule, model: ToolModel, parts: tuple[Segment, Segment], length: float
) -> float:
    """Returns how far a tool gets from its line while it is no farther out than the whole line's end [m].

    Args:
        schedule: the plan.
        model: where its tools are.
        parts: the line and the transfer beside it.
        length: of the whole line [m].
    """
    line, transfer = parts
    out = line.kind == "retract"
    inner, outer = (line.start, line.end) if out else (line.end, line.start)
    times = np.linspace(transfer.start, transfer.end, INSTANTS)
    R, p = model.poses(line.arm, schedule.trajectory.at(np.append([inner, outer], times))[0])
    local: FloatArray = (p - p[0]) @ R[0]
    depth = -local[2:, 2] if out else -local[:1:-1, 2]
    off = (
        np.hypot(local[2:, 0], local[2:, 1]) if out else np.hypot(local[:1:-1, 0], local[:1:-1, 1])
    )
    straight = -float(local[1, 2])
    if straight >= length - 1e-6:
        return 0.0
    gone = np.flatnonzero(depth > length)
    within = off[: int(gone[0])] if len(gone) else off
    return float(within.max(initial=0.0))
