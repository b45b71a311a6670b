"""Pairing of stops into stages where each arm's order is given: feasible, and best."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.orders.paired.problem import IDLE, StageProblem
from dualarm_cli.orders.paired.times import closing, stage_values
from dualarm_cli.orders.rules.stores import Stores
from dualarm_cli.records import dataclass

Queue = Sequence[int]
"""Stops of one arm in their order."""
Moves = tuple[int, ...]
"""By arm, whether it makes its next stop in a stage."""


@dataclass(frozen=True)
class Aligned:
    """How stops of arms fall into stages."""

    slots: IntArray
    """Stops by stage and arm, IDLE for none, shape (n, arms), up to where arms wait for one another forever."""
    at: tuple[int, ...]
    """By arm, so many stops are made by then, all of them where there is a way."""
    is_whole: bool
    """Whether all stops are made."""


def any_alignment(
    stores: Stores,
    tasks: Sequence[Sequence[int]],
    before: Sequence[tuple[int, int]],
    queues: Sequence[Queue],
    meetings: Sequence[tuple[int, int]] = (),
) -> Aligned:
    """Returns stages that keep buffers and precedence, or the most stops that can be made where not all can.

    Arms go in one stage where that leads to the end, and one waits where not: depth first over how far each has got.

    Args:
        stores: the buffers.
        tasks: stops of each task.
        before: pairs of tasks of which the first is over before the second begins.
        queues: stops by arm.
        meetings: pairs of stops that two arms make in one stage: those of hand-overs.
    """
    rules = _Rules(stores, tasks, before, queues, meetings)
    end = tuple(len(queue) for queue in queues)
    start = tuple(0 for _ in queues)
    path, tries = [start], [rules.moves(start)]
    farthest, seen = [start], {start}
    while path[-1] != end:
        move = next(tries[-1], None)
        if move is None:
            path.pop()
            tries.pop()
            if not path:
                return Aligned(_stages(farthest, queues), farthest[-1], is_whole=False)
            continue
        to = tuple(k + one for k, one in zip(path[-1], move, strict=True))
        if to not in seen:
            # What was left once leads nowhere, whichever way it is reached.
            seen.add(to)
            path.append(to)
            tries.append(rules.moves(to))
            if sum(to) > sum(farthest[-1]):
                farthest = list(path)
    return Aligned(_stages(path, queues), end, is_whole=True)


def _stages(path: Sequence[tuple[int, ...]], queues: Sequence[Queue]) -> IntArray:
    """Returns what is done between the places of a path, shape (n, arms)."""
    stages = [
        [queue[k] if k < m else IDLE for queue, k, m in zip(queues, one, other, strict=True)]
        for one, other in pairwise(path)
    ]
    return np.array(stages, dtype=np.int64).reshape(-1, len(queues))


class _Rules:
    """What may be done next from where both arms are."""

    def __init__(
        self,
        stores: Stores,
        tasks: Sequence[Sequence[int]],
        before: Sequence[tuple[int, int]],
        queues: Sequence[Queue],
        meetings: Sequence[tuple[int, int]],
    ) -> None:
        self._stores, self._queues = stores, queues
        self._partner = {a: b for one, other in meetings for a, b in ((one, other), (other, one))}
        self._levels = [
            np.concatenate([[0 * stores.initial], np.cumsum(change, axis=0)])
            for change in (stores.change[list(queue)] for queue in queues)
        ]
        ends = {own[-1]: t for t, own in enumerate(tasks)}
        over = {
            ends[stop]: (a, k + 1)
            for a, queue in enumerate(queues)
            for k, stop in enumerate(queue)
            if stop in ends
        }
        # Where the tasks are over that have to be before a stop is made.
        self._first: dict[int, list[tuple[int, int]]] = {}
        for one, other in before:
            self._first.setdefault(tasks[other][0], []).append(over[one])

    def moves(self, at: tuple[int, ...]) -> Iterator[Moves]:
        """Yields who may make the next stop, all together first, then one alone, who has got less far first."""
        level = self._stores.initial + sum(
            levels[k] for levels, k in zip(self._levels, at, strict=True)
        )
        ready = [a for a in range(len(at)) if self._may_begin(a, at)]
        share = [at[a] / max(1, len(self._queues[a])) for a in range(len(at))]
        ready.sort(key=lambda a: (share[a], a))
        some = [ready] if len(ready) > 1 else []
        for arms in [*some, *([a] for a in ready)]:
            stops = [self._queues[a][at[a]] for a in arms]
            if any(self._partner.get(stop, stop) not in stops for stop in stops):
                continue
            if int(self._stores.fits(level, np.array(stops))) == 0:
                yield tuple(int(a in arms) for a in range(len(at)))

    def _may_begin(self, a: int, at: tuple[int, ...]) -> bool:
        if at[a] == len(self._queues[a]):
            return False
        stop = self._queues[a][at[a]]
        return all(at[b] >= k for b, k in self._first.get(stop, ()))


class Alignments:
    """The best stages of many rows at once: how far both arms have got, as a dynamic programme over the angles."""

    def __init__(
        self, problem: StageProblem, queues: Sequence[IntArray], early: float = 0.0
    ) -> None:
        """Prepares rows.

        Args:
            problem: what is asked, without hand-overs.
            queues: by arm, stops of b rows, shape (b, n).
            early: what it counts that an arm with stops left is idle for a stage [s].
        """
        assert not problem.handovers  # callers have looked
        self._problem, self._queues, self._early = problem, queues, early
        self._b = len(queues[0])
        self._sizes = tuple(own.shape[1] for own in queues)
        self._levels = [] if problem.stores is None else self._changes(problem.stores)
        self._over = [self._ends(own) for own in queues]
        self._first: dict[int, list[int]] = {}
        for one, other in problem.before:
            self._first.setdefault(problem.tasks[other][0], []).append(one)
        self._values: dict[tuple[int, ...], FloatArray] = {}

    def _changes(self, stores: Stores) -> list[IntArray]:
        """Returns, by arm, by how much its first stops change the buffers together, shape (b, n + 1, K)."""
        zero = np.zeros((self._b, 1, len(stores.initial)), dtype=np.int64)
        change = [stores.change[own] for own in self._queues]
        return [np.concatenate([zero, np.cumsum(one, axis=1)], axis=1) for one in change]

    def _ends(self, own: IntArray) -> IntArray:
        """Returns after how many stops of a row each task is over, one more than there are where it is not there."""
        n = own.shape[1]
        found = np.full((self._b, len(self._problem.tasks)), n + 1)
        for t, stops in enumerate(self._problem.tasks):
            row, k = np.nonzero(own == stops[-1])
            found[row, t] = k + 1
        return found

    def totals(self) -> FloatArray:
        """Returns when all is done at best [s], infinite where no stages keep the rules, shape (b,)."""
        problem = self._problem
        f = len(problem.turn)
        start = tuple(0 for _ in self._sizes)
        first = np.full((self._b, f), np.inf)
        first[:, slice(None) if problem.free_start else 0] = 0.0
        self._values = {start: first}
        for at in np.ndindex(*(n + 1 for n in self._sizes)):
            if at == start:
                continue
            best = np.full((self._b, f), np.inf)
            for move in self._into(at):
                over = self._stage(at, move)[0]
                best = np.minimum(best, over)
            self._values[at] = best
        with np.errstate(invalid="ignore"):
            found: FloatArray = (
                self._values[self._sizes] + closing(problem, self._came(self._sizes))
            ).min(axis=1)
        return found

    def _into(self, at: tuple[int, ...]) -> list[Moves]:
        """Returns the moves that lead to a place."""
        every = [m for m in np.ndindex(*(2 for _ in at)) if any(m)]
        return [m for m in every if all(k >= one for k, one in zip(at, m, strict=True))]

    def _came(self, at: tuple[int, ...]) -> IntArray:
        """Returns the stop that each arm made last before a place, shape (b, arms)."""
        start = np.full(self._b, self._problem.stops)
        rows = [own[:, k - 1] if k else start for own, k in zip(self._queues, at, strict=True)]
        return np.stack(rows, axis=1)

    def _stage(self, at: tuple[int, ...], move: Moves) -> tuple[FloatArray, IntArray]:
        """Returns when a stage that leads to a place is over, (b, f), and from which angle it is best begun, (b, f)."""
        before = tuple(k - one for k, one in zip(at, move, strict=True))
        idle = np.full(self._b, IDLE)
        stops = np.stack(
            [
                own[:, k] if one else idle
                for own, k, one in zip(self._queues, before, move, strict=True)
            ],
            axis=1,
        )
        over, angle = stage_values(self._problem, stops, self._came(before), self._values[before])
        waiting = zip(self._sizes, before, move, strict=True)
        over = over + self._early * sum(k < n and not one for n, k, one in waiting)
        return np.where(self._allowed(before, stops)[:, None], over, np.inf), angle

    def _allowed(self, before: tuple[int, ...], stops: IntArray) -> BoolArray:
        """Returns whether stops may be made in one stage where both arms are, shape (b,)."""
        stores, found = self._problem.stores, np.ones(self._b, dtype=np.bool_)
        if stores is not None:
            level = stores.initial + sum(
                levels[:, k] for levels, k in zip(self._levels, before, strict=True)
            )
            found = stores.fits(level, stops) == 0
        for stop, tasks in self._first.items():
            begins = (stops == stop).any(axis=1)
            for task in tasks:
                over = np.any(
                    [ends[:, task] <= k for ends, k in zip(self._over, before, strict=True)], axis=0
                )
                found &= ~begins | over
        return found

    def best(self) -> IntArray:
        """Returns the stages of a single row in which all is done soonest, shape (n, arms); after `totals`."""
        with np.errstate(invalid="ignore"):
            last = self._values[self._sizes] + closing(self._problem, self._came(self._sizes))
        at, angle, stages = self._sizes, int(last[0].argmin()), list[list[int]]()
        while any(at):
            tries = [(self._stage(at, move), move) for move in self._into(at)]
            (_, came), move = min(tries, key=lambda one: one[0][0][0, angle])
            at = tuple(k - one for k, one in zip(at, move, strict=True))
            stages.append(
                [
                    int(own[0, k]) if one else IDLE
                    for own, k, one in zip(self._queues, at, move, strict=True)
                ]
            )
            angle = int(came[0, angle])
        return np.array(stages[::-1], dtype=np.int64).reshape(-1, len(self._sizes))
