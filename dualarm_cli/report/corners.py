"""Outer ends of lines and targets of moves that tools pass in motion: how fast, what limits it, and what it saves."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from dualarm_cli.geometry.elementary import cbrt
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.model.job import Job, PoseTarget, Stop, StopKey
from dualarm_cli.model.joint_motion import SAME_TIME
from dualarm_cli.model.schedule import Event, Schedule, Segment
from dualarm_cli.motion.waiting import MOVES
from dualarm_cli.records import dataclass, field_values
from dualarm_cli.timing.spline import largest_rates
from dualarm_cli.verification.tool_model import ToolModel

AT_REST = 1e-6
"""Joints that are slower stand, but for the rounding of instants [rad/s or m/s]."""
INSTANTS = 200
"""Instants at which a tool is looked at beyond the straight part of a line."""
WHOLE = 1e-6
"""A line of which no more than this need not be straight is straight as a whole [m]."""
AT_ONCE = 64
"""Lines that are looked at together."""


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


@dataclass(frozen=True)
class _Candidate:
    """Where an arm passes a corner, if it does not stand there."""

    time: float
    """When the tool is there [s]."""
    transfer: Segment
    """The transfer beside it, of a target the one that leaves it."""
    line: Segment | None = None
    """The approach or retract whose outer end it is."""
    event: Event | None = None
    """The target of a move that it is."""


def corners(schedule: Schedule, job: Job) -> list[Corner]:
    """Returns the corners of a schedule in order of time.

    Args:
        schedule: a planned one.
        job: what it was planned for, its lines whole.
    """
    model, stops = ToolModel(schedule), job.stops_by_key()
    found = []
    for arm in schedule.robot.arms:
        passed = _passed(schedule, arm)
        speeds = _speeds(schedule, model, arm, [one.time for one in passed])
        limiting = _limiting(schedule, arm, [one.transfer for one in passed])
        besides = _besides(schedule, model, arm, passed, stops)
        for k, (one, speed, named) in enumerate(zip(passed, speeds, limiting, strict=True)):
            work = one.line or one.event
            assert work is not None
            stop = stops.get((arm, work.task, work.action))
            if one.line is not None:
                kind: str = one.line.kind
                off = besides.get(k, 0.0)
            else:
                kind, off = "", _off_target(one.event, stop)
            found.append(Corner(arm, work.task, work.action, kind, one.time, speed, *named, off))
    return sorted(found, key=lambda corner: (corner.time, corner.arm))


def _passed(schedule: Schedule, arm: str) -> list[_Candidate]:
    """Returns the corners of an arm at which it is in motion."""
    parts = sorted((p for p in schedule.segments if p.arm == arm), key=lambda p: p.start)
    near = []
    for k, part in enumerate(parts):
        if part.kind not in ("approach", "retract"):
            continue
        out = part.kind == "retract"
        beside = parts[k + 1 : k + 2] if out else parts[max(0, k - 1) : k]
        if beside and beside[0].kind in MOVES:
            near.append(_Candidate(part.end if out else part.start, beside[0], line=part))
    starts = [part.start for part in parts]
    for event in schedule.events:
        if (event.arm, event.action) != (arm, "move"):
            continue
        first = bisect_left(starts, event.time - SAME_TIME)
        last = bisect_right(starts, event.time + SAME_TIME)
        begun = [part for part in parts[first:last] if part.kind in MOVES]
        if begun:
            near.append(_Candidate(event.time, begun[0], event=event))
    velocity = schedule.trajectory.at(np.array([one.time for one in near]))[1]
    moves = np.abs(velocity[:, _columns(schedule, arm)]).max(axis=1) > AT_REST
    return [one for one, moving in zip(near, moves, strict=True) if moving]


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
        "corners": [field_values(corner) for corner in found],
    }


def _off_target(event: Event | None, stop: Stop | None) -> float:
    """Returns how far a tool is from its target at an event [m]."""
    if event is None or stop is None or not isinstance(stop.target, PoseTarget):
        return 0.0
    return float(norm(event.pose.translation - stop.target.pose.translation))


def _columns(schedule: Schedule, arm: str) -> list[int]:
    return [schedule.trajectory.joints.index(name) for name in schedule.robot.arms[arm].joints]


def _speeds(schedule: Schedule, model: ToolModel, arm: str, times: Sequence[float]) -> list[float]:
    """Returns a tool's speeds at instants [m/s], by central differences."""
    step = 1e-5
    around = np.array(times)[:, None] + np.array([-step, step])
    _, p = model.poses(arm, schedule.trajectory.at(around.ravel())[0])
    return [float(norm(way)) / (2.0 * step) for way in p[1::2] - p[::2]]


