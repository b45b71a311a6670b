"""Arms and order of an asynchronous job, with the platform at one angle.

It includes the time of two arms some of whose tasks cannot be done at the same time.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dualarm_cli.effort import EFFORTS, FreeEffort
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.model.job import ANY, Job
from dualarm_cli.orders.asynchronous.coordination import Diagram, quickest_path
from dualarm_cli.orders.asynchronous.exact import exact_order, is_small
from dualarm_cli.orders.asynchronous.problem import Order, SequencingProblem
from dualarm_cli.orders.asynchronous.recreate import Recreator
from dualarm_cli.orders.asynchronous.times import Timed, best_options, timed
from dualarm_cli.orders.model.meeting import stop_conflicts
from dualarm_cli.orders.model.order_model import OrderModel
from dualarm_cli.orders.proof.cp_sat import prove
from dualarm_cli.orders.proof.relaxation import relax_options
from dualarm_cli.orders.watch import Watch
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class FreeOrderSettings:
    """Numbers that steer the order search of asynchronous arms."""

    most_proven: int = 40
    """Maximum number of tasks for which all orders are bounded."""
    wait: float = 1.5
    """Extra time of a stop that conflicts with all of the other arm's [s]."""
    spare: int = 4
    """Maximum number of orders kept at one angle. The best ones may be infeasible."""
    rounds: int = 4
    """So often orders are improved with what the last one has in each other's way."""
    promising: float = 1.05
    """Angles whose first orders take longer than the best one's by more than this are left."""
    steps: int = 500
    """Steps in which the slower arm's time is divided."""


FREE = FreeOrderSettings()


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

    ranked: tuple[FreeOrder, ...]
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
            watch.record(first.total)
    if not best:
        return FreeOrders((), None, exact=False)
    # Where an arm begins at a stand that a free start puts it to nothing is known of the ways there and back.
    unknown = order.job.start == "free" and bool(order.job.cell.tool_changes)
    bound = None
    if not order.job.is_decided and not unknown:
        bound = _bound(problems, best, how, seed, watch)
    rank = sorted(best, key=lambda f: best[f].objective)[: how.angles]
    # Where arms depend on each other, the ways of tasks are those that are best for each arm alone: no proof.
    exact = all(is_small(one) and not one.coupled for one in problems.values())
    exact = exact and not watch.stopped and order.job.start != "free"
    found = []
    for f in rank:
        if best[f].objective > FREE.promising * best[rank[0]].objective:
            continue
        touch = None
        if how.iterations and any(task.arm == ANY for task in order.job.tasks):
            touch = stop_conflicts(order, f)
        ranked = _improved(problems[f], touch, best[f], how, seed, watch)
        exact = exact and ranked[0][1] <= best[f].total + 1e-9
        found += [
            FreeOrder(_decided(order, own, problems[f].options), order.angles[f], total)
            for own, total in ranked
            if np.isfinite(total)
        ]
    found.sort(key=lambda one: one.total)
    least = min(one.total for one in best.values())
    return FreeOrders(tuple(found), least if exact else bound, exact)


