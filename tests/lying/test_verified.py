"""The verifier on parts that wait and lie, against distances by brute force."""

from __future__ import annotations

from dataclasses import replace

import coal
import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.verification import verify
from dualarm_cli.verification.clearance_checks import edges_of, watched_pairs

PALM = "shapes: [{box: [160 mm, 160 mm, 40 mm], xyz: [0, 0, 95 mm]}]"
TABLE = 0.48
"""Height of the table's top [m]."""
CUBE = 0.11
"""Height of the tool centre point over the table when a cube stands on it [m]."""
HIGH = ", approach: 120 mm, retract: 120 mm"
"""Over the cubes."""
QUICK = PlanSettings(effort="quick")


def placed(shape: tuple[float, float, float], pose: pin.SE3) -> tuple[coal.Box, coal.Transform3s]:
    return coal.Box(*shape), coal.Transform3s(pose.rotation, pose.translation)


def tool_poses(job, schedule, times) -> list[pin.SE3]:
    """Where the left tool is, by pinocchio."""
    model = pin.buildModelFromXML(job.cell.robot.urdf)
    data, arm = model.createData(), job.cell.robot.arm("left")
    frame = model.getFrameId(arm.flange, pin.FrameType.BODY)
    order = [schedule.trajectory.joints.index(name) for name in model.names[1:]]
    found = []
    for q in schedule.trajectory.at(np.array(times))[0][:, order]:
        pin.forwardKinematics(model, data, q)
        flange = pin.updateFramePlacement(model, data, frame)
        found.append(job.cell.base * flange * job.cell.tools["left"].tcp)
    return found


def nearest_cubes(job, schedule, step: float = 0.002) -> float:
    """Least distance of the cube of `two` in the tool from that of `one` on the table [m]."""
    [taken] = [e.time for e in schedule.events if (e.task, e.action) == ("two", "pick")]
    [put] = [e.time + e.dwell for e in schedule.events if (e.task, e.action) == ("two", "place")]
    [lies] = [e.time + e.dwell for e in schedule.events if (e.task, e.action) == ("one", "place")]
    times = np.append(np.arange(max(taken, lies), put, step), put)
    shape = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.055]))
    [there] = tool_poses(job, schedule, [lies])
    other = placed((0.06, 0.06, 0.1), there * shape)
    return min(
        coal.distance(
            *placed((0.06, 0.06, 0.1), pose * shape),
            *other,
            coal.DistanceRequest(),
            coal.DistanceResult(),
        )
        for pose in tool_poses(job, schedule, times)
    )


@pytest.fixture(scope="module")
def beside(job_of, task):
    """Two cubes side by side, 20 mm apart, and a plan that knows nothing of lying parts."""
    job = job_of(
        task("one", (0.45, 0.10, CUBE), (0.45, 0.40, CUBE), HIGH),
        task("two", (0.60, 0.10, CUBE), (0.45, 0.48, CUBE), HIGH),
        clearance="5 mm",
    )
    blind = replace(
        job, cell=replace(job.cell, parts={}), tasks=tuple(replace(t, part="") for t in job.tasks)
    )
    return job, plan_without_bound(blind, QUICK)


def test_the_least_distance_of_a_carried_from_a_lying_part_is_met(beside):
    """As often as every 2 ms by coal, to the proof's precision of 0.5 mm."""
    job, schedule = beside
    brute = nearest_cubes(job, schedule)
    watched = watched_pairs(schedule, job)
    pairs = [
        k
        for k, pair in enumerate(watched.pairs)
        if (watched.solids[pair.first].label, watched.solids[pair.second].label)
        == ("left cube", "cube of one")
    ]
    only = replace(
        watched,
        pairs=[watched.pairs[k] for k in pairs],
        windows=[watched.windows[k] for k in pairs],
    )
    found = min(
        only.certified(edges_of(schedule), contact=False, lying=True), key=lambda one: one.margin
    )
    assert found.margin + 0.005 == pytest.approx(brute, abs=1e-3)
    assert found.margin + 0.005 <= brute + 1e-9
    assert found.met + 0.005 >= brute - 2e-4


