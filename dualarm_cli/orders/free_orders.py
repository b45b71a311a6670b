"""Arms and order of an asynchronous job with the platform at one angle.

Includes the time of two arms with tasks that cannot be done at the same time.
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
class FreeOrder:
    """Order with its platform angle."""

    job: Job
    """Job with arms and order."""
    angle: FloatArray
    """Platform angle while tools work [rad], shape (k,)."""
    total: float
    """Cycle time in the model of the search for orders [s]."""


@dataclass(frozen=True)
class FreeOrders:
    """Best orders of asynchronous arms, with a lower bound and whether it is proven."""

    ranked: tuple[FreeOrder, ...]
    """Best orders of each angle, best first; empty if no angle reaches all tasks."""
    bound: float | None
    """Lower bound with the search's postures and angles [s]; None if unknown."""
    exact: bool
    """Whether the best order is proven optimal on the search's postures and angles."""


def free_orders(order: OrderModel, effort: str, seed: int, watch: Watch) -> FreeOrders:
    """Search the best orders at the best platform angles.

    At every angle that reaches all tasks: all orders if they are few, else a short search. Then the best angles are
    refined, and a lower bound is computed for each angle.

    Args:
        order: the job's tasks.
        effort: one of EFFORTS.
        seed: random seed.
        watch: receives the best total so far.
    """
    how = EFFORTS[effort].clocks
    if order.job.is_decided:
        how = replace(how, glance=0, iterations=0)
    reached = order.reached().any(axis=0).all(axis=0)
    problems = {int(f): order.problem(int(f)) for f in np.flatnonzero(reached)}
    problems = {f: problem for f, problem in problems.items() if _each_has_an_arm(problem)}
    best: dict[int, Timed] = {}
    for f, problem in problems.items():
        if watch.stop() and best:
            break
        small = is_small(problem)
        first = exact_order(problem) if small else _glance(Recreator(problem, seed), how, watch)
        if first is not None and first.is_possible:
            best[f] = first
            watch.record(first.total)
    if not best:
        return FreeOrders((), None, exact=False)
    # With a free start at a stand the first transfer and the return are unknown.
    unknown = order.job.start == "free" and bool(order.job.cell.tool_changes)
    bound = None
    if not order.job.is_decided and not unknown:
        bound = _bound(problems, best, how, seed, watch)
    rank = sorted(best, key=lambda f: best[f].objective)[: how.angles]
    # If arms depend on each other, options are chosen for each arm alone, which proves nothing.
    exact = all(is_small(problem) and not problem.coupled for problem in problems.values())
    exact = exact and not watch.stopped and order.job.start != "free"
    ranking = []
    for f in rank:
        if best[f].objective > how.refined_ratio * best[rank[0]].objective:
            continue
        conflicts = None
        if how.iterations and any(task.arm == ANY for task in order.job.tasks):
            conflicts = stop_conflicts(order, f)
        ranked = _improved(problems[f], conflicts, best[f], how, seed, watch)
        exact = exact and ranked[0][1] <= best[f].total + 1e-9
        ranking += [
            FreeOrder(_decided(order, candidate, problems[f].options), order.angles[f], total)
            for candidate, total in ranked
            if np.isfinite(total)
        ]
    ranking.sort(key=lambda answer: answer.total)
    least = min(first.total for first in best.values())
    return FreeOrders(tuple(ranking), least if exact else bound, exact)


def _improved(
    problem: SequencingProblem,
    conflicts: BoolArray | None,
    start: Timed,
    limits: FreeEffort,
    seed: int,
    watch: Watch,
) -> list[tuple[Timed, float]]:
    """Improve an order at an angle under conflict penalties.

    Returns the orders and times [s].

    While an arm is at a task the other one is at any of its own. If the two collide, one arm waits for about
    `conflict_wait`. So tasks cost more by that time times the fraction of the other arm's tasks that they conflict
    with, and orders are improved again, a few times.
    """
    count = max(200, round(limits.iterations * min(1.0, 100 / problem.tasks)))
    if conflicts is None or not conflicts.any():
        if limits.iterations and not is_small(problem):
            start = Recreator(problem, seed).improve(start, count, stop=watch.stop)
        return [(start, start.total)]
    current, candidates = start, [start]
    for k in range(limits.rounds):
        penalised = _with_conflicts(problem, current, conflicts, limits.conflict_wait)
        retimed = timed(penalised, current.order)
        if is_small(penalised):
            retimed = exact_order(penalised) or retimed
        else:
            retimed = Recreator(penalised, seed).improve(
                retimed, count // limits.rounds, stop=watch.stop
            )
        current = timed(problem, retimed.order)
        candidates.append(current)
        if watch.stop() and k:
            break
    return together_ranked(problem, candidates, conflicts)[: limits.kept]


def _with_conflicts(
    problem: SequencingProblem, current: Timed, conflicts: BoolArray, wait: float
) -> SequencingProblem:
    """Add the expected waits for the other arm's tasks to the times of tasks."""
    first = np.concatenate([[0], np.cumsum(problem.stops)])
    rows = current.order.tasks(problem.options)
    stops_by_arm = [[k for t in row for k in range(first[t], first[t + 1])] for row in rows]
    arms = []
    for a, arm in enumerate(problem.arms):
        other_stops = stops_by_arm[1 - a]
        arm_conflicts = conflicts[:, other_stops] if a == 0 else conflicts[other_stops].T
        stops = arm_conflicts.mean(axis=1) if other_stops else np.zeros(len(conflicts))
        fraction = np.add.reduceat(stops, first[:-1])
        arms.append(replace(arm, first=arm.first + wait * fraction[:, None]))
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
    limits: FreeEffort,
    seed: int,
    watch: Watch,
) -> float | None:
    """Compute a lower bound over all angles [s].

    None if tasks are too many or the search was stopped.
    """
    if any(problem.tasks > limits.most_proven for problem in problems.values()):
        return None
    bound = np.inf
    for f, problem in problems.items():
        if watch.stop():
            return None
        watch.report("bounding all orders")
        start = best[f].order.tasks(problem.options) if f in best else None
        bound = min(
            bound, prove(relax_options(problem), start, limits.proof / len(problems), seed).bound
        )
    return float(bound)


