"""Choice of the orders to plan, by polishing many a little and few longer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dualarm_cli.effort import EFFORTS
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
class TrialSettings:
    """Numbers that select the orders worth planning."""

    random_steps: int = 4
    """Random steps that each round of polishing offers besides: where something touches others lead nowhere."""
    fewer: int = 3
    """Divisor of the number of orders from one polishing to the next."""
    longer: int = 2
    """Factor on the polishing rounds from one polishing to the next."""
    alike: float = 0.9
    """Orders that share more than this part of their stages are much alike: what is off the grid is so as well."""
    unlikely: float = 10.0
    """Upper bound on an order's collision penalty [s]. Such orders are tried last."""
    swings: tuple[float, ...] = (1.0, 0.95, 0.8, 0.5, 0.0)
    """Shares of the arm angle's change along the lines."""
    shifts: tuple[float, ...] = (0.003, 0.01, 0.03, 0.1, 0.3)
    """Shifts of a stop's arm angles, to either side, that repairs try [rad]."""


TRIALS = TrialSettings()


@dataclass(frozen=True)
class _Trial:
    """An order's stages as numbers, and a plan for them."""

    order: DecidedOrder
    problem: SequenceProblem
    plan: Evaluated

    @property
    def objective(self) -> float:
        """About how long a plan in this order takes [s], with what it costs to avoid collisions."""
        lost = plan_clearance(self.problem, self.plan).penalty
        return self.plan.total + min(lost, TRIALS.unlikely)

    def polished(self, rounds: int) -> _Trial:
        """Returns the same with a better plan."""
        polishing = Polishing(self.problem)
        return replace(self, plan=polishing.polished(self.plan, rounds, TRIALS.random_steps))


def most_promising(
    search: PairedSearch, found: tuple[DecidedOrder, ...], effort: str, watch: Watch
) -> tuple[DecidedOrder, ...]:
    """Returns the orders to plan, with better plans: by about how long these take, those much like another one last.

    The search for orders knows one posture for each stop and platform angle, and nothing of the moves between. Here
    orders are looked at with what a plan over the whole sequence will make of them: angles and postures off the grid,
    and what touches on the way.

    Args:
        search: where the orders come from.
        found: the orders; those without a plan are left as they are, at the end.
        effort: one of EFFORTS.
        watch: may end it.
    """
    how = EFFORTS[effort].trials.of_stages(max(len(one.job.stages()) for one in found))
    begun = [_begun(search, one) for one in found if one.plan is not None]
    trials = [one for one in begun if one is not None]
    others = [one for one in found if one.plan is None]
    if len(begun) < 2 or not trials:
        return found
    watch.report(f"trying {len(trials)} orders that are nearly as good")
    count, rounds = how.polished, how.rounds
    trials.sort(key=lambda one: one.objective)
    trials = _polished(trials[:count], count, rounds, watch)
    while (count := count // TRIALS.fewer) >= how.planned and not watch.stop():
        rounds *= TRIALS.longer
        trials = _polished(trials, count, rounds, watch)
    answers = [
        replace(one.order, plan=one.plan.decisions, expected=one.objective)
        for one in _different(trials)[: how.planned]
    ]
    return (*answers, *others)


def _polished(trials: list[_Trial], count: int, rounds: int, watch: Watch) -> list[_Trial]:
    """Returns trials, the first ones of which were polished, the most promising of these first.

    Successive halving [Jamieson2016]: what is left of many orders after a little work gets more of it.
    """
    better: list[_Trial] = []
    for one in trials[:count]:
        if better and watch.stop():
            break
        better.append(one.polished(rounds))
    return [*sorted(better, key=lambda one: one.objective), *trials[len(better) :]]


def _different(trials: list[_Trial]) -> list[_Trial]:
    """Returns trials with those first that are not much like a better one, else in their order."""
    news: list[_Trial] = []
    alike: list[_Trial] = []
    seen: list[set[frozenset[StopKey]]] = []
    for one in trials:
        stages = {frozenset(stage) for stage in one.order.job.pairing or ()}
        like = any(len(stages & other) > TRIALS.alike * len(stages) for other in seen)
        (alike if like else news).append(one)
        seen += [] if like else [stages]
    return [*news, *alike]


def _begun(search: PairedSearch, order: DecidedOrder) -> _Trial | None:
    """Returns an order with the plan that the search counts on, made possible; None where none is near it.

    The search's postures are less than a plan: where any yaw will do, they leave the last joint open, and of lines they
    know the ends alone, which may be so near to a limit that what is between them is beyond it.
    """
    assert order.plan is not None  # callers have looked
    clearance = search.order.clearance
    holding = None if clearance is None else Holding.of(order.job, cell=clearance)
    problem = sequence_problem(search.order.model, order.job, holding)
    plan = repaired(problem, with_yaws(problem, order.plan))
    return None if plan is None else _Trial(order, problem, plan)


def repaired(problem: SequenceProblem, plan: Decisions) -> Evaluated | None:
    """Returns the plan if it is possible, or else the fastest near it; None if there is none.

    Methods that follow a line on other samples than `postures` may end a hair from a position limit; `postures` keeps a
    margin for what is between its samples. Only stages that are impossible change.

    Args:
        problem: the sequence.
        plan: a plan that may be impossible.
    """
    start = evaluate(problem, plan)
    broken: list[tuple[int, IntArray]] = []
    for a, arm in enumerate(problem.arms):
        bad = np.flatnonzero(~start.arms[a].possible & arm.stop_table.active)
        if not len(bad):
            continue
        broken.append((a, bad))
        near = _near(plan, a, bad)
        work = np.array([evaluate(problem, other).arms[a].work[bad] for other in near])
        # Any possible choice will do here; together they are weighed below.
        first = np.argmax(np.isfinite(work), axis=0)
        for k, m in zip(bad.tolist(), first.tolist(), strict=True):
            row = np.array([k])
            arms = list(plan.arms)
            arms[a] = arms[a].put(row, near[m].arms[a].take(row))
            plan = Decisions(plan.angle, tuple(arms))
    start = evaluate(problem, plan)
    for a, bad in broken:
        if np.isfinite(start.total):
            start = best_combination(problem, start, _near(start.decisions, a, bad))
    return start if np.isfinite(start.total) else None


def _near(plan: Decisions, a: int, stages: IntArray) -> list[Decisions]:
    """Returns plans with other arm angles of one arm in some stages."""
    shifts = [0.0, *(side * shift for shift in TRIALS.shifts for side in (1.0, -1.0))]
    return [_changed(plan, a, stages, shift, swing) for swing in TRIALS.swings for shift in shifts]


def _changed(plan: Decisions, a: int, stages: IntArray, shift: float, swing: float) -> Decisions:
    """Returns a plan with other arm angles of one arm in some stages."""
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
