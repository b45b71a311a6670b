"""Search for arms, order and pairing of an open job.

The results are decided jobs.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dualarm_cli.effort import EFFORTS
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import ANY, Job
from dualarm_cli.notes import Note, NoteTable
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
"""Refusal code if the search finds no order, without a proof that none exists."""
search_note = NoteTable(
    "order search",
    proven="proven by dynamic programming to be the best of all orders on the grid of the search",
    dynamic="found by dynamic programming over partial orders, with lower bounds on the remaining time",
    searched="found by removing tasks and inserting them again where the plan is then shortest",
    timed="{cut:some|all} orders of {tasks} tasks were timed, {waits:with every choice of the waiting arm|"
    "the k-th stops of all arms in one stage}",
)
"""Notes on the search that gave the orders."""


@dataclass(frozen=True)
class DecidedOrder:
    """Decided job found by the search."""

    job: Job
    """Job with arms, order and pairing."""
    total: float
    """Cycle time in the model of the search for orders [s]."""
    plan: Decisions | None = None
    """Platform angles and postures of the search, or None."""
    expected: float | None = None
    """Estimated duration of a collision-free plan off the grid [s]; None if not tried."""


@dataclass(frozen=True)
class Orders:
    """Decided jobs, best first, with a lower bound of all orders."""

    ranked: tuple[DecidedOrder, ...]
    """Different orders, best first."""
    bound: float | None
    """Lower bound of all orders on the search's grid [s], or None."""
    search: Note
    """Note on the search that gave the orders."""

    def gap(self, total: float) -> float | None:
        """Compute an order's optimality gap on the search's grid, or None.

        None without a bound.
        """
        return grid_gap(self.bound, total)


