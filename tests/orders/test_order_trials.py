"""What orders are tried with before one is planned: moves looked at closely, and plans off the search's grid."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from dualarm_cli.effort import EFFORTS, TrialEffort
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.orders import order_trials
from dualarm_cli.orders.decided_jobs import decided
from dualarm_cli.orders.order_proofs import OrderMoves
from dualarm_cli.orders.order_trials import orders_to_plan
from dualarm_cli.orders.orders import PairedSearch
from dualarm_cli.orders.paired.problem import IDLE
from dualarm_cli.orders.paired.search import StageSearch
from dualarm_cli.orders.paired.times import with_angles
from dualarm_cli.orders.proof.graph import ENDS, StageGraph
from dualarm_cli.orders.watch import Watch
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.postures.holding import Holding
from dualarm_cli.stages.plans.times import evaluate
from dualarm_cli.stages.search.plan_clearance import PENALTY, plan_clearance
from dualarm_cli.stages.sequence_problem import sequence_problem
from dualarm_cli.verification import verify
from tests.packing_tasks import packing_job


@pytest.fixture(scope="module")
def search(tasks_folder):
    """The search for orders of eight parts, four of them at first on either side, for any arm."""
    job = packing_job(tasks_folder, 8)
    tasks = tuple(dataclasses.replace(t, arm="any") for t in job.tasks)
    job = dataclasses.replace(job, tasks=tasks, order="optimise")
    return PairedSearch.of(
        CellModel.from_cell(job.cell), job, "quick", 0, Watch(), check_collisions=True
    )


def nodes_of(graph, order):
    """Returns the numbers of an order's stages among all that may be."""
    number = {
        (*stops, angle): k
        for k, (stops, angle) in enumerate(
            zip(graph.stops.tolist(), graph.angle.tolist(), strict=True)
        )
        for stops in [tuple(stops)]
    }
    return np.array(
        [
            number[(*row, g)]
            for row, g in zip(order.slots.tolist(), order.angles.tolist(), strict=True)
        ]
    )


def test_moves_cost_what_the_plan_of_the_same_postures_is_said_to_cost(search):
    """Looked at move by move, against all of a plan together, which is another piece of code."""
    graph = StageGraph.of(search.problem, singles=True)
    moves = OrderMoves.of(search.order, search.stages)
    dear = looked = 0
    for seed in range(12):
        first = StageSearch(search.problem, seed).first()
        if first is None or not np.isfinite(first.total):
            continue
        order = with_angles(search.problem, first.slots)
        job = decided(search.order.job, search.order.model, order.slots)
        problem = sequence_problem(search.order.model, job, Holding.of(job))
        plan = evaluate(problem, search.stages.decisions(search.order, order))
        said = plan_clearance(problem, plan).waits
        nodes = nodes_of(graph, order)
        way = np.stack([np.append(ENDS, nodes), np.append(nodes, ENDS)], axis=1)
        found = moves.costs(graph, way)
        idle = np.append((order.slots == IDLE).any(axis=1), False)
        skipped = np.append(False, idle[:-1]) | idle
        np.testing.assert_array_equal(found[skipped], 0.0)
        # Arms that meet on their lines are another matter.
        lines = np.isclose(said - found, PENALTY.turns, atol=5e-3)
        np.testing.assert_allclose(found[~skipped & ~lines], said[~skipped & ~lines], atol=5e-3)
        dear += int((found > 0.05).sum())
        looked += int((~skipped).sum())
    assert looked > 30
    assert 0 < dear < looked


def test_plans_that_are_tried_are_better_and_the_best_come_first(search):
    watch = Watch()
    watch.begin()
    orders = search.orders(watch).ranked
    kept = orders_to_plan(search, orders, "quick", watch)
    assert 1 < len(kept) <= EFFORTS["quick"].trials.planned
    assert kept[0].expected == min(one.expected for one in kept)
    plain = {one.job.pairing: one.total for one in orders}
    for one in kept:
        assert one.total == plain[one.job.pairing]
        problem = sequence_problem(search.order.model, one.job, Holding.of(one.job))
        again = evaluate(problem, one.plan)
        # What is off the grid and costs nothing for clearance is quicker than what is on it.
        assert again.total <= one.expected + 1e-9
        assert again.total < one.total