def test_what_cannot_be_the_nearest_is_left_out_without_changing_the_least(beside):
    """Balls around bodies only save time."""
    job, schedule = beside
    watched, edges = watched_pairs(schedule, job), edges_of(schedule)
    known = np.full(len(edges) - 1, 0.03)
    every = watched.certified(edges, contact=False, lying=True)
    near = watched.certified(edges, contact=False, lying=True, other_margins=known)
    for one, other in zip(every, near, strict=True):
        if one.met < 0.03:
            assert (other.pair, other.margin, other.time) == (one.pair, one.margin, one.time)
        else:
            assert other.margin > 0.0295


@pytest.fixture(scope="module")
def through(job_of, task):
    """A tower between where a cube is picked and placed, and a plan that knows nothing of it."""
    job = job_of(
        task("one", (0.45, 0.10, CUBE), (0.45, 0.50, CUBE)),
        task("two", (0.45, 0.30, 0.31), (0.70, 0.30, 0.31), ", part: tower"),
    )
    blind = replace(
        job,
        cell=replace(job.cell, parts={}),
        tasks=tuple(replace(t, part="") for t in job.tasks),
    )
    return job, plan_without_bound(blind, QUICK)


def test_a_plan_through_a_waiting_part_fails_with_task_part_and_time(through):
    """The cube is as deep in the tower as brute force finds it, at that time, before the tower is picked."""
    job, schedule = through
    verdict = verify(schedule, job, clearance=True)
    [failed] = [check for check in verdict.checks if check.verdict == "failed"]
    assert failed.name == "collisions"
    [taken] = [e.time for e in schedule.events if (e.task, e.action) == ("two", "pick")]
    worst = min(verdict.clearances, key=lambda one: one.margin)
    assert worst.bodies[1] == "tower of two"
    assert worst.time < taken
    assert f"tower of two at {worst.time:.4f} s" in failed.detail
    [pose] = tool_poses(job, schedule, [worst.time])
    own = placed((0.06, 0.06, 0.1), pose * pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.055])))
    tower = placed((0.06, 0.06, 0.3), pin.SE3(np.eye(3), np.array([0.45, 0.30, TABLE + 0.155])))
    if worst.bodies[0] == "left cube":
        deep = coal.distance(*own, *tower, coal.DistanceRequest(), coal.DistanceResult())
        assert worst.clearance == pytest.approx(deep, abs=1e-3)


def test_the_planner_goes_round_it(through):
    """A plan of its own passes; it is no shorter than one that goes through."""
    job, blind = through
    made = plan_without_bound(job, QUICK)
    assert verify(made, job, clearance=True).passed
    assert made.duration >= blind.duration - 1e-9


def on_belt(job_of, passes: float):
    """Two cubes that are picked from a belt, the second one of which passes at a time [s]."""
    tasks = [
        f"{{id: {name}, arm: left, leaves: true, pick: {{xyz: [0.6, 0.35, 0.6], rpy: [180 deg, 0, 0], conveyor: belt, "
        f"passes: {at} s, within: 0.4 m}}, place: {{xyz: [0.35, 0.55, 0.6], rpy: [180 deg, 0, 0]}}}}"
        for name, at in (("first", 1), ("second", passes))
    ]
    return job_of(*tasks, cell="conveyors: {belt: {velocity: [0, -150 mm/s, 0]}}")


def test_a_part_on_a_belt_in_the_way_is_refused_with_the_bodies(job_of):
    """135 mm behind the first one it passes where that is carried away, in stage 2."""
    with pytest.raises(InfeasibleError) as refused:
        plan_without_bound(on_belt(job_of, 1.9), replace(QUICK, blend="none"))
    assert "task 'second': left cube and cube of second lack" in str(refused.value)
    assert " s into stage 2" in str(refused.value)


def test_the_next_lines_are_none_of_a_part_on_a_belt(job_of):
    """The rod ends 30 mm behind the target, the cube begins 5 mm below it: 15 mm too deep, and 5 mm of clearance."""
    pose = "xyz: [0.6, {}], rpy: [180 deg, 0, 0]"
    job = job_of(
        "{id: first, arm: left, pick: {xyz: [0.35, 0.55, 0.6], rpy: [180 deg, 0, 0]}, "
        f"place: {{{pose.format('0.35, 0.6')}, conveyor: belt, passes: 1 s, within: 0.6 m}}}}",
        f"{{id: next, arm: left, approach: 60 mm, retract: 60 mm, move: {{{pose.format('0.02, 0.55')}}}}}",
        cell="conveyors: {belt: {velocity: [0, -150 mm/s, 0]}}",
    )
    with pytest.raises(InfeasibleError) as refused:
        plan_without_bound(job, QUICK)
    assert "left_tool and cube of first lack 20.0 mm of clearance" in str(refused.value)


