"""When everything begins and ends for given orders of arms with clocks of their own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.sequencing.problem import Order, SequencingProblem
from dualarm_cli.sequencing.stored_times import StoredOrder

LATE = 1000.0
"""What an instant of a window that is missed counts, in instants of the total."""
STUCK = 1e6
"""What a stop counts that is never made, as it waits for a part or for room for ever [s]."""


@dataclass(frozen=True)
class Timed:
    """An order's times."""

    order: Order
    """The order."""
    total: float
    """When all is done [s]; infinite where it cannot be."""
    own: tuple[float, ...]
    """By arm, the time of its own transfers and tasks, without waiting [s]."""
    late: float = 0.0
    """By how much windows are missed, together [s]."""
    begins: tuple[tuple[float, ...], ...] = ()
    """By arm, when each task's first approach begins [s]."""
    ends: tuple[tuple[float, ...], ...] = ()
    """By arm, when each task is over [s]."""
    left: int = 0
    """Stops that are never made, as they wait for parts or for room for ever."""

    @property
    def is_possible(self) -> bool:
        """Returns whether all is done, and in time."""
        return np.isfinite(self.total) and self.late <= 1e-9

    @property
    def worth(self) -> float:
        """What is minimised [s]: the total, what is late many times, and a little of the arms' own times."""
        if self.left:
            return STUCK * self.left + sum(self.own)
        return self.total + LATE * self.late + 1e-3 * sum(self.own)


def timed(problem: SequencingProblem, order: Order) -> Timed:
    """Returns the times of an order, with waits for tasks that come before, for windows to open, and for buffers."""
    own = own_times(problem, order)
    if not problem.coupled:
        return Timed(order, max(own), own)
    if problem.stores is not None:
        return _stored(problem, order, own)
    ways, first = problem.ways, _predecessors(problem)
    clock = [0.0] * len(order.nodes)
    place = [0] * len(order.nodes)
    last = [problem.start_node] * len(order.nodes)
    over: dict[int, float] = {}
    begins: list[list[float]] = [[] for _ in order.nodes]
    ends: list[list[float]] = [[] for _ in order.nodes]
    late = 0.0
    moved = True
    while moved:
        moved = False
        for a, nodes in enumerate(order.nodes):
            while place[a] < len(nodes):
                node = nodes[place[a]]
                task = node // ways
                if any(one not in over for one in first[task]):
                    break
                begin = max(
                    clock[a] + problem.between[a][last[a], node],
                    _not_before(problem, task),
                    *(over[one] for one in first[task]),
                )
                clock[a] = over[task] = begin + problem.length[a][node]
                closes = _not_after(problem, task)
                late += clock[a] - closes if clock[a] > closes else 0.0
                begins[a].append(float(begin))
                ends[a].append(float(clock[a]))
                last[a], place[a], moved = node, place[a] + 1, True
    if any(place[a] < len(nodes) for a, nodes in enumerate(order.nodes)):
        return Timed(order, np.inf, own)
    total = max(
        clock[a] + problem.between[a][last[a], problem.start_node] for a in range(len(clock))
    )
    return Timed(
        order, float(total), own, float(late), tuple(map(tuple, begins)), tuple(map(tuple, ends))
    )


def _stored(problem: SequencingProblem, order: Order, own: tuple[float, ...]) -> Timed:
    """Returns the times of an order with buffers."""
    stored = StoredOrder(problem, order)
    last = stored.played()
    if left := stored.left(last):
        return Timed(order, np.inf, own, left=left)
    return Timed(order, stored.done(last), own, last.late, *stored.times(last))


def own_times(problem: SequencingProblem, order: Order) -> tuple[float, ...]:
    """Returns, by arm, the time of its own transfers and tasks, without waiting [s]."""
    found = []
    for a, nodes in enumerate(order.nodes):
        if not nodes:
            # Nothing, but for an arm that has to change its tool all the same.
            found.append(float(problem.between[a][problem.start_node, problem.start_node]))
            continue
        way = np.array([problem.start_node, *nodes, problem.start_node])
        found.append(
            float(problem.between[a][way[:-1], way[1:]].sum() + problem.length[a][way].sum())
        )
    return tuple(found)


def _predecessors(problem: SequencingProblem) -> list[list[int]]:
    found: list[list[int]] = [[] for _ in range(problem.tasks)]
    for one, other in problem.before:
        found[other].append(one)
    return found


def _not_before(problem: SequencingProblem, task: int) -> float:
    return float(problem.not_before[task]) if len(problem.not_before) else 0.0


def _not_after(problem: SequencingProblem, task: int) -> float:
    return float(problem.not_after[task]) if len(problem.not_after) else np.inf


def keeps_rules(problem: SequencingProblem, tasks: Sequence[Sequence[int]]) -> bool:
    """Returns whether each arm's own order keeps precedence, sequences and, where it has to, the file's order."""
    for own in tasks:
        rank = {task: k for k, task in enumerate(own)}
        if problem.in_file_order and list(own) != sorted(own):
            return False
        if any(a in rank and b in rank and rank[a] > rank[b] for a, b in problem.before):
            return False
        for row in problem.sequences:
            ranks = [rank.get(task, -1) for task in row]
            if max(ranks) < 0:
                continue
            if ranks != list(range(ranks[0], ranks[0] + len(row))):
                return False
    return True


def best_ways(problem: SequencingProblem, tasks: Sequence[Sequence[int]]) -> Order:
    """Returns each arm's tasks in the ways that make its own time least, by dynamic programming along its order."""
    return Order(tuple(_best_ways(problem, a, own)[1] for a, own in enumerate(tasks)))


def _best_ways(
    problem: SequencingProblem, a: int, tasks: Sequence[int]
) -> tuple[float, tuple[int, ...]]:
    if not tasks:
        return 0.0, ()
    w, between, length = problem.ways, problem.between[a], problem.length[a]
    value: FloatArray = np.zeros(1)
    nodes = np.array([problem.start_node])
    came = []
    for task in tasks:
        own = np.arange(task * w, (task + 1) * w)
        total = value[:, None] + between[nodes[:, None], own]
        best = total.argmin(axis=0)
        value = total[best, np.arange(w)] + length[own]
        came.append(best)
        nodes = own
    value = value + between[nodes, problem.start_node]
    k = int(value.argmin())
    least = float(value[k])
    found = []
    for task, best in zip(reversed(tasks), reversed(came), strict=True):
        found.append(task * w + k)
        k = int(best[k])
    return least, tuple(reversed(found))
