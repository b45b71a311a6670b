"""Stages of a schedule for reports: segments, deciding arm, corners passed in motion.

Corners are outer ends of lines and targets of moves; each has its speed and the limit that is nearest.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from dualarm_cli.geometry.elementary import cbrt
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.model.job import Job, PoseTarget, Stop, StopKey
from dualarm_cli.model.lines import Line, LineDirection
from dualarm_cli.model.motion.trajectory import SAME_TIME, Trajectory
from dualarm_cli.model.schedule import Event, Schedule, Segment, Stage
from dualarm_cli.motion.waiting import MOVES, whole_transfers
from dualarm_cli.records import dataclass, field_values
from dualarm_cli.timing.spline import largest_rates
from dualarm_cli.verification.measuring.tool_model import ToolModel


@dataclass(frozen=True)
class CornerSettings:
    """Resolution of passed corners."""

    stands: float = 1e-9
    """Displacement below which a joint is at rest [rad]."""
    at_rest: float = 1e-6
    """Speed below which a joint is at rest, apart from rounding [rad/s or m/s]."""
    instants: int = 200
    """Instants per transfer at which a tool's deviation is evaluated."""
    whole: float = 1e-6
    """Tolerance at which a line counts as straight over its whole length [m]."""
    at_once: int = 64
    """Number of lines per batch."""


CORNERS = CornerSettings()

PLATFORM = "platform"
"""Name of the platform joints' group; an arm's group has its name."""


@dataclass(frozen=True)
class StageParts:
    """Segments of one stage by arm."""

    stage: Stage
    """The stage in the schedule."""
    arms: Mapping[str, tuple[Segment, ...]]
    """Segments of each arm in time order, without waits.

    Arms that only wait are omitted. A transfer lasts from the departure of the arm until its line
    may begin, waiting for the platform included.

    A transfer lasts from the departure of the arm until its line may begin, waiting for the
    platform included.
    """
    critical: str
    """Arm that ends the stage; empty without work.

    In a hand-over it is the arm that arrives last.
    """
    group: str
    """Joint group that decides the critical arm's transfer, or the stage without work.

    It is an arm's name, `platform`, or empty.
    """

    def length(self, arm: str, *kinds: str) -> float:
        """Sum the time of an arm's segments of the given kinds [s]."""
        parts = self.arms.get(arm, ())
        return sum((part.end - part.start for part in parts if part.kind in kinds), 0.0)

    def arrival(self, arm: str) -> float:
        """Compute the end of an arm's transfer [s], by default the stage's start."""
        return _arrival(self.arms.get(arm, ()), self.stage)


def is_handover(arms: Mapping[str, Sequence[Segment]]) -> bool:
    """Check whether a stage is a hand-over: lines begin when both arms have arrived."""
    return any(part.action == "give" for parts in arms.values() for part in parts)


def _arrival(parts: Sequence[Segment], stage: Stage) -> float:
    return max((part.end for part in parts if part.kind in MOVES), default=stage.start)


def overlap(stages: Sequence[Stage]) -> bool:
    """Check whether any stage begins before the previous one ends.

    The arms then run asynchronously.
    """
    return any(later.start < before.end - SAME_TIME for before, later in pairwise(stages))


def stage_parts(schedule: Schedule) -> list[StageParts]:
    """Split a schedule into stages with their segments.

    In a schedule without stages the k-th events of all arms form stage k, which ends with their dwells. In one without
    segments an arm's segments are split at its events.

    Args:
        schedule: of any origin; its times must be finite.
    """
    stages = schedule.stages or _stages_of_events(schedule)
    segments = schedule.segments or _segments_of_events(schedule, stages)
    per_stage: list[dict[str, list[Segment]]] = [{} for _ in stages]
    whole = whole_transfers(sorted(segments, key=lambda part: part.start)) if stages else []
    parts = [part for part in whole if part.kind != "wait"]
    for part, k in zip(parts, stages_of(parts, stages), strict=True):
        per_stage[k].setdefault(part.arm, []).append(part)
    return [
        _parts(
            schedule,
            stage,
            {
                name: tuple(sorted(segments_of_arm, key=lambda p: p.start))
                for name, segments_of_arm in arms.items()
            },
        )
        for stage, arms in zip(stages, per_stage, strict=True)
    ]


