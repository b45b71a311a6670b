"""Measures: what decides a schedule's length adds up to it; elbows and platform as the trajectory has them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan, plan_without_bound
from dualarm_cli.report.measures import bottlenecks, elbow_imbalance, platform_travel
from tests.packing_tasks import packing_job


@pytest.fixture(scope="module")
def packing(tasks_folder):
    """The packing job, its first eight tasks, planned with a platform that turns."""
    job = packing_job(tasks_folder, 8)
    return plan(job, PlanSettings(platform="exact"))


@pytest.mark.parametrize("name", ["01_first_pick", "03_bottin_planar", "05_two_robots"])
def test_what_decides_the_time_adds_up_to_all_of_it(tasks_folder, name):
    """On robots with and without a platform, with and without lines."""
    job = load_job(tasks_folder / name / "tasks.yaml")
    schedule = plan(job, PlanSettings(platform="fixed"))
    found = bottlenecks(schedule)
    assert "other" not in found.time
    assert sum(found.time.values()) == pytest.approx(schedule.duration, abs=1e-9)
    assert sum(found.stages.values()) == sum(bool(s.bottleneck) for s in schedule.stages)
    assert ("platform" in found.time) == bool(schedule.robot.platform)


def test_stages_are_counted_by_the_group_of_their_bottleneck(packing):
    """Counted by hand from the stages' own words."""
    groups = {"left_": "left", "right": "right", "torso": "platform"}
    expected: dict[str, int] = {}
    for stage in packing.stages:
        name = groups[stage.bottleneck[:5]]
        expected[name] = expected.get(name, 0) + 1
    assert bottlenecks(packing).stages == expected
    assert list(bottlenecks(packing).stages.values()) == sorted(expected.values(), reverse=True)


def test_equal_elbows_have_no_imbalance(tasks_folder):
    """[Bottin2021], Table 1: `exact` balances the move; the return undoes it, so that both count as zero."""
    job = load_job(tasks_folder / "03_bottin_planar" / "tasks.yaml")
    exact = elbow_imbalance(plan(job, PlanSettings(platform="exact")))
    fixed = elbow_imbalance(plan(job, PlanSettings(platform="fixed")))
    assert exact == pytest.approx(0.0, abs=1e-9)
    # phi stays at -30 degrees: the difference at turn 0 that `dualarm platform` prints for `fixed`.
    assert np.degrees(fixed) == pytest.approx(27.22, abs=0.006)


def test_the_imbalance_is_the_mean_over_the_transfers(packing):
    """Measured once more on the trajectory, transfer by transfer."""
    trajectory = packing.trajectory
    left, right = (trajectory.joints.index(j) for j in ("left_u", "right_u"))
    sizes = []
    for stage in packing.stages:
        moved = []
        for arm, column in (("left", left), ("right", right)):
            parts = [
                s
                for s in packing.segments
                if s.arm == arm
                and s.kind in ("transfer", "return")
                and stage.start - 1e-9 <= s.start < stage.end
            ]
            span = np.array([parts[0].start, parts[0].end])
            q = trajectory.at(span)[0][:, column]
            moved.append(abs(q[1] - q[0]))
        sizes.append(abs(moved[0] - moved[1]))
    assert elbow_imbalance(packing) == pytest.approx(np.mean(sizes), abs=1e-9)


def test_stages_of_one_arm_alone_do_not_count_as_imbalance(tasks_folder):
    """Two robots, of which one has more to do: only common transfers are compared."""
    job = load_job(tasks_folder / "05_two_robots" / "tasks.yaml")
    schedule = plan_without_bound(job, PlanSettings(platform="fixed"), check_collisions=False)
    trajectory = schedule.trajectory
    columns = [trajectory.joints.index(arm.joints[3]) for arm in schedule.robot.arms.values()]
    sizes = []
    for stage in schedule.stages:
        ends = {
            s.arm: s.end
            for s in schedule.segments
            if s.kind in ("transfer", "return") and abs(s.start - stage.start) < 1e-9
        }
        both = len(set(stage.tasks)) == 2 or not stage.tasks
        if both:
            q0 = trajectory.at(np.array([stage.start]))[0][0]
            moved = [
                abs(trajectory.at(np.array([ends.get(arm, stage.start)]))[0][0][c] - q0[c])
                for arm, c in zip(schedule.robot.arms, columns, strict=True)
            ]
            sizes.append(abs(moved[0] - moved[1]))
    assert 0 < len(sizes) < len(schedule.stages)
    assert elbow_imbalance(schedule) == pytest.approx(np.mean(sizes), abs=1e-9)


def test_one_arm_has_no_imbalance_and_no_platform_no_travel(tasks_folder):
    """None, not zero."""
    job = load_job(tasks_folder / "05_two_robots" / "tasks.yaml")
    schedule = plan(job, PlanSettings(platform="fixed"))
    assert platform_travel(schedule) is None
    arms = {"left": schedule.robot.arms["left"]}
    one = dataclasses.replace(schedule, robot=dataclasses.replace(schedule.robot, arms=arms))
    assert elbow_imbalance(one) is None


def test_the_platforms_travel_is_the_sum_of_its_turns(packing):
    """Each stage turns it one way: the differences of the stages' angles, the start at 0."""
    angles = [0.0, *(stage.platform_angle for stage in packing.stages)]
    assert platform_travel(packing) == pytest.approx(np.abs(np.diff(angles)).sum(), abs=1e-6)
