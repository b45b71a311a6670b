"""Grasps of both tools in a hand-over: pairs are read, chosen together, and measured."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.job import Job
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.grasps import possible_grasps
from dualarm_cli.planning.job_faults import job_faults
from dualarm_cli.planning.planned_job import resolve
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.postures.holding import Holding
from dualarm_cli.stages.search.alternatives import ranked_choices
from dualarm_cli.stages.sequence_problem import sequence_problem
from dualarm_cli.verification import verify

CELL = """\
dualarm: cell/1
robot: sda10f
tools:
  left:  {tcp: {xyz: [0, 0, 120 mm]}, shapes: [{capsule: {radius: 30 mm, length: 80 mm}, xyz: [0, 0, 50 mm]}]}
  right: {tcp: {xyz: [0, 0, 120 mm]}, shapes: [{capsule: {radius: 30 mm, length: 80 mm}, xyz: [0, 0, 50 mm]}]}
parts:
  bar:
    shapes: [{box: [40 mm, 60 mm, 100 mm], xyz: [0, 0, -52 mm]}]
    grasps:
      top:    {rpy: [180 deg, 0, 0]}
      near:   {xyz: [0, 0, -5 mm]}
      below:  {xyz: [0, 0, -104 mm]}
      askew:  {xyz: [0, 0, -104 mm], rpy: [0, 0, 60 deg]}
clearance: 10 mm
"""
TASKS = """\
dualarm: tasks/1
cell: cell.yaml
start: home
return: true
defaults: {part: bar, approach: 80 mm, retract: 80 mm, dwell: 0.1 s}
tasks:
  - id: flip
    arm: left
    grasp: top
    pick: {xyz: [0.5, 0.45, 0.84]}
    handover: {xyz: [0.55, 0, 1.05], rpy: [-90 deg, 0, 0], grasp: [near, below, askew]}
    place: {xyz: [0.5, -0.45, 0.736], rpy: [180 deg, 0, 0]}
"""
SETTINGS = PlanSettings(effort="quick", platform="fixed", blend="none")


def job_of(folder: Path, tasks: str = TASKS) -> Job:
    """The job of a folder with these tasks."""
    (folder / "dualarm.toml").write_text("")
    (folder / "cell.yaml").write_text(CELL)
    (folder / "tasks.yaml").write_text(tasks)
    return load_job(folder / "tasks.yaml")


def test_pairs_are_of_different_grasps_and_the_same_for_both_tools(tmp_path: Path) -> None:
    """All pairs of four grasps but those of one grasp: 4 * 4 - 4; the grip follows from the two."""
    tasks = TASKS.replace("    grasp: top\n", "").replace(", grasp: [near, below, askew]", "")
    job = job_of(tmp_path, tasks)
    giver, taker = (task.grasps for task in job.tasks)
    names = [pair.grasp.choice for pair in giver]
    assert names == [pair.grasp.choice for pair in taker]
    assert len(set(names)) == 12
    grasps = job.cell.grasps["bar"]
    for give, take in zip(giver, taker, strict=True):
        assert f"{give.grasp.name}, {take.grasp.name}" == give.grasp.choice
        part = give.stops[1].target.pose * grasps[give.grasp.name].pose.inverse()
        wanted = part * grasps[take.grasp.name].pose
        assert take.stops[0].target.pose.isApprox(wanted, 1e-9)
        assert (give.stops[1].target.pose * give.handover.grip).isApprox(wanted, 1e-9)
        assert take.part == f"bar@{take.grasp.name}"


@pytest.mark.parametrize("arm", ["left", "any"])
def test_pairs_with_colliding_tools_are_left_out(tmp_path: Path, arm: str) -> None:
    """Tool centre points 5 mm apart: the capsules end 10 mm and more before them, 10 mm are required."""
    job = job_of(tmp_path, TASKS.replace("arm: left", f"arm: {arm}"))
    possible, faults = possible_grasps(job, job_faults)
    assert not faults
    names = [[pair.grasp.choice for pair in task.grasps] for task in possible.tasks]
    assert names == [["top, below", "top, askew"]] * 2


def test_both_shares_are_ranked_with_one_pair(tmp_path: Path) -> None:
    """Giver and taker meet with the same pair, and keep it from the pick to the place."""
    job, _ = possible_grasps(job_of(tmp_path), job_faults)
    works = [
        resolve(job.with_grasps({"flip": pair}), SETTINGS) for pair in ("top, below", "top, askew")
    ]
    problems = [sequence_problem(w.model, w.job, Holding.of(w.job)) for w in works]
    offered = np.array([[[True, True, False], [False, True, True]]] * 2)
    linked = np.array([[False, True, False], [False, False, True]])
    ranked = ranked_choices(problems, offered, linked, "quick")
    chosen = {tuple(r.chosen[[0, 0, 1, 1], [0, 1, 1, 2]].tolist()) for r in ranked}
    assert chosen == {(0, 0, 0, 0), (1, 1, 1, 1)}


def test_a_pair_is_chosen_and_measured(tmp_path: Path) -> None:
    """Tools too near are left out; of the other pairs the plan takes one, and the verifier finds it."""
    job = job_of(tmp_path)
    schedule = plan_without_bound(job, SETTINGS)
    alone = plan_without_bound(job.with_grasps({"flip": "top, below"}), SETTINGS)
    assert schedule.duration <= alone.duration + 1e-9
    taken = {(e.arm, e.action): e.grasp for e in schedule.events}
    assert taken["left", "pick"] == taken["left", "give"] == "top"
    assert taken["right", "take"] == taken["right", "place"] in ("below", "askew")
    verification = verify(schedule, job, clearance=True)
    assert verification.passed
    [grip] = [c for c in verification.checks if c.name == "handover_grip"]
    assert grip.verdict == "passed"
    other = {"below": "askew", "askew": "below"}[taken["right", "take"]]
    wrong = tuple(
        dataclasses.replace(e, grasp=other) if e.arm == "right" else e for e in schedule.events
    )
    checks = verify(dataclasses.replace(schedule, events=wrong), job).checks
    [check] = [c for c in checks if c.name == "grasps"]
    assert check.verdict == "failed"
    assert f"{other} stated, {taken['right', 'take']} measured" in check.detail
