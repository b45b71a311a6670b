"""Cycle times with dwells that vary: what waits for what, against plans made anew and against hand arithmetic."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.budget import Budget
from dualarm_cli.model.dwell import Dwell, TimeRange
from dualarm_cli.model.job import Job
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.verification.budget_checks import judge_budget
from dualarm_cli.verification.varied_cycle import cycle_times, varied_cycle
from tests.packing_tasks import packing_job

FIXED = PlanSettings(platform="fixed", blend="none", effort="quick")
JOBS = ["01_first_pick", "06_shared_bin", "11_any_order", "13_hand_over", "14_two_grippers"]


@pytest.mark.parametrize("name", JOBS)
def test_dwells_as_planned_give_the_cycle_of_the_plan(tasks_folder: Path, name: str) -> None:
    """Synchronous and asynchronous arms, hand-overs, tool changes, with blended lines."""
    job = load_job(tasks_folder / name / "tasks.yaml")
    schedule = plan_without_bound(job, PlanSettings(effort="quick"), check_collisions=False)
    assert cycle_times(schedule, {}, 1) == pytest.approx(schedule.duration, abs=1e-6)


def with_dwells(job: Job, times: dict[tuple[str, str], float]) -> Job:
    """Returns the job with other dwells, by task and action [s]."""
    tasks = [
        dataclasses.replace(
            task,
            stops=tuple(
                dataclasses.replace(s, dwell=Dwell(times.get((task.id, s.action), s.dwell.total)))
                for s in task.stops
            ),
        )
        for task in job.tasks
    ]
    return dataclasses.replace(job, tasks=tuple(tasks))


@pytest.mark.parametrize("seed", range(6))
def test_longer_dwells_cost_what_a_plan_made_anew_takes(tasks_folder: Path, seed: int) -> None:
    """Stops at both ends of every line and a fixed platform leave nothing else to decide."""
    job = packing_job(tasks_folder, 8)
    schedule = plan_without_bound(job, FIXED, check_collisions=False)
    random = np.random.default_rng(seed)
    times = {
        (task.id, stop.action): float(random.uniform(0.02, 0.6))
        for task in job.tasks
        for stop in task.stops
    }
    longer = {
        k: np.array([times[part.task, part.action] - (part.end - part.start)])
        for k, part in enumerate(schedule.segments)
        if part.kind == "dwell"
    }
    anew = plan_without_bound(with_dwells(job, times), FIXED, check_collisions=False)
    assert cycle_times(schedule, longer, 1)[0] == pytest.approx(anew.duration, abs=1e-6)


def test_a_hand_over_waits_for_the_taker(tasks_folder: Path) -> None:
    """All wait for a hand-over, so that its time is added in full."""
    job = load_job(tasks_folder / "13_hand_over" / "tasks.yaml")
    settings = PlanSettings(platform="exact", blend="none", effort="quick")
    schedule = plan_without_bound(job, settings, check_collisions=False)
    grips = [k for k, p in enumerate(schedule.segments) if (p.kind, p.action) == ("dwell", "take")]
    assert grips
    longer = {k: np.array([0.25 + 0.1 * n]) for n, k in enumerate(grips)}
    extra = sum(float(more[0]) for more in longer.values())
    assert cycle_times(schedule, longer, 1)[0] == pytest.approx(schedule.duration + extra, abs=1e-6)


def test_the_times_of_one_arm_add_up(tasks_folder: Path) -> None:
    """One arm alone: the worst case is the sum; a sum of many triangles is nearly normal."""
    job = packing_job(tasks_folder, 24)
    spread = TimeRange(0.08, 0.12, 0.28)
    tasks = tuple(
        dataclasses.replace(
            task,
            stops=tuple(
                dataclasses.replace(stop, dwell=Dwell(0.12), varying=(spread,))
                for stop in task.stops
            ),
        )
        for task in job.tasks
        if task.arm == "left"
    )
    job = dataclasses.replace(job, tasks=tasks)
    schedule = plan_without_bound(job, FIXED, check_collisions=False)
    varied = varied_cycle(schedule, job)
    assert varied is not None and varied.dwells == 24
    assert varied.worst == pytest.approx(schedule.duration + 24 * 0.16, abs=1e-6)
    assert varied.least == pytest.approx(schedule.duration - 24 * 0.04, abs=1e-6)
    a, c, b = 0.08, 0.12, 0.28
    mean, variance = (a + b + c) / 3.0, (a * a + b * b + c * c - a * b - a * c - b * c) / 18.0
    expected = schedule.duration + 24 * (mean - c) + 1.6449 * np.sqrt(24 * variance)
    assert varied.percentile_95 == pytest.approx(expected, abs=0.01)


def test_a_triangle_is_drawn_as_its_formula_says() -> None:
    """Half of the shares below the median: by hand, of [0, 1, 3] a third lies below 1."""
    spread = TimeRange(0.0, 1.0, 3.0)
    assert spread.drawn(np.array([0.0, 1.0 / 3.0, 1.0])) == pytest.approx([0.0, 1.0, 3.0])
    shares = np.linspace(0.0, 1.0, 7)
    times = spread.drawn(shares)
    rising = times**2 / 3.0
    falling = 1.0 - (3.0 - times) ** 2 / 6.0
    assert np.where(times < 1.0, rising, falling) == pytest.approx(shares)


def test_the_budget_is_judged_at_the_cycle_that_it_names(tasks_folder: Path) -> None:
    """Between nominal and worst: kept by the plan, missed by its worst cycle."""
    job = packing_job(tasks_folder, 2)
    stops = [
        dataclasses.replace(s, varying=(TimeRange(0.1, 0.12, 0.5),)) for s in job.tasks[0].stops
    ]
    job = dataclasses.replace(
        job, tasks=(dataclasses.replace(job.tasks[0], stops=tuple(stops)), *job.tasks[1:])
    )
    schedule = plan_without_bound(job, FIXED, check_collisions=False)
    varied = varied_cycle(schedule, job)
    assert varied is not None
    allowed = (varied.percentile_95 + varied.worst) / 2.0
    for kind, kept in (("nominal", True), ("95%", True), ("worst", False)):
        budget = Budget(cycle_time=allowed, cycle_kind=kind)  # type: ignore[arg-type]
        [line] = judge_budget(schedule, dataclasses.replace(job, budget=budget))
        assert line.kept is kept
        assert (f"({kind})" in str(line)) is (kind != "nominal")
