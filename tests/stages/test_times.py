"""Closed-form times of a decided sequence against the exact motion that is made of it."""

from collections.abc import Callable

import numpy as np
import pytest

from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job
from dualarm_cli.motion.motion import realise
from dualarm_cli.stages.method import MethodProblem
from dualarm_cli.stages.plans.times import evaluate
from dualarm_cli.stages.sequence import decisions_of, stage_plans
from dualarm_cli.stages.sequence_problem import sequence_problem
from dualarm_cli.stages.stage_by_stage import choose_stages
from dualarm_cli.timing import TIMING_SOLVERS

JOBS = {
    "both arms": {"stages": (4, 4)},
    "one arm longer": {"stages": (2, 5)},
    "one arm only": {"stages": (4, 0)},
    "returns": {"stages": (3, 2), "returns": True},
    "free start": {"stages": (3, 3), "start": "free"},
    "free start returns": {"stages": (3, 3), "start": "free", "returns": True},
    "free yaw": {"stages": (3, 3), "free_yaw": True},
    "joint targets": {"stages": (4, 4), "joints": True, "returns": True},
}


@pytest.mark.parametrize("name", JOBS)
def test_times_equal_those_of_the_exact_motion(random_job: Callable[..., Job], name: str) -> None:
    """Without lines a sequence's closed-form length is that of the motion ruckig makes, to 1e-9."""
    job = random_job(5, **JOBS[name])
    model = CellModel.from_cell(job.cell)
    problem = sequence_problem(model, job)
    plans = choose_stages(MethodProblem(model, job, "arm_angle"), "exact")
    found = evaluate(problem, decisions_of(problem, model, plans))
    made = realise(model, job, plans, TIMING_SOLVERS["ruckig"])
    assert found.total == pytest.approx(made.trajectory.duration, rel=1e-9)
    lengths = [stage.end - stage.start for stage in made.stages]
    expected = [*found.stages, *([found.closing] if job.returns else [])]
    assert lengths == pytest.approx(expected, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("name", JOBS)
def test_stages_as_numbers_and_back_are_the_same_stages(
    random_job: Callable[..., Job], name: str
) -> None:
    """Decisions of stages, made into stages again, lead through the same joints."""
    job = random_job(6, **JOBS[name], line=0.06)
    model = CellModel.from_cell(job.cell)
    problem = sequence_problem(model, job)
    plans = choose_stages(MethodProblem(model, job, "arm_angle"), "exact")
    again = stage_plans(model, job, problem, decisions_of(problem, model, plans), "exact")
    assert len(again) == len(plans)
    for one, other in zip(plans, again, strict=True):
        assert other.arrival == pytest.approx(one.arrival, abs=1e-9)
        assert other.end == pytest.approx(one.end, abs=1e-9)
        assert other.start == pytest.approx(one.start, abs=1e-9)


def test_line_times_are_near_those_of_the_exact_lines(random_job: Callable[..., Job]) -> None:
    """With lines the estimate of a whole sequence is within 5 % of the exact motion."""
    job = random_job(7, (6, 6), line=0.08, dwell=0.2, returns=True)
    model = CellModel.from_cell(job.cell)
    problem = sequence_problem(model, job)
    plans = choose_stages(MethodProblem(model, job, "arm_angle"), "fixed")
    found = evaluate(problem, decisions_of(problem, model, plans))
    made = realise(model, job, plans, TIMING_SOLVERS["ruckig"])
    assert found.total == pytest.approx(made.trajectory.duration, rel=0.05)
    assert np.isfinite(found.stages).all()
