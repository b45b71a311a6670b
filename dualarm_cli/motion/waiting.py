"""Waits of an arm: those that belong to transfers, and those after its last task."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from dualarm_cli.model.motion.trajectory import SAME_TIME
from dualarm_cli.model.schedule import Event, Segment, SegmentKind

MOVES = ("transfer", "return")
"""Segments that lead to the start of a line."""
FOR_THE_OTHER = ("partner", "end")
"""Reasons of waits for the other arm: until it ends the stage, or the motion."""


def with_ends(segments: Sequence[Segment], events: Sequence[Event]) -> tuple[Segment, ...]:
    """Name waits for the other arm: `end` after an arm's last task, `partner` before.

    Args:
        segments: segments of the arms.
        events: their events, because a target that is already reached has no segment.
    """
    last_work: dict[str, float] = {}
    for event in events:
        last_work[event.arm] = max(event.time, last_work.get(event.arm, event.time))
    for part in segments:
        if part.kind != "wait" and part.task:
            last_work[part.arm] = max(part.end, last_work.get(part.arm, part.end))

    def named(part: Segment) -> Segment:
        if part.kind != "wait" or part.reason not in FOR_THE_OTHER:
            return part
        is_last = part.arm not in last_work or part.start >= last_work[part.arm] - SAME_TIME
        return replace(part, reason="end" if is_last else "partner")

    return tuple(named(part) for part in segments)


def whole_transfers(segments: Iterable[Segment]) -> list[Segment]:
    """Merge the segments of each transfer, from departure to the start of the line.

    Pauses during it and the wait for the platform at its end belong to it; so does the wait for the platform of an arm
    that need not move. Waits before departure do not.

    Args:
        segments: segments of the arms, in time order for each arm.
    """
    merged: list[Segment] = []
    runs: dict[str, list[Segment]] = {}
    for part in segments:
        run = runs.setdefault(part.arm, [])
        if run and not _follows(part, run[-1]):
            merged += _merge(run)
            run.clear()
        if part.kind in MOVES or (part.kind == "wait" and _within_transfer(part, run)):
            run.append(part)
        else:
            merged += _merge(run)
            run.clear()
            merged.append(part)
    for run in runs.values():
        merged += _merge(run)
    return merged


def transfer_ends(segments: Sequence[Segment], start: float, end: float) -> list[float]:
    """List the ends of transfers that end after `start` and not after `end` [s]."""
    near = [part for part in segments if part.end > start and part.start <= end]
    return [
        part.end for part in whole_transfers(near) if part.kind in MOVES and start < part.end <= end
    ]


def _follows(part: Segment, before: Segment) -> bool:
    same = (part.task, part.action) == (before.task, before.action)
    return same and abs(part.start - before.end) <= SAME_TIME


def _within_transfer(part: Segment, run: Sequence[Segment]) -> bool:
    return part.reason == "platform" or (part.reason == "shared_zone" and len(run) > 0)


def _merge(run: Sequence[Segment]) -> list[Segment]:
    """Merge a run of moves and waits into one move.

    Waits at its end are not merged unless they are for the platform.
    """
    last = len(run)
    while last and run[last - 1].kind == "wait" and run[last - 1].reason != "platform":
        last -= 1
    whole, remaining = run[:last], list(run[last:])
    if not whole:
        return remaining
    kind: SegmentKind = next((part.kind for part in whole if part.kind in MOVES), "transfer")
    return [replace(whole[0], kind=kind, end=whole[-1].end, reason=""), *remaining]
