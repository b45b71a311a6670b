"""Hand-overs planned: who waits for whom, what stages last, what may touch and what may not."""

from __future__ import annotations

import dataclasses

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.bound.bound import lower_bound
from dualarm_cli.bound.job_bound import _least_work, job_bound
from dualarm_cli.clearing.repairs import Clearing
from dualarm_cli.clearing.stage_samples import arm_motions, combined, stage_samples
from dualarm_cli.collision.clearance import CellClearance
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinds.handover.reading import handover_shares
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import PoseTarget
from dualarm_cli.model.part_flow import Buffer
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.motion.motion import realise
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.postures.holding import Holding
from dualarm_cli.report.report import count_parts
from dualarm_cli.report.sensitivity import sensitivity
from dualarm_cli.report.stage_parts import corners
from dualarm_cli.stages.method import MethodProblem
from dualarm_cli.stages.plans.times import evaluate
from dualarm_cli.stages.sequence import decisions_of, solve_sequence
from dualarm_cli.stages.sequence_problem import sequence_problem
from dualarm_cli.stages.stage_by_stage import choose_stages
from dualarm_cli.timing import TIMING_SOLVERS
from dualarm_cli.verification import verify

QUICK = PlanSettings(effort="quick")


@pytest.fixture(scope="module")
def flip(tasks_folder):
    """The first hand-over of the example."""
    job = load_job(tasks_folder / "13_hand_over" / "tasks.yaml")
    return dataclasses.replace(job, tasks=job.tasks[:2])


@pytest.fixture(scope="module")
def schedule(flip):
    """Its plan."""
    return plan_without_bound(flip, QUICK)


def regripped(job, grip, pose=None):
    """The job with another grip, or another place to meet."""
    giving, taking = job.tasks
    give = giving.stops[1]
    whole = dataclasses.replace(giving, stops=(), handover=None)
    meet = give.target.pose if pose is None else pose
    stops, lines = (giving.stops[0], taking.stops[1]), (give.lines[1], taking.stops[0].lines[0])
    shares = handover_shares(whole, "right", stops, (meet, grip), lines, give.place)
    return dataclasses.replace(job, tasks=tuple(shares))


def parts_of(schedule, arm, action):
    """An arm's segments of one action by kind, with when they begin and end."""
    own = [s for s in schedule.segments if s.arm == arm and s.action == action]
    return {s.kind: (s.start, s.end) for s in own}


def test_the_plan_is_verified(flip, schedule):
    """By the judge that knows nothing of the planner, with proven clearance."""
    found = verify(schedule, flip, clearance=True)
    assert [check.name for check in found.failures] == []
    assert {c.verdict for c in found.checks if c.name.startswith("handover")} == {"passed"}


def test_the_taker_comes_in_motion_and_the_giver_leaves_in_motion(tasks_folder):
    """The taker passes the begin of its approach when the giver is there, which passes the end of the stage."""
    job = load_job(tasks_folder / "13_hand_over" / "tasks.yaml")
    passing = plan_without_bound(job, QUICK)
    found = {(c.arm, c.task, c.line) for c in corners(passing, job) if c.action in ("give", "take")}
    # Nothing follows the second one, whose giver stops.
    assert found == {
        ("right", "flip-1", "approach"),
        ("left", "flip-1", "retract"),
        ("right", "flip-2", "approach"),
    }
    segments = tuple(s for s in passing.segments if s.task == "flip-1")
    first = dataclasses.replace(passing, segments=segments)
    take, give = parts_of(first, "right", "take"), parts_of(first, "left", "give")
    assert take["transfer"][1] == pytest.approx(take["approach"][0], abs=1e-9)
    assert give["transfer"][1] <= take["approach"][0] + 1e-9
    model = CellModel.from_cell(job.cell)
    index = model.arms["right"].columns
    at_border, at_giving = (
        np.abs(passing.trajectory.at(np.array([time]))[1][0])
        for time in (take["approach"][0], 0.5 * sum(take["approach"]))
    )
    assert at_border[index].max() > 0.1
    left = model.arms["left"].columns
    # The giver stands while the taker approaches.
    assert at_border[left].max() < 1e-9
    assert at_giving[left].max() < 1e-9
    stopping = plan_without_bound(job, dataclasses.replace(QUICK, blend="none"))
    assert passing.duration < stopping.duration
    assert verify(passing, job, clearance=True).passed


