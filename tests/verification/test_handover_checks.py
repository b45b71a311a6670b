"""Hand-overs judged: a good plan passes, and each thing that can be wrong with one is found and named."""

from __future__ import annotations

import dataclasses
from itertools import permutations
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.collision.quick_test import QuickTest
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinds.handover.checks import _judge_still, handover_spans, handover_touches
from dualarm_cli.model.motion.joint_motion import JointMotion
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.verification import verify
from dualarm_cli.verification.clearance_checks import touching_spans
from dualarm_cli.verification.measuring.tool_model import ToolModel
from dualarm_cli.verification.tool_checks import Worst

NAMES = ("handover_order", "handover_grip", "handover_still")


@pytest.fixture(scope="module")
def flip(tasks_folder):
    """The first hand-over of the example."""
    job = load_job(tasks_folder / "13_hand_over" / "tasks.yaml")
    return dataclasses.replace(job, tasks=job.tasks[:2])


@pytest.fixture(scope="module")
def schedule(flip):
    """A plan of it."""
    return plan_without_bound(flip, PlanSettings(platform="exact"))


def failed(schedule, job, *, clearance=False):
    """The failed checks of hand-overs and collisions, by name."""
    found = verify(schedule, job, clearance=clearance)
    return {c.name: c for c in found.failures if c.name in (*NAMES, "collisions")}


def with_event(schedule, action, **changes):
    """The schedule with one event changed."""
    events = [
        dataclasses.replace(e, **changes) if e.action == action else e for e in schedule.events
    ]
    return dataclasses.replace(schedule, events=tuple(events))


def event(schedule, action):
    """The one event of an action."""
    [found] = [e for e in schedule.events if e.action == action]
    return found


def without_line(schedule, kind, action):
    """The schedule in which a line is not listed."""
    kept = [s for s in schedule.segments if (s.kind, s.action) != (kind, action)]
    return dataclasses.replace(schedule, segments=tuple(kept))


def test_a_plan_passes(flip, schedule):
    """All three checks, and the proof of clearance."""
    found = verify(schedule, flip, clearance=True)
    assert [check.name for check in found.failures] == []
    assert {c.name for c in found.checks if c.verdict == "passed"} >= set(NAMES)


def test_without_handovers_nothing_is_checked(tasks_folder, schedule):
    """They say so."""
    job = load_job(tasks_folder / "13_hand_over" / "tasks.yaml")
    alone = dataclasses.replace(job, tasks=())
    for one in (None, alone):
        checks = {c.name: c.verdict for c in verify(schedule, one).checks}
        assert {checks[name] for name in NAMES} == {"not checked"}


@pytest.mark.parametrize("action", ["give", "take", "pick", "place"])
def test_what_is_not_done_is_named(flip, schedule, action):
    """Without one of the four events there is no hand-over."""
    events = tuple(e for e in schedule.events if e.action != action)
    check = failed(dataclasses.replace(schedule, events=events), flip)["handover_order"]
    who = "left" if action in ("pick", "give") else "right"
    assert check.detail == f"flip-1: {action} by the {who} arm is not done"


def test_the_giver_must_not_let_go_before_the_taker_has_gripped(flip, schedule):
    """20 ms early: the check says by how much and when."""
    time = event(schedule, "give").time
    check = failed(with_event(schedule, "give", time=time - 0.02), flip)["handover_order"]
    assert check.measured == pytest.approx(0.02)
    assert f"the left arm lets go at {time - 0.02:.4f} s" in check.detail


def test_another_grip_than_the_file_has_is_found(flip, schedule):
    """The file now wants the taking tool 2 mm farther out: the schedule misses it by that."""
    giving, taking = flip.tasks
    moved = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.002])) * giving.handover.grip
    work = dataclasses.replace(giving.handover, grip=moved)
    tasks = tuple(dataclasses.replace(t, handover=work) for t in (giving, taking))
    check = failed(schedule, dataclasses.replace(flip, tasks=tasks))["handover_grip"]
    assert check.measured == pytest.approx(0.002, abs=1e-5)
    turned = giving.handover.grip * pin.SE3(pin.utils.rotate("z", 0.01), np.zeros(3))
    work = dataclasses.replace(giving.handover, grip=turned)
    tasks = tuple(dataclasses.replace(t, handover=work) for t in (giving, taking))
    check = failed(schedule, dataclasses.replace(flip, tasks=tasks))["handover_grip"]
    assert check.measured == pytest.approx(0.01, abs=1e-5)


