"""Paired arms' stages on a turning platform as numbers.

A stage has stops and a platform angle.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray, readonly
from dualarm_cli.orders.rules.stores import Stores
from dualarm_cli.records import dataclass

IDLE = -1
"""Stop number of an arm without a stop in a stage."""


@dataclass(frozen=True)
class StageProblem:
    """Assignment of tasks to arms and stages with the least makespan.

    In a stage platform and arms start together. An arm's approach begins when its own transfer and the platform's turn
    are finished; the stage ends with its last arm. Every arm has one posture at each stop and angle.
    """

    length: tuple[FloatArray, ...]
    """Stage part lengths by arm [s], (s + 1, s + 2, f, f).

    Infinite if infeasible. From stop i at angle f to stop j at angle g; the last row is from the start (the same for
    all f). Column s is the return (0 without one; without the platform's turn). Column s + 1, for IDLE, is minus
    infinity.
    """
    work: tuple[FloatArray, ...]
    """Part of that length after the transfer by arm [s], shape (s, f)."""
    turn: FloatArray
    """Platform times between angles [s], shape (f, f); angle 0 is where it starts."""
    tasks: tuple[tuple[int, ...], ...]
    """Stops of each task; one arm makes them directly one after the other."""
    returns: bool
    """Whether platform and arms return to their start."""
    free_start: bool = False
    """Whether the platform may start at any angle."""
    before: tuple[tuple[int, int], ...] = ()
    """Precedence: pairs of tasks, the first finished before the second begins."""
    sequences: tuple[tuple[int, ...], ...] = ()
    """Tasks that one arm does directly one after the other."""
    not_before: FloatArray | None = None
    """Earliest start of each stop's approach [s], shape (s,)."""
    not_after: FloatArray | None = None
    """Latest end of each stop [s], shape (s,)."""
    in_file_order: bool = False
    """Whether each arm does its tasks in the order of their numbers."""
    handovers: tuple[tuple[int, int], ...] = ()
    """Pairs of the giver's and the taker's task of each hand-over.

    Each arm does one of them, and the last stop of the first is in the same stage as the first stop of the second.
    """
    pair_cost: FloatArray | None = None
    """Cost of simultaneous stops by angle [s], (s + 2, s + 2, f).

    Infinite if the arms collide; 0 in the last row and column, for IDLE.
    """
    stores: Stores | None = None
    """Buffers for parts between stops, or None."""

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        object.__setattr__(self, "length", tuple(readonly(x) for x in self.length))
        object.__setattr__(self, "work", tuple(readonly(x) for x in self.work))
        object.__setattr__(self, "turn", readonly(self.turn))

    @cached_property
    def stops(self) -> int:
        """Number of stops."""
        return sum(len(task) for task in self.tasks)

    def allowed(self, arm: int, task: int) -> bool:
        """Test whether an arm can do a task."""
        return all(bool(np.isfinite(self.work[arm][stop]).any()) for stop in self.tasks[task])


@dataclass(frozen=True)
class StageOrder:
    """Stops of each arm in every stage, with the platform angles."""

    slots: IntArray
    """Stops, shape (n, arms); IDLE for none."""
    angles: IntArray
    """Number of the platform angle of each stage, shape (n,)."""
    total: float
    """Makespan with penalties [s], infinite if infeasible.

    Penalties are for lateness, missing parts and missing room.
    """


def split_pairs(slots: IntArray, pairs: set[tuple[int, int]]) -> IntArray:
    """Split the stages of an order (n, 2) with given stop pairs."""
    rows = []
    for first, second in slots.tolist():
        if (first, second) in pairs:
            rows += [[first, IDLE], [IDLE, second]]
        else:
            rows.append([first, second])
    return np.array(rows, dtype=np.int64).reshape(-1, 2)


@dataclass(frozen=True)
class StopUnit:
    """Consecutive stops of an arm: of a task or sequence of tasks.

    Or both tasks of a hand-over: two stops of the giver, then two of the taker, with the meeting in the middle.
    """

    tasks: tuple[int, ...]
    """Tasks of the unit."""
    stops: tuple[int, ...]
    """Stops of the tasks."""
    arms: tuple[int, ...]
    """Arms that can make all stops, or can give in a hand-over.

    The other arm takes then.
    """
    meets: bool = False
    """Whether the unit is a hand-over."""

    def shares(self, giver: int) -> tuple[StopUnit, StopUnit]:
        """Split a hand-over into the giver's and the taker's unit."""
        (giving, taking), half = self.tasks, len(self.stops) // 2
        return (
            StopUnit((giving,), self.stops[:half], (giver,)),
            StopUnit((taking,), self.stops[half:], (1 - giver,)),
        )


def stage_units(problem: StageProblem) -> list[StopUnit]:
    """List sequences, hand-overs, and all other tasks as single units."""
    within = {t for row in (*problem.sequences, *problem.handovers) for t in row}
    rows = [*problem.sequences, *((t,) for t in range(len(problem.tasks)) if t not in within)]
    units = [
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
    for giving, taking in problem.handovers:
        arms = (
            a for a in range(2) if problem.allowed(a, giving) and problem.allowed(1 - a, taking)
        )
        stops = (*problem.tasks[giving], *problem.tasks[taking])
        units.append(StopUnit((giving, taking), stops, tuple(arms), meets=True))
    return sorted(units, key=lambda unit: unit.tasks)


def near_units(problem: StageProblem, units: list[StopUnit]) -> list[list[int]]:
    """Rank the nearest units of each unit by the shortest stage of any arm."""
    first = np.array([unit.stops[0] for unit in units])
    last = np.array([unit.stops[-1] for unit in units])
    least: FloatArray = np.full((len(units), len(units)), np.inf)
    for length in problem.length:
        quickest = length.min(axis=(2, 3))[last[:, None], first[None, :]]
        least = np.minimum(least, np.minimum(quickest, quickest.T))
    order = np.argsort(least, axis=1, kind="stable")
    return [[int(v) for v in row if v != u][:12] for u, row in enumerate(order)]