def stages_of(parts: Sequence[Segment], stages: Sequence[Stage]) -> list[int]:
    """Find the stage of each segment: the last one begun by its middle.

    Among overlapping stages it must be of the segment's task.

    Several overlapping stages are ranked by the shared time, then the shorter one.
    """
    middles = [(part.start + part.end) / 2.0 for part in parts]
    starts = np.array([stage.start for stage in stages])
    started = np.maximum(np.searchsorted(starts, middles, side="right") - 1, 0)
    if not overlap(stages):
        return [int(k) for k in started]
    by_task: dict[str, list[int]] = {}
    for k, stage in enumerate(stages):
        for task in dict.fromkeys(stage.tasks or ("",)):
            by_task.setdefault(task, []).append(k)

    indices = []
    for part, last in zip(parts, started, strict=True):
        ranked = []
        for k in by_task.get(part.task, []):
            shared = min(stages[k].end, part.end) - max(stages[k].start, part.start)
            if shared >= -SAME_TIME:
                ranked.append((-round(shared, 9), stages[k].end - stages[k].start, k))
        indices.append(min(ranked)[-1] if ranked else int(last))
    return indices


def _parts(schedule: Schedule, stage: Stage, arms: Mapping[str, tuple[Segment, ...]]) -> StageParts:
    ends = {name: parts[-1].end for name, parts in arms.items()}
    if is_handover(arms):
        # Both wait for the arm that arrives last; the order of departure is irrelevant.
        ends = {name: _arrival(parts, stage) for name, parts in arms.items()}
    last = max(ends.values(), default=0.0)
    candidates = [name for name, end in ends.items() if end >= last - SAME_TIME]
    # Among arms that end together, prefer the stated bottleneck of the stage.
    named = [name for name in candidates if _group_of(schedule, stage.bottleneck) == name]
    critical = (named or candidates or [""])[0]
    return StageParts(stage, arms, critical, _deciding_group(schedule, stage, arms, critical))


def _deciding_group(
    schedule: Schedule, stage: Stage, arms: Mapping[str, tuple[Segment, ...]], critical: str
) -> str:
    """Find the group that decides the duration of the critical arm's transfer."""
    if not critical:
        return _group_of(schedule, stage.bottleneck)
    if not any(part.kind in MOVES for part in arms.get(critical, ())):
        return ""
    if any(part.kind == "return" for part in arms[critical]) or not stage.arm_times:
        return _group_of(schedule, stage.bottleneck) or critical
    arm_time = stage.arm_times.get(critical, 0.0)
    return PLATFORM if stage.platform_time > arm_time else critical


def _group_of(schedule: Schedule, joint: str) -> str:
    """Find the group of a joint, or an empty string."""
    if joint in schedule.robot.platform:
        return PLATFORM
    groups = (name for name, arm in schedule.robot.arms.items() if joint in arm.joints)
    return next(groups, "")


def _stages_of_events(schedule: Schedule) -> tuple[Stage, ...]:
    """Build stages of one event per arm, ended by dwells, and a remainder."""
    groups: list[list[Event]] = []
    for event in sorted(schedule.events, key=lambda event: (event.time, event.arm)):
        if not groups or any(event.arm == earlier.arm for earlier in groups[-1]):
            groups.append([])
        groups[-1].append(event)
    clock, last = float(schedule.trajectory.time[0]), float(schedule.trajectory.time[-1])
    stages = []
    for k, group in enumerate(groups):
        # Asynchronous arms may dwell into each other's next stage.
        following = groups[k + 1][0].time if k + 1 < len(groups) else last
        until = min(following, max(event.time + event.dwell for event in group))
        until = max(clock, until)
        stages.append(_stage(clock, until, tuple(event.task for event in group)))
        clock = until
    return (*stages, _stage(clock, last, ())) if last > clock + SAME_TIME else tuple(stages)


def _stage(start: float, end: float, tasks: tuple[str, ...]) -> Stage:
    return Stage(start, end, tasks, "", None, 0.0, {}, {}, "")


def _segments_of_events(schedule: Schedule, stages: tuple[Stage, ...]) -> tuple[Segment, ...]:
    """Split the motion at events: transfers, dwells, and the motion after the last."""
    segments = []
    for k, stage in enumerate(stages):
        # An event may fall on a stage's end; on its start only where there is no stage before.
        after = stage.start + (SAME_TIME if k else -SAME_TIME)
        for name, arm in schedule.robot.arms.items():
            clock, seen = stage.start, None
            for event in schedule.events:
                if event.arm == name and after < event.time <= stage.end + SAME_TIME:
                    seen, rest = event, event.time + event.dwell
                    who = (name, event.task, event.action)
                    segments.append(_segment(who, "transfer", clock, event.time))
                    segments.append(_segment(who, "dwell", event.time, rest))
                    clock = rest
            still = _stands_from(schedule.trajectory, arm.joints, clock, stage.end)
            kind = "retract" if seen is not None else "return"
            who = (name, seen.task, seen.action) if seen is not None else (name, "", "")
            segments.append(_segment(who, kind, clock, still))
    return tuple(part for part in segments if part.end > part.start + SAME_TIME)


def _segment(who: tuple[str, str, str], kind: str, start: float, end: float) -> Segment:
    arm, task, action = who
    return Segment(arm, kind, task, action, start, end)  # type: ignore[arg-type]