def test_a_tool_leaves_a_part_from_within_the_clearance(job_of, task):
    """The palm is 10 mm over the cube, 12 mm when its line ends, of 15 mm required."""
    job = job_of(
        task("one", (0.45, 0.1, 0.31), (0.45, 0.5, 0.31), ", retract: 2 mm"),
        "{id: next, arm: left, move: {xyz: [0.45, 0.2, 0.8], rpy: [180 deg, 0, 0]}}",
        tool=PALM,
        clearance="15 mm",
    )
    assert verify(plan_without_bound(job, QUICK), job, clearance=True).passed


def test_a_tool_leaves_a_part_on_a_belt_from_within_the_clearance(job_of):
    """The palm is 10 mm over the cube, 12 mm when its line ends, of 15 mm required: the next stage begins there."""
    job = job_of(
        "{id: first, arm: left, retract: 2 mm, pick: {xyz: [0.35, 0.55, 0.6], rpy: [180 deg, 0, 0]}, place: "
        "{xyz: [0.6, 0.35, 0.6], rpy: [180 deg, 0, 0], conveyor: belt, passes: 1 s, within: 0.6 m}}",
        "{id: next, arm: left, move: {xyz: [0.45, 0.55, 0.8], rpy: [180 deg, 0, 0]}}",
        cell="conveyors: {belt: {velocity: [0, -150 mm/s, 0]}}",
        tool=PALM,
        clearance="15 mm",
    )
    assert verify(plan_without_bound(job, QUICK), job, clearance=True).passed


def test_a_part_on_a_belt_is_where_the_belt_has_it(job_of):
    """150 mm/s from its pose at `passes` on: the tool is as far from it as brute force finds."""
    job = on_belt(job_of, 4.0)
    schedule = plan_without_bound(job, QUICK)
    assert verify(schedule, job, clearance=True).passed
    watched = watched_pairs(schedule, job)
    pairs = [
        k
        for k, pair in enumerate(watched.pairs)
        if (watched.solids[pair.first].body, watched.solids[pair.second].label)
        == ("left_tool", "cube of second")
        and pair.required > 0.0
    ]
    only = replace(
        watched,
        pairs=[watched.pairs[k] for k in pairs],
        windows=[watched.windows[k] for k in pairs],
    )
    edges = edges_of(schedule)
    found = min(only.certified(edges, contact=False, lying=True), key=lambda one: one.margin)
    [first] = [e for e in schedule.events if (e.task, e.action) == ("first", "place")]
    rod, cube = coal.Capsule(0.02, 0.06), coal.Box(0.06, 0.06, 0.1)
    least = np.inf
    # From the second stop before it on the two need only not reach into one another.
    times = np.arange(0.0, first.time + first.dwell, 0.002)
    for time, pose in zip(times.tolist(), tool_poses(job, schedule, times), strict=True):
        own = pose * pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.08]))
        at = np.array([0.6, 0.35 - 0.15 * (time - 4.0), 0.6 - 0.055])
        least = min(
            least,
            coal.distance(
                rod,
                coal.Transform3s(own.rotation, own.translation),
                cube,
                coal.Transform3s(np.eye(3), at),
                coal.DistanceRequest(),
                coal.DistanceResult(),
            ),
        )
    assert found.met + 0.005 == pytest.approx(least, abs=1e-3)


LOW = [
    f"{{id: {name}, arm: left, move: {{xyz: [0.45, {y}, 0.53], rpy: [180 deg, 0, 0]}}}}"
    for name, y in (("before", 0.28), ("after", 0.32))
]
"""Moves beside the cubes, 60 mm below the height at which they are gripped."""


