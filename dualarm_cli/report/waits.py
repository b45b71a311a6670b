"""What the arms of a schedule wait for, and for how long."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping, Sequence
from typing import Any, get_args

from dualarm_cli.kinds import of_kinds
from dualarm_cli.model.job import Job
from dualarm_cli.model.schedule import Event, Schedule, Segment, WaitReason
from dualarm_cli.motion.waiting import MOVES, SAME_TIME
from dualarm_cli.report.stage_parts import stage_parts

REASONS: tuple[str, ...] = get_args(WaitReason)[1:]
UNSTATED = "unstated"
"""What a wait is called of which the schedule does not say why."""
FOR_THE_OTHER = ("partner", "shared_zone", "end")
"""Reasons that lie in what the other arm does."""
SAME_LENGTH = 1e-6
"""Times that differ by less are one [s]."""


def wait_rows(schedule: Schedule, job: Job) -> list[dict[str, Any]]:
    """Returns every wait as a JSON-ready row, in time order; times in s.

    `task` is what the arm is about to do, `for` the arm and task that it waits for; both None where that is not known,
    `for` also where it waits for the platform or for a time. Of the other arm it is what it does when the wait ends.

    Args:
        schedule: with segments.
        job: what it was planned for: it says which tasks come after which.
    """
    work = _work(schedule)
    after = {task.id: task.after for task in job.tasks}
    waits = sorted(
        (s for s in schedule.segments if s.kind == "wait" and s.end - s.start > SAME_LENGTH),
        key=lambda part: (part.start, part.arm),
    )
    ends = {why: find for kind in of_kinds("measures") for why, find in kind.waits.items()}
    rows = []
    for wait in waits:
        found: Segment | Event | None = None
        if wait.reason in FOR_THE_OTHER:
            found = _meanwhile(wait, work)
        elif wait.reason == "after":
            found = _before(wait, after.get(wait.task, ()), work)
        elif wait.reason in ends:
            found = ends[wait.reason](wait, schedule, job)
        rows.append(
            {
                "arm": wait.arm,
                "start": wait.start,
                "end": wait.end,
                "length": wait.end - wait.start,
                "reason": wait.reason or UNSTATED,
                "task": wait.task or None,
                "for": found and {"arm": found.arm, "task": found.task or None},
            }
        )
    return rows


def waited(schedule: Schedule, arm: str) -> dict[str, float]:
    """Returns how long an arm waits by reason [s]; every reason, and `unstated` where it waits for none of them."""
    times = dict.fromkeys(REASONS, 0.0)
    for part in schedule.segments:
        if part.arm == arm and part.kind == "wait":
            reason = part.reason or UNSTATED
            times[reason] = times.get(reason, 0.0) + part.end - part.start
    return times


def drawn_out(schedule: Schedule) -> dict[str, float]:
    """Returns by how much each arm's transfers are drawn out because the platform needs longer [s].

    Platform and arms leave together, and an arm that would be there before the platform moves more slowly instead of
    waiting at the end. What it would wait is the platform's own time less the arm's, in each transfer that lasts as
    long as the platform's.

    Args:
        schedule: with stages and segments.
    """
    times = dict.fromkeys(schedule.robot.arms, 0.0)
    own = {(s.arm, s.start, s.end) for s in schedule.segments if s.kind in MOVES}
    for found in stage_parts(schedule):
        stage = found.stage
        for arm, parts in found.arms.items():
            alone = stage.arm_times.get(arm)
            if alone is None or arm not in times:
                continue
            for part in parts:
                lasts = abs(part.end - part.start - stage.platform_time) <= SAME_LENGTH
                # One that ends with waiting for the platform was not drawn out.
                if part.kind in MOVES and lasts and (arm, part.start, part.end) in own:
                    times[arm] += max(0.0, stage.platform_time - alone)
    return times


def _work(schedule: Schedule) -> dict[str, list[Segment]]:
    """Returns what each arm does, waits left out, in time order."""
    work: dict[str, list[Segment]] = {}
    for part in sorted(schedule.segments, key=lambda part: part.start):
        if part.kind != "wait":
            work.setdefault(part.arm, []).append(part)
    return work


def _meanwhile(wait: Segment, work: Mapping[str, Sequence[Segment]]) -> Segment | None:
    """Returns what another arm does when a wait ends, that which ends last of several; None for nothing."""
    found = []
    for arm, parts in work.items():
        last = bisect_left(parts, wait.end - SAME_TIME, key=lambda part: part.start) - 1
        if arm != wait.arm and last >= 0 and parts[last].end > wait.start + SAME_TIME:
            found.append(parts[last])
    return max(found, key=lambda part: part.end, default=None)


def _before(
    wait: Segment, after: Sequence[str], work: Mapping[str, Sequence[Segment]]
) -> Segment | None:
    """Returns the last part by a wait's end of those tasks that have to be done before its own; None for nothing."""
    found = [
        part
        for parts in work.values()
        for part in parts
        if part.task in after and part.end <= wait.end + SAME_LENGTH
    ]
    return max(found, key=lambda part: part.end, default=None)
