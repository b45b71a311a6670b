"""Every order of few tasks in stages: all assignments, all orders of each arm, the k-th stops side by side."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import islice, permutations, product

import numpy as np

from dualarm_cli.geometry.arrays import IntArray
from dualarm_cli.sequencing.stage_problem import IDLE, StageOrder, StageProblem
from dualarm_cli.sequencing.stage_search import StageSearch
from dualarm_cli.sequencing.stage_times import totals, with_angles
from dualarm_cli.sequencing.stage_units import Unit

FEW = 7
"""So many tasks, or sequences of tasks, are few."""
AT_ONCE = 2000
"""Orders that are timed at once."""


def best_of_all(
    problem: StageProblem,
    better: Callable[[float], None] = lambda _: None,
    stop: Callable[[], bool] = lambda: False,
) -> StageOrder | None:
    """Returns the best order of all in which each arm makes its next stop as soon as what comes before it is over.

    None where no order keeps all rules.

    Args:
        problem: what is asked.
        better: is told every new least total [s].
        stop: whether to stop early, once there is one.
    """
    every = _orders(problem)
    best: tuple[float, IntArray] | None = None
    while some := list(islice(every, AT_ONCE)):
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


def _orders(problem: StageProblem) -> Iterator[IntArray]:
    """Yields the stages of every order."""
    units = StageSearch(problem, 0).units
    for arms in product(*(unit.arms for unit in units)):
        own = [[u for u, arm in enumerate(arms) if arm == a] for a in range(len(problem.length))]
        if problem.in_file_order:
            ways = [[tuple(sorted(some, key=lambda u: units[u].tasks[0]))] for some in own]
        else:
            ways = [list(permutations(some)) for some in own]
        for rows in product(*ways):
            slots = side_by_side(problem, [[units[u] for u in row] for row in rows])
            if slots is not None:
                yield slots


def side_by_side(problem: StageProblem, rows: Sequence[Sequence[Unit]]) -> IntArray | None:
    """Returns stages in which each arm makes its next stop as soon as what comes before it is over.

    None where arms wait for one another for ever, or a rule is broken.
    """
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
