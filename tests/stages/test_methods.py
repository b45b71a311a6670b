"""Every whole method on small jobs: verified, the same every time."""

from __future__ import annotations

import dataclasses

import pytest

from dualarm_cli.bound.job_bound import job_bound
from dualarm_cli.exporting.schedule_json import to_json
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.report.console import summary_lines
from dualarm_cli.report.report import build_report
from dualarm_cli.stages.method import MethodProblem
from dualarm_cli.stages.methods import METHODS
from dualarm_cli.stages.serving import cell_model, own_redundancy
from dualarm_cli.verification import verify
from tests.packing_tasks import packing_job


@pytest.fixture(scope="module")
def job(tasks_folder):
    """The packing job's first four tasks: four stages and a return."""
    return packing_job(tasks_folder, 4)


@pytest.fixture(scope="module")
def schedules(job, as_for_users):
    """Plan of every method with all stops, as methods decide stages; each one verified."""
    found = {}
    for name in METHODS.names:
        with as_for_users():
            settings = PlanSettings(platform=name, effort="quick", blend="none")
            schedule = plan_without_bound(job, settings)
        assert verify(schedule, job).passed, name
        found[name] = schedule
    return found


@pytest.fixture(scope="module")
def durations(schedules):
    """Exactly timed cycle of every method."""
    return {name: schedule.duration for name, schedule in schedules.items()}


def test_sequence_is_never_slower_than_a_method_that_looks_no_further(durations):
    """fixed, exact, linearised and minimum_time."""
    for name in ("fixed", "exact", "linearised", "minimum_time"):
        assert durations["sequence"] <= durations[name] + 1e-9, name


def test_moves_alone_gain_over_a_platform_that_stands(durations):
    """One move after the other by least time beats the baseline on this job."""
    assert durations["minimum_time"] < durations["fixed"]


def test_no_method_beats_the_bound(durations, job):
    """At two efforts."""
    for effort in ("quick", "normal"):
        assert job_bound(job, effort).value <= min(durations.values())


@pytest.mark.parametrize("name", ["sequence", "minimum_time"])
def test_a_method_gives_the_same_twice(job, name):
    """Every byte of the schedule's file."""
    job = dataclasses.replace(job, tasks=job.tasks[:2])
    settings = PlanSettings(platform=name, effort="quick")
    first, second = (
        b"".join(to_json(plan_without_bound(job, settings), "robot.urdf", {})) for _ in range(2)
    )
    assert first == second


@pytest.mark.parametrize("name", METHODS.names)
def test_methods_say_whom_they_do_not_serve(tasks_folder, name):
    """Two robots with bases of their own: no angle to choose, postures still."""
    job = load_job(tasks_folder / "05_two_robots" / "tasks.yaml")
    redundancy = own_redundancy(name, job.cell.robot)
    problem = MethodProblem(cell_model(job.cell, redundancy), job, redundancy, "quick")
    reason = METHODS[name].why_unsupported(problem)
    if name in ("exact", "linearised"):
        assert "turning platform" in reason
    else:
        assert reason is None
        assert len(METHODS[name].solve(problem).stages) == len(job.stages()) + job.returns


def test_whole_sequence_methods_choose_arm_angles_themselves(job):
    """Another redundancy solver is refused with the reason."""
    problem = MethodProblem(CellModel.from_cell(job.cell), job, "min_norm")
    assert "needs redundancy arm_angle" in METHODS["sequence"].why_unsupported(problem)


def test_a_cycle_without_motion_is_planned(job):
    """One stop of one arm, free start, return: nothing moves, and every report can be written."""
    task = dataclasses.replace(job.tasks[0], stops=job.tasks[0].stops[:1])
    stop = dataclasses.replace(
        task.stops[0], approach=0.0, retract=0.0, dwell=type(task.stops[0].dwell)()
    )
    still = dataclasses.replace(
        job, tasks=(dataclasses.replace(task, stops=(stop,)),), start="free", returns=True
    )
    schedule = plan_without_bound(still, PlanSettings(effort="quick"))
    assert schedule.duration == 0.0
    report = build_report(dataclasses.replace(schedule, lower_bound=0.0), still)
    assert any("faster than 0.000 s" in line for line in summary_lines(report))
