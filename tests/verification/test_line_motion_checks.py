"""A platform that turns while tools are on lines: only where the job allows it, and no tool may leave its line."""

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
    """A job with a slow platform, and its plan, in which the platform turns on lines."""
    changes = {"tasks:/defaults/line_motion": "allowed", "tasks:/defaults/dwell": 0.5}
    job = load_job(tasks_folder / "04_packing" / "tasks.yaml", overrides=changes)
    robot = job.cell.robot
    factor = np.where([j in robot.platform for j in robot.limits.joints], 0.25, 1.0)
    rates = {n: getattr(robot.limits, n) * factor for n in ("velocity", "acceleration", "jerk")}
    robot = replace(robot, limits=replace(robot.limits, **rates))
    job = replace(job, cell=replace(job.cell, robot=robot), tasks=job.tasks[:4])
    return plan_without_bound(job, PlanSettings(effort="quick")), job


def with_stops(job, **changes):
    """The job with all stops changed."""
    tasks = tuple(
        replace(task, stops=tuple(replace(stop, **changes) for stop in task.stops))
        for task in job.tasks
    )
    return replace(job, tasks=tasks)


def failed(schedule, job=None):
    """Names of the checks that fail."""
    return {check.name for check in verify(schedule, job).failures}


def column_of(schedule):
    return schedule.trajectory.joints.index(schedule.robot.platform[0])


def turned_platform(schedule, start, end, angle):
    """A schedule whose platform swings by an angle [rad] and back between two instants, and nothing else does."""
    motion, column = schedule.trajectory, column_of(schedule)
    times = np.union1d(motion.time, np.linspace(start, end, 9))
    q, v, a = (np.array(rows) for rows in motion.at(times))
    share = np.clip((times - start) / (end - start), 0.0, 1.0)
    q[:, column] += angle * np.sin(np.pi * share) ** 2
    moved = replace(motion, time=times, position=q, velocity=v, acceleration=a)
    return replace(schedule, motion=JointMotion.of(moved))


def moving_line(schedule):
    """The line on which the platform turns most."""

    def turned(s):
        times = np.linspace(s.start, s.end, 50)
        return np.ptp(schedule.trajectory.at(times)[0][:, column_of(schedule)])

    line = max((s for s in schedule.segments if s.kind in ("approach", "retract")), key=turned)
    assert turned(line) > np.radians(0.5)
    return line


def test_a_plan_whose_tools_stay_on_their_lines_passes(planned):
    """Measured in the world, with the tolerances that lines have everywhere."""
    schedule, job = planned
    checks = {check.name: check for check in verify(schedule, job).checks}
    for name in ("lines_straight", "lines_steady", "line_lengths", "platform_still"):
        assert checks[name].verdict == "passed"
    assert checks["lines_straight"].allowed == checks["lines_steady"].allowed == 1e-4
    # The planner keeps half of it.
    assert checks["lines_straight"].measured < 6e-5


@pytest.mark.parametrize("dwells", [False, True])
def test_where_the_job_does_not_allow_it_the_platform_has_to_stand(planned, dwells):
    """Whatever the schedule says of itself, and whether or not it may turn in dwells."""
    schedule, job = planned
    forbidding = with_stops(job, line_motion=False, dwell_motion=dwells)
    assert "platform_still" in failed(schedule, forbidding)
    bare = replace(schedule, segments=())
    assert "platform_still" in failed(bare, forbidding)


def test_one_stop_that_forbids_it_is_enough(planned):
    """The line of the other arm in the same stage does not help."""
    schedule, job = planned
    line = moving_line(schedule)
    tasks = tuple(
        replace(task, stops=tuple(replace(s, line_motion=False) for s in task.stops))
        if task.id == line.task
        else task
        for task in job.tasks
    )
    assert "platform_still" in failed(schedule, replace(job, tasks=tasks))


def test_without_a_job_the_schedule_says_whether_the_platform_may_turn(planned):
    schedule, _ = planned
    assert failed(schedule) == set()
    assert "platform_still" in failed(replace(schedule, motion_gain=None))


def test_a_tool_that_leaves_its_line_is_found(planned):
    """1 mrad at 0.4 m from the axis or more is 0.4 mm."""
    schedule, job = planned
    line = moving_line(schedule)
    changed = turned_platform(schedule, line.start, line.end, 1e-3)
    assert failed(changed, job) & {"lines_straight", "lines_steady", "line_lengths"}
    assert failed(changed) & {"lines_straight", "lines_steady", "line_lengths"}


def test_in_dwells_beside_such_lines_the_platform_has_to_stand(planned):
    """By as little as 10 µrad."""
    schedule, job = planned
    line = moving_line(schedule)
    [event] = [
        e
        for e in schedule.events
        if (e.arm, e.task, e.action) == (line.arm, line.task, line.action)
    ]
    changed = turned_platform(schedule, event.time, event.time + event.dwell, 1e-5)
    assert "platform_still" in failed(changed, job)
    bare = replace(changed, segments=())
    assert "platform_still" in failed(bare, job)
