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
from dualarm_cli.model.joint_motion import SAME_TIME
from dualarm_cli.model.schedule import Event, Schedule, Segment, Stage
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.motion.waiting import MOVES, whole_transfers
from dualarm_cli.records import dataclass, field_values
from dualarm_cli.timing.spline import largest_rates
from dualarm_cli.verification.tool_model import ToolModel


@dataclass(frozen=True)
class CornerSettings:
    """Resolution of passed corners."""

    stands: float = 1e-9
    """A joint that is off by less than this stands still [rad]."""
    at_rest: float = 1e-6
    """Joints that are slower stand, but for the rounding of instants [rad/s or m/s]."""
    instants: int = 200
    """Instants at which a tool is looked at beyond the straight part of a line."""
    whole: float = 1e-6
    """Tolerance at which a line counts as straight over its whole length [m]."""
    at_once: int = 64
    """Lines that are looked at together."""


CORNERS = CornerSettings()

PLATFORM = "platform"
"""Name of the group of the joints that carry both arms; the arms' groups bear the arms' names."""


@dataclass(frozen=True)
class StageParts:
    """One stage, arm by arm."""

    stage: Stage
    """What the schedule says of it."""
    arms: Mapping[str, tuple[Segment, ...]]
    """What each arm does, in time order; waiting is left out, and so are arms that only wait. A transfer lasts from
    when the arm leaves until its line may begin, waiting for the platform included."""
    critical: str
    """The arm whose last part ends the stage; in a hand-over the one that comes last; empty where no arm does
    anything."""
    group: str
    """Joint group that decides the critical arm's transfer, or the stage where no arm does anything: an arm's name,
    `platform`, or empty for none."""

    def length(self, arm: str, *kinds: str) -> float:
        """Return how long an arm spends on some kinds of parts [s]."""
        parts = self.arms.get(arm, ())
        return sum((part.end - part.start for part in parts if part.kind in kinds), 0.0)

    def arrival(self, arm: str) -> float:
        """Return when an arm's transfer is over [s]; the stage's start where it has none."""
        return _arrival(self.arms.get(arm, ()), self.stage)


def is_handover(arms: Mapping[str, Sequence[Segment]]) -> bool:
    """Return whether what the arms do in a stage is a hand-over: they begin their lines when both are there."""
    return any(part.action == "give" for parts in arms.values() for part in parts)


def _arrival(parts: Sequence[Segment], stage: Stage) -> float:
    return max((part.end for part in parts if part.kind in MOVES), default=stage.start)


def overlap(stages: Sequence[Stage]) -> bool:
    """Return whether any stage begins before the one before it ends: the arms run asynchronously."""
    return any(later.start < before.end - SAME_TIME for before, later in pairwise(stages))


def stage_parts(schedule: Schedule) -> list[StageParts]:
    """Return the stages of a schedule with their parts.

    Of a schedule without stages, as others may write it, the k-th event of each arm makes stage k, which ends with
    their dwells; of one without segments, an arm's parts are cut at its events.

    Args:
        schedule: also one made elsewhere; its times must be finite.
    """
    stages = schedule.stages or _stages_of_events(schedule)
    segments = schedule.segments or _segments_of_events(schedule, stages)
    per_stage: list[dict[str, list[Segment]]] = [{} for _ in stages]
    whole = whole_transfers(sorted(segments, key=lambda part: part.start)) if stages else []
    parts = [part for part in whole if part.kind != "wait"]
    for part, k in zip(parts, _stages_of(parts, stages), strict=True):
        per_stage[k].setdefault(part.arm, []).append(part)
    return [
        _parts(
            schedule,
            stage,
            {name: tuple(sorted(found, key=lambda p: p.start)) for name, found in arms.items()},
        )
        for stage, arms in zip(stages, per_stage, strict=True)
    ]


def _stages_of(parts: Sequence[Segment], stages: Sequence[Stage]) -> list[int]:
    """Return for each part the place of its stage: the last one begun by its middle, of its task where stages overlap.

    Of several overlapping stages of a task, or without one, that which has most of the part, and of those the shortest.
    """
    middles = [(part.start + part.end) / 2.0 for part in parts]
    starts = np.array([stage.start for stage in stages])
    begun = np.maximum(np.searchsorted(starts, middles, side="right") - 1, 0)
    if not overlap(stages):
        return [int(k) for k in begun]
    by_task: dict[str, list[int]] = {}
    for k, stage in enumerate(stages):
        for task in dict.fromkeys(stage.tasks or ("",)):
            by_task.setdefault(task, []).append(k)

    found = []
    for part, last in zip(parts, begun, strict=True):
        ranked = []
        for k in by_task.get(part.task, []):
            shared = min(stages[k].end, part.end) - max(stages[k].start, part.start)
            if shared >= -SAME_TIME:
                ranked.append((-round(shared, 9), stages[k].end - stages[k].start, k))
        found.append(min(ranked)[-1] if ranked else int(last))
    return found


