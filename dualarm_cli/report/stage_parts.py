"""A schedule taken apart: what each arm does in each stage, in order, and which arm ends it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np

from dualarm_cli.model.joint_motion import SAME_TIME
from dualarm_cli.model.schedule import Event, Schedule, Segment, Stage
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.motion.waiting import MOVES, whole_transfers
from dualarm_cli.records import dataclass

STANDS = 1e-9
"""A joint that is off by less than this stands still [rad]."""
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
        """Returns how long an arm spends on some kinds of parts [s]."""
        parts = self.arms.get(arm, ())
        return sum((part.end - part.start for part in parts if part.kind in kinds), 0.0)

    def arrival(self, arm: str) -> float:
        """Returns when an arm's transfer is over [s]; the stage's start where it has none."""
        return _arrival(self.arms.get(arm, ()), self.stage)


def is_handover(arms: Mapping[str, Sequence[Segment]]) -> bool:
    """Returns whether what the arms do in a stage is a hand-over: they begin their lines when both are there."""
    return any(part.action == "give" for parts in arms.values() for part in parts)


def _arrival(parts: Sequence[Segment], stage: Stage) -> float:
    return max((part.end for part in parts if part.kind in MOVES), default=stage.start)


def overlap(stages: Sequence[Stage]) -> bool:
    """Returns whether any stage begins before the one before it ends: the arms run asynchronously."""
    return any(later.start < before.end - SAME_TIME for before, later in pairwise(stages))


def stage_parts(schedule: Schedule) -> list[StageParts]:
    """Returns the stages of a schedule with their parts.

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
    """Returns for each part the place of its stage: the last one begun by its middle, of its task where stages overlap.

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
    """Returns which group decides how long the critical arm's transfer takes."""
    if not critical:
        return _group_of(schedule, stage.bottleneck)
    if not any(part.kind in MOVES for part in arms.get(critical, ())):
        return ""
    if any(part.kind == "return" for part in arms[critical]) or not stage.arm_times:
        return _group_of(schedule, stage.bottleneck) or critical
    own = stage.arm_times.get(critical, 0.0)
    return PLATFORM if stage.platform_time > own else critical


def _group_of(schedule: Schedule, joint: str) -> str:
    """Returns the group of a joint, or an empty string."""
    if joint in schedule.robot.platform:
        return PLATFORM
    found = (name for name, arm in schedule.robot.arms.items() if joint in arm.joints)
    return next(found, "")


def _stages_of_events(schedule: Schedule) -> tuple[Stage, ...]:
    """Returns stages of one event per arm, each as long as their dwells, and one for what follows the last."""
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
    """Returns parts cut at the events: the way to an event, its dwell, and what the arm moves afterwards."""
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
    """Returns from when on the joints stand where they are at `end` [s]."""
    columns = [trajectory.joints.index(name) for name in joints]
    inside = trajectory.time[(trajectory.time > start) & (trajectory.time < end)]
    time = np.concatenate([[start], inside, [end]])
    q = trajectory.at(time)[0][:, columns]
    moving = np.flatnonzero((np.abs(q - q[-1]) > STANDS).any(axis=1))
    return float(time[moving[-1] + 1]) if len(moving) else start
