"""Care of parts and tasks: rates by finite differences, in plans with it and in the verifier."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.collision.clearance import CellClearance
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.cell import Held
from dualarm_cli.model.job import Job
from dualarm_cli.model.part_flow import Care
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.verification import tool_checks, verify
from dualarm_cli.verification.as_done import job_as_done
from dualarm_cli.verification.care_checks import check_care
from dualarm_cli.verification.measuring.tool_model import ToolModel

CARE = Care(speed=0.5, acceleration=0.8, tool_speed=0.5)
STEP = 2e-4


def careful(job: Job, **fields: Care) -> Job:
    """Returns the job with care in all its tasks."""
    return dataclasses.replace(
        job, tasks=tuple(dataclasses.replace(task, **fields) for task in job.tasks)
    )


def largest(schedule: Schedule, job: Job, spans: list[tuple[str, float, float]]) -> float:
    """Returns the largest share of CARE in the spans of arms, by differences of positions."""
    robot = schedule.robot
    model = pin.buildModelFromXML(robot.urdf)
    data, share = model.createData(), 0.0
    for arm, start, end in spans:
        joints = (*robot.arms[arm].joints, *robot.platform)
        limits = job.cell.robot.limits.select(joints)
        time = np.arange(start, end, STEP)
        q = schedule.trajectory.select(joints).clamped(time)[0]
        v, a = np.diff(q, axis=0) / STEP, np.diff(q, 2, axis=0) / STEP**2
        share = max(share, float((np.abs(v) / limits.velocity).max()) / CARE.speed)
        allowed = CARE.speed**2 * CARE.acceleration * limits.acceleration
        share = max(share, float((np.abs(a) / allowed).max()))
        jerk = np.abs(np.diff(q, 3, axis=0)).max(axis=0) / STEP**3
        share = max(share, float((jerk / (CARE.speed**3 * limits.jerk)).max()))
        frame, tip = model.getFrameId(robot.arms[arm].flange), []
        for whole in schedule.trajectory.clamped(time)[0]:
            order = [schedule.trajectory.joints.index(name) for name in model.names[1:]]
            pin.forwardKinematics(model, data, whole[order])
            tip.append((pin.updateFramePlacement(model, data, frame) * robot.arms[arm].tcp).translation)  # fmt: skip
        speed = np.linalg.norm(np.diff(tip, axis=0), axis=1).max() / STEP
        share = max(share, float(speed) / CARE.tool_speed)
    return share


def held(schedule: Schedule) -> list[tuple[str, float, float]]:
    """Returns arm, start and end of every span in which a part is held."""
    times = {(e.task, e.action): e for e in schedule.events}
    return [
        (times[task, taken].arm, times[task, taken].time, times[task, given].time)
        for task in {e.task for e in schedule.events}
        for taken, given in (("pick", "give"), ("take", "place"))
    ]


def check_of(schedule: Schedule, job: Job, name: str = "care") -> Any:
    """Returns a check of the verifier."""
    return next(check for check in verify(schedule, job).checks if check.name == name)


@pytest.fixture(scope="module")
def flip(tasks_folder: Any) -> Job:
    """Two hand-overs with a turning torso."""
    return load_job(tasks_folder / "13_hand_over" / "tasks.yaml")


def test_held_parts_are_moved_with_care_by_arms_and_platform(
    flip: Job, quick_plan: Callable[[str], Any]
) -> None:
    """Blended hand-overs keep what the plan without care exceeds, and use it up."""
    before, job = quick_plan("13_hand_over"), careful(flip, holding=CARE)
    share = largest(before, job, held(before))
    found = check_of(before, job)
    assert found.verdict == "failed"
    assert found.measured == pytest.approx(share, rel=2e-2) and share > 1.5
    plan = plan_without_bound(job, PlanSettings(effort="quick", platform="exact"))
    assert {check.name for check in verify(plan, job).checks if check.verdict == "failed"} == set()
    share = largest(plan, job, held(plan))
    assert 0.95 < share < 1.02
    assert check_of(plan, job).measured == pytest.approx(share, abs=2e-2)


def test_only_the_arm_of_a_careful_task_is_slow(tasks_folder: Any) -> None:
    """The first stage: one arm at half speed takes twice as long, the other one as before."""
    job = load_job(tasks_folder / "02_two_trays" / "tasks.yaml")
    tasks = tuple(
        dataclasses.replace(task, after=(), care=Care(speed=0.5) if task.arm == "left" else Care())
        for task in job.tasks
    )
    job = dataclasses.replace(job, tasks=tasks)
    plan = plan_without_bound(job, PlanSettings(effort="quick", platform="fixed"))
    assert check_of(plan, job).verdict == "passed"
    limits = job.limits
    for name, speed in (("left", 0.5), ("right", 1.0)):
        joints = plan.robot.arms[name].joints
        moves = [s for s in plan.segments if s.arm == name and s.kind == "transfer" and s.action]
        for move in moves:
            time = np.linspace(move.start, move.end, 2_000)
            v = np.abs(plan.trajectory.select(joints).clamped(time)[1]).max(axis=0)
            share = float((v / limits.select(joints).velocity).max())
            assert share <= speed * (1.0 + 1e-9)
        if name == "right":
            assert share > 0.6


def attitudes(schedule: Schedule, arm: str, time: np.ndarray) -> np.ndarray:
    """Returns the rotations of an arm's tool at instants (n,), shape (n, 3, 3)."""
    robot = schedule.robot
    model = pin.buildModelFromXML(robot.urdf)
    data, rows = model.createData(), []
    frame = model.getFrameId(robot.arms[arm].flange)
    order = [schedule.trajectory.joints.index(name) for name in model.names[1:]]
    for whole in schedule.trajectory.clamped(time)[0]:
        pin.forwardKinematics(model, data, whole[order])
        placement = pin.updateFramePlacement(model, data, frame) * robot.arms[arm].tcp
        rows.append(robot.base.rotation @ placement.rotation)
    return np.array(rows)


