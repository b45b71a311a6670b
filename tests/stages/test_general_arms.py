"""Whole plans of arms without closed forms by the search over the whole sequence."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from dualarm_cli.errors import InfeasibleError, UnsupportedError
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan, plan_without_bound
from dualarm_cli.verification import verify

QUICK = PlanSettings(effort="quick")


@pytest.mark.parametrize("name", ["yumi", "nextage", "spherical", "ur5"])
def test_any_arms_are_planned_and_verified_and_not_slower_than_greedily(
    general_robots, tmp_path, name
):
    """Seven axes with offsets; six without closed forms on a waist; six with them. Nothing is named.

    With all stops, which is what methods are compared by.
    """
    job = load_job(general_robots.write_cell(tmp_path, name, tasks=1 if name == "nextage" else 2))
    stopping = replace(QUICK, blend="none")
    schedule = plan(job, stopping)
    assert verify(schedule, job).passed
    closed = name in ("spherical", "ur5")
    assert (schedule.lower_bound is not None) == closed
    assert any(note.startswith("lower bound: none") for note in schedule.notes) != closed
    assert not closed or 0.3 * schedule.duration < schedule.lower_bound <= schedule.duration
    assert schedule.provenance.settings["platform"] == "sequence"
    assert schedule.provenance.settings["redundancy"] == "numeric"
    (note,) = (one for one in schedule.notes if "planned with redundancy numeric" in one)
    assert ("in closed form" in note) == closed
    assert ("not spherical-revolute-spherical" in note) != closed
    greedy = plan_without_bound(job, replace(stopping, platform="fixed"))
    assert verify(greedy, job).passed
    assert schedule.duration <= greedy.duration + 1e-9


@pytest.mark.parametrize("kind", ["parallel_axes", "general"])
def test_a_tool_straight_down_blends_as_one_tilted_by_a_millidegree(general_robots, tmp_path, kind):
    """Wrist 2 of a UR rests then along all lines, but for rounding; the tilt moves the tool by 2 µm in 100 mm."""
    cycles = []
    for roll in ("180 deg", "179.999 deg"):
        file = general_robots.write_cell(tmp_path, "ur5", tasks=1)
        file.write_text(
            re.sub(r".*right .*\n(.*\n){3}", "", file.read_text()).replace("180 deg", roll)
        )
        robot = tmp_path / "robot.yaml"
        robot.write_text(robot.read_text().replace("parallel_axes", kind))
        schedule = plan_without_bound(load_job(file), QUICK)
        assert schedule.blend_gain > 0.05 * schedule.duration
        cycles.append(schedule.duration)
    assert cycles[0] == pytest.approx(cycles[1], rel=1e-3)


def test_the_same_job_has_the_same_plan_twice(general_robots, tmp_path):
    """Bit for bit."""
    job = load_job(general_robots.write_cell(tmp_path, "yumi", tasks=1))
    one, two = (plan_without_bound(job, QUICK).trajectory for _ in range(2))
    assert np.array_equal(one.position, two.position)


def test_free_starts_symmetry_free_yaw_joint_targets_and_idle_arms(general_robots, tmp_path):
    """All in one job."""
    file = general_robots.write_cell(tmp_path, "yumi")
    file.write_text(
        "dualarm: tasks/1\ncell: cell.yaml\nstart: free\nreturn: true\nspeed: 80%\n"
        "defaults: {approach: 40 mm, retract: 40 mm, dwell: 0.1 s}\ntasks:\n"
        "  - id: a\n    arm: left\n"
        "    pick:  {xyz: [0.3, 0.2, 0.1], rpy: [180 deg, 0, 0], free: yaw}\n"
        "    place: {xyz: [0.35, 0.3, 0.1], rpy: [180 deg, 0, 90 deg], symmetry: 4}\n"
        "  - {id: b, arm: right, move: {xyz: [0.35, -0.25, 0.1], rpy: [180 deg, 0, 0]}}\n"
        "  - {id: c, arm: left, move: {joints: [1.0, -0.2, -0.3, 0.7, 0.3, -0.15, 0.0]}}\n"
    )
    job = load_job(file)
    schedule = plan_without_bound(job, QUICK)
    assert verify(schedule, job).passed


def test_clearance_is_kept_by_any_arms(general_robots, tmp_path):
    """A post between pick and place of the left arm: proven clear, and it costs."""
    shapes = "{capsule: {radius: 30 mm, length: 60 mm}, xyz: [0, 0, 40 mm]}"
    post = "obstacles: {post: {box: [0.04, 0.04, 0.3], xyz: [0.33, 0.26, 0.2]}}\nclearance: 10 mm\n"
    job = load_job(general_robots.write_cell(tmp_path, "yumi", 1, shapes, post))
    stopping = replace(QUICK, blend="none")
    schedule = plan_without_bound(job, stopping)
    unchecked = plan_without_bound(job, stopping, check_collisions=False)
    assert not verify(unchecked, job, clearance=True).passed
    assert verify(schedule, job, clearance=True).passed
    assert schedule.clearance_cost == pytest.approx(schedule.duration - unchecked.duration)


@pytest.mark.parametrize("platform", ["sequence", "fixed"])
def test_a_target_out_of_reach_is_refused_with_its_place_and_miss(
    general_robots, tmp_path, platform
):
    """Task, arm, and how far: a spherical wrist on 0.4 and 0.4 m links, the tool 150 mm below it.

    The target 1.2 m ahead of the shoulder on its height is missed by sqrt(1.2² + 0.15²) - 0.8 m at least, which is
    what an arm stretched towards the wrist leaves.
    """
    file = general_robots.write_cell(tmp_path, "spherical", tasks=1)
    file.write_text(file.read_text().replace("[0.45, 0.2, 0.1]", "[1.2, 0.3, 0.4]"))
    with pytest.raises(InfeasibleError) as caught:
        plan_without_bound(load_job(file), PlanSettings(platform, effort="quick"))
    message = str(caught.value)
    assert "task 'left 0': left arm cannot pick" in message
    miss = (np.hypot(1.2, 0.15) - 0.8) * 1000
    assert f"than {miss:.1f} mm" in message or f"than {miss + 0.1:.1f} mm" in message


def test_named_methods_that_do_not_serve_say_why(general_robots, tmp_path):
    """Only what nobody named is replaced."""
    job = load_job(general_robots.write_cell(tmp_path, "yumi", tasks=1))
    for settings, words in (
        (PlanSettings().naming(platform="exact"), "platform exact cannot plan YuMi"),
        (
            PlanSettings().naming(redundancy="arm_angle"),
            "redundancy arm_angle cannot plan YuMi",
        ),
    ):
        with pytest.raises(UnsupportedError) as caught:
            plan_without_bound(job, settings)
        assert words in str(caught.value)
        assert "left and right arms are not spherical-revolute-spherical" in str(caught.value)
        assert "the platform methods sequence and fixed plan such arms" in str(caught.value)


def test_numeric_inverse_kinematics_serves_arms_with_closed_forms_as_well(tasks_folder):
    """Nearly as fast a plan; the bound, which needs closed forms, holds for it too."""
    job = load_job(tasks_folder / "01_first_pick" / "tasks.yaml")
    schedule = plan(job, PlanSettings(effort="quick").naming(redundancy="numeric"))
    assert verify(schedule, job).passed
    assert schedule.lower_bound <= schedule.duration
    assert schedule.duration <= 1.1 * plan_without_bound(job, QUICK).duration


def test_a_stop_without_lines_is_where_it_is_asked_on_a_platform_that_turns(tmp_path):
    """A waist that turns while an arm without closed forms goes to a bare target: its tool was once 60 mm off."""
    from dualarm_cli.files.tasks.tasks import load_job
    from dualarm_cli.model.settings import PlanSettings
    from dualarm_cli.planning.planner import plan_without_bound
    from dualarm_cli.verification import verify

    target = (
        "{xyz: [0.215455, -0.334051, 1.300075], quat: [0.951681, -0.205047, 0.228604, 0.000056]}"
    )
    (tmp_path / "cell.yaml").write_text("dualarm: cell/1\nrobot: nextage\n")
    text = f"dualarm: tasks/1\ncell: cell.yaml\ntasks: [{{id: t, arm: right, move: {target}}}]\n"
    (tmp_path / "tasks.yaml").write_text(text)
    job = load_job(tmp_path / "tasks.yaml")
    schedule = plan_without_bound(job, PlanSettings(effort="quick"), check_collisions=False)
    verdict = verify(schedule, job)
    assert verdict.passed, verdict.failures
