"""Targets of moves that tools pass in motion: never slower, verified, and only where the file allows it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dualarm_cli.errors import InputError
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.job import Job
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.report.corners import corners
from dualarm_cli.verification import verify

CELL = """\
dualarm: cell/1
robot: sda10f
tools:
  left: {tcp: {xyz: [0, 0, 120 mm]}}
  right: {tcp: {xyz: [0, 0, 120 mm]}}
"""


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


def planned(job: Job, blend: str = "lines") -> Schedule:
    """A plan that the verifier passes, clearance included."""
    schedule = plan_without_bound(job, PlanSettings(effort="quick", blend=blend))
    verdict = verify(schedule, job, clearance=True)
    assert verdict.passed, verdict.failures
    return schedule


@pytest.mark.parametrize("head", ["", "limits: {tool_speed: 800 mm/s}\n", "mode: free\n"])
@pytest.mark.parametrize("both", [False, True])
def test_moves_that_are_passed_are_never_slower(tmp_path: Path, both: bool, head: str) -> None:
    """Against the same file with all stops; without a cap on the tools' speed it is quicker."""
    for seed in range(1 if head else 2):
        job = job_of(tmp_path, moves(seed, ", blend: 20 mm", both), head)
        passing, stopping = planned(job), planned(job, "none")
        assert passing.duration <= stopping.duration + 1e-9
        if not head:
            assert passing.duration < 0.995 * stopping.duration
            found = [corner for corner in corners(passing, job) if not corner.line]
            assert found and all(corner.speed > 0.0 for corner in found)


def test_what_is_passed_without_leave_is_found(tmp_path: Path) -> None:
    """The same motion, judged by a file that does not allow it."""
    passing = planned(job_of(tmp_path, moves(0, ", blend: 20 mm", both=True)))
    strict = job_of(tmp_path, moves(0, "", both=True))
    assert [check.name for check in verify(passing, strict).failures] == ["stands_at_events"]


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


@pytest.mark.parametrize(
    ("task", "message"),
    [
        ("move: home, blend: 0", "length must be positive"),
        ("move: home, blend: 10 mm, dwell: 0.1 s", "'blend' does not go with 'dwell'"),
        ("move: home, blend: 10 mm, approach: 5 mm", "'blend' does not go with 'approach'"),
        ("pick: {xyz: [0.5, 0.3, 0.8]}, blend: 10 mm", "'blend' goes with a move, or into a path"),
    ],
)
def test_errors_are_told_at_their_place(tmp_path: Path, task: str, message: str) -> None:
    """At the key in the file."""
    with pytest.raises(InputError) as error:
        job_of(tmp_path, f"  - {{id: one, arm: left, {task}}}\n")
    [found] = error.value.diagnostics
    assert message in found.message and found.line == 5