def test_the_taker_comes_when_both_are_there_and_the_giver_leaves_when_it_has_gripped(schedule):
    """The stage by its segments: both arrivals, approach, two dwells, retract, nothing in between."""
    take, give = parts_of(schedule, "right", "take"), parts_of(schedule, "left", "give")
    there = max(take["transfer"][1], give["transfer"][1])
    assert take["approach"][0] == pytest.approx(there, abs=1e-9)
    assert take["dwell"] == pytest.approx((take["approach"][1], take["approach"][1] + 0.15))
    assert give["dwell"] == pytest.approx((take["dwell"][1], take["dwell"][1] + 0.15))
    assert give["retract"][0] == pytest.approx(give["dwell"][1])
    stage = schedule.stages[1]
    assert stage.tasks == ("flip-1",)
    assert stage.end == pytest.approx(give["retract"][1], abs=1e-9)
    # Stage by hand: both transfers begin together, then line, dwell, dwell, line one after the other.
    lines = sum(b - a for a, b in (take["approach"], give["retract"]))
    assert stage.end - stage.start == pytest.approx(there - stage.start + lines + 0.3, abs=1e-9)
    assert "retract" not in take
    assert "approach" not in give


def test_the_search_knows_how_long_handovers_last(flip):
    """The closed form of every stage against the timed motion of the same postures.

    Lines are estimates there; without the other arm's line and dwell the hand-over would be far too short.
    """
    model = CellModel.from_cell(flip.cell)
    problem = sequence_problem(model, flip)
    stages = solve_sequence(MethodProblem(model, flip, "arm_angle", "quick")).stages
    plan = evaluate(problem, decisions_of(problem, model, stages))
    motion = realise(model, flip, stages, TIMING_SOLVERS["ruckig"])
    timed = [stage.end - stage.start for stage in motion.stages]
    np.testing.assert_allclose(plan.stages, timed[:-1], rtol=0.04)
    unchecked = evaluate(dataclasses.replace(problem, handing=()), plan.decisions)
    assert unchecked.stages[1] < 0.75 * timed[1]
    assert [one.duration for one in stages[:-1]] == pytest.approx(timed[:-1], rel=0.04)


def test_no_plan_is_quicker_than_the_bound(flip, schedule):
    """It knows all four dwells, one after the other, and what the other arm's line takes at least."""
    passing = job_bound(flip, "quick", "lines").value
    assert 4 * 0.15 < passing < schedule.duration
    bound = job_bound(flip, "quick").value
    schedule = plan_without_bound(flip, dataclasses.replace(QUICK, blend="none"))
    assert passing <= bound < schedule.duration
    problem = sequence_problem(CellModel.from_cell(flip.cell), flip)
    unchecked = lower_bound(dataclasses.replace(problem, handing=()), "quick").value
    assert bound > unchecked + 0.15
    for a, (arm, action, line) in enumerate(
        (("left", "give", "retract"), ("right", "take", "approach"))
    ):
        parts = parts_of(schedule, arm, action)
        spent = sum(parts[kind][1] - parts[kind][0] for kind in ("dwell", line))
        assert 0.15 < _least_work(problem, a, 1, "quick") <= spent


def test_sensitivities_know_both_arms_lines(schedule):
    """All limits at 81 % of acceleration and 72.9 % of jerk would be 0.9 of the speed: bounds by time scaling.

    With acceleration and jerk 10 % lower a motion may last at most 1 / 0.9^(1/2) to 1 / 0.9^(1/3) times as long, where
    no speed limit decides; dwells, 0.6 s, stay.
    """
    [both] = [one for one in sensitivity(schedule) if one.limit == "acceleration and jerk"]
    moving = schedule.duration - 0.6
    assert 0.6 + moving * 1.005 < both.lower < 0.6 + moving / 0.9**0.5 + 1e-6
    assert both.higher < schedule.duration


def test_one_part_is_one_part(flip):
    """Two shares, one part."""
    assert count_parts(flip) == 1


