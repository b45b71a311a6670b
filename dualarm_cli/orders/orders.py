"""Arms, order and pairing of a job that leaves them open: the best ones found, as jobs that say all."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dualarm_cli.effort import EFFORTS
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import ANY, Job
from dualarm_cli.orders.decided_jobs import decided
from dualarm_cli.orders.free_orders import free_orders
from dualarm_cli.orders.messages import (
    check_meetings,
    check_reach,
    grid_gap,
    why_impossible,
)
from dualarm_cli.orders.model.order_model import OrderModel
from dualarm_cli.orders.model.stage_order_model import StageModel, stage_model, stage_stands
from dualarm_cli.orders.model.tool_changes import paired_as, with_changes
from dualarm_cli.orders.order_proofs import is_provable, least_total, proven_orders
from dualarm_cli.orders.paired.changes import (
    StageStands,
    closed,
    stages_with_changes,
    with_whole_changes,
)
from dualarm_cli.orders.paired.orders import good_orders, is_few, searched_orders, short_search
from dualarm_cli.orders.paired.problem import IDLE, StageOrder, StageProblem, split_pairs
from dualarm_cli.orders.paired.times import totals, with_angles
from dualarm_cli.orders.proof.relaxation import relax_options, relax_stages
from dualarm_cli.orders.watch import Watch
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal
from dualarm_cli.stages.plans.problem import Decisions

NO_ORDER_FOUND = "no_order_found"
"""What is refused where the search finds no order, and nothing is proven."""
PROVEN = "proven by dynamic programming to be the best of all orders on the grid of the search"
"""How orders of few tasks of one arm are found."""
DYNAMIC = (
    "found by dynamic programming over partial orders, with lower bounds on the remaining time"
)
"""How orders are found on the way to a bound."""
SEARCHED = "found by removing tasks and inserting them again where the plan is then shortest"
"""How orders of many tasks are found."""


@dataclass(frozen=True)
class DecidedOrder:
    """One answer."""

    job: Job
    """The job with arms, order and pairing."""
    total: float
    """Its cycle time as far as the search for orders knows [s]."""
    plan: Decisions | None = None
    """Platform angles and postures that the search counts on; None where it says none."""
    expected: float | None = None
    """About how long its plan will take, off the search's grid and clear of everything [s]; None where not tried."""


@dataclass(frozen=True)
class Orders:
    """What the search found."""

    ranked: tuple[DecidedOrder, ...]
    """Different orders, the best one first."""
    bound: float | None
    """No order takes less with the search's platform angles and postures [s]; None where none is known."""
    how: str
    """How they were found, in words."""

    def gap(self, total: float) -> float | None:
        """Returns by what share another order may be quicker than one of a total [s], both on the search's grid.

        None without a bound.
        """
        return grid_gap(self.bound, total)


