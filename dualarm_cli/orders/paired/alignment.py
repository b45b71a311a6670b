"""Pairing of stops into stages for given orders of each arm: feasible, and optimal."""

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
"""Whether each arm makes its next stop in a stage."""


@dataclass(frozen=True)
class Aligned:
    """Pairing of the arms' stops into stages."""

    slots: IntArray
    """Stops by stage and arm, (n, arms), IDLE for none.

    They end at a deadlock, if any.
    """
    at: tuple[int, ...]
    """Number of finished stops of each arm."""
    is_whole: bool
    """Whether all stops are made."""


def any_alignment(
    stores: Stores,
    tasks: Sequence[Sequence[int]],
    before: Sequence[tuple[int, int]],
    queues: Sequence[Queue],
    meetings: Sequence[tuple[int, int]] = (),
) -> Aligned:
    """Find stages that satisfy buffers and precedence, or the longest ones before a deadlock.

    Depth-first search over the progress of both arms: they go together if that leads to the end, else one waits.

    Args:
        stores: the buffers.
        tasks: stops of each task.
        before: pairs of tasks, the first finished before the second begins.
        queues: stops by arm.
        meetings: pairs of stops that both arms make in one stage: those of hand-overs.
    """
    rules = _Rules(stores, tasks, before, queues, meetings)
    end = tuple(len(queue) for queue in queues)
    start = tuple(0 for _ in queues)
    path, remaining_moves = [start], [rules.moves(start)]
    farthest, seen = [start], {start}
    while path[-1] != end:
        move = next(remaining_moves[-1], None)
        if move is None:
            path.pop()
            remaining_moves.pop()
            if not path:
                return Aligned(_stages(farthest, queues), farthest[-1], is_whole=False)
            continue
        state = tuple(k + step for k, step in zip(path[-1], move, strict=True))
        if state not in seen:
            # A state that was left once is a dead end on every path.
            seen.add(state)
            path.append(state)
            remaining_moves.append(rules.moves(state))
            if sum(state) > sum(farthest[-1]):
                farthest = list(path)
    return Aligned(_stages(path, queues), end, is_whole=True)


def _stages(path: Sequence[tuple[int, ...]], queues: Sequence[Queue]) -> IntArray:
    """Convert a path of states to stages, shape (n, arms)."""
    stages = [
        [queue[k] if k < m else IDLE for queue, k, m in zip(queues, state, next_state, strict=True)]
        for state, next_state in pairwise(path)
    ]
    return np.array(stages, dtype=np.int64).reshape(-1, len(queues))