def test_tools_may_touch_the_part_only_while_it_is_handed_over(flip, schedule):
    """At the grip both tools are at the part: with it on its way that is a collision, in a hand-over it is none."""
    cell = CellClearance.of(flip.cell, flip.carried())
    take = next(e for e in schedule.events if e.action == "take")
    [q] = schedule.trajectory.at(np.array([take.time]))[0]
    for before, part in ((("left", "bracket"), 0), (("right", "bracket@flip-1"), 1)):
        held = cell.loads.nothing(1, 2)
        held[0, part] = cell.loads.number(before[1])
        handed = cell.loads.at_stops(held, np.array([True]))
        # The part ends 2 mm before either tool centre point, at which the tool's cap ends.
        assert cell.cross_margins(q[None], held)[0] < -0.005
        assert cell.cross_margins(q[None], handed)[0] > 0.0
        # Everything else counts as ever: obstacles, and the other arm's links.
        assert cell.arm_margins(part, q[None], handed[:, part])[0] > 0.0
    long = dataclasses.replace(
        flip.cell, parts={"bracket": (), "bracket@flip-1": flip.cell.parts["bracket@flip-1"]}
    )
    [box] = long.parts["bracket@flip-1"]
    huge = dataclasses.replace(box, size=(0.04, 0.06, 0.5))
    cell = CellClearance.of(
        dataclasses.replace(long, parts={"bracket": (huge,), "bracket@flip-1": (box,)}),
        flip.carried(),
    )
    held = np.array([[cell.loads.number("bracket"), cell.loads.number("")]])
    handed = cell.loads.at_stops(held, np.array([True]))
    assert cell.cross_margins(q[None], handed)[0] < 0.0
    one, other, _ = cell.nearest(q, handed[0])
    assert "left bracket" in (one, other)
    assert "right_tool" not in (one, other)


def test_while_it_is_handed_over_a_part_keeps_clear_of_obstacles(flip):
    """Where parts are picked they may lie on something; in the air they may not."""
    holding = Holding.of(flip)
    assert holding.is_handover.tolist() == [False, True, False]
    loads = holding.cell.loads
    left, right = ([loads.load(n) for n in row] for row in holding.at_targets.T.tolist())
    assert [load.is_handed for load in left] == [False, True, False]
    assert [load.name for load in left] == ["bracket", "bracket", ""]
    assert [load.name for load in right] == ["", "bracket@flip-1", "bracket@flip-1"]
    # What is on a line may touch the ground.
    assert [load.on_line for load in left][:2] == [True, False]
    assert right[2].on_line


def test_tools_that_would_meet_are_refused(flip):
    """5 mm between two tools that have to keep 10: no posture helps; the message names them and the place."""
    near = pin.SE3(pin.utils.rotate("x", np.pi), np.array([0.0, 0.0, 0.005]))
    with pytest.raises(InfeasibleError) as caught:
        plan_without_bound(regripped(flip, near), QUICK)
    wanted = "task 'flip-1': at the grip left_tool and right_tool lack 5.0 mm of clearance"
    assert wanted in str(caught.value)


def test_a_place_out_of_reach_is_told_with_its_line(flip):
    """Three metres away: exit 3, who cannot reach what, and where it is written."""
    far = pin.SE3(pin.utils.rotate("x", np.pi / 2), np.array([3.0, 0.0, 1.0]))
    with pytest.raises(InfeasibleError) as caught:
        plan_without_bound(regripped(flip, flip.tasks[0].handover.grip, far), QUICK)
    assert caught.value.exit_code == 3
    assert "left arm cannot give" in str(caught.value)
    assert "tasks.yaml:19:7: task 'flip-1'" in str(caught.value)


def test_the_other_arm_may_give(flip):
    """Right to left, from the right-hand place: the same sentences, and the same verdict."""
    giving, taking = flip.tasks
    pose = pin.SE3(pin.utils.rotate("x", -np.pi / 2), giving.stops[1].target.pose.translation)
    whole = dataclasses.replace(giving, arm="right", stops=(), handover=None)
    stops = (
        dataclasses.replace(taking.stops[1], action="pick"),
        dataclasses.replace(giving.stops[0], action="place"),
    )
    meeting = pose, giving.handover.grip
    lines = giving.stops[1].lines[1], taking.stops[0].lines[0]
    shares = handover_shares(whole, "left", stops, meeting, lines, giving.place)
    job = dataclasses.replace(flip, tasks=tuple(shares))
    found = plan_without_bound(job, PlanSettings(platform="fixed"))
    assert [check.name for check in verify(found, job, clearance=True).failures] == []
    order = [(e.arm, e.action) for e in found.events]
    assert order == [("right", "pick"), ("left", "take"), ("right", "give"), ("left", "place")]
    assert isinstance(shares[0].stops[1].target, PoseTarget)