@dataclass(frozen=True)
class PairedSearch:
    """The search for orders of paired arms."""

    order: OrderModel
    """The job's tasks as each arm may do them."""
    stages: StageModel
    """Its stages, and what their numbers mean."""
    problem: StageProblem
    """Its stages as the search has them."""
    effort: str
    """One of EFFORTS."""
    seed: int
    """Of all randomness."""
    start: IntArray | None = None
    """An order that is known to be good, shape (n, arms); None where none is."""
    stands: StageStands | None = None
    """The same with the stops of tool changes as stops; None where no arm changes tools."""

    @classmethod
    def of(
        cls, model: CellModel, job: Job, effort: str, seed: int, watch: Watch, *, clear: bool
    ) -> PairedSearch:
        """Prepares a job.

        Args:
            model: its cell.
            job: what is to be done.
            effort: one of EFFORTS.
            seed: of all randomness.
            watch: receives what is being done.
            clear: whether postures have to be clear of the cell, and arms of each other at their stops.

        Raises:
            InfeasibleError: a task that no arm reaches.
        """
        watch.report("timing each task at every platform angle")
        order = OrderModel.of(model, job, clear=clear)
        check_reach(order)
        stages = stage_model(order)
        whole = stages.problem
        check_meetings(order, whole)
        stands = stage_stands(order, whole)
        problem = whole if stands is None else with_whole_changes(stands, len(job.tasks))
        return cls(order, stages, problem, effort, seed, stands=stands)

    def orders(self, watch: Watch) -> Orders:
        """Returns the best orders found.

        Raises:
            InfeasibleError: rules that no order keeps.
        """
        job, model = self.order.job, self.order.model
        # An arm's own clock knows windows of whole tasks only, not those of targets that move.
        if len(model.arms) == 1 and not model.platform.is_chosen and not job.moves:
            return _alone(self.order, self.effort, self.seed, watch)
        watch.report("putting tasks in order")
        tasks = len(self.problem.tasks)
        kept = EFFORTS[self.effort].order_bound.time_share * (watch.limit or 0.0)
        effort, provable = EFFORTS[self.effort].orders, is_provable(self.problem, self.effort)
        if provable:
            # What bounds orders finds good ones as well.
            effort = effort.shorter(4)
        wanted = (
            self.problem,
            effort,
            self.seed,
            self.start,
            watch.record,
            lambda: watch.stop(kept),
        )
        found, few = good_orders(*wanted), is_few(self.problem) and self.start is None
        if few and not found:
            # Where the k-th stops of both arms collide, one arm may wait for the other one.
            found, few = searched_orders(*wanted), False
        if not found or self._is_late(found[0]):
            # Lateness is as far as the search knows: only what is proven ends here.
            # And with targets that move where they are guessed to be met it proves nothing.
            why = None
            if not job.moves:
                why = why_impossible(self.order, relax_stages(self.problem))
            if why is not None or not found:
                raise why or InfeasibleError(Refusal(NO_ORDER_FOUND))
        bound, how = None, SEARCHED
        if few:
            which = "some" if watch.stopped else "all"
            stages = "the k-th stops of all arms in one stage"
            if self.problem.stores is not None:
                stages = "with every choice of which arm waits"
            how = f"{which} orders of {tasks} tasks were timed, {stages}"
        # What was timed is no bound: orders in which an arm is idle for a stage are not among it.
        if provable and not watch.stop():
            known = found[0]
            better, bound = proven_orders(
                self.order, self.stages, self.problem, known, self.effort, watch
            )
            how = DYNAMIC if better[0].total < known.total else how
            found = _distinct([*better, *found])
        if (bound is None or relax_stages(self.problem).timed) and not watch.stop():
            least = least_total(self.order, self.problem, self.effort, self.seed, watch)
            bound = max(bound or 0.0, least)
        if job.moves:
            # They are elsewhere when they are met.
            bound = None
        answers = [self._answer(one) for one in found]
        return Orders(tuple(sorted(answers, key=lambda one: one.total)), bound or None, how)

    def _answer(self, found: StageOrder) -> DecidedOrder:
        """Returns an order as a job, with its tool changes in stages that suit them best."""
        if self.problem.free_start and self.problem.returns:
            found = closed(self.problem, found)
        slots, total = found.slots, found.total
        job = decided(self.order.job, self.order.model, slots)
        changed = with_changes(job)
        if self.stands is None or changed is job:
            return DecidedOrder(job, total, self.stages.decisions(self.order, found))
        stages = stages_with_changes(self.stands, slots)
        own = float(totals(self.stands.whole, stages[None])[0])
        # With idle stages between that the arms wait for each other, as they do in the search, it is possible as well.
        return DecidedOrder(paired_as(changed, stages), own if np.isfinite(own) else total)

    def in_file_order(self) -> float | None:
        """Returns the least total that a short search finds among orders in which each arm keeps that of the file [s].

        None where all orders are few, or none was found.
        """
        if is_few(self.problem):
            return None
        return short_search(replace(self.problem, in_file_order=True), self.seed)

    def as_it_is(self) -> Orders:
        """Returns the order that the search would go on from, without any search."""
        assert self.start is not None  # it goes on from one
        return Orders((self._answer(with_angles(self.problem, self.start)),), None, SEARCHED)

    def _is_late(self, found: StageOrder) -> bool:
        """Returns whether an order misses a window, by the search's own times."""
        if self.problem.not_after is None:
            return False
        plain = replace(self.problem, not_after=None)
        return bool(totals(plain, found.slots[None])[0] < found.total - 1e-6)

    def of_either_arm(self) -> frozenset[str]:
        """Returns the tasks that either of two arms may do and, as far as the search knows, can do."""
        arms = range(len(self.order.model.arms))
        return frozenset(
            task.id
            for t, task in enumerate(self.order.job.tasks)
            if len(arms) == 2
            and task.arm == ANY
            and task.handover is None
            and all(self.problem.allowed(a, t) for a in arms)
        )

    def without(self, pairs: set[StagePair], others: set[ArmTask], near: Job) -> PairedSearch:
        """Returns the search among orders in which pairs of stops are not made in one stage.

        Args:
            pairs: stops of the first and of the second arm, each by task and action.
            others: arms and tasks that the other arm is to do.
            near: an order to go on from, unless an arm does in it what the other one is to do.
        """
        numbers, stops = self._stop_numbers(), self.problem.stops
        cuts = {(numbers[one], numbers[other]) for one, other in pairs}
        stands = self.stands
        if stands is not None:
            stands = replace(stands, whole=_forbid_pairs(stands.whole, cuts))
        # Stops at stands are none of the search.
        cuts = {(one, other) for one, other in cuts if max(one, other) < stops}
        slots = self._slots(near)
        problem = _forbid_tasks(_forbid_pairs(self.problem, cuts), self._barred(others))
        # Most of a long order is as good as it was.
        effort = "quick" if len(slots) > 60 else self.effort
        done = {(task.arm, task.id) for task in near.tasks}
        start = split_pairs(slots, cuts) if done.isdisjoint(others) else None
        return replace(self, problem=problem, effort=effort, start=start, stands=stands)

    def _barred(self, others: set[ArmTask]) -> list[tuple[int, int]]:
        """Returns arms and tasks as numbers."""
        arms = list(self.order.model.arms)
        number = {task.id: t for t, task in enumerate(self.order.job.tasks)}
        return sorted((arms.index(arm), number[task]) for arm, task in others)

    def _slots(self, job: Job) -> IntArray:
        """Returns the stops of a decided job's stages but for those at stands, shape (n, arms)."""
        numbers = self._stop_numbers()
        slots = np.full((len(job.stages()), len(self.order.model.arms)), IDLE, dtype=np.int64)
        for k, work in enumerate(job.stages()):
            for a, name in enumerate(self.order.model.arms):
                if name in work and not work[name][0].is_change:
                    slots[k, a] = numbers[work[name][0].id, work[name][1].action]
        return slots[(slots != IDLE).any(axis=1)]

    def _stop_numbers(self) -> dict[tuple[str, str], int]:
        """Returns the number of every stop, those at stands among them, by the name of its task and its action."""
        keys = [(task.id, stop.action) for task in self.order.tasks for stop in task.stops]
        return {key: k for k, key in enumerate(keys)}