def test_the_giver_must_stand_until_it_has_let_go(flip, schedule):
    """Its event 50 ms later, its dwell reaches into its retract: it moves while it should stand."""
    time = event(schedule, "give").time
    check = failed(with_event(schedule, "give", time=time + 0.05), flip)["handover_still"]
    assert "the giving tool moves, left arm" in check.detail


def nodding(schedule, arm, start, end):
    """The schedule in which an arm's last joint turns by a milliradian and back between two instants, knots 1 ms apart.

    By r (1 - cos 2 pi x) / 2: the jerk at the ends is nothing that these checks look at.
    """
    knots = schedule.trajectory.time
    time = np.unique(np.concatenate([knots, np.linspace(start, end, round((end - start) / 1e-3))]))
    q, v, a = (rates.copy() for rates in schedule.trajectory.at(time))
    column = schedule.trajectory.joints.index(schedule.robot.arms[arm].joints[-1])
    inside = (time > start) & (time < end)
    rate = 2.0 * np.pi / (end - start)
    x = rate * (time[inside] - start)
    q[inside, column] += 5e-4 * (1.0 - np.cos(x))
    v[inside, column] += 5e-4 * rate * np.sin(x)
    a[inside, column] += 5e-4 * rate**2 * np.cos(x)
    trajectory = Trajectory(schedule.trajectory.joints, time, q, v, a)
    return dataclasses.replace(schedule, motion=JointMotion.of(trajectory))


def line(schedule, kind, action):
    """Start and end of the one line of a kind at the event of an action [s]."""
    [found] = [s for s in schedule.segments if (s.kind, s.action) == (kind, action)]
    return found.start, found.end


def test_the_giver_must_stand_while_the_taker_comes(flip, schedule):
    """It nods during the taker's approach, whatever the approach is called in the list."""
    nods = nodding(schedule, "left", *line(schedule, "approach", "take"))
    for one in (nods, without_line(nods, "approach", "take")):
        check = failed(one, flip)["handover_still"]
        assert "the giving tool moves, left arm" in check.detail
        assert check.measured == pytest.approx(1e-3, abs=1e-5)


def test_the_taker_must_stand_until_the_giver_is_away(flip, schedule):
    """It nods during the giver's retract."""
    nods = nodding(schedule, "right", *line(schedule, "retract", "give"))
    for one in (nods, without_line(nods, "retract", "give")):
        check = failed(one, flip)["handover_still"]
        assert "the taking tool moves, right arm" in check.detail
        assert check.measured == pytest.approx(1e-3, abs=1e-5)


def test_an_order_that_cannot_be_is_found(flip, schedule):
    """A pick after the hand-over, and a place before it."""
    give, take = event(schedule, "give"), event(schedule, "take")
    late = failed(with_event(schedule, "pick", time=give.time), flip)["handover_order"]
    assert "picked at" in late.detail
    early = failed(with_event(schedule, "place", time=take.time), flip)["handover_order"]
    assert "placed at" in early.detail


def with_line(job, kind, action, length):
    """The job with another length of one line [m]."""

    def changed(stop):
        return dataclasses.replace(stop, **{kind: length}) if stop.action == action else stop

    tasks = [dataclasses.replace(t, stops=tuple(map(changed, t.stops))) for t in job.tasks]
    return dataclasses.replace(job, tasks=tuple(tasks))


@pytest.mark.parametrize(("kind", "action"), [("approach", "take"), ("retract", "give")])
def test_tools_may_touch_the_part_only_within_the_handover(flip, schedule, kind, action):
    """On the line that the job has there; without it a tool at the part is a collision, with the pair named."""
    assert "collisions" not in failed(schedule, flip, clearance=True)
    # What the list calls the line makes no difference.
    assert "collisions" not in failed(without_line(schedule, kind, action), flip, clearance=True)
    check = failed(schedule, with_line(flip, kind, action, 0.0), clearance=True)["collisions"]
    other = (
        "left bracket and right_tool"
        if kind == "approach"
        else "left_tool and right bracket@flip-1"
    )
    assert all(name in check.detail for name in other.split(" and "))