def _stands_from(
    trajectory: Trajectory, joints: tuple[str, ...], start: float, end: float
) -> float:
    """Find the time from which the joints keep their positions at `end` [s]."""
    columns = [trajectory.joints.index(name) for name in joints]
    inside = trajectory.time[(trajectory.time > start) & (trajectory.time < end)]
    time = np.concatenate([[start], inside, [end]])
    q = trajectory.clamped(time)[0][:, columns]
    moving = np.flatnonzero((np.abs(q - q[-1]) > CORNERS.stands).any(axis=1))
    return float(time[moving[-1] + 1]) if len(moving) else start


@dataclass(frozen=True)
class Corner:
    """Corner that a tool passes in motion.

    The outer end of a line's straight part, or the target of a move.
    """

    arm: str
    """left or right."""
    task: str
    """Id of the task."""
    action: str
    """Action at the target, such as pick or place."""
    line: str
    """approach or retract; empty for a target."""
    time: float
    """Time at which the tool passes the corner [s]."""
    speed: float
    """Speed of the tool at the corner [m/s]."""
    joint: str
    """Joint nearest to one of its limits in the transfer at the corner.

    At a target, it is the transfer that leaves it.
    """
    limit: str
    """Limit that `joint` is nearest to: velocity, acceleration or jerk."""
    beside: float
    """Largest deviation from the line, or distance from the target [m].

    For a line: in the part that need not be straight.
    """


@dataclass(frozen=True)
class _Candidate:
    """Corner at which an arm may pass in motion or stop."""

    time: float
    """Time at which the tool is at the corner [s]."""
    transfer: Segment
    """Transfer at the corner; for a target the one that leaves it."""
    line: Segment | None = None
    """Approach or retract with this outer end."""
    event: Event | None = None
    """Event of the target of a move."""


def corners(schedule: Schedule, job: Job) -> list[Corner]:
    """Find the corners that tools pass in motion, in order of time.

    Args:
        schedule: a planned one.
        job: the planned job, its lines whole.
    """
    model, stops = ToolModel(schedule), job.stops_by_key()
    corners = []
    for arm in schedule.robot.arms:
        passed = _passed(schedule, arm)
        speeds = _speeds(schedule, model, arm, [candidate.time for candidate in passed])
        limiting = _limiting(schedule, arm, [candidate.transfer for candidate in passed])
        besides = _besides(schedule, model, arm, passed, stops)
        for k, (candidate, speed, named) in enumerate(zip(passed, speeds, limiting, strict=True)):
            work = candidate.line or candidate.event
            assert work is not None
            stop = stops.get((arm, work.task, work.action))
            if candidate.line is not None:
                kind: str = candidate.line.kind
                off = besides.get(k, 0.0)
            else:
                kind, off = "", _off_target(candidate.event, stop)
            corners.append(
                Corner(arm, work.task, work.action, kind, candidate.time, speed, *named, off)
            )
    return sorted(corners, key=lambda corner: (corner.time, corner.arm))


def _passed(schedule: Schedule, arm: str) -> list[_Candidate]:
    """Select the corners of an arm at which it is in motion."""
    parts = sorted((p for p in schedule.segments if p.arm == arm), key=lambda p: p.start)
    near = []
    for k, part in enumerate(parts):
        if part.kind not in ("approach", "retract"):
            continue
        out = part.kind == "retract"
        neighbours = parts[k + 1 : k + 2] if out else parts[max(0, k - 1) : k]
        if neighbours and neighbours[0].kind in MOVES:
            near.append(_Candidate(part.end if out else part.start, neighbours[0], line=part))
    starts = [part.start for part in parts]
    for event in schedule.events:
        if (event.arm, event.action) != (arm, "move"):
            continue
        first = bisect_left(starts, event.time - SAME_TIME)
        last = bisect_right(starts, event.time + SAME_TIME)
        begun = [part for part in parts[first:last] if part.kind in MOVES]
        if begun:
            near.append(_Candidate(event.time, begun[0], event=event))
    velocity = schedule.trajectory.clamped(np.array([candidate.time for candidate in near]))[1]
    moves = np.abs(velocity[:, _columns(schedule, arm)]).max(axis=1) > CORNERS.at_rest
    return [candidate for candidate, moving in zip(near, moves, strict=True) if moving]


def blending_rows(schedule: Schedule, job: Job) -> dict[str, Any] | None:
    """Summarise the effect of blending, JSON-ready.

    None where tools stop at the outer ends of lines.
    """
    if schedule.blend_gain is None:
        return None
    passed = corners(schedule, job)
    stopping = schedule.duration + schedule.blend_gain
    return {
        "gain": schedule.blend_gain,
        "share": schedule.blend_gain / stopping if stopping > 0.0 else 0.0,
        "largest_deviation": max((corner.beside for corner in passed if corner.line), default=0.0),
        "corners": [field_values(corner) for corner in passed],
    }


