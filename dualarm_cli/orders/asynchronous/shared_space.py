"""How long two arms take together where some of their tasks cannot be done at the same time."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.orders.asynchronous.coordination import Diagram, quickest_together
from dualarm_cli.orders.asynchronous.problem import Order, SequencingProblem
from dualarm_cli.orders.asynchronous.times import Timed, best_ways, timed

STEPS = 500
"""Steps in which the slower arm's time is divided."""


def time_together(problem: SequencingProblem, order: Order, touch: BoolArray) -> float:
    """Returns when both arms are done if they wait for each other wherever their stops touch [s].

    A stop takes its place from when the arm leaves for it until it is over; arms wait between stops.

    Args:
        problem: two arms.
        order: their tasks.
        touch: whether the arms touch while the first makes one stop and the second another, shape (s, s); stops are
            those of all tasks, one after the other.
    """
    ends = [_ends(problem, a, nodes) for a, nodes in enumerate(order.nodes)]
    longest = max((float(own[-1]) for own in ends if len(own)), default=0.0)
    if not all(len(own) for own in ends) or longest <= 0.0:
        return longest
    step = longest / STEPS
    steps = [max(1, int(np.ceil(own[-1] / step - 1e-9))) for own in ends]
    first = np.concatenate([[0], np.cumsum(problem.stops)])
    stops = [
        [k for t in row for k in range(first[t], first[t + 1])] for row in order.tasks(problem.ways)
    ]
    doing = [
        _doing(own, row, count, step) for own, row, count in zip(ends, stops, steps, strict=True)
    ]
    band = max(steps)
    i = np.arange(steps[0] + 1)[:, None]
    j = i + np.arange(2 * band + 1)[None, :] - band
    inside = (j >= 0) & (j <= steps[1])
    both = touch[doing[0][i], doing[1][np.clip(j, 0, steps[1])]]
    home = (doing[0][i] < 0) | (doing[1][np.clip(j, 0, steps[1])] < 0)
    rests = tuple(
        tuple(sorted({min(round(float(time) / step), count) for time in (0.0, *own[:-1])}))
        for own, count in zip(ends, steps, strict=True)
    )
    found = quickest_together(
        Diagram((steps[0], steps[1]), (rests[0], rests[1]), inside & both & ~home)
    )
    return np.inf if found is None else found.length * step


def _ends(problem: SequencingProblem, a: int, nodes: tuple[int, ...]) -> FloatArray:
    """Returns when each stop is over, and at last when the arm is back, by its own clock [s]."""
    if not nodes:
        return np.zeros(0)
    start, w, arm = problem.start_node, problem.ways, problem.arms[a]
    found, clock, last = [], 0.0, start
    for node in nodes:
        t, way = divmod(node, w)
        clock += float(problem.between[a][last, node] + arm.first[t, way])
        found.append(clock)
        if problem.stops[t] > 1:
            clock += float(arm.second[t, way])
            found.append(clock)
        last = node
    return np.array([*found, clock + float(problem.between[a][last, start])])


def _doing(ends: FloatArray, stops: list[int], steps: int, step: float) -> IntArray:
    """Returns which stop an arm makes after so many steps, -1 on its way back and at its very start."""
    time = step * np.arange(steps + 1)
    number = np.searchsorted(ends, time, side="right")
    found: IntArray = np.append(stops, [-1, -1]).astype(np.int64)[np.minimum(number, len(stops))]
    found[0] = -1
    return found


def together_ranked(
    problem: SequencingProblem, orders: list[Timed], touch: BoolArray
) -> list[tuple[Timed, float]]:
    """Returns orders, as they are and with one arm's or both arms' tasks the other way round, the quickest first.

    Each with how long it takes together [s].

    Args:
        problem: two arms.
        orders: good orders, not empty.
        touch: as of `time_together`.
    """
    tries: list[Timed] = []
    for one in {one.order: one for one in orders}.values():
        rows = one.order.tasks(problem.ways)
        turned = problem.coupled or problem.sequences or problem.in_file_order
        for flip in ((False, False),) if turned else FLIPS:
            own = [row[::-1] if back else row for row, back in zip(rows, flip, strict=True)]
            tries.append(timed(problem, best_ways(problem, own)) if any(flip) else one)
    lengths = [max(one.total, time_together(problem, one.order, touch)) for one in tries]
    rank = np.argsort(lengths, kind="stable")
    return [(tries[k], float(lengths[k])) for k in rank]


FLIPS = ((False, False), (True, False), (False, True), (True, True))
"""Which arms' orders are turned round."""
