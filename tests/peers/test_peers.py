"""General optimisers on a sequence: they gain where there is something to gain, and never lose."""

import dataclasses

import pytest

from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.loading.tasks import load_job
from dualarm_cli.minimum_time.stops import StopTable
from dualarm_cli.minimum_time.times import evaluate
from dualarm_cli.peers.grid import local_search
from dualarm_cli.peers.swarm import particle_swarm
from dualarm_cli.planning.sequence_plans import decisions_of
from dualarm_cli.planning.sequence_problem import sequence_problem
from dualarm_cli.planning.stages import choose_stages


@pytest.fixture(scope="module")
def start(tasks_folder):
    """Three stages of the packing job by `exact` with unrefined postures, as numbers."""
    job = load_job(tasks_folder / "04_packing" / "tasks.yaml")
    job = dataclasses.replace(job, tasks=job.tasks[:3])
    model = CellModel.from_cell(job.cell)
    problem = sequence_problem(model, job)
    tables = tuple(StopTable.of(work) for work in problem.arms)
    plans = choose_stages(model, job, "exact", "arm_angle", refine=False)
    return problem, tables, evaluate(problem, tables, decisions_of(problem, model, plans))


def test_local_search_ends_where_no_step_helps(start):
    """It gains, and a second search from its end gains nothing."""
    problem, tables, plan = start
    better = local_search(problem, tables, plan, "quick")
    assert better.total < plan.total
    again = local_search(problem, tables, better, "quick")
    assert again.total == pytest.approx(better.total, rel=5e-3)


def test_the_swarm_gains_and_depends_on_its_seed_alone(start):
    """The same seed gives the same plan."""
    problem, tables, plan = start
    one, two = (particle_swarm(problem, tables, plan, "quick", 7) for _ in range(2))
    assert one.total == two.total < plan.total
