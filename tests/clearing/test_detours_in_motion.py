"""Detours that begin and end in motion: exact legs by the via point, verified plans, never slower."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dualarm_cli.clearing import blended_plan
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.motion.curved_transfers import moving_detour
from dualarm_cli.motion.transfers import Drive
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.postures.stage_plan import Detour, StagePlan
from dualarm_cli.timing import TIMING_SOLVERS
from dualarm_cli.verification import verify


def planned(job):
    """A quick plan that the verifier passes, clearance included."""
    schedule = plan_without_bound(job, PlanSettings(effort="quick"))
    verdict = verify(schedule, job, clearance=True)
    assert verdict.passed, verdict.failures
    return schedule


@pytest.mark.parametrize(
    ("name", "some"),
    [
        ("07_two_shelves", slice(2, 3)),
        pytest.param("07_two_shelves", slice(4), marks=pytest.mark.slow),
        pytest.param("08_narrow_bin", slice(4), marks=pytest.mark.slow),
    ],
)
def test_detours_in_motion_are_verified_and_quicker_than_with_stops(
    tasks_folder, monkeypatch, name, some
):
    """Against the same stages with all detours between stops."""
    job = load_job(tasks_folder / name / "tasks.yaml")
    job = replace(job, tasks=job.tasks[some])
    found, calls = blended_plan.moving_detours, []

    def noted(*args):
        calls.append(found(*args))
        return calls[-1]

    monkeypatch.setattr(blended_plan, "moving_detours", noted)
    moving = planned(job)
    assert any(calls)
    monkeypatch.setattr(blended_plan, "moving_detours", lambda *_: {})
    assert moving.duration < planned(job).duration - 1e-3


def test_legs_of_a_detour_in_motion_join_keep_limits_and_take_as_long_as_they_have_to(tasks_folder):
    """Random postures and rates; limits are looked at on a grid of the motion."""
    job = load_job(tasks_folder / "04_packing" / "tasks.yaml")
    model = CellModel.from_cell(job.cell)
    drive = Drive.of(model, job, TIMING_SOLVERS["ruckig"])
    index = drive.columns["left"]
    limits = drive.limits.select(drive.joints("left"))
    random = np.random.default_rng(5)
    middle = 0.5 * (limits.lower + limits.upper)
    for _ in range(50):
        q = middle + random.uniform(-0.5, 0.5, (3, len(index)))
        rates = random.uniform(-0.4, 0.4, (3, 2, len(index)))
        rates *= np.stack([limits.velocity, limits.acceleration])
        start, goal = np.zeros((2, len(job.cell.robot.joints)))
        start[index], goal[index] = q[0], q[2]
        detours = {"left": Detour(q[1:2], stops=False, rates=rates)}
        plan = StagePlan(start, goal, goal, {}, "exact", 0.0, detours=detours)
        least = float(random.uniform(0.0, 4.0))
        legs = moving_detour(drive, plan, "left", least)
        assert sum(leg.duration for leg in legs) >= least - 1e-9
        for k, leg in enumerate(legs):
            ends = (
                np.stack(rows) for rows in zip(*leg.at(np.array([0.0, leg.duration])), strict=True)
            )
            for state, (there, rate) in zip(
                ends, ((q[k], rates[k]), (q[k + 1], rates[k + 1])), strict=True
            ):
                assert np.allclose(state, np.vstack([there, rate]), atol=1e-9)
            _, v, a = leg.at(np.linspace(0.0, leg.duration, 400))
            assert (np.abs(v) <= limits.velocity * (1 + 1e-9)).all()
            assert (np.abs(a) <= limits.acceleration * (1 + 1e-9)).all()
