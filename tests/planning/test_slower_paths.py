"""Paths that are too fast: less speed is tried, in few rounds, and a method's own self-motion is slowed as well."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinds.path import planning as path_jobs
from dualarm_cli.kinds.path.context import PathContext
from dualarm_cli.kinds.path.following import PATH_SOLVERS, NoPath, PathMotion, PathProblem
from dualarm_cli.kinds.path.following.velocity import follow_min_norm
from dualarm_cli.kinds.path.motion import FollowedPath, InstantBudget, Refused, follow_path
from dualarm_cli.kinds.path.starts import path_starts
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.refusals import Refusal
from dualarm_cli.registry import Registry, Solver
from dualarm_cli.verification import verify

CELL = """\
dualarm: cell/1
robot:
  left:  {robot: iiwa14, base: {xyz: [0, 0.35, 0.6], rpy: [-45 deg, 0, 0]}}
  right: {robot: iiwa14, base: {xyz: [0, -0.35, 0.6], rpy: [45 deg, 0, 0]}}
clearance: 5 mm
"""
TURN = """\
dualarm: tasks/1
cell: cell.yaml
start: free
tasks:
  - id: turn
    path:
      speed: %s
      slower: allowed
      left:
        through:
          - {xyz: [0.40, 0.10, 0.90], rpy: [90 deg, 0, 0]}
          - {turn: {about: [0.50, 0, 0.90], axis: [0, 1, 0], angle: %s deg}}
      right:
        through:
          - {xyz: [0.40, -0.10, 0.90], rpy: [-90 deg, 0, 0]}
          - {turn: {about: [0.50, 0, 0.90], axis: [0, 1, 0], angle: %s deg}}
"""


def turn(folder: Path, speed: str, degrees: int) -> Job:
    """Both arms turn a part about a horizontal axis."""
    (folder / "cell.yaml").write_text(CELL)
    (folder / "tasks.yaml").write_text(TURN % (speed, degrees, degrees))
    return load_job(folder / "tasks.yaml")


class Follower:
    """Follows by least norm what takes long enough, and says of all else only that it is too fast."""

    def __init__(self, least: float) -> None:
        """Takes the least time that a path must take [s]."""
        self.least, self.asked = least, list[float]()

    def __call__(self, problem: PathProblem) -> PathMotion | NoPath:
        """Follows, or does not."""
        duration = (problem.instants - 1) * problem.step
        self.asked.append(duration)
        if duration < self.least:
            return NoPath(Refusal("joints_stop", data={"also": []}), problem.instants // 2, np.inf)
        return follow_min_norm(problem)


@pytest.mark.parametrize("speed", ["60 mm/s", pytest.param("30 mm/s", marks=pytest.mark.slow)])
def test_a_part_is_turned_the_other_way_round_too(tmp_path: Path, speed: str) -> None:
    """By -180 deg: 314.2 mm at full speed and a ramp of 0.3 s, in no more than 8 rounds.

    From one start joints run into their limits at any speed; from the other self-motion is as quick as accelerations
    allow, and the curve through the instants overshoots.
    """
    rounds = []
    solver = PATH_SOLVERS["manipulability"]
    counted = Solver(
        name=solver.name,
        solve=lambda problem: rounds.append(1) or solver.solve(problem),
        summary="",
        reference="",
    )
    job = turn(tmp_path, speed, -180)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(path_jobs, "PATH_SOLVERS", Registry("path", "redundancy", [counted]))
        schedule = plan_without_bound(job, PlanSettings(follower="manipulability"))
    assert verify(schedule, job, clearance=True).passed
    metres = float(speed.split()[0]) / 1000.0
    assert schedule.duration == pytest.approx(np.pi * 0.1 / metres + 0.3, rel=1e-6)
    assert len(rounds) <= 8


def test_unknown_excess_is_bracketed_and_bisected(tmp_path: Path) -> None:
    """A path of 0.8 s that is followed from 2.2 s on: at most 1.2 times as slow as it must be, in ten rounds."""
    job = turn(tmp_path, "150 mm/s", 45)
    context = PathContext.of(CellModel.from_cell(job.cell), job)
    work = job.tasks[0].path
    assert work is not None
    home = np.array(job.cell.robot.postures["home"])
    [start, *_] = path_starts(context, work, home, 0, None).configurations
    follower = Follower(2.2)
    solver = Solver(name="picky", solve=follower, summary="", reference="")
    found = follow_path(context, work, solver, start, InstantBudget())
    assert isinstance(found, FollowedPath)
    assert 2.2 <= found.trajectory.duration < 1.2 * 2.2
    assert len(follower.asked) <= 10
    # Without, the first refusal stands.
    follower.asked.clear()
    refused = follow_path(context, work, solver, start, InstantBudget(), halve=False)
    assert isinstance(refused, Refused)
    assert len(follower.asked) == 1


def test_a_refusal_has_tried_slower_from_few_starts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A method that never follows is asked at a sixteenth of the speed before the path is refused, 32 times at most."""
    follower = Follower(np.inf)
    solver = Solver(name="manipulability", solve=follower, summary="", reference="")
    monkeypatch.setattr(path_jobs, "PATH_SOLVERS", Registry("path", "redundancy", [solver]))
    job = turn(tmp_path, "300 mm/s", 90)
    with pytest.raises(InfeasibleError) as error:
        plan_without_bound(job, PlanSettings(follower="manipulability"))
    assert max(follower.asked) > 10.0 * min(follower.asked)
    assert len(follower.asked) <= 32
    # It was allowed to be slower, and that did not help.
    assert "lower its speed" not in str(error.value)
