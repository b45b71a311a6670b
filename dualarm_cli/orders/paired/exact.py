"""Every order of few tasks in stages: all assignments, all orders of each arm, the k-th stops in one stage."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import islice, permutations, product
from math import prod

import numpy as np

from dualarm_cli.geometry.arrays import IntArray
from dualarm_cli.orders.paired.alignment import Alignments, any_alignment
from dualarm_cli.orders.paired.problem import IDLE, StageOrder, StageProblem, StopUnit
from dualarm_cli.orders.paired.search import StageSearch
from dualarm_cli.orders.paired.times import totals, with_angles

FEW = 7
"""So many tasks, or sequences of tasks, are few."""
FEW_WITH_BUFFERS = 6
"""The same where buffers make arms wait for each other: all stops that may fall into one stage are timed as well."""


def best_of_all(
    problem: StageProblem,
    better: Callable[[float], None] = lambda _: None,
    stop: Callable[[], bool] = lambda: False,
) -> StageOrder | None:
    """Returns the best order of all in which each arm makes its next stop as soon as what comes before it is over.

    None where no order keeps all rules. With buffers it is the best of all, whoever waits for whom.

    Args:
        problem: what is asked.
        better: receives every new least total [s].
        stop: whether to stop early, once there is one.
    """
    if problem.stores is not None:
        return _best_with_buffers(problem, better, stop)
    every = _orders(problem)
    best: tuple[float, IntArray] | None = None
    while some := list(islice(every, 2000)):
        if best is not None and stop():
            break
        length = max(len(one) for one in some)
        batch = np.full((len(some), length, len(problem.length)), IDLE, dtype=np.int64)
        for k, one in enumerate(some):
            batch[k, : len(one)] = one
        found = totals(problem, batch)
        k = int(found.argmin())
        if np.isfinite(found[k]) and (best is None or found[k] < best[0]):
            best = float(found[k]), some[k]
            better(best[0])
    return None if best is None else with_angles(problem, best[1])


def _best_with_buffers(
    problem: StageProblem, better: Callable[[float], None], stop: Callable[[], bool]
) -> StageOrder | None:
    """Returns the best order of all, see `best_of_all`."""
    best: tuple[float, list[IntArray]] | None = None
    for some in _queues(problem):
        if best is not None and stop():
            break
        size = max(1, 1_000_000 // (len(problem.turn) * len(problem.turn)))
        for k in range(0, len(some[0]), size):
            queues = [own[k : k + size] for own in some]
            found = Alignments(problem, queues).totals()
            row = int(found.argmin())
            if np.isfinite(found[row]) and (best is None or found[row] < best[0]):
                best = float(found[row]), [own[row : row + 1] for own in queues]
                better(best[0])
    if best is None:
        return None
    one = Alignments(problem, best[1])
    one.totals()
    return with_angles(problem, one.best())


def _queues(problem: StageProblem) -> Iterator[list[IntArray]]:
    """Yields, for each way to give tasks to arms, every order of all arms: by arm their stops, shape (b, n)."""
    units = StageSearch(problem, 0).units
    for ways in _own_orders(problem, units):
        count = prod(len(own) for own in ways)
        rows = np.indices([len(own) for own in ways]).reshape(len(ways), count)
        yield [
            np.array([[s for u in row for s in units[u].stops] for row in own], dtype=np.int64)[
                rows[a]
            ].reshape(count, -1)
            for a, own in enumerate(ways)
        ]


def _own_orders(
    problem: StageProblem, units: Sequence[StopUnit]
) -> Iterator[list[list[tuple[int, ...]]]]:
    """Yields, for each way to give units to arms, every order of each arm's own."""
    for arms in product(*(unit.arms for unit in units)):
        own = [[u for u, arm in enumerate(arms) if arm == a] for a in range(len(problem.length))]
        if problem.in_file_order:
            ways = [[tuple(sorted(some, key=lambda u: units[u].tasks[0]))] for some in own]
        else:
            ways = [list(permutations(some)) for some in own]
        yield ways


def _orders(problem: StageProblem) -> Iterator[IntArray]:
    """Yields the stages of every order."""
    units = StageSearch(problem, 0).units
    for ways in _own_orders(problem, units):
        for rows in product(*ways):
            slots = side_by_side(problem, [[units[u] for u in row] for row in rows])
            if slots is not None:
                yield slots


def side_by_side(problem: StageProblem, rows: Sequence[Sequence[StopUnit]]) -> IntArray | None:
    """Returns stages in which each arm makes its next stop as soon as what comes before it is over.

    None where arms wait for one another forever, or a rule is broken. With buffers an arm waits as well where both
    would not get to the end otherwise.
    """
    if problem.stores is not None:
        own = [[stop for unit in row for stop in unit.stops] for row in rows]
        meetings = [(problem.tasks[a][-1], problem.tasks[b][0]) for a, b in problem.handovers]
        found = any_alignment(problem.stores, problem.tasks, problem.before, own, meetings)
        return found.slots if found.is_whole else None
    queues = [
        [(t, stop) for unit in row for t in unit.tasks for stop in problem.tasks[t]] for row in rows
    ]
    first: dict[int, list[int]] = {}
    for one, other in problem.before:
        first.setdefault(other, []).append(one)
    partner: dict[int, int] = {}
    for one, other in problem.handovers:
        give, take = problem.tasks[one][-1], problem.tasks[other][0]
        partner |= {give: take, take: give}
    over: set[int] = set()
    place = [0] * len(queues)
    slots = []
    while any(place[a] < len(queue) for a, queue in enumerate(queues)):
        row, done = [IDLE] * len(queues), []
        next_up = {queue[k][1] for queue, k in zip(queues, place, strict=True) if k < len(queue)}
        for a, queue in enumerate(queues):
            if place[a] == len(queue):
                continue
            t, stop = queue[place[a]]
            begins = stop == problem.tasks[t][0]
            if begins and any(one not in over for one in first.get(t, ())):
                continue
            if stop in partner and partner[stop] not in next_up:
                continue  # the other arm has not come yet
            row[a] = stop
            place[a] += 1
            if stop == problem.tasks[t][-1]:
                done.append(t)
        if all(stop == IDLE for stop in row):
            return None
        over.update(done)
        slots.append(row)
    return np.array(slots, dtype=np.int64).reshape(-1, len(queues))
