"""Waits among an arm's segments: which of them belong to a transfer, and which come after all its work."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from dualarm_cli.model.joint_motion import SAME_TIME
from dualarm_cli.model.schedule import Event, Segment, SegmentKind

MOVES = ("transfer", "return")
"""Segments that lead to where a line begins."""
FOR_THE_OTHER = ("partner", "end")
"""Reasons of waits for the other arm: it finishes a stage, or all that is left."""


def with_ends(segments: Sequence[Segment], events: Sequence[Event]) -> tuple[Segment, ...]:
    """Returns segments in which waiting for the other arm is called `end` after an arm's last task, `partner` before.

    Args:
        segments: all that the arms do.
        events: their events: a target where the arm stands already has no segment.
    """
    done: dict[str, float] = {}
    for event in events:
        done[event.arm] = max(event.time, done.get(event.arm, event.time))
    for part in segments:
        if part.kind != "wait" and part.task:
            done[part.arm] = max(part.end, done.get(part.arm, part.end))

    def named(part: Segment) -> Segment:
        if part.kind != "wait" or part.reason not in FOR_THE_OTHER:
            return part
        over = part.arm not in done or part.start >= done[part.arm] - SAME_TIME
        return replace(part, reason="end" if over else "partner")

    return tuple(named(part) for part in segments)


def whole_transfers(segments: Iterable[Segment]) -> list[Segment]:
    """Returns segments in which each transfer is one, from where the arm leaves until its line may begin.

    Pauses on the way and waiting for the platform at its end are parts of it; so is standing until the platform is
    there where the arm itself has no way to go. Waiting before the arm leaves is not.

    Args:
        segments: all that the arms do, each arm's in time order.
    """
    found: list[Segment] = []
    runs: dict[str, list[Segment]] = {}
    for part in segments:
        run = runs.setdefault(part.arm, [])
        if run and not _follows(part, run[-1]):
            found += _as_one(run)
            run.clear()
        if part.kind in MOVES or (part.kind == "wait" and _on_the_way(part, run)):
            run.append(part)
        else:
            found += _as_one(run)
            run.clear()
            found.append(part)
    for run in runs.values():
        found += _as_one(run)
    return found


def transfer_ends(segments: Sequence[Segment], start: float, end: float) -> list[float]:
    """Returns when those transfers are over [s] that end after a start and not after an end."""
    near = [part for part in segments if part.end > start and part.start <= end]
    return [
        part.end for part in whole_transfers(near) if part.kind in MOVES and start < part.end <= end
    ]


def _follows(part: Segment, before: Segment) -> bool:
    same = (part.task, part.action) == (before.task, before.action)
    return same and abs(part.start - before.end) <= SAME_TIME


def _on_the_way(part: Segment, run: Sequence[Segment]) -> bool:
    return part.reason == "platform" or (part.reason == "shared_zone" and len(run) > 0)


def _as_one(run: Sequence[Segment]) -> list[Segment]:
    """Returns a run of moves and waits as one move; waits at its end but for the platform stay by themselves."""
    last = len(run)
    while last and run[last - 1].kind == "wait" and run[last - 1].reason != "platform":
        last -= 1
    whole, rest = run[:last], list(run[last:])
    if not whole:
        return rest
    kind: SegmentKind = next((part.kind for part in whole if part.kind in MOVES), "transfer")
    return [replace(whole[0], kind=kind, end=whole[-1].end, reason=""), *rest]