def test_parts_lean_as_far_as_the_tool_that_holds_them(
    flip: Job, quick_plan: Callable[[str], Any]
) -> None:
    """Each millisecond, by the axis that is vertical at the pick; the part keeps its attitude at the hand-over."""
    plan, job = quick_plan("13_hand_over"), careful(flip, holding=Care(tilt=1.0))
    times = {(e.task, e.action): e for e in plan.events}
    largest_angle = 0.0
    for task in {e.task for e in plan.events}:
        up = np.array([0.0, 0.0, 1.0])
        for taken, given in (("pick", "give"), ("take", "place")):
            first, last = times[task, taken], times[task, given]
            span = np.arange(first.time, last.time + last.dwell, 1e-3)
            R = attitudes(plan, first.arm, np.append(span, times[task, "take"].time))
            world = R @ (R[0].T @ up)
            least = max(float(world[:, 2].min()), -1.0)
            largest_angle = max(largest_angle, float(np.arccos(least)))
            up = world[-1]
    found = check_of(plan, job, "tilt")
    assert found.measured == pytest.approx(largest_angle, abs=2e-3)
    assert found.verdict == "failed" and largest_angle > 3.0  # brackets are turned over
    # 1e-6 rad beyond its limit is the error of measurement, however small the limits of others are.
    for beyond, verdict in ((0.5e-6, "passed"), (5e-6, "failed")):
        job = job_as_done(plan, careful(flip, holding=Care(tilt=found.measured - beyond)))
        other = dataclasses.replace(job.tasks[0], id="other", holding=Care(tilt=0.01))
        job = dataclasses.replace(job, tasks=(*job.tasks, other))
        [check] = check_care(plan, job, ToolModel(plan))
        assert check.verdict == verdict


def test_the_planner_measures_the_same_angles(flip: Job, quick_plan: Callable[[str], Any]) -> None:
    """At random instants of a plan on a tilted base: the allowed angle less that of the tool."""
    plan, job = quick_plan("13_hand_over"), careful(flip, holding=Care(tilt=1.0))
    base = pin.SE3(pin.rpy.rpyToMatrix(0.3, -0.2, 0.5), np.zeros(3))
    job = dataclasses.replace(job, cell=dataclasses.replace(job.cell, base=base))
    plan = dataclasses.replace(plan, robot=dataclasses.replace(plan.robot, base=base))
    clearance = CellClearance.of_job(job)
    time = np.random.default_rng(0).uniform(0.0, plan.duration, 20)
    position = plan.trajectory.select(job.cell.robot.joints).clamped(time)[0]
    for a, arm in enumerate(clearance.arms):
        task = next(task for task in job.tasks if task.arm == arm)
        held = np.full(len(time), clearance.loads.number(Held(task.tool, task.part).name))
        world = attitudes(plan, arm, time) @ np.array(task.upright)
        spare = clearance.spare_tilt(a, position, held)
        np.testing.assert_allclose(spare, 1.0 - np.arccos(world[:, 2]), atol=1e-6)
    assert np.isinf(clearance.spare_tilt(0, position, clearance.loads.nothing(len(time)))).all()


def test_a_motion_too_long_to_measure_fails(
    flip: Job, quick_plan: Callable[[str], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without measuring it: a bound below the plan's length stands for a plan of hours."""
    plan, job = quick_plan("13_hand_over"), careful(flip, holding=Care(speed=0.999, tilt=1.0))
    shorter = dataclasses.replace(tool_checks.SPEED, longest=1.0)
    monkeypatch.setattr(tool_checks, "SPEED", shorter)
    for name in ("care", "tilt"):
        check = check_of(plan, job, name)
        assert check.verdict == "failed" and "is too long to check" in check.detail
