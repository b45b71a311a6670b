"""Clearance in the search: what the beam sees of it, what plans are charged for it, and local repair."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from dualarm_cli.collision.clearance import CellClearance
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.geometry.arrays import best_of_each
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.postures.holding import Holding
from dualarm_cli.stages.method import MethodProblem
from dualarm_cli.stages.plans.clearance import LIKE, SAMPLES, NoGood
from dualarm_cli.stages.plans.times import evaluate
from dualarm_cli.stages.search.plan_clearance import PENALTY, plan_clearance, step_waits
from dualarm_cli.stages.search.search import search_near
from dualarm_cli.stages.sequence import decisions_of
from dualarm_cli.stages.sequence_problem import sequence_problem
from dualarm_cli.stages.stage_by_stage import choose_stages


@pytest.fixture(scope="module")
def shelves(tasks_folder):
    """A crowded sequence of sixteen stages, with a greedy plan without collision checking that touches."""
    job = load_job(tasks_folder / "07_two_shelves" / "tasks.yaml")
    model = CellModel.from_cell(job.cell)
    plans = choose_stages(MethodProblem(model, job, "arm_angle"), "exact", refine=False)
    problem = sequence_problem(model, job, Holding.of(job))
    return problem, plans, decisions_of(problem, model, plans)


def test_steps_cost_what_the_plan_of_which_they_are_is_charged(shelves):
    """Stage by stage from the plan's own joints; on lines, which steps do not see, a plan may be charged turns more."""
    problem, plans, decisions = shelves
    clear = plan_clearance(problem, evaluate(problem, decisions))
    touched = 0
    for k, plan in enumerate(plans[: problem.stages]):
        target = np.array(plan.arrival)
        for work in problem.arms:
            if work.name in plan.stops:
                columns = problem.clearance.holding.cell.columns[problem.arms.index(work)]
                target[list(columns)] = plan.stops[work.name].posture.q_target
        rows = (plan.start, plan.arrival, target, plan.end)
        [waits] = step_waits(problem.clearance, k, *(row[None] for row in rows))
        more = clear.waits[k] - waits
        assert abs(more) < 1e-3 or more == pytest.approx(PENALTY.turns, abs=1e-3)
        touched += waits > 0.0
    assert 2 < touched < problem.stages


def test_who_touches_at_a_target_may_come_after_the_other_but_not_in_a_hand_over(shelves):
    """Both arms at rest where they reach into each other: turns, or nothing helps."""
    problem, plans, _ = shelves
    test = problem.clearance
    arms = [column for columns in test.holding.cell.columns for column in columns]
    random, touching = np.random.default_rng(0), plans[0].end[None].copy()
    while test.holding.cell.cross_margins(touching, test.holding.at_targets[:1])[0] > -0.02:
        touching[0, arms] = random.uniform(-1.5, 1.5, len(arms))
    rows = (touching,) * 4
    taken, given = (
        dataclasses.replace(
            test,
            settled=frozenset(),
            holding=dataclasses.replace(test.holding, is_handover=np.full(problem.stages, handed)),
        )
        for handed in (False, True)
    )
    settled = frozenset({0})
    [turns] = step_waits(dataclasses.replace(taken, settled=settled), 0, *rows)
    assert np.isfinite(turns)
    assert turns >= PENALTY.turns
    [never] = step_waits(given, 0, *rows)
    assert np.isinf(never)
    [known] = step_waits(dataclasses.replace(given, settled=settled), 0, *rows)
    assert known == turns


def test_each_arms_move_is_tested_once_and_none_where_the_arms_touch_after_it(shelves, monkeypatch):
    """Two moves of each arm, in all four pairs, make four moves to test; of steps that end in a touch none."""
    problem, plans, _ = shelves
    test, k = problem.clearance, 2
    tested, margins = list[int](), CellClearance.arm_margins

    def counted(cell, a, position, held, **others):
        tested.append(len(position))
        return margins(cell, a, position, held, **others)

    start, end = plans[k].start, plans[k].end
    arms = [list(columns) for columns in test.holding.cell.columns]
    both = [column for columns in arms for column in columns]
    starts = np.tile(start, (4, 1))
    for row, moved in enumerate(np.ndindex(2, 2)):
        for columns, offset in zip(arms, moved, strict=True):
            starts[row, columns] += 0.01 * offset
    ends = np.tile(end, (4, 1))
    monkeypatch.setattr(CellClearance, "arm_margins", counted)
    waits = step_waits(test, k, starts, ends, ends, ends)
    assert tested == [2 * SAMPLES, 2 * SAMPLES]
    single = [step_waits(test, k, s[None], *(end[None],) * 3)[0] for s in starts]
    np.testing.assert_array_equal(waits, single)
    tested.clear()
    random, touching = np.random.default_rng(0), end[None].copy()
    while test.holding.cell.cross_margins(touching, test.holding.after[k : k + 1])[0] > -0.02:
        touching[0, both] = random.uniform(-1.5, 1.5, len(both))
    assert np.isinf(step_waits(test, k, starts[:1], touching, touching, touching)).all()
    assert sum(tested) == 0


def test_no_good_costs_count_for_moves_that_are_alike_and_for_no_others(shelves):
    """A no-good makes its own move impossible; half a radian away, or in another stage, nothing is known."""
    problem, plans, _ = shelves
    everything = tuple(range(len(plans[0].start)))
    no_good = NoGood(3, everything, plans[3].start, plans[3].arrival, 2.5)
    test = dataclasses.replace(problem.clearance, no_goods=(no_good,))
    starts = np.array([plans[3].start, plans[3].start + 1.01 * LIKE])
    ends = np.array([plans[3].arrival, plans[3].arrival])
    np.testing.assert_array_equal(test.no_good_costs(3, starts, ends), [2.5, 0.0])
    np.testing.assert_array_equal(test.no_good_costs(4, starts, ends), [0.0, 0.0])


def test_local_repair_touches_nothing_else_and_makes_better_what_it_touches(shelves):
    """All stages but those that collide and their neighbours stay to the last bit."""
    problem, _, decisions = shelves
    before = plan_clearance(problem, evaluate(problem, decisions))
    found = search_near(problem, decisions, [], "quick", 0, local=True)
    assert found is not None
    after = plan_clearance(problem, found)
    assert after.penalty < before.penalty or not np.isfinite(before.penalty)
    n = problem.stages
    moves = before.waits > 0.0
    touched = ~before.stops | ~before.moves[:n] | moves[:n] | moves[1:]
    near = touched.copy()
    near[1:] |= touched[:-1]
    near[:-1] |= touched[1:]
    assert not near.all()
    np.testing.assert_array_equal(found.decisions.angle[~near], decisions.angle[~near])
    for mine, theirs in zip(found.decisions.arms, decisions.arms, strict=True):
        for field in dataclasses.fields(mine):
            np.testing.assert_array_equal(
                getattr(mine, field.name)[~near], getattr(theirs, field.name)[~near]
            )


def test_few_of_a_kind_come_first_and_then_the_others():
    """By hand: two of each kind at most, in their order, then what is left in its order."""
    kinds = np.array([5, 5, 5, 1, 5, 1, 1, 2])
    np.testing.assert_array_equal(best_of_each(kinds, 2, 8), [0, 1, 3, 5, 7, 2, 4, 6])
    np.testing.assert_array_equal(best_of_each(kinds, 2, 4), [0, 1, 3, 5])