@dataclass(frozen=True)
class PairedSearch:
    """Search for the orders of paired arms."""

    order: OrderModel
    """Tasks of the job as each arm can do them."""
    stages: StageModel
    """Stages of the job as numbers."""
    problem: StageProblem
    """Stages as the search uses them."""
    effort: str
    """Effort, one of EFFORTS."""
    seed: int
    """Random seed."""
    start: IntArray | None = None
    """Known good order, shape (n, arms), or None."""
    stands: StageStands | None = None
    """Stages with the stops of tool changes; None if no arm changes tools."""

    @classmethod
    def of(
        cls,
        model: CellModel,
        job: Job,
        effort: str,
        seed: int,
        watch: Watch,
        *,
        check_collisions: bool,
    ) -> PairedSearch:
        """Build the search of a job.

        Args:
            model: kinematics of the cell.
            job: the open job.
            effort: one of EFFORTS.
            seed: random seed.
            watch: receives progress.
            check_collisions: whether to check postures with the cell, and arms at their stops with each other.

        Raises:
            InfeasibleError: a task that no arm reaches.
        """
        watch.report("timing each task at every platform angle")
        order = OrderModel.of(model, job, check_collisions=check_collisions)
        check_reach(order)
        stages = stage_model(order)
        whole = stages.problem
        check_meetings(order, whole)
        stands = stage_stands(order, whole)
        problem = whole if stands is None else with_whole_changes(stands, len(job.tasks))
        return cls(order, stages, problem, effort, seed, stands=stands)

    def orders(self, watch: Watch) -> Orders:
        """Search the best orders.

        Raises:
            InfeasibleError: rules that no order keeps.
        """
        job, model = self.order.job, self.order.model
        # Asynchronous arms support windows of whole tasks only, not those of moving targets.
        if len(model.arms) == 1 and not model.platform.is_chosen and not job.moves:
            return _alone(self.order, self.effort, self.seed, watch)
        watch.report("putting tasks in order")
        tasks = len(self.problem.tasks)
        reserved = EFFORTS[self.effort].order_bound.time_share * (watch.limit or 0.0)
        effort, provable = EFFORTS[self.effort].orders, is_provable(self.problem, self.effort)
        if provable:
            # The search for a lower bound finds good orders as well.
            effort = effort.shorter(4)
        arguments = (
            self.problem,
            effort,
            self.seed,
            self.start,
            watch.record,
            lambda: watch.stop(reserved),
        )
        candidates, all_timed = good_orders(*arguments), is_few(self.problem) and self.start is None
        if all_timed and not candidates:
            # If the k-th stops of both arms collide, one arm may wait for the other one.
            candidates, all_timed = searched_orders(*arguments), False
        if not candidates or self._is_late(candidates[0]):
            # Lateness is an estimate of the search: only a proof ends the search here.
            # The places of moving targets are estimates, which prove nothing.
            why = None
            if not job.moves:
                why = why_impossible(self.order, relax_stages(self.problem))
            if why is not None or not candidates:
                raise why or InfeasibleError(Refusal(NO_ORDER_FOUND))
        bound, search = None, search_note("searched")
        if all_timed:
            waits, cut = self.problem.stores is not None, watch.stopped is not None
            search = search_note("timed", cut=cut, tasks=tasks, waits=waits)
        # The timed orders are no bound: they have no stages with an idle arm.
        if provable and not watch.stop():
            best = candidates[0]
            better, bound = proven_orders(
                self.order, self.stages, self.problem, best, self.effort, watch
            )
            if better[0].total < best.total:
                search = search_note("dynamic")
            candidates = _distinct([*better, *candidates])
        if (bound is None or relax_stages(self.problem).timed) and not watch.stop():
            least = least_total(self.order, self.problem, self.effort, self.seed, watch)
            bound = max(bound or 0.0, least)
        if job.moves:
            # The moving targets will be elsewhere, so the bound does not hold.
            bound = None
        answers = [self._answer(order) for order in candidates]
        return Orders(tuple(sorted(answers, key=lambda order: order.total)), bound or None, search)

    def _answer(self, stage_order: StageOrder) -> DecidedOrder:
        """Convert an order to a decided job, tool changes in best stages."""
        if self.problem.free_start and self.problem.returns:
            stage_order = closed(self.problem, stage_order)
        slots, total = stage_order.slots, stage_order.total
        job = decided(self.order.job, self.order.model, slots)
        changed = with_changes(job)
        if self.stands is None or changed is job:
            return DecidedOrder(job, total, self.stages.decisions(self.order, stage_order))
        stages = stages_with_changes(self.stands, slots)
        with_stands = float(totals(self.stands.whole, stages[None])[0])
        # Idle stages in which the arms wait for each other, as in the search, are feasible as well.
        return DecidedOrder(
            paired_as(changed, stages), with_stands if np.isfinite(with_stands) else total
        )

    def in_file_order(self) -> float | None:
        """Compute a short search's least total in the file's arm orders [s].

        None if all orders are timed anyway, or if none was found.
        """
        if is_few(self.problem):
            return None
        problem = replace(self.problem, in_file_order=True)
        return short_search(problem, EFFORTS[self.effort].orders, self.seed)

    def as_it_is(self) -> Orders:
        """Convert the start order without any search."""
        assert self.start is not None  # it goes on from one
        return Orders(
            (self._answer(with_angles(self.problem, self.start)),), None, search_note("searched")
        )

    def _is_late(self, stage_order: StageOrder) -> bool:
        """Test whether an order misses a window in the model of the search."""
        if self.problem.not_after is None:
            return False
        unlimited = replace(self.problem, not_after=None)
        return bool(totals(unlimited, stage_order.slots[None])[0] < stage_order.total - 1e-6)

    def of_either_arm(self) -> frozenset[str]:
        """List the tasks that either of two arms may do and can reach."""
        arms = range(len(self.order.model.arms))
        return frozenset(
            task.id
            for t, task in enumerate(self.order.job.tasks)
            if len(arms) == 2
            and task.arm == ANY
            and task.handover is None
            and all(self.problem.allowed(a, t) for a in arms)
        )

    def without(
        self, pairs: set[StagePair], excluded: set[ArmTask], start_job: Job
    ) -> PairedSearch:
        """Build the search without stage pairs, and with tasks of fixed arms.

        A stage pair is a pair of stops in the same stage.

        Args:
            pairs: stops of the first and of the second arm, each by task and action.
            excluded: excluded pairs of arm and task; the other arm does the task.
            start_job: start order, unless it contains an excluded pair of arm and task.
        """
        numbers, stops = self._stop_numbers(), self.problem.stops
        cuts = {(numbers[first], numbers[second]) for first, second in pairs}
        stands = self.stands
        if stands is not None:
            stands = replace(stands, whole=_forbid_pairs(stands.whole, cuts))
        # The search has no stops at stands.
        cuts = {pair for pair in cuts if max(pair) < stops}
        slots = self._slots(start_job)
        problem = _forbid_tasks(_forbid_pairs(self.problem, cuts), self._arm_task_numbers(excluded))
        # Most of a long order stays as it is.
        effort = "quick" if len(slots) > 60 else self.effort
        assigned = {(task.arm, task.id) for task in start_job.tasks}
        start = split_pairs(slots, cuts) if assigned.isdisjoint(excluded) else None
        return replace(self, problem=problem, effort=effort, start=start, stands=stands)

    def _arm_task_numbers(self, others: set[ArmTask]) -> list[tuple[int, int]]:
        """Convert arms and tasks to numbers."""
        arms = list(self.order.model.arms)
        number = {task.id: t for t, task in enumerate(self.order.job.tasks)}
        return sorted((arms.index(arm), number[task]) for arm, task in others)

    def _slots(self, job: Job) -> IntArray:
        """List a decided job's stops by stage, (n, arms), without stands."""
        numbers = self._stop_numbers()
        slots = np.full((len(job.stages()), len(self.order.model.arms)), IDLE, dtype=np.int64)
        for k, work in enumerate(job.stages()):
            for a, name in enumerate(self.order.model.arms):
                if name in work and not work[name][0].is_change:
                    slots[k, a] = numbers[work[name][0].id, work[name][1].action]
        return slots[(slots != IDLE).any(axis=1)]

    def _stop_numbers(self) -> dict[tuple[str, str], int]:
        """Number all stops by task and action, those at stands included."""
        keys = [(task.id, stop.action) for task in self.order.tasks for stop in task.stops]
        return {key: k for k, key in enumerate(keys)}