def _parts(schedule: Schedule, stage: Stage, arms: Mapping[str, tuple[Segment, ...]]) -> StageParts:
    ends = {name: parts[-1].end for name, parts in arms.items()}
    if is_handover(arms):
        # Both wait for the one that comes last; that the giver leaves last says nothing.
        ends = {name: _arrival(parts, stage) for name, parts in arms.items()}
    last = max(ends.values(), default=0.0)
    candidates = [name for name, end in ends.items() if end >= last - SAME_TIME]
    # Of arms that end together the one that the stage itself names as its bottleneck.
    named = [name for name in candidates if _group_of(schedule, stage.bottleneck) == name]
    critical = (named or candidates or [""])[0]
    return StageParts(stage, arms, critical, _deciding_group(schedule, stage, arms, critical))


def _deciding_group(
    schedule: Schedule, stage: Stage, arms: Mapping[str, tuple[Segment, ...]], critical: str
) -> str:
    """Return which group decides how long the critical arm's transfer takes."""
    if not critical:
        return _group_of(schedule, stage.bottleneck)
    if not any(part.kind in MOVES for part in arms.get(critical, ())):
        return ""
    if any(part.kind == "return" for part in arms[critical]) or not stage.arm_times:
        return _group_of(schedule, stage.bottleneck) or critical
    own = stage.arm_times.get(critical, 0.0)
    return PLATFORM if stage.platform_time > own else critical


def _group_of(schedule: Schedule, joint: str) -> str:
    """Return the group of a joint, or an empty string."""
    if joint in schedule.robot.platform:
        return PLATFORM
    found = (name for name, arm in schedule.robot.arms.items() if joint in arm.joints)
    return next(found, "")


def _stages_of_events(schedule: Schedule) -> tuple[Stage, ...]:
    """Return stages of one event per arm, each as long as their dwells, and one for what follows the last."""
    groups: list[list[Event]] = []
    for event in sorted(schedule.events, key=lambda event: (event.time, event.arm)):
        if not groups or any(event.arm == other.arm for other in groups[-1]):
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
    """Return parts cut at the events: the way to an event, its dwell, and what the arm moves afterwards."""
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
    """Return from when on the joints stand where they are at `end` [s]."""
    columns = [trajectory.joints.index(name) for name in joints]
    inside = trajectory.time[(trajectory.time > start) & (trajectory.time < end)]
    time = np.concatenate([[start], inside, [end]])
    q = trajectory.at(time)[0][:, columns]
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
    """Largest deviation from the line, or distance from the target when passing [m].

    Of a line, in the part of it that need not be straight.
    """


@dataclass(frozen=True)
class _Candidate:
    """Corner that an arm passes, or stands at."""

    time: float
    """Time at which the tool is at the corner [s]."""
    transfer: Segment
    """The transfer beside it, of a target the one that leaves it."""
    line: Segment | None = None
    """The approach or retract whose outer end it is."""
    event: Event | None = None
    """The target of a move that it is."""


def corners(schedule: Schedule, job: Job) -> list[Corner]:
    """Find the corners that tools pass in motion, in order of time.

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
    """Select the corners of an arm at which it is in motion."""
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
    moves = np.abs(velocity[:, _columns(schedule, arm)]).max(axis=1) > CORNERS.at_rest
    return [one for one, moving in zip(near, moves, strict=True) if moving]


def blending_rows(schedule: Schedule, job: Job) -> dict[str, Any] | None:
    """Summarise the effect of blending, JSON-ready.

    None where tools stop at the outer ends of lines.
    """
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
    _, p = model.poses(arm, schedule.trajectory.at(around.ravel())[0])
    return [float(norm(way)) / (2.0 * step) for way in p[1::2] - p[::2]]


def _limiting(schedule: Schedule, arm: str, parts: Sequence[Segment]) -> list[tuple[str, str]]:
    """Find the joint nearest to a limit in each part, and that limit."""
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
    """Compute the tool's deviations from lines that continue beyond their straight parts.

    They count while the tool is no farther out than the end of the whole line.

    Args:
        schedule: a planned one.
        model: its tools.
        arm: whose.
        passed: its corners.
        stops: those of the job, their lines whole.

    Returns:
        Largest deviations [m] by the place among the corners, of those lines only.
    """
    ended = [(k, one.line, one.transfer) for k, one in enumerate(passed) if one.line is not None]
    found: dict[int, float] = {}
    for first in range(0, len(ended), CORNERS.at_once):
        some = ended[first : first + CORNERS.at_once]
        out = np.array([line.kind == "retract" for _, line, _ in some])
        spans = np.array([(line.start, line.end) for _, line, _ in some])
        ends = np.where(out[:, None], spans, spans[:, ::-1])
        R, p = model.poses(arm, schedule.trajectory.at(ends.ravel())[0])
        R, p = R[::2], p.reshape(-1, 2, 3)
        straight = -np.einsum("ki,kij->kj", p[:, 1] - p[:, 0], R)[:, 2]
        for row, (k, line, transfer) in enumerate(some):
            stop = stops.get((arm, line.task, line.action))
            length = 0.0 if stop is None else getattr(stop, line.kind)
            if straight[row] >= length - CORNERS.whole:
                continue
            along = np.linspace(transfer.start, transfer.end, CORNERS.instants)
            places = model.poses(arm, schedule.trajectory.at(along[:: 1 if out[row] else -1])[0])[1]
            local = product(places - p[row, 0], R[row])
            gone = np.flatnonzero(-local[:, 2] > length)
            within = local[: gone[0] if len(gone) else None]
            found[k] = float(np.hypot(within[:, 0], within[:, 1]).max(initial=0.0))
    return found