def test_what_is_not_a_tool_must_keep_clear_of_the_part(flip, schedule):
    """A part that is longer than the space between the tools reaches into the other arm's wrist."""
    [box] = flip.cell.parts["bracket"]
    parts = dict(flip.cell.parts)
    parts["bracket"] = (dataclasses.replace(box, size=(0.04, 0.06, 0.5)),)
    job = dataclasses.replace(flip, cell=dataclasses.replace(flip.cell, parts=parts, obstacles=()))
    found = verify(schedule, job, clearance=True)
    pairs = {stage.bodies for stage in found.clearances if stage.stage == 1 and stage.margin < 0.0}
    assert any("left bracket" in bodies for bodies in pairs)
    assert all("right_tool" not in bodies for bodies in pairs)


def with_hands(job, beyond="left_tool0", other="right_tool0"):
    """The job's robot with the tools' capsules as links of its URDF, each fixed to a link, and tools without shapes."""
    shape = (
        '<link name="{0}_palm"><collision><origin xyz="0 0 0.05"/><geometry><cylinder radius="0.03" length="0.14"/>'
        '</geometry></collision></link><joint name="{0}_palm_joint" type="fixed"><parent link="{1}"/>'
        '<child link="{0}_palm"/></joint>'
    )
    more = shape.format("left", beyond) + shape.format("right", other)
    robot = dataclasses.replace(
        job.cell.robot, urdf=job.cell.robot.urdf.replace("</robot>", f"{more}</robot>")
    )
    tools = {arm: dataclasses.replace(tool, shapes=()) for arm, tool in job.cell.tools.items()}
    cell = dataclasses.replace(job.cell, robot=robot, tools=tools)
    return dataclasses.replace(job, cell=cell)


def test_the_hand_of_a_robot_is_a_tool(flip, schedule):
    """Links beyond the flange may touch what changes hands as a tool's shapes may, and are planned so."""
    hands = with_hands(flip)
    assert hands.cell.robot.hands["left"][-1] == "left_palm"
    assert failed(schedule, hands, clearance=True) == {}
    cross = QuickTest(hands.cell, hands.carried())
    parts = {"left": "bracket", "right": ""}
    near = [cross.labels(pair) for pair in cross.cross(parts).pairs]
    handed = [cross.labels(pair) for pair in cross.cross(parts, frozenset({"left"})).pairs]
    left_out = {frozenset(pair) for pair in near} - {frozenset(pair) for pair in handed}
    assert frozenset(("right_palm", "left bracket")) in left_out
    assert all("palm" in name or "bracket" in name for pair in left_out for name in pair)


def test_a_body_before_the_last_joint_is_no_tool(flip, schedule):
    """The same body on the link before: the part of the other arm must keep clear of it, as of a forearm."""
    elsewhere = with_hands(flip, "left_link_b", "right_link_b")
    assert elsewhere.cell.robot.hands == flip.cell.robot.hands
    test = QuickTest(elsewhere.cell, elsewhere.carried())
    pairs = test.cross({"left": "bracket", "right": ""}, frozenset({"left"})).pairs
    assert ("right_palm", "left bracket") in {test.labels(pair) for pair in pairs}


def test_somebody_holds_the_part_while_it_changes_hands(flip, schedule):
    """An obstacle round the meeting place: the part lies in no hand's way to touch it, before or after the grip."""
    from dualarm_cli.model.cell import Obstacle
    from dualarm_cli.model.shape import Shape

    give = event(schedule, "give")
    middle = give.pose.act(np.array([0.0, 0.0, 0.052]))
    ball = Obstacle("ball", Shape("sphere", (0.005,), pin.SE3(np.eye(3), middle)))
    cell = dataclasses.replace(flip.cell, obstacles=(ball,))
    found = verify(schedule, dataclasses.replace(flip, cell=cell), clearance=True)
    touched = {body for s in found.clearances for body in s.bodies if s.margin < 0.0}
    assert touched & {"left bracket", "right bracket@flip-1"}


