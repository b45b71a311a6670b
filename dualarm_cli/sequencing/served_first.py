"""A first order where buffers make arms wait: what can be done next is put last, so that no arm waits for ever."""

from __future__ import annotations

import numpy as np

from dualarm_cli.sequencing.problem import Order, SequencingProblem
from dualarm_cli.sequencing.route_units import Unit
from dualarm_cli.sequencing.times import Timed, timed

TRIES = 6
"""So often all is begun anew where it leads nowhere."""
LOOKS = 8
"""So many of an arm's next units are looked at before all are."""


def order_that_is_served(
    problem: SequencingProblem, units: list[Unit], random: np.random.Generator
) -> Timed | None:
    """Returns an order in which no arm waits for ever, None where none was found.

    Units are put behind what is there, where all is over soonest among those for which there are parts and room.

    Args:
        problem: with buffers.
        units: tasks that go together.
        random: for the order in which units are looked at.
    """
    for _ in range(TRIES):
        found = _tried(problem, units, random)
        if found is not None:
            return found
    return None


def _tried(
    problem: SequencingProblem, units: list[Unit], random: np.random.Generator
) -> Timed | None:
    rows: list[tuple[int, ...]] = [() for _ in problem.arms]
    left = random.permutation(len(units)).tolist()
    if problem.in_file_order:
        left.sort(key=lambda u: units[u].tasks)
    best: Timed | None = None
    while left:
        best = None
        taken = (0, 0)
        for some in (left[:LOOKS], left[LOOKS:]):
            for u in some:
                for a in range(len(rows)):
                    if not _may_be_next(problem, units, left, u, a):
                        continue
                    way = int(units[u].inside[a].argmin())
                    more = tuple(units[u].nodes[a][way].tolist())
                    order = Order(tuple(r + more * (b == a) for b, r in enumerate(rows)))
                    one = timed(problem, order)
                    if np.isfinite(one.total) and (best is None or one.worth < best.worth):
                        best, taken = one, (u, a)
            if best is not None:
                break
        if best is None:
            return None
        rows = list(best.order.nodes)
        left.remove(taken[0])
    return best


def _may_be_next(
    problem: SequencingProblem, units: list[Unit], left: list[int], u: int, a: int
) -> bool:
    """Returns whether an arm can do a unit, and keeps the file's order with it where it has to."""
    if not np.isfinite(units[u].inside[a]).any():
        return False
    if not problem.in_file_order:
        return True
    return u == next(v for v in left if np.isfinite(units[v].inside[a]).any())