class _Rules:
    """Feasible next stages of both arms."""

    def __init__(
        self,
        stores: Stores,
        tasks: Sequence[Sequence[int]],
        before: Sequence[tuple[int, int]],
        queues: Sequence[Queue],
        meetings: Sequence[tuple[int, int]],
    ) -> None:
        self._stores, self._queues = stores, queues
        self._partner = {a: b for give, take in meetings for a, b in ((give, take), (take, give))}
        self._levels = [
            np.concatenate([[0 * stores.initial], np.cumsum(change, axis=0)])
            for change in (stores.change[list(queue)] for queue in queues)
        ]
        ends = {stops[-1]: t for t, stops in enumerate(tasks)}
        finished = {
            ends[stop]: (a, k + 1)
            for a, queue in enumerate(queues)
            for k, stop in enumerate(queue)
            if stop in ends
        }
        # Progress at which the predecessors of each stop are finished.
        self._first: dict[int, list[tuple[int, int]]] = {}
        for earlier, later in before:
            self._first.setdefault(tasks[later][0], []).append(finished[earlier])

    def moves(self, at: tuple[int, ...]) -> Iterator[Moves]:
        """Yield feasible stages: all arms together, then single arms, the least advanced first."""
        level = self._stores.initial + sum(
            levels[k] for levels, k in zip(self._levels, at, strict=True)
        )
        ready = [a for a in range(len(at)) if self._may_begin(a, at)]
        progress = [at[a] / max(1, len(self._queues[a])) for a in range(len(at))]
        ready.sort(key=lambda a: (progress[a], a))
        together = [ready] if len(ready) > 1 else []
        for arms in [*together, *([a] for a in ready)]:
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
    """Optimal stages of many rows: dynamic programming over arm progress and angles.

    The progress is that of both arms.
    """

    def __init__(
        self, problem: StageProblem, queues: Sequence[IntArray], early: float = 0.0
    ) -> None:
        """Prepare rows.

        Args:
            problem: the stage problem, without hand-overs.
            queues: by arm, stops of b rows, shape (b, n).
            early: penalty of a stage in which an arm with remaining stops is idle [s].
        """
        assert not problem.handovers  # callers have looked
        self._problem, self._queues, self._early = problem, queues, early
        self._b = len(queues[0])
        self._sizes = tuple(rows.shape[1] for rows in queues)
        self._levels = [] if problem.stores is None else self._changes(problem.stores)
        self._over = [self._ends(rows) for rows in queues]
        self._first: dict[int, list[int]] = {}
        for earlier, later in problem.before:
            self._first.setdefault(problem.tasks[later][0], []).append(earlier)
        self._values: dict[tuple[int, ...], FloatArray] = {}

    def _changes(self, stores: Stores) -> list[IntArray]:
        """Sum each arm's buffer changes over first stops, (b, n + 1, K)."""
        zero = np.zeros((self._b, 1, len(stores.initial)), dtype=np.int64)
        change = [stores.change[rows] for rows in self._queues]
        return [np.concatenate([zero, np.cumsum(steps, axis=1)], axis=1) for steps in change]

    def _ends(self, rows: IntArray) -> IntArray:
        """Count the stops up to the end of each task.

        For missing tasks it is the number of stops plus 1.
        """
        n = rows.shape[1]
        ends = np.full((self._b, len(self._problem.tasks)), n + 1)
        for t, stops in enumerate(self._problem.tasks):
            row, k = np.nonzero(rows == stops[-1])
            ends[row, t] = k + 1
        return ends

    def totals(self) -> FloatArray:
        """Compute the least makespans [s], shape (b,); infinite if no stages are feasible."""
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
            makespans: FloatArray = (
                self._values[self._sizes] + closing(problem, self._last_stops(self._sizes))
            ).min(axis=1)
        return makespans

    def _into(self, at: tuple[int, ...]) -> list[Moves]:
        """List the stages that lead to a state."""
        every = [m for m in np.ndindex(*(2 for _ in at)) if any(m)]
        return [m for m in every if all(k >= step for k, step in zip(at, m, strict=True))]

    def _last_stops(self, at: tuple[int, ...]) -> IntArray:
        """Look up each arm's last stop before a state, shape (b, arms)."""
        start = np.full(self._b, self._problem.stops)
        rows = [stops[:, k - 1] if k else start for stops, k in zip(self._queues, at, strict=True)]
        return np.stack(rows, axis=1)

    def _stage(self, at: tuple[int, ...], move: Moves) -> tuple[FloatArray, IntArray]:
        """Compute a stage's ends at a state, with the best earlier angles."""
        before = tuple(k - moves for k, moves in zip(at, move, strict=True))
        idle = np.full(self._b, IDLE)
        stops = np.stack(
            [
                rows[:, k] if moves else idle
                for rows, k, moves in zip(self._queues, before, move, strict=True)
            ],
            axis=1,
        )
        stage_ends, angle = stage_values(
            self._problem, stops, self._last_stops(before), self._values[before]
        )
        waiting = zip(self._sizes, before, move, strict=True)
        stage_ends = stage_ends + self._early * sum(k < n and not moves for n, k, moves in waiting)
        return np.where(self._allowed(before, stops)[:, None], stage_ends, np.inf), angle

    def _allowed(self, before: tuple[int, ...], stops: IntArray) -> BoolArray:
        """Test whether stops may be made in one stage after a state, shape (b,)."""
        stores, allowed = self._problem.stores, np.ones(self._b, dtype=np.bool_)
        if stores is not None:
            level = stores.initial + sum(
                levels[:, k] for levels, k in zip(self._levels, before, strict=True)
            )
            allowed = stores.fits(level, stops) == 0
        for stop, tasks in self._first.items():
            begins = (stops == stop).any(axis=1)
            for task in tasks:
                finished = np.any(
                    [ends[:, task] <= k for ends, k in zip(self._over, before, strict=True)], axis=0
                )
                allowed &= ~begins | finished
        return allowed

    def best(self) -> IntArray:
        """Trace the optimal stages of a single row, shape (n, arms); after `totals`."""
        with np.errstate(invalid="ignore"):
            last = self._values[self._sizes] + closing(self._problem, self._last_stops(self._sizes))
        at, angle, stages = self._sizes, int(last[0].argmin()), list[list[int]]()
        while any(at):
            candidates = [(self._stage(at, move), move) for move in self._into(at)]
            (_, angles_before), move = min(candidates, key=lambda stage: stage[0][0][0, angle])
            at = tuple(k - step for k, step in zip(at, move, strict=True))
            stages.append(
                [
                    int(rows[0, k]) if moves else IDLE
                    for rows, k, moves in zip(self._queues, at, move, strict=True)
                ]
            )
            angle = int(angles_before[0, angle])
        return np.array(stages[::-1], dtype=np.int64).reshape(-1, len(self._sizes))
