"""Enumeration of few tasks in stages: all assignments and orders.

The k-th stops of all arms are in the same stage.
"""

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
"""Maximum number of tasks whose orders are all timed."""
FEW_WITH_BUFFERS = 6
"""Maximum number of tasks whose orders are all timed in jobs with buffers.

All pairings of stops are timed as well, because buffers make arms wait for each other.
"""


def best_of_all(
    problem: StageProblem,
    better: Callable[[float], None] = lambda _: None,
    stop: Callable[[], bool] = lambda: False,
) -> StageOrder | None:
    """Compute the best order whose arms make each stop as soon as possible.

    None if no order is feasible. With buffers it is the best order, whichever arm waits.

    Args:
        problem: the stage problem.
        better: receives every new least total [s].
        stop: whether to stop early, once an order was found.
    """
    if problem.stores is not None:
        return _best_with_buffers(problem, better, stop)
    orders = _orders(problem)
    best: tuple[float, IntArray] | None = None
    while chunk := list(islice(orders, 2000)):
        if best is not None and stop():
            break
        length = max(len(order) for order in chunk)
        batch = np.full((len(chunk), length, len(problem.length)), IDLE, dtype=np.int64)
        for k, order in enumerate(chunk):
            batch[k, : len(order)] = order
        makespans = totals(problem, batch)
        k = int(makespans.argmin())
        if np.isfinite(makespans[k]) and (best is None or makespans[k] < best[0]):
            best = float(makespans[k]), chunk[k]
            better(best[0])
    return None if best is None else with_angles(problem, best[1])


def _best_with_buffers(
    problem: StageProblem, better: Callable[[float], None], stop: Callable[[], bool]
) -> StageOrder | None:
    """Compute the best order with buffers, see `best_of_all`."""
    best: tuple[float, list[IntArray]] | None = None
    for every_order in _queues(problem):
        if best is not None and stop():
            break
        size = max(1, 1_000_000 // (len(problem.turn) * len(problem.turn)))
        for k in range(0, len(every_order[0]), size):
            queues = [rows[k : k + size] for rows in every_order]
            makespans = Alignments(problem, queues).totals()
            row = int(makespans.argmin())
            if np.isfinite(makespans[row]) and (best is None or makespans[row] < best[0]):
                best = float(makespans[row]), [rows[row : row + 1] for rows in queues]
                better(best[0])
    if best is None:
        return None
    alignments = Alignments(problem, best[1])
    alignments.totals()
    return with_angles(problem, alignments.best())


def _queues(problem: StageProblem) -> Iterator[list[IntArray]]:
    """Yield all orders by assignment: each arm's stops, shape (b, n)."""
    units = StageSearch(problem, 0).units
    for orders in _orders_by_arm(problem, units):
        count = prod(len(arm_orders) for arm_orders in orders)
        rows = np.indices([len(arm_orders) for arm_orders in orders]).reshape(len(orders), count)
        yield [
            np.array(
                [[s for u in row for s in units[u].stops] for row in arm_orders], dtype=np.int64
            )[rows[a]].reshape(count, -1)
            for a, arm_orders in enumerate(orders)
        ]


def _orders_by_arm(
    problem: StageProblem, units: Sequence[StopUnit]
) -> Iterator[list[list[tuple[int, ...]]]]:
    """Yield every order of each arm's units, for each assignment of units."""
    for arms in product(*(unit.arms for unit in units)):
        assigned = [
            [u for u, arm in enumerate(arms) if arm == a] for a in range(len(problem.length))
        ]
        if problem.in_file_order:
            orders = [
                [tuple(sorted(arm_units, key=lambda u: units[u].tasks[0]))]
                for arm_units in assigned
            ]
        else:
            orders = [list(permutations(arm_units)) for arm_units in assigned]
        yield orders


def _orders(problem: StageProblem) -> Iterator[IntArray]:
    """Yield the stages of every order."""
    units = StageSearch(problem, 0).units
    for orders in _orders_by_arm(problem, units):
        for rows in product(*orders):
            slots = side_by_side(problem, [[units[u] for u in row] for row in rows])
            if slots is not None:
                yield slots


def side_by_side(problem: StageProblem, rows: Sequence[Sequence[StopUnit]]) -> IntArray | None:
    """Build stages, each stop as early as its rules allow.

    None in a deadlock, or if a rule is violated. With buffers an arm also waits if the order would end in a deadlock
    otherwise.
    """
    if problem.stores is not None:
        stops = [[stop for unit in row for stop in unit.stops] for row in rows]
        meetings = [(problem.tasks[a][-1], problem.tasks[b][0]) for a, b in problem.handovers]
        aligned = any_alignment(problem.stores, problem.tasks, problem.before, stops, meetings)
        return aligned.slots if aligned.is_whole else None
    queues = [
        [(t, stop) for unit in row for t in unit.tasks for stop in problem.tasks[t]] for row in rows
    ]
    predecessors: dict[int, list[int]] = {}
    for earlier, later in problem.before:
        predecessors.setdefault(later, []).append(earlier)
    partner: dict[int, int] = {}
    for giving, taking in problem.handovers:
        give, take = problem.tasks[giving][-1], problem.tasks[taking][0]
        partner |= {give: take, take: give}
    finished: set[int] = set()
    place = [0] * len(queues)
    slots = []
    while any(place[a] < len(queue) for a, queue in enumerate(queues)):
        row, completed = [IDLE] * len(queues), []
        next_up = {queue[k][1] for queue, k in zip(queues, place, strict=True) if k < len(queue)}
        for a, queue in enumerate(queues):
            if place[a] == len(queue):
                continue
            t, stop = queue[place[a]]
            begins = stop == problem.tasks[t][0]
            if begins and any(earlier not in finished for earlier in predecessors.get(t, ())):
                continue
            if stop in partner and partner[stop] not in next_up:
                continue  # the other arm is not ready yet
            row[a] = stop
            place[a] += 1
            if stop == problem.tasks[t][-1]:
                completed.append(t)
        if all(stop == IDLE for stop in row):
            return None
        finished.update(completed)
        slots.append(row)
    return np.array(slots, dtype=np.int64).reshape(-1, len(queues))
