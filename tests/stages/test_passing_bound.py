"""The bound on plans that pass lines' outer ends in motion: its law by hand and by integration, no plan below it."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from dualarm_cli.bound.bound import lower_bound
from dualarm_cli.bound.job_bound import job_bound
from dualarm_cli.effort import EFFORTS
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.blending import BLENDINGS
from dualarm_cli.model.motion.rest_to_rest import PassingLaw, RestToRest
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan, plan_without_bound
from dualarm_cli.verification import verify
from tests.packing_tasks import packing_job


def law(velocity: float, acceleration: float, jerk: float) -> PassingLaw:
    """The law of one joint."""
    return PassingLaw.of(RestToRest(*(np.array([x]) for x in (velocity, acceleration, jerk))))


@pytest.mark.parametrize(
    ("limits", "time", "way"),
    [
        # j t³ / 6 while the acceleration rises.
        ((10.0, 10.0, 6.0), 1.0, 1.0),
        # 1 s of jerk 2 to the acceleration 2 (1/3 rad, 1 rad/s), then 1 s of it: 1 + 1 rad.
        ((10.0, 2.0, 2.0), 2.0, 1.0 / 3.0 + 2.0),
        # Without a jerk limit a t²/2 = 2 rad in 1 s to 4 rad/s, then 4 rad.
        ((4.0, 4.0, math.inf), 2.0, 2.0 + 4.0),
        # The speed limit is met while the acceleration rises: 2 t²/2 = 1 rad/s at 1 s, 1/3 rad, then 1 rad.
        ((1.0, 10.0, 2.0), 2.0, 1.0 / 3.0 + 1.0),
    ],
)
def test_ways_from_rest_are_those_of_hand_arithmetic(limits, time, way):
    """One joint under three limits."""
    assert law(*limits).reachable_distance(np.array([time]))[0] == pytest.approx(way, rel=1e-12)


@pytest.mark.parametrize(
    ("limits", "time", "speed"),
    [
        ((10.0, 10.0, 6.0), 1.0, 3.0),  # j t²/2
        ((10.0, 2.0, 2.0), 2.0, 3.0),  # 1 rad/s after the first second, then 2 rad/s²
        ((4.0, 4.0, math.inf), 0.5, 2.0),
        ((1.0, 10.0, 2.0), 2.0, 1.0),  # the limit
    ],
)
def test_speeds_from_rest_are_those_of_hand_arithmetic(limits, time, speed):
    """One joint under three limits."""
    assert law(*limits).reachable_speed(np.array([time]))[0] == pytest.approx(speed, rel=1e-12)


def test_no_motion_from_rest_goes_farther():
    """Random piecewise constant jerk within limits, integrated: forth and back added up, it stays below."""
    random = np.random.default_rng(4)
    for _ in range(200):
        v, a, j = random.uniform(0.5, 3.0), random.uniform(1.0, 12.0), random.uniform(5.0, 200.0)
        h, speed, acceleration, way = 1e-3, 0.0, 0.0, 0.0
        jerk = 0.0
        for k in range(400):
            if k % 20 == 0:
                jerk = random.choice([-j, j, j])
            acceleration = float(np.clip(acceleration + h * jerk, -a, a))
            speed = float(np.clip(speed + h * acceleration, -v, v))
            way += h * abs(speed)
        # The sum over steps is ahead of the integral by a step.
        most = law(v, a, j).reachable_distance(np.array([400 * h + 2 * h]))[0]
        assert way <= most


@pytest.mark.parametrize("name", ["01_first_pick", "02_two_trays", "12_chute", "13_hand_over"])
def test_no_blended_plan_is_below_the_bound_nor_the_bound_above_that_with_stops(tasks_folder, name):
    """Plans that are verified, by two methods; a plan with all stops is one that might have passed some."""
    job = load_job(tasks_folder / name / "tasks.yaml")
    if name == "12_chute":  # asynchronous arms: a load and an unload
        tasks = tuple(task for task in job.tasks if task.id in ("load-1", "unload-1"))
        job = dataclasses.replace(job, tasks=tasks)
    bound, stopping = (job_bound(job, "quick", blend).value for blend in BLENDINGS.names)
    assert bound is not None and stopping is not None
    assert 0.0 < bound <= stopping
    for platform in ("sequence", "fixed"):
        found = plan_without_bound(
            job, PlanSettings(platform, effort="quick"), check_collisions=False
        )
        assert bound <= found.duration


@pytest.mark.parametrize("seed", range(4))
def test_stops_without_lines_are_at_rest(random_problem, seed, monkeypatch):
    """Then blending does not help: the bound of plans with stops, but for other tables. With lines it does."""
    alike = dataclasses.replace(EFFORTS["quick"], passing_bound=EFFORTS["quick"].bound)
    monkeypatch.setitem(EFFORTS, "quick", alike)
    problem = random_problem(seed, (3, 3), line=0.0, returns=True)
    in_motion = problem.under(PassingLaw.of)
    least, stopping = (lower_bound(x, "quick").value for x in (in_motion, problem))
    assert 0.99 * stopping < least < 1.01 * stopping
    passing = random_problem(seed, (3, 3), line=0.08, returns=True)
    least, stopping = (
        lower_bound(x, "quick").value for x in (passing.under(PassingLaw.of), passing)
    )
    assert 0.0 < least < 0.9 * stopping


@pytest.mark.full_effort
def test_a_shorter_straight_part_has_a_lower_bound_and_a_quicker_plan(tasks_folder):
    """Two tasks of the packing job with 80, 40 and 20 mm: all verified, both quicker than with the whole lines."""
    job = packing_job(tasks_folder, 2)
    durations, bounds = [], []
    for straight in (math.inf, 0.04, 0.02):
        tasks = tuple(
            dataclasses.replace(
                task, stops=tuple(dataclasses.replace(s, straight=straight) for s in task.stops)
            )
            for task in job.tasks
        )
        own = dataclasses.replace(job, tasks=tasks)
        found = plan(own, PlanSettings(effort="quick"))
        assert verify(found, own, clearance=True).passed
        assert found.blend_gain is not None and found.blend_gain > 0.0
        durations.append(found.duration)
        bounds.append(found.lower_bound)
    assert durations[0] > max(durations[1:])
    assert durations[2] < 1.01 * durations[1]
    assert bounds[0] > bounds[1] > bounds[2]
    # With all stops whole lines are straight, whatever may not be.
    stopping = plan(own, PlanSettings(effort="quick", blend="none"))
    assert verify(stopping, own, clearance=True).passed
    assert stopping.duration > durations[0]
    assert stopping.blend_gain is None
    # What is straight on 20 mm only is no plan for a job that asks for 80 mm.
    assert not verify(found, job, clearance=True).passed
