"""How late an arm may be in a plan: against pinocchio and coal, asked for, and where nothing is said."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from xml.etree import ElementTree

import coal
import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.collision.solids import cell_solids
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.budget import Budget
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.model.shape import Shape
from dualarm_cli.model.verification import ArmDelay
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.report.report import skew_sentence
from dualarm_cli.verification import verify
from dualarm_cli.verification.budget_checks import judge_budget
from dualarm_cli.verification.delay_checks import _to_the_ends

CELL = """\
dualarm: cell/1
robot: sda10f
tools:
  left:  {tcp: {xyz: [0, 0, 120 mm]}, shapes: [{capsule: {radius: 30 mm, length: 80 mm}, xyz: [0, 0, 50 mm]}]}
  right: {tcp: {xyz: [0, 0, 120 mm]}, shapes: [{capsule: {radius: 30 mm, length: 80 mm}, xyz: [0, 0, 50 mm]}]}
"""
TASKS = """\
dualarm: tasks/1
cell: cell.yaml
mode: free
return: true
defaults: {approach: 80 mm, retract: 80 mm, dwell: 0.2}
tasks:
  - {id: l, arm: left, move: {xyz: [0.5, 0, 0.85], rpy: [180 deg, 0, 0], free: yaw}}
  - {id: r, arm: right, move: {xyz: [0.5, 0, 0.85], rpy: [180 deg, 0, 0], free: yaw}}
"""
QUICK = PlanSettings(effort="quick", blend="none").naming(platform="fixed")


@pytest.fixture(scope="module")
def job(tmp_path_factory):
    """Both arms at one place, one after the other."""
    folder = tmp_path_factory.mktemp("project")
    (folder / "dualarm.toml").touch()
    (folder / "cell.yaml").write_text(CELL)
    (folder / "tasks.yaml").write_text(TASKS)
    return load_job(folder / "tasks.yaml")


def judged(job, settings=QUICK):
    """Its plan with the verifier's judgement."""
    schedule = plan_without_bound(job, settings)
    return replace(schedule, verification=verify(schedule, job, clearance=True))


@pytest.fixture(scope="module")
def schedule(job):
    """The plan without a skew."""
    return judged(job)


def least(schedule, job, late, delay, times):
    """Least distance of one arm's solids from the other's with one of them late [m]; by pinocchio and coal alone."""
    model = pin.buildModelFromXML(job.cell.robot.urdf)
    data, motion = model.createData(), schedule.trajectory
    solids = cell_solids(job.cell, model, [])
    sides = [[s for s in solids if s.body.startswith(side)] for side in ("left", "right")]
    columns = [motion.joints.index(name) for name in late.joints]
    q = motion.clamped(times)[0]
    q[:, columns] = motion.clamped(times - delay)[0][:, columns]
    order, found = [motion.joints.index(name) for name in model.names[1:]], np.inf
    for row in q[:, order]:
        pin.forwardKinematics(model, data, row)
        for one in sides[0]:
            for other in sides[1]:
                T, U = (data.oMi[s.joint] * s.pose for s in (one, other))
                if np.linalg.norm(T.translation - U.translation) > 0.6:
                    continue
                result = coal.DistanceResult()
                here = coal.distance(
                    one.geometry,
                    coal.Transform3s(T.rotation, T.translation),
                    other.geometry,
                    coal.Transform3s(U.rotation, U.translation),
                    coal.DistanceRequest(),
                    result,
                )
                found = min(found, here)
    return found


def test_only_spans_at_an_end_of_the_motion_go_on_beyond_it(schedule):
    last = schedule.trajectory.time[-1]
    spans = [(0.0, 0.1), (0.2, 0.3), (0.4, last)]
    assert _to_the_ends(schedule, spans) == [(-np.inf, 0.1), (0.2, 0.3), (0.4, np.inf)]


def test_arms_that_take_turns_are_clear_up_to_what_is_said_and_not_beyond(schedule, job):
    """The second arm comes as the first one leaves: one of them may be little late, and touches where it is said."""
    delays = schedule.verification.delays
    assert [one.arm for one in delays] == ["left", "right"]
    worst = min(delays, key=lambda one: one.clear)
    assert 0.0 < worst.clear < 0.2
    for one, arm in zip(delays, job.cell.robot.arms, strict=True):
        times = np.arange(0.0, schedule.duration + 0.5, 0.04)
        assert least(schedule, job, arm, 0.9 * one.clear, times) >= -1e-6
        if one.lacking is not None:
            assert one.lacking - one.clear < max(1e-3, 0.02 * one.lacking)
            assert least(schedule, job, arm, one.lacking, np.array([one.time])) < 0.0
    text = skew_sentence(schedule.verification, job)
    assert f"{worst.arm} arm clear up to {1e3 * worst.clear:.0f}"[:-1] in text
    assert all(body in text for body in worst.bodies)


