"""Targets of moves that tools pass in motion: never slower, verified, and only where the file allows it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dualarm_cli.bound.job_bound import job_bound
from dualarm_cli.errors import InputError
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.job import Job, PoseTarget
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.report.stage_parts import corners
from dualarm_cli.verification import verify
from dualarm_cli.verification.measuring.tool_model import ToolModel

CELL = """\
dualarm: cell/1
robot: sda10f
tools:
  left: {tcp: {xyz: [0, 0, 120 mm]}}
  right: {tcp: {xyz: [0, 0, 120 mm]}}
"""


JOINTS = [
    [0.2, 0.5, 0.1, -0.9, 0.2, 0.3, 0.0],
    [0.5, 0.9, 0.3, -0.6, 0.4, 0.5, 0.3],
    [0.8, 1.0, 0.2, -0.9, 0.7, 0.6, 0.5],
]


def job_of(folder: Path, tasks: str, head: str = "") -> Job:
    """A job of some tasks that returns."""
    (folder / "cell.yaml").write_text(CELL)
    path = folder / "tasks.yaml"
    path.write_text(f"dualarm: tasks/1\ncell: cell.yaml\nreturn: true\n{head}tasks:\n{tasks}")
    return load_job(path)


def moves(seed: int, blend: str, both: bool) -> str:
    """Five moves of each arm at random places in front of it, or of the left one alone."""
    random, rows = np.random.default_rng(seed), []
    for k in range(5):
        for arm, side in (("left", 1.0), ("right", -1.0))[: 1 + both]:
            x, y, z = random.uniform([0.40, 0.15, 0.80], [0.65, 0.45, 1.10])
            pose = f"xyz: [{x:.3f}, {side * y:.3f}, {z:.3f}], rpy: [180 deg, 0, 0], free: yaw"
            rows.append(f"  - {{id: {arm}{k}, arm: {arm}, move: {{{pose}}}{blend}}}\n")
    return "".join(rows)


def planned(job: Job, blend: str = "lines", **others: Any) -> Schedule:
    """A plan that the verifier passes, clearance included."""
    schedule = plan_without_bound(job, PlanSettings(effort="quick", blend=blend, **others))
    verdict = verify(schedule, job, clearance=True)
    assert verdict.passed, verdict.failures
    return schedule


@pytest.mark.parametrize(
    ("both", "head"),
    [
        (False, ""),
        (True, ""),
        (True, "limits: {tool_speed: 800 mm/s}\n"),
        (True, "mode: free\n"),
    ],
)
def test_moves_that_are_passed_are_never_slower(tmp_path: Path, both: bool, head: str) -> None:
    """Against the same file with all stops; without a cap on the tools' speed it is quicker."""
    job = job_of(tmp_path, moves(0, ", blend: 20 mm", both), head)
    passing, stopping = planned(job), planned(job, "none")
    assert passing.duration <= stopping.duration + 1e-9
    if not head:
        assert passing.duration < 0.995 * stopping.duration
        found = [corner for corner in corners(passing, job) if not corner.line]
        assert found and all(corner.speed > 0.0 for corner in found)


@pytest.mark.full_effort
def test_tools_pass_beside_their_targets_as_far_as_they_may_and_gain_by_it(tmp_path: Path) -> None:
    """Measured on the tools' motion: within `blend`, in the target's orientation; at some of them well beside it."""
    durations, beside = {}, []
    for blend in (1, 30):
        job = job_of(tmp_path, moves(0, f", blend: {blend} mm", both=True))
        schedule = planned(job)
        durations[blend] = schedule.duration
        model, stops = ToolModel(schedule), job.stops_by_key()
        for event in schedule.events:
            target = stops[event.arm, event.task, event.action].target
            assert isinstance(target, PoseTarget)
            times = np.linspace(event.time - 0.1, event.time + 0.1, 2001).clip(0, schedule.duration)
            _, p = model.poses(event.arm, schedule.trajectory.at(times)[0])
            off = np.linalg.norm(p - target.pose.translation, axis=1).min()
            assert off <= 1e-3 * blend + 1e-5
            beside.append((blend, off))
            tilt = event.pose.rotation[:, 2] @ target.pose.rotation[:, 2]
            assert tilt == pytest.approx(1.0, abs=1e-9)
        found = [corner for corner in corners(schedule, job) if not corner.line]
        assert all(corner.beside <= 1e-3 * blend + 1e-6 for corner in found)
    assert durations[30] < 0.99 * durations[1]
    assert sum(off > 5e-3 for blend, off in beside if blend == 30) >= 3


