"""The benchmark's nonlinear programs: their kinematics are those of the arms, their results are never worse."""

import dataclasses
import importlib
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import casadi
import numpy as np
import pytest

from dualarm_cli.bound.bound import lower_bound
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job
from dualarm_cli.model.motion.rest_to_rest import RestToRest
from dualarm_cli.stages.method import MethodProblem
from dualarm_cli.stages.plans.candidates import flange_poses
from dualarm_cli.stages.plans.problem import SequenceProblem
from dualarm_cli.stages.plans.times import evaluate
from dualarm_cli.stages.search.search import search
from dualarm_cli.stages.sequence import decisions_of
from dualarm_cli.stages.sequence_problem import sequence_problem
from dualarm_cli.stages.stage_by_stage import choose_stages

Problems = Callable[..., SequenceProblem]


@pytest.fixture(scope="module")
def nonlinear() -> Iterator[SimpleNamespace]:
    """The modules of the benchmark."""
    names = ("continuous", "ipopt", "program", "program_kinematics")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(Path(__file__).parents[2])
        yield SimpleNamespace(
            **{name: importlib.import_module(f"benchmarks.nonlinear.{name}") for name in names}
        )


def test_forward_kinematics_in_casadi_equals_the_arm_s(
    random_problem: Problems, nonlinear: SimpleNamespace
) -> None:
    """Random postures of both arms."""
    random = np.random.default_rng(1)
    for work in random_problem(0, (1, 1)).arms:
        function = nonlinear.program_kinematics.chain_function(work.kinematics)
        for q in random.uniform(work.limits.lower, work.limits.upper, (200, 7)):
            expected = work.kinematics.forward(q)
            for found, one in zip(function(q), expected, strict=True):
                assert np.array(found).reshape(one.shape) == pytest.approx(one, abs=1e-13)


def test_inverse_kinematics_in_casadi_equals_the_arm_s(
    random_problem: Problems, nonlinear: SimpleNamespace
) -> None:
    """Random postures of both arms, every branch: back to the same joints."""
    random = np.random.default_rng(0)
    R, p, psi = casadi.SX.sym("R", 3, 3), casadi.SX.sym("p", 3), casadi.SX.sym("psi")
    near = casadi.SX.sym("near", 7)
    for work in random_problem(0, (1, 1)).arms:
        arm, seen = work.kinematics, set()
        inverse = nonlinear.program_kinematics.inverse
        functions = [
            casadi.Function(
                "inverse",
                [R, p, psi, near],
                [inverse(arm, R, p, psi, branch, near)],
            )
            for branch in range(8)
        ]
        for q in random.uniform(work.limits.lower, work.limits.upper, (200, 7)):
            branch = int(arm.branch(q))
            seen.add(branch)
            found = functions[branch](*arm.forward(q), float(arm.arm_angle(q)), q)
            assert np.array(found).ravel() == pytest.approx(q, abs=1e-10)
        assert seen == set(range(8))


def test_the_program_s_poses_are_those_of_a_stop(
    random_problem: Problems, nonlinear: SimpleNamespace
) -> None:
    """After the platform and the tool have turned: against the poses that plans are evaluated with."""
    problem = random_problem(2, (2, 2))
    for work in problem.arms:
        row = np.array([0])
        poses = [
            flange_poses(problem.platform, work, row, yaw, angle[:, None])[:2]
            for yaw, angle in ((np.zeros(1), np.array([0.2])), (np.array([0.7]), np.array([-0.3])))
        ]
        moved = nonlinear.program_kinematics.turned_pose(
            work, poses[0][0][0], poses[0][1][0], -0.5, 0.7, slides=False
        )
        for found, expected in zip(moved, poses[1], strict=True):
            value = np.array(casadi.DM(found)).reshape(expected[0].shape)
            assert value == pytest.approx(expected[0], abs=1e-12)


@pytest.mark.parametrize("jerk", [np.inf, 30.0, 3.0])
def test_the_reachable_distance_is_the_closed_form_s(
    jerk: float, nonlinear: SimpleNamespace
) -> None:
    """With and without jerk limit, with and without a phase at full acceleration."""
    law = RestToRest(np.array([2.0]), np.array([5.0]), np.array([jerk]))
    time = casadi.SX.sym("t")
    function = casadi.Function("D", [time], [nonlinear.program.reachable_distance(law, 0, time)])
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
def test_refining_never_loses(
    random_problem: Problems, nonlinear: SimpleNamespace, shape: dict
) -> None:
    """From a quick plan, for every shape of job."""
    problem = random_problem(3, **shape)
    found = search(problem, [], "quick", 0)
    assert found is not None
    assert nonlinear.continuous.refine(problem, found.best).total <= found.best.total


def test_ipopt_gains_and_never_goes_below_the_bound(
    packing: Job, nonlinear: SimpleNamespace
) -> None:
    """From three stages of the packing job by `exact` with unrefined postures."""
    job = dataclasses.replace(packing, tasks=packing.tasks[:3])
    model = CellModel.from_cell(job.cell)
    problem = sequence_problem(model, job)
    plans = choose_stages(MethodProblem(model, job, "arm_angle"), "exact", refine=False)
    plan = evaluate(problem, decisions_of(problem, model, plans))
    found = nonlinear.ipopt.nonlinear_program(problem, plan)
    assert lower_bound(problem, "quick").value <= found.total < plan.total