@pytest.mark.parametrize("deep", [-0.005, 0.008])
def test_a_tool_without_lines_reaches_no_deeper_into_its_part_than_at_the_grip(job_of, task, deep):
    """5 mm above the cube, or 8 mm in it; from beside it the tool comes round the edge, not through it."""
    length = 0.105 + deep
    tool = f"shapes: [{{box: [0.04, 0.04, {length}], xyz: [0, 0, {0.02 + 0.5 * length}]}}]"
    bare = ", approach: 0 mm, retract: 0 mm"
    job = job_of(
        LOW[0], task("one", (0.45, 0.15, CUBE), (0.45, 0.45, CUBE), bare), LOW[1], tool=tool
    )
    job = replace(job, cell=replace(job.cell, obstacles=()))
    blind = replace(
        job, cell=replace(job.cell, parts={}), tasks=tuple(replace(t, part="") for t in job.tasks)
    )
    through = plan_without_bound(blind, QUICK)
    verdict = verify(through, job, clearance=True)
    [failed] = [check for check in verdict.checks if check.verdict == "failed"]
    assert "left_tool and cube of one at" in failed.detail
    worst = min(verdict.clearances, key=lambda one: one.margin)
    assert worst.required == pytest.approx(-0.0005 - max(0.0, deep), abs=1e-6)
    own, cube = (0.04, 0.04, length), pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.055]))
    centre = pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.1 + 0.5 * length]))

    def deepest(schedule) -> float:
        """How deep the tool is in the cube at most before its pick and after its place, by coal every 2 ms [m]."""
        pick, place = (next(e for e in schedule.events if e.action == a) for a in ("pick", "place"))
        over, depths = place.time + place.dwell, []
        for first, last, grip in ((0.0, pick.time, pick.time), (over, schedule.duration, over)):
            times = np.append(np.arange(first, last, 0.002), grip)
            *poses, there = tool_poses(job, schedule, times)
            lies = placed((0.06, 0.06, 0.1), there * cube)
            for pose in poses:
                asked = coal.DistanceRequest(), coal.DistanceResult()
                depths.append(-coal.distance(*placed(own, pose * centre), *lies, *asked))
        return max(depths)

    assert deepest(through) > max(0.0, deep) + 0.005
    made = plan_without_bound(job, QUICK)
    assert verify(made, job, clearance=True).passed
    assert deepest(made) <= max(0.0, deep) + 0.0005


@pytest.mark.parametrize(("retract", "approach"), [(60, 60), (60, 3), (3, 60)])
def test_a_part_that_is_placed_and_taken_again_may_be_gripped_on_both_lines(
    job_of, task, retract, approach
):
    """The tool is 8 mm in the cube at the place and, right after it, at the pick; at 3 mm from there 5 mm."""
    tool = "shapes: [{box: [0.04, 0.04, 0.113], xyz: [0, 0, 0.0765]}]"
    lines = f", retract: {retract} mm", f", approach: {approach} mm"
    first = task("one", (0.45, 0.15, CUBE), (0.45, 0.45, CUBE), lines[0])
    again = task("two", (0.45, 0.45, CUBE), (0.60, 0.45, CUBE), lines[1])
    job = job_of(first, again, tool=tool)
    made = plan_without_bound(job, replace(QUICK, blend="none"))
    assert verify(made, job, clearance=True).passed


def test_on_a_path_after_its_place_a_tool_keeps_the_clearance_from_the_part(job_of, task):
    """1 mm over the cube, whose top is at 105 mm; the tool ends 30 mm above its centre point."""
    through = ", ".join(f"{{xyz: [0.45, {y}, {TABLE + 0.076}]}}" for y in (0.35, 0.45))
    through = through.replace("]}", "], rpy: [180 deg, 0, 0]}", 1)
    path = f"{{id: path, arm: left, path: {{speed: 0.1, through: [{through}]}}}}"
    job = job_of(task("one", (0.45, 0.10, CUBE), (0.45, 0.40, CUBE)), path)
    with pytest.raises(InfeasibleError):
        plan_without_bound(job, replace(QUICK, blend="none"))
    blind = replace(
        job, cell=replace(job.cell, parts={}), tasks=tuple(replace(t, part="") for t in job.tasks)
    )
    verdict = verify(plan_without_bound(blind, replace(QUICK, blend="none")), job, clearance=True)
    [failed] = [check for check in verdict.checks if check.verdict == "failed"]
    assert "left_tool and cube of one" in failed.detail
    worst = min(verdict.clearances, key=lambda one: one.margin)
    assert (worst.required, worst.margin) == (0.005, pytest.approx(-0.004, abs=1e-3))