def _off_target(event: Event | None, stop: Stop | None) -> float:
    """Compute the distance of a tool from its target at an event [m].

    0 without an event, or where the target is not a pose.
    """
    if event is None or stop is None or not isinstance(stop.target, PoseTarget):
        return 0.0
    return float(norm(event.pose.translation - stop.target.pose.translation))


def _columns(schedule: Schedule, arm: str) -> list[int]:
    return [schedule.trajectory.joints.index(name) for name in schedule.robot.arms[arm].joints]


def _speeds(schedule: Schedule, model: ToolModel, arm: str, times: Sequence[float]) -> list[float]:
    """Compute a tool's speeds at instants [m/s], by central differences."""
    step = 1e-5
    around = np.array(times)[:, None] + np.array([-step, step])
    _, p = model.poses(arm, schedule.trajectory.clamped(around.ravel())[0])
    return [float(norm(step_vector)) / (2.0 * step) for step_vector in p[1::2] - p[::2]]


def _limiting(schedule: Schedule, arm: str, parts: Sequence[Segment]) -> list[tuple[str, str]]:
    """Find the joint nearest to a limit in each part, and that limit."""
    limits = schedule.robot.limits.select(schedule.robot.arms[arm].joints)
    motion = schedule.trajectory.select(limits.joints)
    # A transfer between two lines has a corner at both ends.
    nearest: dict[tuple[float, float], tuple[str, str]] = {}
    for part in parts:
        if (part.start, part.end) in nearest:
            continue
        low, high = np.searchsorted(motion.time, (part.start - 1e-9, part.end + 1e-9))
        rows = slice(int(low), int(high))
        rates = largest_rates(motion.time[rows], motion.velocity[rows], motion.acceleration[rows])
        # Factors by which the segment could be faster under each limit alone.
        shares = np.stack(
            [
                rates[0] / limits.velocity,
                np.sqrt(rates[1] / limits.acceleration),
                cbrt(rates[2] / limits.jerk),
            ]
        )
        which, joint = divmod(int(np.argmax(shares)), shares.shape[1])
        limit = ("velocity", "acceleration", "jerk")[which]
        nearest[part.start, part.end] = limits.joints[joint], limit
    return [nearest[part.start, part.end] for part in parts]


def _besides(
    schedule: Schedule,
    model: ToolModel,
    arm: str,
    passed: Sequence[_Candidate],
    stops: Mapping[StopKey, Stop],
) -> dict[int, float]:
    """Compute the tool's deviations from lines that continue beyond their straight parts.

    They count while the tool is no farther out than the end of the whole line.

    Args:
        schedule: a planned one.
        model: its tools.
        arm: arm of the tool.
        passed: its corners.
        stops: those of the job, their lines whole.

    Returns:
        Largest deviations [m] by the index of the corner, of those lines only.
    """
    ended = [
        (k, candidate.line, candidate.transfer)
        for k, candidate in enumerate(passed)
        if candidate.line is not None
    ]
    deviations: dict[int, float] = {}
    for first in range(0, len(ended), CORNERS.at_once):
        batch = ended[first : first + CORNERS.at_once]
        out = np.array([line.kind == "retract" for _, line, _ in batch])
        spans = np.array([(line.start, line.end) for _, line, _ in batch])
        ends = np.where(out[:, None], spans, spans[:, ::-1])
        R, p = model.poses(arm, schedule.trajectory.clamped(ends.ravel())[0])
        R, p = R[::2], p.reshape(-1, 2, 3)
        lines = [_line_of(stops, arm, line) for _, line, _ in batch]
        pairs = zip(lines, R, strict=True)
        R = np.array([product(R_tool, line.axes(R_tool)) for (_, line), R_tool in pairs])
        straight = -np.einsum("ki,kij->kj", p[:, 1] - p[:, 0], R)[:, 2]
        for row, (k, _, transfer) in enumerate(batch):
            length = lines[row][0]
            if straight[row] >= length - CORNERS.whole:
                continue
            along = np.linspace(transfer.start, transfer.end, CORNERS.instants)
            places = model.poses(
                arm, schedule.trajectory.clamped(along[:: 1 if out[row] else -1])[0]
            )[1]
            local = product(places - p[row, 0], R[row])
            beyond = np.flatnonzero(-local[:, 2] > length)
            within = local[: beyond[0] if len(beyond) else None]
            deviations[k] = float(np.hypot(within[:, 0], within[:, 1]).max(initial=0.0))
    return deviations


def _line_of(stops: Mapping[StopKey, Stop], arm: str, part: Segment) -> Line:
    """Return length and direction of a job's line; no length without one."""
    stop = stops.get((arm, part.task, part.action))
    return (0.0, LineDirection()) if stop is None else stop.lines[part.kind == "retract"]