def test_a_share_belongs_to_one_arm(flip, schedule):
    """In an open job too: the right arm is said to give what the left one picked, or both to take."""
    work = dataclasses.replace(flip.tasks[0].handover, giver="any", taker="any")
    tasks = tuple(dataclasses.replace(t, arm="any", handover=work) for t in flip.tasks)
    job = dataclasses.replace(flip, tasks=tasks, order="optimise")
    assert [check.name for check in verify(schedule, job, clearance=True).failures] == []
    found = verify(with_event(schedule, "give", arm="right"), job)
    checks = {check.name: check.detail for check in found.failures}
    assert "flip-1: pick and give are done by left and right" in checks["order"]
    fixed = tuple(
        dataclasses.replace(t, arm="right" if k == 0 else "left") for k, t in enumerate(tasks)
    )
    found = verify(schedule, dataclasses.replace(job, tasks=fixed))
    checks = {check.name: check.detail for check in found.failures}
    assert checks["order"] == "flip-1: pick and give are the right arm's, the left arm does them"


def test_only_tools_and_the_part_itself_may_touch_what_changes_hands(
    flip, schedule, measured_lines
):
    """Of every pair of things there are: the giver's part and the taker's tool, the reverse, and both parts."""
    spans = measured_lines(schedule, flip)
    [span], touches = handover_spans(flip, spans), handover_touches(flip, spans)
    mine, yours = ("left", "bracket"), ("right", "bracket@flip-1")
    things = [mine, yours, *(("", name) for name in ("left_tool", "right_tool", "table"))]
    things += [("", "right_link_b"), ("right", "bracket"), ("left", "bracket@flip-1")]
    allowed = [{mine, ("", "right_tool")}, {yours, ("", "left_tool")}, {mine, yours}]
    for one, other in permutations(things, 2):
        solids = [SimpleNamespace(carrier=carrier, body=body) for carrier, body in (one, other)]
        expected = [(span.start, span.end)] if {one, other} in allowed else []
        assert touching_spans(touches, *solids, gripped=True) == expected
        assert touching_spans(touches, *solids) == []


@pytest.mark.parametrize(("start", "end", "off"), [(0.8, 1.2, 0.05), (0.0, 0.8, 0.7)])
def test_how_far_a_tool_moves_is_measured_from_where_it_stands_at_first(clean, start, end, off):
    """On an approach of 50 mm, in metres; on a transfer over 0.4 rad of the platform and 0.3 of the arm, in radians."""
    worst = Worst()
    model = ToolModel(clean.schedule)
    _judge_still(clean.schedule, "left", (start, end), model, worst, "the giving")
    assert worst.value == pytest.approx(off, abs=1e-9)


@pytest.mark.parametrize(("share", "expected"), [(0.9, "passed"), (1.1, "failed")])
def test_tolerances_of_hand_overs(flip, schedule, share, expected):
    """The taker grips so much of a nanosecond after the giver lets go; the grip is so much of a micrometre off."""
    took, gave = event(schedule, "take"), event(schedule, "give")
    late = with_event(schedule, "take", dwell=gave.time + share * 1e-9 - took.time)
    own = {c.name: c.verdict for c in verify(late, flip).checks}
    assert own["handover_order"] == expected
    # Where the tools are exactly: the plan's own error does not count.
    model = ToolModel(schedule)
    poses = [
        model.pose(e.arm, schedule.trajectory.at(np.array([took.time]))[0][0]) for e in (gave, took)
    ]
    grip = poses[0].actInv(poses[1])
    for off in (
        pin.SE3(np.eye(3), np.array([0.0, share * 1e-6, 0.0])),
        pin.SE3(pin.utils.rotate("x", share * 1e-6), np.zeros(3)),
    ):
        tasks = tuple(
            dataclasses.replace(t, handover=dataclasses.replace(t.handover, grip=grip * off))
            for t in flip.tasks
        )
        own = verify(schedule, dataclasses.replace(flip, tasks=tasks)).checks
        assert {c.name: c.verdict for c in own}["handover_grip"] == expected
