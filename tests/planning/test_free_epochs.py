"""Asynchronous arms while the platform stands first here, then there."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.verification import verify

CELL = """dualarm: cell/1
robot: sda10f
tools:
  left:  {tcp: {xyz: [0, 0, 120 mm]}, shapes: [{capsule: {radius: 30 mm, length: 80 mm}, xyz: [0, 0, 50 mm]}]}
  right: {tcp: {xyz: [0, 0, 120 mm]}, shapes: [{capsule: {radius: 30 mm, length: 80 mm}, xyz: [0, 0, 50 mm]}]}
frames:
  front: {xyz: [0.60, 0, 0.80]}
  rear:  {xyz: [-0.60, 0, 0.80], rpy: [0, 0, 180 deg]}
clearance: 10 mm
"""
PRESS = """  - id: press-{at}
    arm: left
    dwell: 2.5 s
    approach: 60 mm
    retract: 60 mm
    move: {{at: {at}, xyz: [0, 250 mm, 0], rpy: [180 deg, 0, 0], free: yaw}}
"""
PICK = """  - id: part-{at}-{k}
    arm: right
    pick:  {{at: {at}, xyz: [-50 mm, {y} mm, 0], rpy: [180 deg, 0, 0], free: yaw}}
    place: {{at: {at}, xyz: [120 mm, {y} mm, 20 mm], rpy: [180 deg, 0, 0], free: yaw}}
"""


@pytest.fixture(scope="module")
def job(tmp_path_factory):
    """The left arm presses 2.5 s in front and behind; meanwhile the right one has time for more than one stop."""
    folder = tmp_path_factory.mktemp("front-and-rear")
    (folder / ".git").mkdir()
    (folder / "cell.yaml").write_text(CELL)
    tasks = "".join(
        PRESS.format(at=at) + PICK.format(at=at, k=1, y=-250) + PICK.format(at=at, k=2, y=-150)
        for at in ("front", "rear")
    )
    head = "dualarm: tasks/1\ncell: cell.yaml\nmode: free\norder: optimise\nreturn: true\n"
    (folder / "tasks.yaml").write_text(
        f"{head}defaults: {{approach: 60 mm, retract: 60 mm, dwell: 0.1 s}}\ntasks:\n{tasks}"
    )
    return load_job(folder / "tasks.yaml")


@pytest.fixture(scope="module")
def plan(job) -> Schedule:
    """Its plan."""
    return plan_without_bound(job, PlanSettings(effort="quick"))


def test_the_platform_stands_twice_and_every_check_passes(job, plan):
    """From the posture in front nothing behind is reached by the arm that has to."""
    found = verify(plan, job)
    assert found.passed, [check for check in found.checks if not check.passed]
    assert any("the platform stands at" in note and ", then at" in note for note in plan.notes)
    column = job.cell.robot.joints.index("torso_b1")
    stands = {
        round(float(plan.trajectory.at(np.array([event.time]))[0][0, column]), 6)
        for event in plan.events
    }
    assert len(stands) == 2


def test_it_ends_where_it_began(plan):
    """All joints, the platform's too."""
    position = plan.trajectory.position
    np.testing.assert_allclose(position[-1], position[0], rtol=0, atol=1e-9)


def test_stage_by_stage_it_would_take_longer(plan):
    """While the left arm presses, paired the right one makes one stop; here as many as it can."""
    (note,) = (note for note in plan.notes if "synchronous stages would take" in note)
    paired = float(note.split("would take ")[1].split(" s")[0])
    assert plan.duration < paired - 1.0


@pytest.mark.slow
def test_windows_count_from_the_beginning_of_all(job, plan):
    """A task of the second epoch that must wait waits until the file's instant, not from its epoch's beginning."""
    last = max(plan.events, key=lambda event: event.time).task
    opens = plan.duration + 3.0
    tasks = tuple(
        dataclasses.replace(task, not_before=opens) if task.id == last else task
        for task in job.tasks
    )
    later = dataclasses.replace(job, tasks=tasks)
    found = plan_without_bound(later, PlanSettings(effort="quick"), check_collisions=False)
    arrives = min(event.time for event in found.events if event.task == last)
    assert arrives >= opens - 1e-9
    assert found.duration < opens + 12.0