def test_a_skew_that_is_asked_for_is_judged_and_planned(schedule, job):
    """The plan without it fails by time and pair; the plan with it passes, and is no more than that longer per turn."""
    clear = min(one.clear for one in schedule.verification.delays)
    asked = replace(job, skew=clear + 0.06)
    [check] = [c for c in verify(schedule, asked, clearance=True).failures]
    assert (check.name, check.unit, check.allowed) == ("skew", "s", asked.skew)
    assert check.measured < asked.skew
    assert " arm " in check.detail
    assert " s)" in check.detail
    keeps = judged(asked)
    assert keeps.verification.passed
    assert min(one.clear for one in keeps.verification.delays) >= asked.skew
    assert keeps.duration <= schedule.duration + asked.skew + 0.1


def test_a_budget_of_skew_is_kept_and_missed(schedule, job):
    """What is proven, and a millisecond more; without a proof it is missed."""
    clear = min(one.clear for one in schedule.verification.delays)
    for figure, found, kept in (
        (clear, schedule, True),
        (clear + 1e-3, schedule, False),
        (1e-3, replace(schedule, verification=None), False),
    ):
        [line] = judge_budget(found, replace(job, budget=Budget(skew=figure)))
        assert (line.name, line.kept) == ("skew", kept)
    assert str(line) == "skew not proven, at least 1 ms: MISSED (:0:0)"


def test_arms_without_shapes_have_no_figure(schedule, job):
    """A skew that is asked for is then not checked; of one arm's motion alone nothing is said."""
    tree = ElementTree.fromstring(job.cell.robot.urdf)
    for link in tree.iter("link"):
        for shape in link.findall("collision"):
            link.remove(shape)
    urdf = ElementTree.tostring(tree, encoding="unicode")
    cell = replace(job.cell, robot=replace(job.cell.robot, urdf=urdf, meshes={}))
    shapeless = replace(job, cell=cell, skew=0.02)
    found = verify(schedule, shapeless, clearance=True)
    assert found.delays == ()
    [check] = [c for c in found.checks if c.name == "skew"]
    assert check.verdict == "not checked"
    assert skew_sentence(found, shapeless) is None
    assert verify(schedule, job).delays == ()


def test_a_figure_that_was_not_proven_to_the_end_says_so():
    """In words, rounded to the safe side; a figure with a counterexample names it."""
    assert str(ArmDelay("left", 0.0123456, None, None, None)).endswith(
        "up to 12.3 ms late (more is not proven)"
    )
    assert str(ArmDelay("left", 0.5, None, None, None)) == "left arm clear up to 500 ms late"
    found = ArmDelay("right", 0.02899, 0.02901, ("a", "b"), 1.5)
    assert str(found) == "right arm clear up to 28.9 ms late (not 29.1 ms: a and b at 1.500 s)"


@pytest.mark.parametrize(("master", "named"), [("left", True), (None, False)])
def test_only_seams_of_both_arms_need_them_in_step(schedule, job, master, named):
    """On a part that stands in the cell one arm works alone."""
    seam = SimpleNamespace(master=master, touches=())
    tasks = (replace(job.tasks[0], seam=seam), *job.tasks[1:])
    text = skew_sentence(schedule.verification, replace(job, tasks=tasks))
    assert ("both arms work together in l" in text) == named


def test_parts_that_are_fed_are_named_as_not_counted(schedule, job):
    """A place that is picked from twice is fed; one that is picked from once is not."""
    [one, other] = job.tasks
    [stop] = one.stops
    pick = replace(stop, action="pick")
    shapes = {"box": (Shape("sphere", (0.02,), pin.SE3.Identity()),)}
    cell = replace(job.cell, parts=shapes)
    once, twice = (
        replace(job, cell=cell, tasks=tuple(replace(t, part="box", stops=(pick,)) for t in tasks))
        for tasks in ((one,), (one, other))
    )
    text = "; parts that are fed to their picks are not counted"
    assert text not in skew_sentence(schedule.verification, once)
    assert skew_sentence(schedule.verification, twice).endswith(text)
