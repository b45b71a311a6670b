"""Decisions with which stops are left: reach by hand, times against those of plans that stand, never longer."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.stages.leaving import (
    LeavingSearch,
    MotionRoom,
    leaving_of,
    leaving_plans,
)
from dualarm_cli.stages.plans.stops import StopTable
from dualarm_cli.stages.plans.times import evaluate
from dualarm_cli.stages.sequence_problem import sequence_problem
from dualarm_cli.stages.stage_by_stage import choose_stages
from dualarm_cli.timing.rest_to_rest import RestToRest


def law(velocity, acceleration, jerk):
    """The law of one joint."""
    return RestToRest(*(np.array([x]) for x in (velocity, acceleration, jerk)))


@pytest.mark.parametrize(
    ("limits", "time", "way"),
    [
        # Four phases of jerk of T/4: 2 j (T/4)³ = j T³ / 32.
        ((9.0, 99.0, 64.0), 0.5, 64.0 * 0.125 / 32.0),
        # Without a jerk limit half of the time up, half down: a T² / 4.
        ((9.0, 2.0, np.inf), 1.0, 0.5),
        # At the speed limit but for ramps of v / a: v (T - v / a).
        ((1.0, 4.0, np.inf), 2.0, 1.0 * (2.0 - 0.25)),
    ],
)
def test_reach_is_that_of_hand_arithmetic(limits, time, way):
    assert law(*limits).reachable_distance(np.array([time]))[0] == pytest.approx(way, rel=1e-9)


@pytest.fixture(scope="module", params=[(5, {"returns": True}), (3, {"start": "free"})])
def planned(request, random_job):
    """A random job with dwells, its numbers, and stages that a simple method decides."""
    seed, options = request.param
    job = random_job(seed, (4, 3), line=0.05, dwell=0.5, **options)
    model = CellModel.from_cell(job.cell)
    plans = choose_stages(model, job, "exact", "arm_angle")
    return model, job, sequence_problem(model, job), plans


def room_of(numbers, time, lines=0.0):
    """The same time wherever both arms have a target, for platform and arms; another one on lines there."""
    both = np.array([all(work.stops[k] for work in numbers.arms) for k in range(numbers.stages)])
    arms = tuple(
        np.array([0.0 if stop is None else time for stop in work.stops]) for work in numbers.arms
    )
    on_lines = np.repeat(np.where(both, lines, 0.0)[:, None], 2, axis=1)
    if numbers.free_start:
        on_lines[0, 0] = 0.0
    return MotionRoom(np.where(both, time, 0.0), arms, on_lines)


def test_without_changes_times_are_those_of_the_plan(planned):
    """Against the closed forms of plans that stand."""
    model, _, numbers, plans = planned
    same = leaving_of(numbers, model, plans)
    search = LeavingSearch(numbers, room_of(numbers, 0.5))
    tables = tuple(StopTable.of(work) for work in numbers.arms)
    expected = evaluate(numbers, tables, same.arriving)
    assert np.isfinite(expected.total)
    assert search.total(search.made(same)) == pytest.approx(expected.total, rel=1e-12)
    assert not same.changes.any()


def test_plans_become_shorter_within_reach(planned):
    """Nothing at a stop moves farther than a rest-to-rest motion goes in the time that is there."""
    model, _, numbers, plans = planned
    start, room = leaving_of(numbers, model, plans), room_of(numbers, 0.5)
    search = LeavingSearch(numbers, room)
    found = search.improved(start)
    made = search.made(found)
    assert search.total(made) < search.total(search.made(start)) - 1e-3
    assert found.changes.any()
    turned = np.abs(found.leaving.angle - found.arriving.angle)
    assert (numbers.platform_law.duration(turned[:, None]) <= room.platform + 1e-6).all()
    for a, work in enumerate(numbers.arms):
        k = np.flatnonzero(found.changes & np.array([stop is not None for stop in work.stops]))
        moved = made.leaving[a].q_target[k] - made.arriving[a].q_target[k]
        # A linear program is exact to second order only.
        assert (work.law.duration(moved) <= 0.5 * 1.02).all()
    idle = room.platform == 0.0
    assert (turned[idle] == 0.0).all()


def test_more_room_is_worth_more(planned):
    """With none nothing moves at stops, though the plan may become shorter; from there it becomes so with some."""
    model, _, numbers, plans = planned
    totals, found = [], leaving_of(numbers, model, plans)
    for time in (0.0, 0.2, 0.5):
        search = LeavingSearch(numbers, room_of(numbers, time))
        found = search.improved(found)
        totals.append(search.total(search.made(found)))
        assert found.changes.any() == (time > 0.0)
    assert totals[2] < totals[1] < totals[0]


def test_stages_of_a_plan_follow_one_another(planned):
    """Each begins where the one before ends; platform and arms leave as decided; tools stay at their targets."""
    model, job, numbers, plans = planned
    start = leaving_of(numbers, model, plans)
    found = LeavingSearch(numbers, room_of(numbers, 0.5)).improved(start)
    stages = leaving_plans(model, job, numbers, found, plans)
    assert len(stages) == len(plans)
    for before, after in pairwise(stages):
        assert np.array_equal(before.end, after.start)
    for k, stage in enumerate(stages[: numbers.stages]):
        column = model.platform_columns[0]
        assert stage.arrival[column] == found.arriving.angle[k]
        assert stage.end[column] == found.leaving.angle[k]
        for name, left in stage.leaving.items():
            come, gone = np.array(stage.arrival), np.array(stage.end)
            columns = model.arms[name].columns
            come[columns], gone[columns] = stage.stops[name].posture.q_target, left.posture.q_target
            moved = model.tool_pose(name, come).actInv(model.tool_pose(name, gone))
            assert np.abs(moved.homogeneous - np.eye(4)).max() < 1e-9


def test_stages_are_put_back_one_by_one(planned):
    model, _, numbers, plans = planned
    start = leaving_of(numbers, model, plans)
    found = LeavingSearch(numbers, room_of(numbers, 0.5)).improved(start)
    k = np.flatnonzero(found.changes)[:1]
    assert list(np.flatnonzero(found.put(k, start).changes)) == list(
        np.flatnonzero(found.changes)[1:]
    )
    half = found.nearer(0.5)
    turned = found.leaving.angle - found.arriving.angle
    assert half.leaving.angle - half.arriving.angle == pytest.approx(0.5 * turned, abs=1e-12)
    assert not found.nearer(0.0).changes.any()


def test_on_lines_the_platform_stays_within_reach(planned):
    """It may turn there without any motion at targets; no farther than from rest to rest in the time that is there."""
    model, _, numbers, plans = planned
    start = LeavingSearch(numbers, room_of(numbers, 0.0)).improved(
        leaving_of(numbers, model, plans)
    )
    assert not start.outer.any()
    room = room_of(numbers, 0.0, lines=0.3)
    search = LeavingSearch(numbers, room)
    found = search.improved(start)
    assert search.total(search.made(found)) <= search.total(search.made(start))
    assert found.outer.any()
    assert not found.changes.any()
    turning = numbers.platform_law.duration(np.abs(found.outer)[..., None])
    assert (turning <= room.lines + 1e-6).all()
    angles = found.arriving.angle[:, None] + found.outer
    low, high = numbers.platform_range
    assert ((angles >= low) & (angles <= high)).all()