PICK = (
    "pick: {{xyz: [{x:.3f}, {y:.3f}, 0.9], rpy: [180 deg, 0, 0]}}, approach: 60 mm, retract: 60 mm"
)
"""Keys of a pick at a place in front of the robot."""


def picks_and_moves(left: str, right: str, blend: str) -> str:
    """Tasks of both arms in their order: p for a pick, m for a move."""
    random, rows = np.random.default_rng(5), []
    for arm, side, kinds in (("left", 1.0, left), ("right", -1.0, right)):
        for k, kind in enumerate(kinds):
            x, y = random.uniform([0.40, 0.15], [0.65, 0.45]) * (1.0, side)
            work = PICK.format(x=x, y=y)
            if kind == "m":
                work = f"move: {{xyz: [{x:.3f}, {y:.3f}, 1.1], rpy: [180 deg, 0, 0]}}{blend}"
            rows.append(f"  - {{id: {arm}{k}, arm: {arm}, {work}}}\n")
    return "".join(rows)


@pytest.mark.parametrize(
    ("left", "right", "head"),
    [
        ("pmp", "pmp", ""),
        ("pmp", "pp", ""),
        ("mpm", "p", "start: free\n"),
        ("pmp", "pp", "mode: free\n"),
        ("pm", "mp", "order: optimise\n"),
    ],
)
def test_no_plan_is_faster_than_the_bound_past_moves(tmp_path, left, right, head):
    """Blended plans of two efforts' methods; the bound is at most that of the same file with stops at its moves."""
    passing = job_of(tmp_path, picks_and_moves(left, right, ", blend: 30 mm"), head)
    stopping = job_of(tmp_path, picks_and_moves(left, right, ""), head)
    least, at_rest = (job_bound(job, "quick", "lines") for job in (passing, stopping))
    assert least.value is not None and at_rest.value is not None
    assert 0.0 < least.value <= at_rest.value
    assert any(note.key == "passed_targets" for note in least.assumptions)
    for platform in ("sequence", "fixed"):
        found = plan_without_bound(
            passing, PlanSettings(platform, effort="quick"), check_collisions=False
        )
        assert least.value <= found.duration


def test_a_move_that_is_passed_counts_as_if_it_were_not_there(tmp_path):
    """Where both arms pass one at the same time, or one arm works alone; at rest it counts."""
    for left, right in (("pmp", "pmp"), ("pmmp", "")):
        tasks = [picks_and_moves(left, right, blend) for blend in (", blend: 30 mm", "")]
        without = "".join(row for row in tasks[0].splitlines(True) if "move" not in row)
        passed, stops, none = (
            job_bound(job_of(tmp_path, rows), "quick", "lines").value for rows in (*tasks, without)
        )
        assert passed == none
        assert stops is not None and passed is not None and stops > passed


def test_a_tool_too_far_beside_its_target_is_found(tmp_path: Path) -> None:
    """A plan for 30 mm, judged by a file that allows 5 mm."""
    wide = planned(job_of(tmp_path, moves(0, ", blend: 30 mm", both=True)))
    narrow = job_of(tmp_path, moves(0, ", blend: 5 mm", both=True))
    assert [check.name for check in verify(wide, narrow).failures] == ["events_at_targets"]


