"""Joints that move while tools dwell: only where the job allows it, and no tool may move."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.joint_motion import JointMotion
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.verification import verify


@pytest.fixture(scope="module")
def planned(tasks_folder):
    """A job with a slow platform and long dwells, and its plan, in which joints move in dwells."""
    changes = {"tasks:/defaults/dwell": 0.5, "tasks:/defaults/dwell_motion": "allowed"}
    job = load_job(tasks_folder / "04_packing" / "tasks.yaml", overrides=changes)
    robot = job.cell.robot
    factor = np.where([j in robot.platform for j in robot.limits.joints], 0.25, 1.0)
    rates = {n: getattr(robot.limits, n) * factor for n in ("velocity", "acceleration", "jerk")}
    robot = replace(robot, limits=replace(robot.limits, **rates))
    job = replace(job, cell=replace(job.cell, robot=robot), tasks=job.tasks[:4])
    return plan_without_bound(job, PlanSettings(effort="quick")), job


def forbidding(job):
    """The job with all dwells at rest."""
    tasks = tuple(
        replace(task, stops=tuple(replace(stop, dwell_motion=False) for stop in task.stops))
        for task in job.tasks
    )
    return replace(job, tasks=tasks)


def failed(schedule, job=None):
    """Names of the checks that fail."""
    return {check.name for check in verify(schedule, job).failures}


def turned_platform(schedule, start, end, angle):
    """A schedule whose platform swings by an angle [rad] and back between two instants, and nothing else does."""
    motion = schedule.trajectory
    column = motion.joints.index(schedule.robot.platform[0])
    times = np.union1d(motion.time, np.linspace(start, end, 9))
    q, v, a = (np.array(rows) for rows in motion.at(times))
    share = np.clip((times - start) / (end - start), 0.0, 1.0)
    q[:, column] += angle * np.sin(np.pi * share) ** 2
    moved = replace(motion, time=times, position=q, velocity=v, acceleration=a)
    return replace(schedule, motion=JointMotion.of(moved))


def moving_event(schedule):
    """The event in whose dwell the platform turns most."""
    column = schedule.trajectory.joints.index(schedule.robot.platform[0])

    def turned(event):
        times = np.linspace(event.time, event.time + event.dwell, 50)
        return np.ptp(schedule.trajectory.at(times)[0][:, column])

    event = max(schedule.events, key=turned)
    assert turned(event) > np.radians(0.5)
    return event


def test_a_plan_whose_tools_stand_passes_and_says_so(planned):
    schedule, job = planned
    checks = {check.name: check for check in verify(schedule, job).checks}
    assert (
        checks["tool_held_in_dwells"].verdict
        == checks["tool_upright_in_dwells"].verdict
        == "passed"
    )
    assert checks["tool_held_in_dwells"].allowed == 2e-5
    assert checks["platform_still"].verdict == checks["segment_kinds"].verdict == "passed"


def test_where_the_job_does_not_allow_it_platform_and_arms_have_to_stand(planned):
    """Whatever the schedule says of itself."""
    schedule, job = planned
    assert "platform_still" in failed(schedule, forbidding(job))


def test_without_a_job_the_schedule_says_whether_joints_may_move(planned):
    schedule, _ = planned
    assert failed(schedule) == set()
    assert "platform_still" in failed(replace(schedule, motion_gain=None))


def test_a_tool_that_moves_in_its_dwell_is_found(planned):
    """0.1 mrad at 0.5 m from the axis is 0.05 mm."""
    schedule, job = planned
    event = moving_event(schedule)
    changed = turned_platform(schedule, event.time, event.time + event.dwell, 2e-4)
    assert "tool_held_in_dwells" in failed(changed, job)
    assert "tool_held_in_dwells" in failed(changed)


def test_a_tool_that_moves_where_it_waits_after_its_dwell_is_found(planned):
    """There it stands as well; measured by the tool, as joints may go on moving."""
    schedule, job = planned
    over = {(e.arm, e.task, e.action): e.time + e.dwell for e in schedule.events}
    waits = [
        s
        for s in schedule.segments
        if s.kind == "wait" and abs(s.start - over.get((s.arm, s.task, s.action), -1.0)) < 1e-9
    ]
    assert waits
    wait = max(waits, key=lambda s: s.end - s.start)
    columns = [schedule.trajectory.joints.index(n) for n in schedule.robot.arms[wait.arm].joints]
    motion = schedule.trajectory
    times = np.union1d(motion.time, np.linspace(wait.start, wait.end, 9))
    q, v, a = (np.array(rows) for rows in motion.at(times))
    share = np.clip((times - wait.start) / (wait.end - wait.start), 0.0, 1.0)
    q[:, columns[0]] += 1e-3 * np.sin(np.pi * share) ** 2
    moved = replace(motion, time=times, position=q, velocity=v, acceleration=a)
    assert "segment_kinds" in failed(replace(schedule, motion=JointMotion.of(moved)), job)


@pytest.mark.parametrize("kind", ["approach", "retract"])
def test_on_lines_the_platform_has_to_stand(planned, kind):
    """Also beside a dwell in which it may turn, and where the schedule lists no lines."""
    schedule, job = planned
    event = moving_event(schedule)
    [line] = [
        s
        for s in schedule.segments
        if (s.arm, s.task, s.action, s.kind) == (event.arm, event.task, event.action, kind)
    ]
    changed = turned_platform(schedule, line.start, line.end, 1e-5)
    assert "platform_still" in failed(changed, job)
    bare = replace(changed, segments=())
    assert "platform_still" in failed(bare, job)


def test_an_arm_without_lines_may_move_its_elbow_on_until_its_partner_is_done(
    tmp_path, random_valid_jobs
):
    """The left arm's elbow is not done as its dwell is over; its tool stands until the stage is over, so it may."""
    random_valid_jobs.write_random_job(23, tmp_path)
    changes = {"tasks:/defaults/dwell_motion": "allowed"}
    job = load_job(tmp_path / "tasks.yaml", overrides=changes)
    schedule = plan_without_bound(job, PlanSettings(effort="quick"))
    assert failed(schedule, job) == set()
    # Without the permission the same motion leaves the stage early, and more.
    assert "pairing" in failed(schedule, forbidding(job))