@pytest.mark.parametrize("late", ["left", "right"])
def test_an_arm_that_is_late_makes_both_late(flip, late):
    """A delay before the hand-over costs what its repair expects: the other arm's lines begin later too."""
    model, timing = CellModel.from_cell(flip.cell), TIMING_SOLVERS["ruckig"]
    holding = Holding.of(flip)
    plan = choose_stages(MethodProblem(model, flip, "arm_angle"), "exact")[1]
    clearing = Clearing(model, flip, holding, timing, 0)
    motion = clearing.alone(plan)
    samples = stage_samples(motion, 0, 1, holding)
    motions = arm_motions(model, motion, 0, samples)
    delay = 75
    thought = combined(model, samples, motions, {late: delay})
    made = clearing.alone(dataclasses.replace(plan, waits={late: delay * samples.step}))
    real = stage_samples(made, 0, 1, holding)
    count = min(len(thought.position), len(real.position))
    assert abs(len(thought.position) - len(real.position)) <= 2
    # Arrivals lie between instants: off by one at most, at no more than 3 rad/s.
    arms = [column for arm in model.arms.values() for column in arm.columns]
    off = np.abs(thought.position[:count, arms] - real.position[:count, arms])
    assert off.max() < 2 * 3.0 * samples.step
    assert (thought.held[:count] != real.held[:count]).any(axis=1).sum() <= 6
    # Both hold something else in the end, and the part is being handed over in between.
    loads = [[holding.cell.loads.load(n) for n in row] for row in real.held.tolist()]
    states = [tuple(load.name for load in row) for row in loads]
    assert list(dict.fromkeys(states)) == [("bracket", ""), ("", "bracket@flip-1")]
    handed = np.array([any(load.is_handed for load in row) for row in loads])
    lines = [s for s in made.segments if s.kind in ("approach", "dwell", "retract")]
    span = max(s.end for s in lines) - min(s.start for s in lines)
    assert handed.sum() * samples.step == pytest.approx(span, abs=2 * samples.step)
    assert not handed[0]


def relined(job, approach, retract):
    """The job with lines of other lengths at the hand-over."""
    giving, taking = job.tasks
    give = dataclasses.replace(giving.stops[1], retract=retract)
    take = dataclasses.replace(taking.stops[0], approach=approach)
    tasks = (
        dataclasses.replace(giving, stops=(giving.stops[0], give)),
        dataclasses.replace(taking, stops=(take, taking.stops[1])),
    )
    return dataclasses.replace(job, tasks=tasks)


@pytest.mark.parametrize(
    ("approach", "retract", "wanted"),
    [
        (0.0, 0.08, "where the right arm's approach begins bracket and right_tool lack 8.0 mm"),
        (0.005, 0.08, "where the right arm's approach begins bracket and right_tool lack 3.0 mm"),
        (0.08, 0.0, "where the left arm's retract ends left_tool and bracket@flip-1 lack 8.0 mm"),
    ],
)
def test_lines_that_are_too_short_are_told(flip, approach, retract, wanted):
    """The part ends 2 mm before either tool; 10 mm are required where it may not be touched yet, or any more."""
    with pytest.raises(InfeasibleError) as caught:
        plan_without_bound(relined(flip, approach, retract), QUICK)
    assert f"task 'flip-1': {wanted} of clearance" in str(caught.value)


def test_lines_that_are_just_long_enough_are_planned(flip):
    """12.1 mm and the 2 mm of the grip are 10 required and 2 that stops keep beyond: planned and verified."""
    job = relined(flip, 0.0121, 0.0121)
    found = plan_without_bound(job, PlanSettings(effort="quick", platform="exact"))
    assert [check.name for check in verify(found, job, clearance=True).failures] == []


@pytest.mark.parametrize("changes", [{"mode": "free"}, {"order": "optimise"}])
def test_parts_out_of_a_buffer_are_handed_over(tasks_folder, changes):
    """Two parts that are there at the start: the arms meet in one stage all the same, and the judge says so."""
    job = load_job(tasks_folder / "13_hand_over" / "tasks.yaml")
    tasks = tuple(
        dataclasses.replace(
            task,
            stops=tuple(
                dataclasses.replace(stop, buffer="infeed" if stop.action == "pick" else "")
                for stop in task.stops
            ),
        )
        for task in job.tasks
    )
    buffers = {"infeed": Buffer(capacity=2, initial=2)}
    job = dataclasses.replace(job, tasks=tasks, buffers=buffers, returns=False, **changes)
    schedule = plan_without_bound(job, QUICK, check_collisions=False)
    assert [check.name for check in verify(schedule, job).failures] == []
