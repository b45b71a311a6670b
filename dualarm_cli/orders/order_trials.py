"""Selection of the orders to plan: many are polished briefly, few for longer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dualarm_cli.effort import EFFORTS, TrialEffort
from dualarm_cli.effort.stages import SequenceSettings
from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.model.job import StopKey
from dualarm_cli.orders.orders import DecidedOrder, PairedSearch
from dualarm_cli.orders.watch import Watch
from dualarm_cli.postures.holding import Holding
from dualarm_cli.records import dataclass
from dualarm_cli.stages.plans.problem import Decisions, SequenceProblem
from dualarm_cli.stages.plans.times import Evaluated, evaluate
from dualarm_cli.stages.search.corridor import best_combination
from dualarm_cli.stages.search.node_plans import with_yaws
from dualarm_cli.stages.search.plan_clearance import plan_clearance
from dualarm_cli.stages.search.polish import Polishing
from dualarm_cli.stages.sequence_problem import sequence_problem


@dataclass(frozen=True)
class _Trial:
    """Order with its sequence problem and a plan."""

    order: DecidedOrder
    problem: SequenceProblem
    plan: Evaluated
    effort: TrialEffort

    @property
    def objective(self) -> float:
        """Estimated duration of a plan in this order [s], with its collision penalty."""
        penalty = plan_clearance(self.problem, self.plan).penalty
        return self.plan.total + min(penalty, self.effort.largest_penalty)

    def polished(self, rounds: int) -> _Trial:
        """Polish the plan."""
        polishing = Polishing(self.problem)
        return replace(self, plan=polishing.polished(self.plan, rounds, self.effort.random_steps))


def orders_to_plan(
    search: PairedSearch, orders: tuple[DecidedOrder, ...], effort: str, watch: Watch
) -> tuple[DecidedOrder, ...]:
    """Select the orders to plan, with polished plans, shortest first.

    Orders similar to a better one come last. The search for orders has one posture for each stop and platform angle,
    and no transfers between them. Here orders are rated by plans of the whole sequence, with angles and postures off
    the grid and with collisions in transfers.

    Args:
        search: the search that found the orders.
        orders: the orders; those without a plan stay unchanged, at the end.
        effort: one of EFFORTS.
        watch: may end it.
    """
    settings = EFFORTS[effort].trials.of_stages(max(len(order.job.stages()) for order in orders))
    started = [_started(search, order, settings) for order in orders if order.plan is not None]
    trials = [trial for trial in started if trial is not None]
    others = [order for order in orders if order.plan is None]
    if len(started) < 2 or not trials:
        return orders
    watch.report(f"trying {len(trials)} near-optimal orders")
    count, rounds = settings.polished, settings.rounds
    trials.sort(key=lambda trial: trial.objective)
    trials = _polished(trials[:count], count, rounds, watch)
    while (count := count // settings.fewer) >= settings.planned and not watch.stop():
        rounds *= settings.longer
        trials = _polished(trials, count, rounds, watch)
    answers = [
        replace(trial.order, plan=trial.plan.decisions, expected=trial.objective)
        for trial in _different(trials, settings.alike)[: settings.planned]
    ]
    return (*answers, *others)


def _polished(trials: list[_Trial], count: int, rounds: int, watch: Watch) -> list[_Trial]:
    """Polish the first trials and sort them by their objective.

    Successive halving [Jamieson2016]: the best of many orders after little work get more work.
    """
    polished: list[_Trial] = []
    for trial in trials[:count]:
        if polished and watch.stop():
            break
        polished.append(trial.polished(rounds))
    return [*sorted(polished, key=lambda rated: rated.objective), *trials[len(polished) :]]


def _different(trials: list[_Trial], common: float) -> list[_Trial]:
    """Sort trials with too many stages of a better one to the end."""
    distinct: list[_Trial] = []
    alike: list[_Trial] = []
    seen: list[set[frozenset[StopKey]]] = []
    for trial in trials:
        stages = {frozenset(stage) for stage in trial.order.job.pairing or ()}
        is_similar = any(len(stages & earlier) > common * len(stages) for earlier in seen)
        (alike if is_similar else distinct).append(trial)
        seen += [] if is_similar else [stages]
    return [*distinct, *alike]


def _started(search: PairedSearch, order: DecidedOrder, effort: TrialEffort) -> _Trial | None:
    """Build an order's trial, or None without a feasible plan near it.

    The search's postures are less than a plan: the last joint is open if the yaw is free, and of lines only the ends
    were checked, so that a point in between may violate a limit.
    """
    assert order.plan is not None  # callers have looked
    clearance = search.order.clearance
    holding = None if clearance is None else Holding.of(order.job, cell=clearance)
    problem = sequence_problem(search.order.model, order.job, holding, is_careful=True)
    plan = repaired(problem, with_yaws(problem, order.plan))
    return None if plan is None else _Trial(order, problem, plan, effort)


def repaired(problem: SequenceProblem, plan: Decisions) -> Evaluated | None:
    """Repair a plan: return the fastest feasible plan near it, or None.

    A feasible plan is returned as it is.

    Methods that follow a line on other samples than `postures` may violate a position limit slightly; `postures` keeps
    a margin between its samples. Only infeasible stages change.

    Args:
        problem: the sequence.
        plan: a plan that may be infeasible.
    """
    start = evaluate(problem, plan)
    repairs: list[tuple[int, IntArray]] = []
    for a, arm in enumerate(problem.arms):
        infeasible = np.flatnonzero(~start.arms[a].possible & arm.stop_table.active)
        if not len(infeasible):
            continue
        repairs.append((a, infeasible))
        variants = _variants(problem.settings, plan, a, infeasible)
        work = np.array(
            [evaluate(problem, variant).arms[a].work[infeasible] for variant in variants]
        )
        # Any feasible choice is fine here; combinations are compared below.
        first = np.argmax(np.isfinite(work), axis=0)
        for k, m in zip(infeasible.tolist(), first.tolist(), strict=True):
            row = np.array([k])
            arms = list(plan.arms)
            arms[a] = arms[a].put(row, variants[m].arms[a].take(row))
            plan = Decisions(plan.angle, tuple(arms))
    start = evaluate(problem, plan)
    for a, infeasible in repairs:
        if np.isfinite(start.total):
            variants = _variants(problem.settings, start.decisions, a, infeasible)
            start = best_combination(problem, start, variants)
    return start if np.isfinite(start.total) else None


def _variants(
    settings: SequenceSettings, plan: Decisions, a: int, stages: IntArray
) -> list[Decisions]:
    """List plans with other arm angles of one arm in some stages."""
    sides = (side * shift for shift in settings.repair_shifts for side in (1.0, -1.0))
    shifts, swings = [0.0, *sides], settings.repair_swings
    return [_changed(plan, a, stages, shift, swing) for swing in swings for shift in shifts]


def _changed(plan: Decisions, a: int, stages: IntArray, shift: float, swing: float) -> Decisions:
    """Shift an arm's angles in given stages, and scale changes along lines."""
    rows = plan.arms[a].take(stages)
    psi = rows.psi_target + shift

    def end(before: FloatArray) -> FloatArray:
        return psi + swing * (before - rows.psi_target)

    moved = replace(
        rows,
        psi_target=psi,
        psi_approach=end(rows.psi_approach),
        psi_retract=end(rows.psi_retract),
    )
    arms = list(plan.arms)
    arms[a] = arms[a].put(stages, moved)
    return Decisions(plan.angle, tuple(arms))