def _distinct(found: list[StageOrder]) -> list[StageOrder]:
    """Returns orders without those that are there already, at the same angles."""
    return list({one.slots.tobytes() + one.angles.tobytes(): one for one in found[::-1]}.values())[
        ::-1
    ]


StagePair = tuple[tuple[str, str], tuple[str, str]]
"""Task (see `stop_name`) and action of the first arm's stop in a stage and of the second arm's."""


ArmTask = tuple[str, str]
"""An arm, and the id of a task."""


def _forbid_tasks(problem: StageProblem, barred: list[tuple[int, int]]) -> StageProblem:
    """Returns stages in which arms cannot do some tasks, each an arm's and a task's number."""
    if not barred:
        return problem
    length, work = (
        [np.array(one) for one in problem.length],
        [np.array(one) for one in problem.work],
    )
    for arm, task in barred:
        for stop in problem.tasks[task]:
            length[arm][:, stop], work[arm][stop] = np.inf, np.inf
    return replace(problem, length=tuple(length), work=tuple(work))


def _forbid_pairs(problem: StageProblem, cuts: set[tuple[int, int]]) -> StageProblem:
    """Returns stages in which pairs of stops are not made in one stage."""
    size = problem.stops + 2
    table: FloatArray = np.zeros((size, size, len(problem.turn)))
    if problem.pair_cost is not None:
        table = np.array(problem.pair_cost)
    for one, other in cuts:
        table[one, other] = np.inf
    return replace(problem, pair_cost=table)


def _alone(order: OrderModel, effort: str, seed: int, watch: Watch) -> Orders:
    """Returns the orders of one arm that nothing carries: it goes by its own clock, whatever the mode."""
    orders = free_orders(order, effort, seed, watch)
    if not orders.ranked:
        raise why_impossible(order, relax_options(order.problem(0))) or InfeasibleError(
            Refusal(NO_ORDER_FOUND)
        )
    how = PROVEN if orders.exact else SEARCHED
    answers = [DecidedOrder(one.job, one.total) for one in orders.ranked]
    return Orders(tuple(answers), orders.bound, how)
