"""Stages of paired arms on a turning platform, as numbers: who does what in which stage, and at which angle."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray, readonly
from dualarm_cli.orders.rules.stores import Stores
from dualarm_cli.records import dataclass

IDLE = -1
"""Stands for an arm without a stop in a stage."""


@dataclass(frozen=True)
class StageProblem:
    """Tasks to be given to arms and put into stages, so that all is done soonest.

    In a stage platform and arms leave together; an arm's approach begins when its own transfer and the platform's are
    over; the stage ends when the last of its arms is done. Every arm has one posture at each stop and angle.
    """

    length: tuple[FloatArray, ...]
    """By arm, how long its part of a stage takes [s], infinite where it cannot be: from stop i, made at angle f, to
    stop j at angle g, shape (s + 1, s + 2, f, f). The last row is from its start (the same for all f); column s the way
    back (0 without one; without the platform's turn); column s + 1, which IDLE points at, for nothing to do: minus
    infinity."""
    work: tuple[FloatArray, ...]
    """By arm, what of that comes after the transfer [s], shape (s, f)."""
    turn: FloatArray
    """Platform times between angles [s], shape (f, f); angle 0 is where it starts."""
    tasks: tuple[tuple[int, ...], ...]
    """Stops of each task; one arm makes them one right after the other."""
    returns: bool
    """Whether platform and arms go back to where they start."""
    free_start: bool = False
    """Whether the platform may stand at any angle to begin with."""
    before: tuple[tuple[int, int], ...] = ()
    """Pairs of tasks of which the first is over before the second begins."""
    sequences: tuple[tuple[int, ...], ...] = ()
    """Tasks that one arm does one right after the other."""
    not_before: FloatArray | None = None
    """Earliest instant at which a stop's approach begins [s], shape (s,)."""
    not_after: FloatArray | None = None
    """Latest instant at which a stop may be over [s], shape (s,)."""
    in_file_order: bool = False
    """Whether each arm does its tasks in the order of their numbers."""
    handovers: tuple[tuple[int, int], ...] = ()
    """Pairs of tasks, the giver's share of a hand-over and the taker's: one arm does the one, the other arm the other,
    and the last stop of the first falls into the same stage as the first stop of the second."""
    pair_cost: FloatArray | None = None
    """What it costs that the first arm makes a stop while the second one makes another, infinite where they would
    touch, by angle [s], shape (s + 2, s + 2, f); 0 in the last row and column, which IDLE points at."""
    stores: Stores | None = None
    """Buffers for parts between stops; None without any."""

    def __post_init__(self) -> None:
        """Freezes the arrays."""
        object.__setattr__(self, "length", tuple(readonly(x) for x in self.length))
        object.__setattr__(self, "work", tuple(readonly(x) for x in self.work))
        object.__setattr__(self, "turn", readonly(self.turn))

    @cached_property
    def stops(self) -> int:
        """How many stops there are."""
        return sum(len(own) for own in self.tasks)

    def allowed(self, arm: int, task: int) -> bool:
        """Returns whether an arm can do a task at all."""
        return all(bool(np.isfinite(self.work[arm][stop]).any()) for stop in self.tasks[task])


@dataclass(frozen=True)
class StageOrder:
    """An answer: what each arm does in every stage."""

    slots: IntArray
    """Stops, IDLE where an arm has none, shape (n, arms)."""
    angles: IntArray
    """Number of the platform angle of each stage, shape (n,)."""
    total: float
    """When all is done [s], with LATE times what is late and what parts count that are not there or have no room;
    infinite where it cannot be."""


def split_pairs(slots: IntArray, pairs: set[tuple[int, int]]) -> IntArray:
    """Returns an order (n, 2) in which pairs of stops are not made in the same stage: one after the other instead."""
    rows = []
    for one, other in slots.tolist():
        if (one, other) in pairs:
            rows += [[one, IDLE], [IDLE, other]]
        else:
            rows.append([one, other])
    return np.array(rows, dtype=np.int64).reshape(-1, 2)


@dataclass(frozen=True)
class StopUnit:
    """Stops that one arm makes one right after the other: a task's, or those of a sequence of tasks.

    Or both shares of a hand-over: two stops of the giver, then two of the taker, that meet in the middle.
    """

    tasks: tuple[int, ...]
    """Its tasks."""
    stops: tuple[int, ...]
    """Their stops."""
    arms: tuple[int, ...]
    """The arms that can make them all; of a hand-over those that can give while the other one takes."""
    meets: bool = False
    """Whether it is a hand-over."""

    def shares(self, giver: int) -> tuple[StopUnit, StopUnit]:
        """Returns the giver's and the taker's share of a hand-over."""
        (one, other), half = self.tasks, len(self.stops) // 2
        return (
            StopUnit((one,), self.stops[:half], (giver,)),
            StopUnit((other,), self.stops[half:], (1 - giver,)),
        )


def stage_units(problem: StageProblem) -> list[StopUnit]:
    """Returns sequences, hand-overs, and all other tasks by themselves."""
    within = {t for row in (*problem.sequences, *problem.handovers) for t in row}
    rows = [*problem.sequences, *((t,) for t in range(len(problem.tasks)) if t not in within)]
    found = [
        StopUnit(
            tuple(row),
            tuple(stop for t in row for stop in problem.tasks[t]),
            tuple(
                a
                for a in range(len(problem.length))
                if all(problem.allowed(a, task) for task in row)
            ),
        )
        for row in sorted(rows)
    ]
    for one, other in problem.handovers:
        arms = (a for a in range(2) if problem.allowed(a, one) and problem.allowed(1 - a, other))
        stops = (*problem.tasks[one], *problem.tasks[other])
        found.append(StopUnit((one, other), stops, tuple(arms), meets=True))
    return sorted(found, key=lambda unit: unit.tasks)


def near_units(problem: StageProblem, units: list[StopUnit]) -> list[list[int]]:
    """Returns the nearest other units of each: those that follow it soonest on any arm, wherever the platform is."""
    first = np.array([unit.stops[0] for unit in units])
    last = np.array([unit.stops[-1] for unit in units])
    least: FloatArray = np.full((len(units), len(units)), np.inf)
    for length in problem.length:
        quickest = length.min(axis=(2, 3))[last[:, None], first[None, :]]
        least = np.minimum(least, np.minimum(quickest, quickest.T))
    order = np.argsort(least, axis=1, kind="stable")
    return [[int(v) for v in row if v != u][:12] for u, row in enumerate(order)]
