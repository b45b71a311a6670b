"""The nonlinear program: its kinematics are those of the arm, its result is never worse."""

from collections.abc import Callable

import casadi
import numpy as np
import pytest

from dualarm_cli.minimum_time.continuous import _reachable, _stop_function, refine
from dualarm_cli.minimum_time.problem import SequenceProblem
from dualarm_cli.minimum_time.search import search
from dualarm_cli.minimum_time.stops import StopTable
from dualarm_cli.timing.rest_to_rest import RestToRest

Problems = Callable[..., SequenceProblem]


def test_inverse_kinematics_in_casadi_equals_the_arm_s(random_problem: Problems) -> None:
    """Random postures of both arms, every branch: back to the same joints."""
    random = np.random.default_rng(0)
    for work in random_problem(0, (1, 1)).arms:
        function = _stop_function(work)
        for _ in range(100):
            q = random.uniform(work.limits.lower, work.limits.upper)
            R, p = work.kinematics.forward(q)
            branch, psi = int(work.kinematics.branch(q)), float(work.kinematics.arm_angle(q))
            found = np.array(function(R, p, 0.0, 0.0, psi, branch, q)).ravel()
            assert found == pytest.approx(q, abs=1e-10)


@pytest.mark.parametrize("jerk", [np.inf, 30.0, 3.0])
def test_the_reachable_distance_is_the_closed_form_s(jerk: float) -> None:
    """With and without jerk limit, with and without a phase at full acceleration."""
    law = RestToRest(np.array([2.0]), np.array([5.0]), np.array([jerk]))
    time = casadi.SX.sym("t")
    function = casadi.Function("D", [time], [_reachable(casadi, law, 0, time)])
    for t in np.linspace(0.01, 4.0, 60):
        expected = float(law.reachable_distance(np.array([t]))[0])
        assert float(function(t)) == pytest.approx(expected, rel=1e-12, abs=1e-15)


@pytest.mark.parametrize(
    "shape",
    [
        {"stages": (3, 3)},
        {"stages": (3, 2), "line": 0.05, "returns": True},
        {"stages": (2, 2), "free_yaw": True, "start": "free", "returns": True},
        {"stages": (2, 2), "joints": True},
        {"stages": (2, 0)},
    ],
    ids=["plain", "lines", "free", "joint targets", "one arm"],
)
def test_refining_never_loses(random_problem: Problems, shape: dict) -> None:
    """From a quick plan, for every shape of job."""
    problem = random_problem(3, **shape)
    tables = tuple(StopTable.of(work) for work in problem.arms)
    found = search(problem, [], "quick", 0)
    assert found is not None
    assert refine(problem, tables, found.best, "quick").total <= found.best.total
