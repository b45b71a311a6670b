"""Closed-form times of a decided sequence against the exact motion that is made of it."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job
from dualarm_cli.model.part_flow import Care
from dualarm_cli.motion.motion import realise
from dualarm_cli.stages.method import MethodProblem
from dualarm_cli.stages.plans.slowing import Places, fastest
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


CAREFUL = {
    "speed": Care(speed=0.5),
    "acceleration": Care(acceleration=0.4),
    "tool speed": Care(tool_speed=0.25),
    "all": Care(0.8, 0.5, 0.25),
}


@pytest.mark.parametrize("name", CAREFUL)
@pytest.mark.parametrize("seed", range(2))
def test_careful_times_are_those_of_the_exact_motion(
    random_job: Callable[..., Job], name: str, seed: int
) -> None:
    """Of one arm on a platform that stands: exact for shares of rates.

    A tool's speed limit is estimated, because joints with different limits do not move in proportion: within 2 % in the
    median, and no stage is half as far off as without the limit.
    """
    care = CAREFUL[name]
    job = random_job(seed, stages=(4, 0))
    job = replace(job, tasks=tuple(replace(task, care=care) for task in job.tasks))
    model = CellModel.from_cell(job.cell)
    problem = sequence_problem(model, job, is_careful=True)
    plans = choose_stages(MethodProblem(model, job, "arm_angle"), "fixed")
    found = evaluate(problem, decisions_of(problem, model, plans))
    made = realise(model, job, plans, TIMING_SOLVERS["ruckig"])
    plain = evaluate(sequence_problem(model, job), found.decisions)
    lengths = np.array([stage.end - stage.start for stage in made.stages])
    error, unknowing = (np.abs(times.stages / lengths - 1.0) for times in (found, plain))
    assert (unknowing > 0.05).all()
    assert (error < 0.5 * unknowing).all()
    assert np.median(error) < 0.02
    assert care.tool_speed < np.inf or error.max() < 1e-9


def test_the_largest_tool_speed_is_that_of_the_straight_transfer(
    random_job: Callable[..., Job],
) -> None:
    """Between an eighth and seven eighths of 30 swings, by differences of the tool's place."""
    job = random_job(0, stages=(2, 0))
    job = replace(job, tasks=tuple(replace(t, care=Care(tool_speed=0.5)) for t in job.tasks))
    problem = sequence_problem(CellModel.from_cell(job.cell), job, is_careful=True)
    slowing, joints = problem.arms[0].slowing, problem.arms[0].joints
    assert slowing is not None
    random = np.random.default_rng(0)
    start = random.uniform(-0.6, 0.6, (30, joints + 1))
    goal = start + random.uniform(-0.8, 0.8, start.shape)
    rows = (start + share * (goal - start) for share in np.linspace(0.0, 1.0, 2001))
    places = [slowing.places(problem.platform, q[:, :-1], q[:, -1:]) for q in rows]
    steps = np.diff([place.p for place in places], axis=0)[250:1750]
    exact = 2000.0 * np.linalg.norm(steps, axis=-1).max(axis=0)
    assert fastest(places[::1000]) == pytest.approx(exact, rel=0.01)


def test_the_slope_of_a_slow_tool_is_that_of_its_time(random_job: Callable[..., Job]) -> None:
    """By central differences of the tool's speed over the limit, of a short transfer."""
    job = random_job(0, stages=(2, 0))
    job = replace(job, tasks=tuple(replace(t, care=Care(tool_speed=0.5)) for t in job.tasks))
    model = CellModel.from_cell(job.cell)
    problem = sequence_problem(model, job, is_careful=True)
    work, stage, step = problem.arms[0], np.array([1]), 1e-6
    random = np.random.default_rng(0)
    start = random.uniform(-0.6, 0.6, (1, work.joints + 1))
    goal = start + 0.01 * random.normal(size=start.shape)

    def places(goal: np.ndarray) -> list[Places]:
        assert work.slowing is not None
        rows = start, 0.5 * (start + goal), goal
        return [work.slowing.places(problem.platform, q[:, :-1], q[:, -1:]) for q in rows]

    assert work.slowing is not None
    slope = work.slowing.slopes(stage, places(goal))
    for joint in range(work.joints + 1):
        moved = 0.5 * step * (np.arange(work.joints + 1) == joint)
        ahead, behind = (fastest(places(goal + sign * moved))[0] for sign in (1.0, -1.0))
        assert slope[0, joint] == pytest.approx((ahead - behind) / step / 0.5, abs=0.05)
