"""When two arms leave the places at which they may wait: exact instants for what was found in whole steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from dualarm_cli.model.schedule import WaitReason
from dualarm_cli.planning.clock_steps import ClockSteps, Since
from dualarm_cli.planning.waiting import SAME_TIME


@dataclass(frozen=True)
class NotBefore:
    """An arm does not leave a rest before an instant, or before the other arm is somewhere on its way."""

    arm: int
    """Whose rest."""
    rest: int
    """Its number."""
    reason: WaitReason
    """Why; empty where it is only how far the other arm was meanwhile."""
    time: float
    """The instant [s], or how long after (or, negative, before) the other arm is there [s]."""
    other: Since | None = None
    """Where the other arm has to be."""


def leaving_times(
    clocks: Sequence[ClockSteps], rules: Sequence[NotBefore]
) -> tuple[tuple[float, ...], ...] | None:
    """Returns by arm the earliest instants at which it leaves its rests [s]; None where arms wait for ever.

    Args:
        clocks: one or two arms' own clocks.
        rules: what they wait for, best in the order in which it comes about.
    """
    found = [list(clock.rests) for clock in clocks]
    for _ in range(sum(map(len, found)) + 2):
        moved = False
        for rule in rules:
            at = due(rule, found)
            own, rests = found[rule.arm], clocks[rule.arm].rests
            if own[rule.rest] >= at - SAME_TIME:
                continue
            moved = True
            own[rule.rest] = at
            for k in range(rule.rest + 1, len(own)):
                own[k] = max(own[k], own[k - 1] + rests[k] - rests[k - 1])
        if not moved:
            return tuple(map(tuple, found))
    return None


def due(rule: NotBefore, leaving: Sequence[Sequence[float]]) -> float:
    """Returns the instant before which a rule keeps its arm at the rest [s].

    Args:
        rule: one rule.
        leaving: by arm, when it leaves its rests [s].
    """
    if rule.other is None:
        return rule.time
    left = leaving[1 - rule.arm][rule.other.rest] if rule.other.rest >= 0 else 0.0
    return left + rule.other.after + rule.time


def waits_at(clock: ClockSteps, leaving: Sequence[float]) -> list[float]:
    """Returns how long an arm waits at each rest [s].

    Args:
        clock: its own clock.
        leaving: when it leaves its rests [s].
    """
    found, gone = [], 0.0
    for time, left in zip(clock.rests, leaving, strict=True):
        found.append(left - time - gone)
        gone = left - time
    return found