def _limiting(schedule: Schedule, arm: str, parts: Sequence[Segment]) -> list[tuple[str, str]]:
    """Returns the joint that uses the largest share of a limit in each part, and which limit it is."""
    limits = schedule.robot.limits.select(schedule.robot.arms[arm].joints)
    motion = schedule.trajectory.select(limits.joints)
    # A transfer between two lines has a corner at both ends.
    found: dict[tuple[float, float], tuple[str, str]] = {}
    for part in parts:
        if (part.start, part.end) in found:
            continue
        low, high = np.searchsorted(motion.time, (part.start - 1e-9, part.end + 1e-9))
        rows = slice(int(low), int(high))
        rates = largest_rates(motion.time[rows], motion.velocity[rows], motion.acceleration[rows])
        # Times: by how much the part could be played faster for each limit alone.
        shares = np.stack(
            [
                rates[0] / limits.velocity,
                np.sqrt(rates[1] / limits.acceleration),
                cbrt(rates[2] / limits.jerk),
            ]
        )
        which, joint = divmod(int(np.argmax(shares)), shares.shape[1])
        limit = ("velocity", "acceleration", "jerk")[which]
        found[part.start, part.end] = limits.joints[joint], limit
    return [found[part.start, part.end] for part in parts]


def _besides(
    schedule: Schedule,
    model: ToolModel,
    arm: str,
    passed: Sequence[_Candidate],
    stops: Mapping[StopKey, Stop],
) -> dict[int, float]:
    """Returns how far the tool gets from its line while it is no farther out than the whole line's end [m].

    Args:
        schedule: a planned one.
        model: its tools.
        arm: whose.
        passed: its corners.
        stops: those of the job, their lines whole.

    Returns:
        By the place among the corners, of those at ends of lines that go on beyond their straight parts.
    """
    ended = [(k, one.line, one.transfer) for k, one in enumerate(passed) if one.line is not None]
    found: dict[int, float] = {}
    for first in range(0, len(ended), AT_ONCE):
        some = ended[first : first + AT_ONCE]
        out = np.array([line.kind == "retract" for _, line, _ in some])
        spans = np.array([(line.start, line.end) for _, line, _ in some])
        ends = np.where(out[:, None], spans, spans[:, ::-1])
        R, p = model.poses(arm, schedule.trajectory.at(ends.ravel())[0])
        R, p = R[::2], p.reshape(-1, 2, 3)
        straight = -np.einsum("ki,kij->kj", p[:, 1] - p[:, 0], R)[:, 2]
        for row, (k, line, transfer) in enumerate(some):
            stop = stops.get((arm, line.task, line.action))
            length = 0.0 if stop is None else getattr(stop, line.kind)
            if straight[row] >= length - WHOLE:
                continue
            along = np.linspace(transfer.start, transfer.end, INSTANTS)
            places = model.poses(arm, schedule.trajectory.at(along[:: 1 if out[row] else -1])[0])[1]
            local = product(places - p[row, 0], R[row])
            gone = np.flatnonzero(-local[:, 2] > length)
            within = local[: gone[0] if len(gone) else None]
            found[k] = float(np.hypot(within[:, 0], within[:, 1]).max(initial=0.0))
    return found