def _distinct(orders: list[StageOrder]) -> list[StageOrder]:
    """Remove orders with equal stops and angles."""
    keyed = {order.slots.tobytes() + order.angles.tobytes(): order for order in orders[::-1]}
    return list(keyed.values())[::-1]


StagePair = tuple[tuple[str, str], tuple[str, str]]
"""Stops of both arms in a stage, each as task (see `stop_name`) and action."""


ArmTask = tuple[str, str]
"""Arm and task id."""


def _forbid_tasks(problem: StageProblem, excluded: list[tuple[int, int]]) -> StageProblem:
    """Exclude tasks, given as pairs of arm and task number, from stages."""
    if not excluded:
        return problem
    length, work = (
        [np.array(table) for table in problem.length],
        [np.array(table) for table in problem.work],
    )
    for arm, task in excluded:
        for stop in problem.tasks[task]:
            length[arm][:, stop], work[arm][stop] = np.inf, np.inf
    return replace(problem, length=tuple(length), work=tuple(work))


def _forbid_pairs(problem: StageProblem, cuts: set[tuple[int, int]]) -> StageProblem:
    """Exclude pairs of stops from common stages."""
    size = problem.stops + 2
    table: FloatArray = np.zeros((size, size, len(problem.turn)))
    if problem.pair_cost is not None:
        table = np.array(problem.pair_cost)
    for first, second in cuts:
        table[first, second] = np.inf
    return replace(problem, pair_cost=table)


def _alone(order: OrderModel, effort: str, seed: int, watch: Watch) -> Orders:
    """Search a single arm's orders without platform, asynchronous in any mode."""
    orders = free_orders(order, effort, seed, watch)
    if not orders.ranked:
        raise why_impossible(order, relax_options(order.problem(0))) or InfeasibleError(
            Refusal(NO_ORDER_FOUND)
        )
    search = search_note("proven" if orders.exact else "searched")
    answers = [DecidedOrder(order.job, order.total) for order in orders.ranked]
    return Orders(tuple(answers), orders.bound, search)
