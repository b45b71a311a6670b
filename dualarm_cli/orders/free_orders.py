"""Arms and order of a job whose arms are asynchronous, with the platform standing at one angle."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dualarm_cli.effort import EFFORTS, FreeEffort
from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.model.job import ANY, Job
from dualarm_cli.orders.asynchronous.exact import exact_order, is_small
from dualarm_cli.orders.asynchronous.problem import SequencingProblem
from dualarm_cli.orders.asynchronous.recreate import Recreator
from dualarm_cli.orders.asynchronous.shared_space import together_ranked
from dualarm_cli.orders.asynchronous.times import Timed, timed
from dualarm_cli.orders.model.meeting import stop_conflicts
from dualarm_cli.orders.model.order_model import OrderModel
from dualarm_cli.orders.proof.cp_sat import prove
from dualarm_cli.orders.proof.relaxation import of_ways
from dualarm_cli.orders.watch import Watch
from dualarm_cli.records import dataclass

MOST_PROVEN = 40
"""Of so many tasks at most a bound on all orders is looked for."""
WAIT = 1.5
"""What a task costs more at which the other arm is in the way wherever it works [s]."""
SPARE = 4
"""Orders at one angle that are kept, for the case that the best ones cannot be planned."""
ROUNDS = 4
"""So often orders are improved with what the last one has in each other's way."""
PROMISING = 1.05
"""Angles whose first orders take longer than the best one's by more than this are left."""


@dataclass(frozen=True)
class FreeOrder:
    """One answer."""

    job: Job
    """The job with arms and order."""
    angle: FloatArray
    """Where the platform stands while tools work, shape (k,)."""
    total: float
    """Its cycle time as far as the search for orders knows [s]."""


@dataclass(frozen=True)
class FreeOrders:
    """What the search found."""

    found: tuple[FreeOrder, ...]
    """Some of the best ones of each angle, the best of all first; none where no angle serves all tasks."""
    bound: float | None
    """No order takes less with the search's postures and the platform at any of its angles [s]; None if unknown."""
    exact: bool
    """Whether the best order is proven to be that with the search's postures and angles."""


def free_orders(order: OrderModel, effort: str, seed: int, watch: Watch) -> FreeOrders:
    """Returns the best orders found at the best platform angles.

    At every angle from which all tasks are reached: all orders where they are few, else a glance; then the best angles
    more closely; then a bound at each angle.

    Args:
        order: the job's tasks.
        effort: one of EFFORTS.
        seed: of all randomness.
        watch: receives the best so far.
    """
    how = EFFORTS[effort].clocks
    if order.job.is_decided:
        how = FreeEffort(0, 0, how.angles, how.proof)
    reached = order.reached().any(axis=0).all(axis=0)
    problems = {int(f): order.problem(int(f)) for f in np.flatnonzero(reached)}
    problems = {f: one for f, one in problems.items() if _each_has_an_arm(one)}
    best: dict[int, Timed] = {}
    for f, one in problems.items():
        if watch.stop() and best:
            break
        first = exact_order(one) if is_small(one) else _glance(Recreator(one, seed), how, watch)
        if first is not None and first.is_possible:
            best[f] = first
            watch.found(first.total)
    if not best:
        return FreeOrders((), None, exact=False)
    # Where an arm begins at a stand that a free start puts it to nothing is known of the ways there and back.
    unknown = order.job.start == "free" and bool(order.job.cell.tool_changes)
    bound = None
    if not order.job.is_decided and not unknown:
        bound = _bound(problems, best, how, seed, watch)
    rank = sorted(best, key=lambda f: best[f].worth)[: how.angles]
    # Where arms depend on each other, the ways of tasks are those that are best for each arm alone: no proof.
    exact = all(is_small(one) and not one.coupled for one in problems.values())
    exact = exact and not watch.stopped and order.job.start != "free"
    found = []
    for f in rank:
        if best[f].worth > PROMISING * best[rank[0]].worth:
            continue
        ranked = _improved(order, f, problems[f], best[f], how, seed, watch)
        exact = exact and ranked[0][1] <= best[f].total + 1e-9
        found += [
            FreeOrder(_decided(order, own, problems[f].ways), order.angles[f], total)
            for own, total in ranked
            if np.isfinite(total)
        ]
    found.sort(key=lambda one: one.total)
    least = min(one.total for one in best.values())
    return FreeOrders(tuple(found), least if exact else bound, exact)