def _improved(
    problem: SequencingProblem,
    touch: BoolArray | None,
    start: Timed,
    how: FreeEffort,
    seed: int,
    watch: Watch,
) -> list[tuple[Timed, float]]:
    """Returns better orders at one angle, in which the arms are seldom in each other's way, and how long they take [s].

    While an arm is at a task the other one is at any of its own: where the two touch, one will wait for
    about `wait`. So
    tasks are made dearer by that times the share of the other arm's present tasks that they touch, and orders are
    improved anew, a few times.
    """
    count = max(200, round(how.iterations * min(1.0, 100 / problem.tasks)))
    if touch is None or not touch.any():
        if how.iterations and not is_small(problem):
            start = Recreator(problem, seed).improve(start, count, stop=watch.stop)
        return [(start, start.total)]
    current, tried = start, [start]
    for k in range(FREE.rounds):
        dear = _with_conflicts(problem, current, touch)
        again = timed(dear, current.order)
        if is_small(dear):
            again = exact_order(dear) or again
        else:
            again = Recreator(dear, seed).improve(again, count // FREE.rounds, stop=watch.stop)
        current = timed(problem, again.order)
        tried.append(current)
        if watch.stop() and k:
            break
    return together_ranked(problem, tried, touch)[: FREE.spare]


def _with_conflicts(
    problem: SequencingProblem, current: Timed, touch: BoolArray
) -> SequencingProblem:
    """Returns a problem in which tasks are dearer by the waits that they cause with the other arm's present tasks."""
    first = np.concatenate([[0], np.cumsum(problem.stops)])
    rows = current.order.tasks(problem.options)
    own = [[k for t in row for k in range(first[t], first[t + 1])] for row in rows]
    arms = []
    for a, arm in enumerate(problem.arms):
        other = own[1 - a]
        mine = touch[:, other] if a == 0 else touch[other].T
        stops = mine.mean(axis=1) if other else np.zeros(len(touch))
        share = np.add.reduceat(stops, first[:-1])
        arms.append(replace(arm, first=arm.first + FREE.wait * share[:, None]))
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
    if any(one.tasks > FREE.most_proven for one in problems.values()):
        return None
    found = np.inf
    for f, one in problems.items():
        if watch.stop():
            return None
        watch.report("bounding all orders")
        start = best[f].order.tasks(one.options) if f in best else None
        found = min(found, prove(relax_options(one), start, how.proof / len(problems), seed).bound)
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


def time_together(problem: SequencingProblem, order: Order, touch: BoolArray) -> float:
    """Time an order in which arms wait wherever their stops touch [s].

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
    step = longest / FREE.steps
    steps = [max(1, int(np.ceil(own[-1] / step - 1e-9))) for own in ends]
    first = np.concatenate([[0], np.cumsum(problem.stops)])
    stops = [
        [k for t in row for k in range(first[t], first[t + 1])]
        for row in order.tasks(problem.options)
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
    found = quickest_path(
        Diagram((steps[0], steps[1]), (rests[0], rests[1]), inside & both & ~home)
    )
    return np.inf if found is None else found.length * step


def _ends(problem: SequencingProblem, a: int, nodes: tuple[int, ...]) -> FloatArray:
    """Compute by the arm's clock when each stop and the return end [s]."""
    if not nodes:
        return np.zeros(0)
    start, w, arm = problem.start_node, problem.options, problem.arms[a]
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
    """Sample the index of an arm's stop at each step, shape (steps + 1,).

    It is -1 at the very start and on the return.
    """
    time = step * np.arange(steps + 1)
    number = np.searchsorted(ends, time, side="right")
    found: IntArray = np.append(stops, [-1, -1]).astype(np.int64)[np.minimum(number, len(stops))]
    found[0] = -1
    return found


def together_ranked(
    problem: SequencingProblem, orders: list[Timed], touch: BoolArray
) -> list[tuple[Timed, float]]:
    """Rank orders and their reversals by the time of both arms together.

    One arm's or both arms' tasks are also tried in reverse, unless they are coupled, in sequences or in the file's
    order.

    Args:
        problem: two arms.
        orders: good orders, not empty.
        touch: as of `time_together`.

    Returns:
        Orders with their times [s], the quickest first.
    """
    tries: list[Timed] = []
    for one in {one.order: one for one in orders}.values():
        rows = one.order.tasks(problem.options)
        turned = problem.coupled or problem.sequences or problem.in_file_order
        for flip in ((False, False),) if turned else FLIPS:
            own = [row[::-1] if back else row for row, back in zip(rows, flip, strict=True)]
            tries.append(timed(problem, best_options(problem, own)) if any(flip) else one)
    lengths = [max(one.total, time_together(problem, one.order, touch)) for one in tries]
    rank = np.argsort(lengths, kind="stable")
    return [(tries[k], float(lengths[k])) for k in rank]


FLIPS = ((False, False), (True, False), (False, True), (True, True))
"""Combinations of arms whose tasks are done in reverse order."""
