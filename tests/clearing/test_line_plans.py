"""Plans in which the platform turns while tools are on lines: verified, never slower, only where tasks allow it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.job_bound import job_bound
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.report.console import motion_lines
from dualarm_cli.report.report import build_report
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


def turned_on_lines(schedule):
    """How far the platform turns on each line [rad], by arm, task, action and line."""
    columns = [schedule.trajectory.joints.index(name) for name in schedule.robot.platform]
    found = {}
    for s in schedule.segments:
        if s.kind in ("approach", "retract"):
            q = schedule.trajectory.at(np.linspace(s.start, s.end, 50))[0][:, columns]
            found[s.arm, s.task, s.action, s.kind] = float(np.ptp(q, axis=0).max(initial=0.0))
    return found


def tools(job, schedule, arm, times):
    """A tool's poses in the world by pinocchio alone, on the schedule's joints."""
    robot = job.cell.robot
    model = pin.buildModelFromXML(robot.urdf)
    data, flange = model.createData(), model.getFrameId(robot.arm(arm).flange)
    columns = [model.joints[model.getJointId(name)].idx_q for name in schedule.trajectory.joints]
    found = []
    for row in schedule.trajectory.at(times)[0]:
        q = np.zeros(model.nq)
        q[columns] = row
        pin.framesForwardKinematics(model, data, q)
        found.append(job.cell.base * data.oMf[flange] * job.cell.tools[arm].tcp)
    return found


@pytest.fixture(scope="module")
def turning(tasks_folder):
    """A job with a slow platform that may turn while tools are on lines, and its plan."""
    job = job_of(tasks_folder, slower=4.0, line_motion="allowed")
    return job, planned(job)


@pytest.mark.parametrize("blend", ["lines", "none"])
def test_a_slow_platform_gains_and_tools_stay_on_their_lines(tasks_folder, turning, blend):
    """Measured by pinocchio beside the verifier: 0.1 mm and 0.1 mrad from the line through the target."""
    standing = planned(job_of(tasks_folder, slower=4.0), blend=blend)
    job, moving = turning
    if blend == "none":
        moving = planned(job, blend=blend)
    assert standing.motion_gain is None
    assert max(turned_on_lines(standing).values()) == 0.0
    assert moving.motion_gain > 0.01
    assert moving.duration <= standing.duration - moving.motion_gain + 1e-9
    turned = turned_on_lines(moving)
    assert max(turned.values()) > np.radians(1.0)
    for s in moving.segments:
        if turned.get((s.arm, s.task, s.action, s.kind), 0.0) == 0.0:
            continue
        poses = tools(job, moving, s.arm, np.linspace(s.start, s.end, 40))
        target = poses[-1 if s.kind == "approach" else 0]
        for pose in poses:
            off = target.actInv(pose)
            assert np.hypot(*off.translation[:2]) < 1e-4
            assert np.linalg.norm(pin.log3(off.rotation)) < 1e-4


def test_the_same_job_gives_the_same_plan(turning):
    job, one = turning
    other = planned(job)
    assert np.array_equal(one.trajectory.time, other.trajectory.time)
    assert np.array_equal(one.trajectory.position, other.trajectory.position)


def test_only_lines_that_allow_it_are_used(tasks_folder):
    """The platform stands on all lines of a stage whose other stop forbids it, also with a dwell that allows it."""
    job = job_of(tasks_folder, slower=4.0, dwell=0.5, line_motion="allowed", dwell_motion="allowed")
    first = job.tasks[0]
    assert all(stop.line_motion for stop in first.stops)
    own = replace(first, stops=tuple(replace(s, line_motion=False) for s in first.stops))
    job = replace(job, tasks=(own, *job.tasks[1:]))
    schedule = planned(job)
    turned = turned_on_lines(schedule)
    for stage in schedule.stages:
        if first.id in stage.tasks:
            for (_, task, _, _), way in turned.items():
                assert way == 0.0 or task not in stage.tasks


@pytest.mark.parametrize("defaults", [{"dwell_motion": "allowed"}, {"straight": 0.04}])
def test_it_goes_with_motion_in_dwells_and_short_straight_parts(tasks_folder, defaults):
    """No longer than without it, and the gain tells of both."""
    given = {"dwell": 0.5, **defaults}
    without = planned(job_of(tasks_folder, slower=4.0, **given))
    job = job_of(tasks_folder, slower=4.0, line_motion="allowed", **given)
    schedule = planned(job)
    assert schedule.duration <= without.duration + 1e-9
    assert schedule.motion_gain >= 0.0
    report = build_report(schedule, job)
    [line] = motion_lines(report)
    assert ("in dwells" in line) == ("dwell_motion" in defaults)
    assert "on lines" in line
    assert report["motion_allowed"] == [
        key for key in ("dwell_motion", "line_motion") if key in defaults or key == "line_motion"
    ]


@pytest.mark.parametrize("name", ["01_first_pick", "06_shared_bin"])
def test_one_arm_and_crowded_cells(tasks_folder, name):
    """With obstacles and detours of both arms, with one arm: never slower, collision-free."""
    standing = planned(job_of(tasks_folder, name, count=2), platform="exact")
    job = job_of(tasks_folder, name, count=2, line_motion="allowed")
    moving = planned(job, platform="exact")
    assert (name == "06_shared_bin") == any("detours" in note for note in moving.notes)
    assert moving.duration <= standing.duration
    assert moving.motion_gain >= 0.0


def test_a_cap_on_the_speed_of_tools_is_kept(tasks_folder):
    """By the verifier; with both arms at work."""
    job = replace(job_of(tasks_folder, slower=4.0, line_motion="allowed"), tool_speed=0.4)
    assert planned(job).motion_gain >= 0.0


@pytest.mark.parametrize(
    ("name", "count", "note"),
    [
        ("13_hand_over", 2, "not used at hand-overs: flip-1 (give), flip-1 (take)"),
        ("15_conveyor", 2, "not used in tasks with conveyors"),
        ("10_seam", None, "not used on paths and seams: seam"),
    ],
)
def test_where_nothing_moves_a_note_says_so(tasks_folder, name, count, note):
    """Of motion in dwells and of motion on lines, which are both allowed."""
    motion = {"line_motion": "allowed", "dwell_motion": "allowed"}
    changes = {f"tasks:/defaults/{key}": value for key, value in motion.items()}
    if name == "10_seam":
        changes = {"tasks:/defaults": motion}
    job = load_job(tasks_folder / name / "tasks.yaml", overrides=changes)
    schedule = planned(replace(job, tasks=job.tasks[:count]))
    for key in motion:
        assert any(text.startswith(f"{key}: {note}") for text in schedule.notes)


def test_robots_without_a_platform_and_asynchronous_arms_are_named(tasks_folder):
    """The YuMi, whose arms have no closed forms; two arms at a chute."""
    job = job_of(tasks_folder, "09_yumi", line_motion="allowed", count=2)
    schedule = planned(job)
    assert schedule.motion_gain == 0.0
    assert "line_motion: not used, as no platform of one joint can be moved" in schedule.notes
    [line] = motion_lines(build_report(schedule, job))
    assert line.startswith("motion on lines: saves 0.000 s")
    both = {"line_motion": "allowed", "dwell_motion": "allowed"}
    schedule = planned(job_of(tasks_folder, "12_chute", count=2, **both))
    assert any(stage.arm for stage in schedule.stages)
    for key in ("line_motion", "dwell_motion"):
        assert f"{key}: not used, as the arms run asynchronously" in schedule.notes


def test_there_is_no_bound_where_the_platform_need_not_stand(tasks_folder):
    """The bound holds for plans whose platform stands on lines only."""
    bound = job_bound(job_of(tasks_folder, line_motion="allowed"), "quick", blended=True)
    assert bound.value is None
    assert "line_motion" in bound.assumptions[0]
    both = job_of(tasks_folder, line_motion="allowed", dwell_motion="allowed")
    assert len(job_bound(both, "quick", blended=True).assumptions) == 2


@pytest.mark.slow
@pytest.mark.parametrize("name", ["04_packing", "07_two_shelves", "08_narrow_bin", "12_chute"])
def test_bundled_jobs_are_never_slower(tasks_folder, name):
    standing = planned(job_of(tasks_folder, name))
    moving = planned(job_of(tasks_folder, name, line_motion="allowed"))
    assert moving.duration <= standing.duration
    assert moving.motion_gain >= 0.0