def _decided(order: OrderModel, answer: Timed, options: int) -> Job:
    """Build the job with each arm's tasks in their order."""
    job = order.job
    rows = answer.order.tasks(options)
    tasks = []
    for name, row in zip(order.model.arms, rows, strict=True):
        for t in row:
            task = job.tasks[t]
            tasks.append(replace(task, arm=name) if task.arm == ANY else task)
    return replace(job, tasks=tuple(tasks), order="given", pairing=None)


def time_together(problem: SequencingProblem, order: Order, touch: BoolArray) -> float:
    """Time an order in which arms wait wherever their stops collide [s].

    A stop occupies its place from the departure towards it until its end; arms wait between stops.

    Args:
        problem: two arms.
        order: nodes of both arms.
        touch: whether the arms collide at pairs of stops, shape (s, s); stops are numbered task by task.
    """
    ends = [_ends(problem, a, nodes) for a, nodes in enumerate(order.nodes)]
    longest = max((float(arm_ends[-1]) for arm_ends in ends if len(arm_ends)), default=0.0)
    if not all(len(arm_ends) for arm_ends in ends) or longest <= 0.0:
        return longest
    step = longest / 500  # time steps of the slower arm
    steps = [max(1, int(np.ceil(arm_ends[-1] / step - 1e-9))) for arm_ends in ends]
    first = np.concatenate([[0], np.cumsum(problem.stops)])
    stops = [
        [k for t in row for k in range(first[t], first[t + 1])]
        for row in order.tasks(problem.options)
    ]
    doing = [
        _doing(arm_ends, row, count, step)
        for arm_ends, row, count in zip(ends, stops, steps, strict=True)
    ]
    band = max(steps)
    i = np.arange(steps[0] + 1)[:, None]
    j = i + np.arange(2 * band + 1)[None, :] - band
    inside = (j >= 0) & (j <= steps[1])
    colliding = touch[doing[0][i], doing[1][np.clip(j, 0, steps[1])]]
    at_home = (doing[0][i] < 0) | (doing[1][np.clip(j, 0, steps[1])] < 0)
    rests = tuple(
        tuple(sorted({min(round(float(time) / step), count) for time in (0.0, *arm_ends[:-1])}))
        for arm_ends, count in zip(ends, steps, strict=True)
    )
    path = quickest_path(
        Diagram((steps[0], steps[1]), (rests[0], rests[1]), inside & colliding & ~at_home)
    )
    return np.inf if path is None else path.length * step


def _ends(problem: SequencingProblem, a: int, nodes: tuple[int, ...]) -> FloatArray:
    """Compute the ends of stops and return by the arm's clock [s]."""
    if not nodes:
        return np.zeros(0)
    start, w, arm = problem.start_node, problem.options, problem.arms[a]
    ends, clock, last = [], 0.0, start
    for node in nodes:
        t, option = divmod(node, w)
        clock += float(problem.between[a][last, node] + arm.first[t, option])
        ends.append(clock)
        if problem.stops[t] > 1:
            clock += float(arm.second[t, option])
            ends.append(clock)
        last = node
    return np.array([*ends, clock + float(problem.between[a][last, start])])


def _doing(ends: FloatArray, stops: list[int], steps: int, step: float) -> IntArray:
    """Sample the index of an arm's stop at each step, shape (steps + 1,).

    It is -1 at the very start and on the return.
    """
    time = step * np.arange(steps + 1)
    number = np.searchsorted(ends, time, side="right")
    indices: IntArray = np.append(stops, [-1, -1]).astype(np.int64)[np.minimum(number, len(stops))]
    indices[0] = -1
    return indices


def together_ranked(
    problem: SequencingProblem, orders: list[Timed], touch: BoolArray
) -> list[tuple[Timed, float]]:
    """Rank orders and their reversals by the time of both arms together.

    One arm's or both arms' tasks are also tried in reverse, unless they are coupled, in sequences or in the file's
    order.

    Args:
        problem: two arms.
        orders: candidate orders, not empty.
        touch: as of `time_together`.

    Returns:
        Orders with their times [s], the quickest first.
    """
    candidates: list[Timed] = []
    for candidate in {timed_order.order: timed_order for timed_order in orders}.values():
        rows = candidate.order.tasks(problem.options)
        is_fixed = problem.coupled or problem.sequences or problem.in_file_order
        for flip in ((False, False),) if is_fixed else FLIPS:
            reversed_rows = [
                row[::-1] if back else row for row, back in zip(rows, flip, strict=True)
            ]
            candidates.append(
                timed(problem, best_options(problem, reversed_rows)) if any(flip) else candidate
            )
    lengths = [max(order.total, time_together(problem, order.order, touch)) for order in candidates]
    rank = np.argsort(lengths, kind="stable")
    return [(candidates[k], float(lengths[k])) for k in rank]


FLIPS = ((False, False), (True, False), (False, True), (True, True))
"""Combinations of arms whose tasks are done in reverse order."""