def _improved(
    order: OrderModel,
    f: int,
    problem: SequencingProblem,
    start: Timed,
    how: FreeEffort,
    seed: int,
    watch: Watch,
) -> list[tuple[Timed, float]]:
    """Returns better orders at one angle, in which the arms are seldom in each other's way, and how long they take [s].

    While an arm is at a task the other one is at any of its own: where the two touch, one will wait for about WAIT. So
    tasks are made dearer by that times the share of the other arm's present tasks that they touch, and orders are
    improved anew, a few times.
    """
    touch = None
    if how.iterations and any(task.arm == ANY for task in order.job.tasks):
        touch = stop_conflicts(order, f)
    count = max(200, round(how.iterations * min(1.0, 100 / problem.tasks)))
    if touch is None or not touch.any():
        if how.iterations and not is_small(problem):
            start = Recreator(problem, seed).improve(start, count, stop=watch.stop)
        return [(start, start.total)]
    current, tried = start, [start]
    for k in range(ROUNDS):
        dear = _with_conflicts(problem, current, touch)
        again = timed(dear, current.order)
        if is_small(dear):
            again = exact_order(dear) or again
        else:
            again = Recreator(dear, seed).improve(again, count // ROUNDS, stop=watch.stop)
        current = timed(problem, again.order)
        tried.append(current)
        if watch.stop() and k:
            break
    return together_ranked(problem, tried, touch)[:SPARE]


def _with_conflicts(
    problem: SequencingProblem, current: Timed, touch: BoolArray
) -> SequencingProblem:
    """Returns a problem in which tasks are dearer by the waits that they cause with the other arm's present tasks."""
    first = np.concatenate([[0], np.cumsum(problem.stops)])
    rows = current.order.tasks(problem.ways)
    own = [[k for t in row for k in range(first[t], first[t + 1])] for row in rows]
    arms = []
    for a, arm in enumerate(problem.arms):
        other = own[1 - a]
        mine = touch[:, other] if a == 0 else touch[other].T
        stops = mine.mean(axis=1) if other else np.zeros(len(touch))
        share = np.add.reduceat(stops, first[:-1])
        arms.append(replace(arm, first=arm.first + WAIT * share[:, None]))
    return replace(problem, arms=tuple(arms))


def _glance(search: Recreator, how: FreeEffort, watch: Watch) -> Timed | None:
    first = search.first()
    if first is None:
        return None
    return search.improve(first, how.glance, stop=watch.stop)


def _each_has_an_arm(problem: SequencingProblem) -> bool:
    return bool(np.any([arm.allowed for arm in problem.arms], axis=0).all())


def _bound(
    problems: dict[int, SequencingProblem],
    best: dict[int, Timed],
    how: FreeEffort,
    seed: int,
    watch: Watch,
) -> float | None:
    """Returns a bound over all angles [s]; None where there are too many tasks or it was stopped."""
    if any(one.tasks > MOST_PROVEN for one in problems.values()):
        return None
    found = np.inf
    for f, one in problems.items():
        if watch.stop():
            return None
        watch.tell("bounding all orders")
        start = best[f].order.tasks(one.ways) if f in best else None
        found = min(found, prove(of_ways(one), start, how.proof / len(problems), seed).bound)
    return float(found)


def _decided(order: OrderModel, answer: Timed, ways: int) -> Job:
    """Returns the job with each arm's tasks in their order."""
    job = order.job
    rows = answer.order.tasks(ways)
    tasks = []
    for name, row in zip(order.model.arms, rows, strict=True):
        for t in row:
            task = job.tasks[t]
            tasks.append(replace(task, arm=name) if task.arm == ANY else task)
    return replace(job, tasks=tuple(tasks), order="given", pairing=None)
