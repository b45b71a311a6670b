"""Plans in which platform and arms move while tools dwell: verified, never slower, only where tasks allow it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.job_bound import job_bound
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.verification import verify


def job_of(tasks_folder, name="02_two_trays", *, slower=1.0, count=None, **defaults):
    """A bundled job with other defaults, a slower platform, or its first tasks only."""
    changes = {f"tasks:/defaults/{key}": value for key, value in defaults.items()}
    job = load_job(tasks_folder / name / "tasks.yaml", overrides=changes)
    robot = job.cell.robot
    factor = np.where([j in robot.platform for j in robot.limits.joints], 1.0 / slower, 1.0)
    rates = {n: getattr(robot.limits, n) * factor for n in ("velocity", "acceleration", "jerk")}
    robot = replace(robot, limits=replace(robot.limits, **rates))
    return replace(job, cell=replace(job.cell, robot=robot), tasks=job.tasks[:count])


def planned(job, **settings):
    """A quick plan that the verifier passes, clearance included."""
    schedule = plan_without_bound(job, PlanSettings(effort="quick", **settings))
    verdict = verify(schedule, job, clearance=True)
    assert verdict.passed, verdict.failures
    return schedule


def moved_in_dwells(schedule, names):
    """How far any of some joints moves in each event's dwell, by arm, task and action."""
    columns = [schedule.trajectory.joints.index(name) for name in names]
    found = {}
    for event in schedule.events:
        times = np.linspace(event.time, event.time + event.dwell, 50)
        q = schedule.trajectory.at(times)[0][:, columns]
        found[event.arm, event.task, event.action] = float(np.ptp(q, axis=0).max())
    return found


@pytest.mark.parametrize(("slower", "blend"), [(1.0, "lines"), (4.0, "none")])
def test_plans_are_verified_and_shorter_with_long_dwells(tasks_folder, blend, slower):
    """Against the plan of the same job in which all stands; what moves is said in seconds."""
    standing = planned(job_of(tasks_folder, slower=slower, dwell=0.5), blend=blend)
    job = job_of(tasks_folder, slower=slower, dwell=0.5, dwell_motion="allowed")
    moving = planned(job, blend=blend)
    assert standing.motion_gain is None
    assert max(moved_in_dwells(standing, standing.trajectory.joints).values()) == 0.0
    assert moving.motion_gain > 0.01
    assert moving.duration <= standing.duration - moving.motion_gain + 1e-9
    assert max(moved_in_dwells(moving, moving.robot.platform).values()) > np.radians(0.5)


def test_the_same_job_gives_the_same_plan(tasks_folder):
    job = job_of(tasks_folder, dwell=0.5, dwell_motion="allowed")
    one, other = planned(job), planned(job)
    assert np.array_equal(one.trajectory.time, other.trajectory.time)
    assert np.array_equal(one.trajectory.position, other.trajectory.position)


def test_only_dwells_that_allow_it_are_used(tasks_folder):
    """The platform turns in none of a stage whose other stop forbids it, and that arm stands."""
    job = job_of(tasks_folder, slower=4.0, dwell=0.5, dwell_motion="allowed")
    first = job.tasks[0]
    assert all(stop.dwell_motion for stop in first.stops)
    tasks = (replace(first, stops=tuple(replace(s, dwell_motion=False) for s in first.stops)),)
    job = replace(job, tasks=(*tasks, *job.tasks[1:]))
    schedule = planned(job)
    moved = moved_in_dwells(schedule, schedule.robot.arms[first.arm].joints)
    turned = moved_in_dwells(schedule, schedule.robot.platform)
    for stop in first.stops:
        key = first.arm, first.id, stop.action
        assert moved[key] == turned[key] == 0.0


def test_stops_without_dwells_are_named(tasks_folder):
    schedule = planned(job_of(tasks_folder, dwell_motion="allowed", dwell=0.0))
    [note] = [text for text in schedule.notes if text.startswith("dwell_motion: not used")]
    assert note.startswith("dwell_motion: not used at stops without a dwell: tray-1 (pick)")
    assert schedule.motion_gain == 0.0


def test_there_is_no_bound_where_the_platform_need_not_stand(tasks_folder):
    """The bound holds for plans whose platform stands in dwells only."""
    bound = job_bound(job_of(tasks_folder, dwell_motion="allowed"), "quick", blended=True)
    assert bound.value is None
    assert "dwell_motion" in bound.assumptions[0]
    assert job_bound(job_of(tasks_folder), "quick", blended=True).value > 0.0


def test_arms_without_closed_forms_move_too(tasks_folder):
    """The YuMi has no platform: its elbows move on."""
    job = job_of(tasks_folder, "09_yumi", dwell=0.5, dwell_motion="allowed", count=2)
    schedule = planned(job)
    assert schedule.motion_gain >= 0.0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["04_packing", "06_shared_bin", "08_narrow_bin", "12_chute"])
def test_bundled_jobs_are_never_slower(tasks_folder, name):
    standing = planned(job_of(tasks_folder, name))
    moving = planned(job_of(tasks_folder, name, dwell_motion="allowed"))
    assert moving.duration <= standing.duration
    assert moving.motion_gain >= 0.0
