"""Grasps that the planner chooses: never slower than one grasp throughout, and the best of all choices on the nodes."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.exporting.schedule_json import event_row
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.job import Job
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.grasps import possible_grasps
from dualarm_cli.planning.job_faults import job_faults
from dualarm_cli.planning.planned_job import resolve
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.postures.holding import Holding
from dualarm_cli.stages.search.alternatives import RankedChoice, ranked_choices
from dualarm_cli.stages.sequence_problem import sequence_problem
from dualarm_cli.verification import verify

CELL = """\
dualarm: cell/1
robot: iiwa14
tools:
  left:
    tcp: {xyz: [0, 0, 150 mm]}
    opening: [10 mm, 50 mm]
    shapes: [{cylinder: {radius: 20 mm, length: 100 mm}, xyz: [0, 0, 50 mm]}]
obstacles: {table: {box: [1, 2, 0.1], xyz: [0.6, 0, -0.05]}}
parts:
  peg:
    width: 30 mm
    shapes: [{box: [30 mm, 30 mm, 80 mm], xyz: [0, 0, 40 mm]}]
    grasps:
      top:    {xyz: [0, 0, 80 mm], rpy: [180 deg, 0, 0]}
      turned: {xyz: [0, 0, 80 mm], rpy: [180 deg, 0, 120 deg]}
      under:  {rpy: [0, 0, 0]}
clearance: 5 mm
"""
TASKS = """\
dualarm: tasks/1
cell: cell.yaml
return: true
defaults: {part: peg, approach: 50 mm, retract: 50 mm, dwell: 0.1 s}
tasks:
  - {id: a, arm: left, pick: {xyz: [0.5, 0.2, 0]}, place: {xyz: [0.5, -0.2, 0], rpy: [0, 0, 100 deg]}}
  - id: b
    arm: left
    pick: {xyz: [0.6, 0.1, 0], rpy: [0, 0, -150 deg]}
    place: {xyz: [0.6, -0.1, 0], rpy: [0, 0, -60 deg]}
