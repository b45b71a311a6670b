"""Plans that are tried in an order: possible ones are left alone, impossible ones repaired where they have to be."""

import dataclasses

import numpy as np
import pytest

from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.orders.order_trials import repaired
from dualarm_cli.stages.method import MethodProblem
from dualarm_cli.stages.plans.times import evaluate
from dualarm_cli.stages.sequence import decisions_of
from dualarm_cli.stages.sequence_problem import sequence_problem
from dualarm_cli.stages.stage_by_stage import choose_stages
from tests.packing_tasks import packing_job


@pytest.fixture(scope="module")
def start(tasks_folder):
    """Three stages of the packing job by `exact` with unrefined postures, as numbers."""
    job = packing_job(tasks_folder, 3)
    model = CellModel.from_cell(job.cell)
    problem = sequence_problem(model, job)
    plans = choose_stages(MethodProblem(model, job, "arm_angle"), "exact", refine=False)
    return problem, evaluate(problem, decisions_of(problem, model, plans))


def test_a_start_beyond_a_limit_is_repaired_where_it_is_impossible_only(start):
    """One arm's lines get a swing that no joint limit allows; the other stages stay as they were."""
    problem, plan = start
    left = plan.decisions.arms[0]
    spoiled = np.array(left.psi_approach)
    table = problem.arms[0].stop_table
    k = int(np.flatnonzero(table.active & (table.approach > 0.0))[0])
    spoiled[k] += 3.0
    arms = (dataclasses.replace(left, psi_approach=spoiled), *plan.decisions.arms[1:])
    decisions = dataclasses.replace(plan.decisions, arms=arms)
    assert evaluate(problem, decisions).total == np.inf
    found = repaired(problem, decisions)
    assert found is not None
    assert np.isfinite(found.total)
    others = np.arange(problem.stages) != k
    for before, after in zip(decisions.arms, found.decisions.arms, strict=True):
        assert np.array_equal(before.psi_approach[others], after.psi_approach[others])


def test_a_possible_start_is_left_alone(start):
    """Bit for bit."""
    problem, plan = start
    found = repaired(problem, plan.decisions)
    assert found is not None
    assert found.total == plan.total
