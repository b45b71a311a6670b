"""The run matrix: which cases there are, and what comes of plans, failures and refusals."""

from __future__ import annotations

import dataclasses
import itertools

import pytest

from dualarm_cli.errors import UnknownSolverError
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.job import PoseTarget
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.model.verification import Check, Verification
from dualarm_cli.planning.comparison import Case, cases, run_cases
from dualarm_cli.stages.methods import METHODS
from dualarm_cli.timing import TIMING_SOLVERS
from dualarm_cli.verification import verify

GREEDY = [Case(name, "arm_angle", "ruckig") for name in ("fixed", "exact")]


@pytest.fixture(scope="module")
def first_pick(tasks_folder):
    """The smallest job."""
    return load_job(tasks_folder / "01_first_pick" / "tasks.yaml")


def run(job, matrix, judge=verify, bound=None):
    """All outcomes, with a clock that ticks once per look."""
    ticks = itertools.count()

    def judged(schedule, job):
        bounded = dataclasses.replace(schedule, lower_bound=bound)
        return dataclasses.replace(bounded, verification=judge(bounded, job))

    return list(run_cases(job, PlanSettings(), matrix, judged, lambda: float(next(ticks))))


def test_without_names_every_method_and_resolver_runs_with_the_default_timing():
    """The registry decides; every method has the redundancy solver that serves the robot; nothing is listed twice."""
    found = cases()
    assert len(found) == len(METHODS.names)
    assert {case.method for case in found} == set(METHODS.names)
    assert {case.timing for case in found} == {PlanSettings().timing}
    assert len(set(found)) == len(found)


def test_all_timings_are_every_one_and_names_given_twice_are_one():
    """`all` may stand beside names."""
    found = cases(["fixed", "fixed"], ["arm_angle"], ["ruckig", "all"])
    assert [case.timing for case in found] == TIMING_SOLVERS.names
    assert {case.method for case in found} == {"fixed"}


@pytest.mark.parametrize("names", [(["exat"], [], []), ([], ["exat"], []), ([], [], ["exat"])])
def test_unknown_names_are_refused_with_the_known_ones(names):
    """Before any work."""
    with pytest.raises(UnknownSolverError, match="there is no 'exat'"):
        cases(*names)


def test_a_good_plan_is_verified_and_held_against_the_bound(first_pick):
    """The verifier saw the bound; the clock was looked at before and after planning."""
    outcomes = run(first_pick, GREEDY, bound=1.0)
    assert [outcome.status for outcome in outcomes] == ["verified", "verified"]
    for outcome in outcomes:
        assert outcome.schedule.lower_bound == 1.0
        assert outcome.schedule.verification.passed
        assert outcome.planning_time == 1.0
        assert outcome.reason == ""


def test_a_plan_below_the_bound_fails(first_pick):
    """Then either is wrong, and the row says so."""
    (outcome,) = run(first_pick, GREEDY[:1], bound=1000.0)
    assert outcome.status == "failed"
    assert "lower_bound: stated 1000 s" in outcome.reason


def test_what_the_verifier_finds_is_the_reason(first_pick):
    """A judge that fails everything."""
    fault = Check("velocity", "failed", 2.0, 1.0, "", "left_l at 0.1 s")
    (outcome,) = run(first_pick, GREEDY[:1], judge=lambda *_: Verification((fault,)))
    assert (outcome.status, outcome.reason) == ("failed", "velocity: left_l at 0.1 s")


def test_a_job_that_cannot_be_done_is_a_row_and_not_an_end(first_pick):
    """A target five metres away: every method says infeasible, with the place."""
    task = first_pick.tasks[0]
    target = task.stops[0].target
    pose = target.pose.copy()
    pose.translation[0] = 5.0
    stop = dataclasses.replace(task.stops[0], target=PoseTarget(pose))
    far = dataclasses.replace(task, stops=(stop, *task.stops[1:]))
    job = dataclasses.replace(first_pick, tasks=(far, *first_pick.tasks[1:]))
    outcomes = run(job, GREEDY)
    assert [outcome.status for outcome in outcomes] == ["infeasible"] * 2
    assert all("left part" in outcome.reason for outcome in outcomes)
    assert all(outcome.schedule is None for outcome in outcomes)


def test_methods_and_timings_that_do_not_serve_say_why(tasks_folder, first_pick):
    """No platform to turn; jerk limits that a timing does not keep."""
    robots = load_job(tasks_folder / "05_two_robots" / "tasks.yaml")
    (outcome,) = run(robots, [GREEDY[1]])
    assert outcome.status == "not served"
    assert "turning platform" in outcome.reason
    assert outcome.planning_time is None
    (outcome,) = run(first_pick, [Case("fixed", "arm_angle", "toppra")])
    assert outcome.status == "not served"
    assert "15 joints have jerk limits" in outcome.reason