"""
SETTINGS = PlanSettings(effort="quick")


@pytest.fixture(scope="module")
def pegs(shared_folder: Path) -> Job:
    """Two pegs, each gripped in two ways; a third grasp would be in the table."""
    folder = shared_folder / "grasps"
    folder.mkdir(exist_ok=True)
    (folder / "dualarm.toml").write_text("")
    (folder / "cell.yaml").write_text(CELL)
    (folder / "tasks.yaml").write_text(TASKS)
    return load_job(folder / "tasks.yaml")


@pytest.fixture(scope="module")
def planned(pegs: Job) -> Schedule:
    """The plan of both pegs."""
    return plan_without_bound(pegs, SETTINGS)


def choices(job: Job) -> Iterator[dict[str, str]]:
    """All choices of possible grasps."""
    rows = [[(t.id, g.grasp.name) for g in t.grasps if g.grasp] for t in job.tasks]
    yield from (dict(choice) for choice in itertools.product(*rows))


def problem_of(job: Job):
    """The sequence of a job with decided grasps, with its clearance."""
    work = resolve(job, SETTINGS)
    return sequence_problem(work.model, work.job, Holding.of(work.job))


def test_impossible_grasps_are_left_out(pegs: Job) -> None:
    """From below the tool would be in the table: a fault only where no other grasp is allowed."""
    job, faults = possible_grasps(pegs, job_faults)
    assert not faults
    assert [[g.grasp.name for g in t.grasps if g.grasp] for t in job.tasks] == [
        ["top", "turned"]
    ] * 2
    only = dataclasses.replace(pegs, tasks=tuple(t.by_grasp(t.grasps[2]) for t in pegs.tasks))
    assert {fault.task for fault in job_faults(only)} == {"a", "b"}
    with pytest.raises(InfeasibleError):
        plan_without_bound(only, SETTINGS)


def test_faults_that_hide_others_are_all_found(pegs: Job) -> None:
    """As of a search that ends at the first of them."""
    job, faults = possible_grasps(pegs, lambda decided: job_faults(decided)[:1])
    assert not faults
    assert [len(task.grasps) for task in job.tasks] == [2, 2]


def test_a_single_possible_grasp_is_taken(pegs: Job) -> None:
    """One of two grasps of every task is in the table: the plan is that of the other one."""
    tasks = [dataclasses.replace(t, grasps=(t.grasps[2], t.grasps[0])) for t in pegs.tasks]
    job = dataclasses.replace(pegs, tasks=tuple(tasks))
    top = {"a": "top", "b": "top"}
    alone = plan_without_bound(pegs.with_grasps(top), SETTINGS)
    schedule = plan_without_bound(job, SETTINGS)
    assert schedule.duration == pytest.approx(alone.duration, abs=1e-9)
    assert {event.grasp for event in schedule.events} == {"top"}


def test_a_tool_tilts_past_a_beam(tmp_path: Path) -> None:
    """Straight down the last link would touch it."""
    (tmp_path / "dualarm.toml").write_text("")
    beam = "obstacles: {beam: {box: [0.3, 0.02, 0.02], xyz: [0.5, 0.25, 0.26]}, "
    head, _, rest = CELL.replace("obstacles: {", beam).partition("      turned:")
    tasks = "".join(TASKS.partition("  - id: b")[0]).replace(", rpy: [0, 0, 100 deg]", "")
    (tmp_path / "tasks.yaml").write_text(tasks)
    cell = head + "clearance:" + rest.partition("clearance:")[2]
    (tmp_path / "cell.yaml").write_text(cell)
    with pytest.raises(InfeasibleError, match="link_7 and beam"):
        plan_without_bound(load_job(tmp_path / "tasks.yaml"), SETTINGS)
    tilted = cell.replace("[180 deg, 0, 0]", "[180 deg, 0, 0], free: {tilt: 15 deg}")
    (tmp_path / "cell.yaml").write_text(tilted)
    job = load_job(tmp_path / "tasks.yaml")
    schedule = plan_without_bound(job, SETTINGS)
    [pick, place] = schedule.events
    assert pick.grasp == place.grasp == "top/tilt +x"
    assert pick.pose.rotation[2, 2] == pytest.approx(-np.cos(np.deg2rad(15.0)), abs=1e-6)
    assert verify(schedule, job, clearance=True).passed


def test_the_ranking_has_the_best_of_all_choices_on_the_nodes(pegs: Job) -> None:
    """Against enumeration: each choice alone, searched as a sequence without alternatives."""
    job, _ = possible_grasps(pegs, job_faults)
    problems = [problem_of(job.with_grasps({"a": n, "b": n})) for n in ("top", "turned")]
    offered, linked = np.ones((2, 1, 4), dtype=np.bool_), np.array([[False, True, False, True]])
    ranked = ranked_choices(problems, offered, linked, "quick")
    totals = {}
    for choice in choices(job):
        nothing = np.ones((1, 1, 4), dtype=np.bool_), np.zeros((1, 4), dtype=np.bool_)
        [alone] = ranked_choices([problem_of(job.with_grasps(choice))], *nothing, "quick")
        a, b = (("top", "turned").index(choice[name]) for name in "ab")
        totals[a, a, b, b] = alone.total
    found = {tuple(r.chosen[0].tolist()): r.total for r in ranked if isinstance(r, RankedChoice)}
    assert set(found) <= set(totals)  # pick and place by one grasp
    assert ranked[0].total == pytest.approx(min(totals.values()), abs=2e-3)
    for chosen, total in found.items():
        assert total >= totals[chosen] - 2e-3


def test_a_plan_is_as_short_as_with_any_choice_and_names_its_grasps(
    pegs: Job, planned: Schedule
) -> None:
    """All four choices are planned; the verifier measures the grasps from the motion."""
    job, _ = possible_grasps(pegs, job_faults)
    durations = [
        plan_without_bound(job.with_grasps(choice), SETTINGS).duration for choice in choices(job)
    ]
    assert planned.duration <= min(durations) + 1e-9
    verification = verify(planned, pegs, clearance=True)
    assert verification.passed
    assert [c.verdict for c in verification.checks if c.name == "grasps"] == ["passed"]
    assert all(event_row(event)["grasp"] == event.grasp for event in planned.events)
    assert {event_row(event)["width"] for event in planned.events} == {0.03}
    # The tool is where the part's pose and the grasp have it.
    poses = {"a": pin.SE3(np.eye(3), np.array([0.5, 0.2, 0.0]))}
    [pick] = [e for e in planned.events if (e.task, e.action) == ("a", "pick")]
    grasp = pegs.cell.grasps["peg"][pick.grasp]
    assert pick.pose.isApprox(poses["a"] * grasp.pose, 1e-6)


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        (lambda e: dataclasses.replace(e, grasp=""), "none stated"),
        (lambda e: dataclasses.replace(e, grasp="under"), "under stated"),
        (lambda e: dataclasses.replace(e, width=0.04), "40 mm wide instead of 30 mm"),
        (
            lambda e: (
                e
                if e.action == "pick"
                else dataclasses.replace(
                    e, pose=e.pose * pin.SE3(pin.utils.rotate("z", 0.3), np.zeros(3))
                )
            ),
            "no allowed grasp measured",
        ),
    ],
)
def test_stated_grasps_are_those_of_the_motion(
    pegs: Job, planned: Schedule, change, fault: str
) -> None:
    """A wrong name, and a tool that is turned against the part."""
    wrong = dataclasses.replace(planned, events=tuple(map(change, planned.events)))
    [check] = [c for c in verify(wrong, pegs).checks if c.name == "grasps"]
    assert check.verdict == "failed" and fault in check.detail


def test_a_place_by_another_grasp_than_the_pick_fails(pegs: Job, planned: Schedule) -> None:
    """Both poses are allowed by some grasp, but the part would have turned in the gripper."""
    task = pegs.tasks[0]
    [pick] = [e for e in planned.events if (e.task, e.action) == ("a", "pick")]
    [other] = [t for t in task.grasps if t.grasp and t.grasp.name not in (pick.grasp, "under")]
    assert other.grasp is not None
    pose = other.stops[1].target.pose  # type: ignore[union-attr]
    wrong = tuple(
        dataclasses.replace(e, pose=pose, grasp=other.grasp.name)
        if (e.task, e.action) == ("a", "place")
        else e
        for e in planned.events
    )
    [check] = [
        c
        for c in verify(dataclasses.replace(planned, events=wrong), pegs).checks
        if c.name == "grasps"
    ]
    assert check.verdict == "failed" and "not placed by the grasp of its pick" in check.detail
