"""When two arms leave the places at which they may wait: exact instants for what was found in whole steps."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Sequence

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.joint_motion import SAME_TIME
from dualarm_cli.model.schedule import WaitReason
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class Since:
    """An instant of an arm's own clock, counted from when the arm leaves a place to rest: it moves with that."""

    rest: int
    """Number of the rest; -1 for the start of the motion, which nothing moves."""
    after: float
    """How long after the arm leaves it [s]."""


@dataclass(frozen=True)
class ClockSteps:
    """A timeline of whole steps; each place at which the arm may wait has a step of its own."""

    step: float
    """Length of a step [s]."""
    rests: tuple[float, ...]
    """When the arm is where it may wait, by its own clock [s], increasing."""
    places: tuple[int, ...]
    """The step of each rest, never before its instant, increasing."""
    count: int
    """How many steps there are: the arm leaves its last rest even where its clock has no length."""
    duration: float
    """Length of the clock [s]."""

    @classmethod
    def of(cls, rests: Sequence[float], duration: float, step: float) -> ClockSteps:
        """Lays steps over a clock.

        Args:
            rests: when the arm may wait, by its own clock [s], increasing.
            duration: length of the clock [s].
            step: length of a step [s].
        """
        places: list[int] = []
        for time in rests:
            places.append(max(_up(time, step), places[-1] + 1 if places else 0))
        count = max(_up(duration, step), places[-1] + 1 if places else 0)
        return cls(step, tuple(rests), tuple(places), count, duration)

    def times(self) -> FloatArray:
        """Returns the instant of every step by the own clock [s], exact at rests, shape (count + 1,)."""
        found = np.minimum(self.step * np.arange(self.count + 1), self.duration)
        found[list(self.places)] = self.rests
        return found

    def rest_at(self, time: float) -> int | None:
        """Returns the number of the rest at an instant of the own clock [s], None where the arm goes on."""
        k = bisect_left(self.rests, time - SAME_TIME)
        return k if k < len(self.rests) and self.rests[k] <= time + SAME_TIME else None

    def place_after(self, time: float) -> int:
        """Returns the first step that is not before an instant of the own clock [s] between two rests."""
        k = bisect_right(self.rests, time + SAME_TIME) - 1
        least = self.places[k] + 1 if k >= 0 else 0
        return min(max(_up(time, self.step), least), self.count)

    def arrived(self, time: float) -> Since:
        """Returns an instant of the own clock [s] as one at which the arm has yet to leave a rest that is just then."""
        return self._since(bisect_left(self.rests, time - SAME_TIME) - 1, time)

    def left(self, time: float) -> Since:
        """Returns an instant of the own clock [s] as one at which the arm has left a rest that is just then."""
        return self._since(bisect_right(self.rests, time + SAME_TIME) - 1, time)

    def reached(self, place: int) -> Since:
        """Returns when the arm comes to a step; one at which it may wait, before it waits there."""
        k = bisect_left(self.places, place)
        time = min(self.step * place, self.duration)
        if k < len(self.places) and self.places[k] == place:
            time = self.rests[k]
        return self._since(k - 1, time)

    def _since(self, rest: int, time: float) -> Since:
        return Since(rest, time - (self.rests[rest] if rest >= 0 else 0.0))


def _up(time: float, step: float) -> int:
    return int(np.ceil(time / step - SAME_TIME))


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
    """Returns by arm the earliest instants at which it leaves its rests [s]; None where arms wait forever.

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
