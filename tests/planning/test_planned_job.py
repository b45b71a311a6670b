"""Resolved jobs: what depends on robot and settings is asked once, and each job takes one route."""

from __future__ import annotations

from dataclasses import replace

import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinds import planning as kinds_planning
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning import planned_job
from dualarm_cli.planning.planned_job import resolve
from dualarm_cli.planning.planner import plan

QUICK = PlanSettings(effort="quick")


@pytest.fixture
def job(tasks_folder):
    """Loads a shipped job by its folder."""
    return lambda name: load_job(tasks_folder / name / "tasks.yaml")


def test_a_plan_with_its_bound_measures_the_cell_and_asks_for_kinds_once(job, monkeypatch):
    """Also for the bound, for what is proven impossible, and for plans of less effort."""
    own, measured, asked = job("01_first_pick"), [], []
    measure = CellModel.from_cell.__func__

    def from_cell(cls, cell, **options):
        measured.append(cell)
        return measure(cls, cell, **options)

    def kinds_of(job):
        asked.append(job)
        return kinds_planning.kinds_of(job)

    monkeypatch.setattr(CellModel, "from_cell", classmethod(from_cell))
    monkeypatch.setattr(planned_job, "kinds_of", kinds_of)
    monkeypatch.setattr("dualarm_cli.bound.job_bound.kinds_of", kinds_of)
    schedule = plan(own, PlanSettings(effort="normal"))
    assert 0.0 < schedule.lower_bound < schedule.duration
    assert sum(cell is own.cell for cell in measured) == 1
    assert len(asked) == 1


@pytest.mark.parametrize(
    ("name", "mode", "route"),
    [
        ("01_first_pick", "paired", "paired"),
        ("01_first_pick", "free", "own clocks"),
        ("10_seam", "paired", "sections"),
        ("13_hand_over", "free", "paired"),  # both arms meet, whatever their mode
    ],
)
def test_each_job_takes_one_route(job, name, mode, route):
    """By sections, in stages that both arms start together, or asynchronously."""
    work = resolve(replace(job(name), mode=mode), QUICK)
    assert work.route == route


def test_variants_keep_what_is_resolved(job):
    """Another order of the tasks, or another effort: the same cell, kinds and solvers."""
    work = resolve(job("01_first_pick"), QUICK)
    variant = work.with_job(replace(work.job, tasks=work.job.tasks[::-1])).with_effort("normal")
    assert variant.model is work.model
    assert variant.kinds is work.kinds
    assert variant.problem.job.tasks == work.job.tasks[::-1]
    assert (variant.problem.effort, work.problem.effort) == ("normal", "quick")
    assert variant.effort.section_orders > work.effort.section_orders