def test_joints_that_are_named_are_passed_exactly(tmp_path: Path) -> None:
    """A corner of joints is not cut."""
    rows = "".join(
        f"  - {{id: m{k}, arm: left, move: {{joints: {q}}}, blend: 50 mm}}\n"
        for k, q in enumerate(JOINTS)
    )
    schedule = planned(job_of(tmp_path, rows))
    columns = [
        schedule.trajectory.joints.index(name) for name in schedule.robot.arms["left"].joints
    ]
    times = np.array([event.time for event in schedule.events])
    position, velocity = (one[:, columns] for one in schedule.trajectory.at(times)[:2])
    assert np.abs(position - np.array(JOINTS)).max() < 1e-9
    assert np.abs(velocity).max(axis=1).min() > 0.0


def test_arms_of_any_kind_cut_corners(tmp_path: Path) -> None:
    """Without closed forms over an arm angle: verified, and quicker than with stops."""
    job = job_of(tmp_path, moves(1, ", blend: 30 mm", both=False))
    cutting = planned(job, redundancy="numeric")
    assert cutting.duration < planned(job, "none", redundancy="numeric").duration
    found = [corner for corner in corners(cutting, job) if not corner.line]
    assert max(corner.beside for corner in found) > 5e-3


def test_what_is_passed_without_leave_is_found(tmp_path: Path) -> None:
    """The same motion, judged by a file that does not allow it."""
    passing = planned(job_of(tmp_path, moves(0, ", blend: 20 mm", both=True)))
    strict = job_of(tmp_path, moves(0, "", both=True))
    assert [check.name for check in verify(passing, strict).failures] == [
        "events_at_targets",
        "stands_at_events",
    ]


def test_arms_with_a_dwell_at_a_move_and_with_a_partner_that_works_stop_or_slow_down(
    tmp_path: Path,
) -> None:
    """A dwell stops what the defaults would let pass; a partner's pick with lines makes the passing arm later."""
    down = "rpy: [180 deg, 0, 0]"
    picks = f"""\
  - id: tray
    arm: right
    pick: {{xyz: [0.5, -0.3, 0.8], {down}}}
    place: {{xyz: [0.4, -0.4, 0.8], {down}}}
  - {{id: over, arm: left, move: {{xyz: [0.5, 0.3, 0.9], {down}}}}}
  - {{id: look, arm: left, move: {{xyz: [0.6, 0.2, 1.0], {down}}}, dwell: 0.1 s}}
"""
    head = "defaults: {approach: 60 mm, retract: 60 mm, dwell: 0.2 s, blend: 10 mm}\n"
    job = job_of(tmp_path, picks, head)
    assert [stop.blend for task in job.tasks for stop in task.stops] == [0.0, 0.0, 0.01, 0.0]
    schedule = planned(job)
    assert schedule.duration <= planned(job, "none").duration + 1e-9
    assert {c.task for c in corners(schedule, job) if not c.line} <= {"over"}


def test_a_move_that_is_passed_may_say_that_it_has_no_lines_and_no_dwell(tmp_path: Path) -> None:
    """Zeros are no lines and no dwell, as is leaving them out."""
    zeros = "approach: 0, retract: 0 mm, dwell: {gripper: 0, settle: 0 s}"
    task = f"  - {{id: one, arm: left, move: home, blend: 10 mm, {zeros}}}\n"
    assert job_of(tmp_path, task).tasks[0].stops[0].blend == 0.01


@pytest.mark.parametrize(
    ("task", "message"),
    [
        ("move: home, blend: 0", "length must be positive"),
        ("move: home, blend: 10 mm, dwell: 0.1 s", "'blend' does not go with 'dwell'"),
        ("move: home, blend: 10 mm, approach: 5 mm", "'blend' does not go with 'approach'"),
        (
            "move: {xyz: [0.5, 0.3, 0.8], retract: 5 mm}, blend: 10 mm",
            "'blend' does not go with 'retract'",
        ),
        ("pick: {xyz: [0.5, 0.3, 0.8]}, blend: 10 mm", "'blend' goes with a move, or into a path"),
    ],
)
def test_errors_are_told_at_their_place(tmp_path: Path, task: str, message: str) -> None:
    """At the key in the file."""
    with pytest.raises(InputError) as error:
        job_of(tmp_path, f"  - {{id: one, arm: left, {task}}}\n")
    [found] = error.value.diagnostics
    assert message in found.message and found.line == 5