@pytest.mark.parametrize(("stages", "polished"), [(4, 40), (24, 40), (48, 10), (1000, 3)])
def test_of_long_orders_fewer_are_polished_but_as_many_as_are_planned(stages, polished):
    """Twice as long: each takes about twice as long, of half as many."""
    effort = TrialEffort(40, 2, 3)
    assert effort.of_stages(stages) == TrialEffort(polished, 2, 3)


def test_orders_that_are_all_but_the_same_are_planned_last(search, monkeypatch):
    """The best one, then those that share nine of ten stages or fewer with it and each other, then the rest."""
    watch = Watch()
    watch.begin()
    quick = dataclasses.replace(EFFORTS["quick"], trials=TrialEffort(40, 1, 40))
    monkeypatch.setattr(order_trials, "EFFORTS", {"quick": quick})
    orders = search.orders(watch).ranked
    some = [one for one in orders if one.plan is not None]
    kept = orders_to_plan(search, tuple(some), "quick", watch)
    assert {one.job.pairing for one in kept} == {one.job.pairing for one in some}
    stages = [{frozenset(stage) for stage in one.job.pairing} for one in kept]

    def is_like(k, others):
        return any(len(stages[k] & stages[m]) > 0.9 * len(stages[k]) for m in others)

    news = next((k for k in range(len(kept)) if is_like(k, range(k))), len(kept))
    assert 1 <= news < len(kept)
    assert all(is_like(k, range(news)) for k in range(news, len(kept)))
    for part in (kept[:news], kept[news:]):
        assert [one.expected for one in part] == sorted(one.expected for one in part)


def test_a_third_of_the_orders_is_polished_on_and_twice_as_long(search, monkeypatch):
    """18 of them for one round, the best 6 of these for two, the best 2 for four; none is lost."""
    watch = Watch()
    watch.begin()
    some = [one for one in search.orders(watch).ranked if one.plan is not None]
    orders = tuple(dataclasses.replace(some[0], total=float(k)) for k in range(20))
    effort = dataclasses.replace(EFFORTS["quick"], trials=TrialEffort(18, 1, 2))
    monkeypatch.setattr(order_trials, "EFFORTS", {"quick": effort})
    monkeypatch.setattr(order_trials, "_started", lambda _, order, effort: Polished(order))
    rounds = []

    class Polished(SimpleNamespace):
        """Worth less with every round, the more so the later it comes."""

        plan = SimpleNamespace(decisions=None)

        def __init__(self, order, done=0):
            super().__init__(order=order, done=done, objective=100.0 - done * order.total)

        def polished(self, count):
            rounds.append(count)
            return Polished(self.order, self.done + count)

    kept = orders_to_plan(search, orders, "quick", watch)
    assert rounds == [1] * 18 + [2] * 6 + [4] * 2
    # They are all alike: the best ones are first.
    assert [one.total for one in kept] == [17.0, 16.0]
    assert [one.expected for one in kept] == [100.0 - 7 * 17.0, 100.0 - 7 * 16.0]


def test_the_order_of_a_job_is_proven_nearly_best_and_its_plan_passes_every_check(search):
    job = search.order.job
    schedule = plan_without_bound(job, PlanSettings(effort="quick"))
    assert not verify(schedule, job, clearance=True).failures
    assert schedule.order_grid_gap is not None
    assert 0.0 <= schedule.order_grid_gap < 0.1


@pytest.mark.parametrize("not_after", [np.inf, 60.0])
def test_few_orders_are_planned_also_where_none_is_tried_before(search, not_after):
    """With windows orders are not tried off the grid: many are nearly as good, and only the best ones are planned."""
    job = search.order.job
    some = [dataclasses.replace(task, not_after=not_after) for task in job.tasks[:4]]
    told = []
    watch = Watch(report=told.append)
    plan_without_bound(
        dataclasses.replace(job, tasks=tuple(some)), PlanSettings(effort="quick"), watch
    )
    # After them comes the file's order, whose arms are searched for as well.
    filed = "planning the file's order"
    searched = told[: told.index(filed)] if filed in told else told
    planned = [text for text in searched if text.startswith("planning order")]
    assert 1 <= len(planned) <= EFFORTS["quick"].trials.planned
