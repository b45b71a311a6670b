"""Collision-free plans: other postures, delays and detours, each only where it is needed; or the reason why not."""

from __future__ import annotations

import dataclasses
from itertools import product

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.background import allow_workers
from dualarm_cli.clearing import blended_plan, repairs
from dualarm_cli.clearing.clear_plan import quickest_clear
from dualarm_cli.clearing.repairs import Clearing
from dualarm_cli.collision.solids import (
    cell_solids,
    geometry_model,
    pairs_that_must_keep_apart,
)
from dualarm_cli.effort import EFFORTS
from dualarm_cli.errors import BlockedError, InfeasibleError
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.cell import Obstacle
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.model.shape import Shape
from dualarm_cli.motion import blending
from dualarm_cli.motion.blending import passing_launches, with_launches
from dualarm_cli.motion.motion import realise
from dualarm_cli.motion.transfers import Drive, MotionCache
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.postures.holding import Holding
from dualarm_cli.refusals import Refusal
from dualarm_cli.stages.method import Decided, MethodProblem
from dualarm_cli.stages.stage_by_stage import choose_stages
from dualarm_cli.timing import TIMING_SOLVERS
from dualarm_cli.verification import verify
from tests.packing_tasks import packing_job

QUICK = PlanSettings(effort="quick")


@pytest.fixture(scope="module")
def packing(tasks_folder):
    """The first three parts of each arm."""
    return packing_job(tasks_folder, 6)


def with_obstacle(job, kind, size, place):
    """The job with one more obstacle."""
    added = Obstacle("thing", Shape(kind, size, pin.SE3(np.eye(3), np.asarray(place))))
    cell = dataclasses.replace(job.cell, obstacles=(*job.cell.obstacles, added))
    return dataclasses.replace(job, cell=cell)


def least(schedule, job):
    """The least proven margin, after everything else was verified."""
    found = verify(schedule, job, clearance=True)
    assert [check.name for check in found.failures] == []
    return min(stage.margin for stage in found.clearances)


@pytest.mark.slow
def test_a_plan_goes_round_what_stands_in_the_way_of_the_one_before(packing):
    """A ball where the left elbow link was in the unchecked plan: the new plan keeps its 10 mm from it."""
    unchecked = plan_without_bound(packing, QUICK)
    robot = packing.cell.robot
    model = pin.buildModelFromXML(robot.urdf)
    data = model.createData()
    event = next(e for e in unchecked.events if e.arm == "left")
    [q], _, _ = unchecked.trajectory.at(np.array([event.time]))
    order = [unchecked.trajectory.joints.index(name) for name in model.names[1:]]
    pin.forwardKinematics(model, data, q[order])
    elbow = packing.cell.base * data.oMi[model.getJointId("left_u")]
    job = with_obstacle(packing, "sphere", (0.03,), elbow.translation)
    blind_check = verify(unchecked, job, clearance=True)
    assert "collisions" in [check.name for check in blind_check.failures]
    schedule = plan_without_bound(job, QUICK)
    assert least(schedule, job) >= 0.0
    again = plan_without_bound(job, QUICK)
    np.testing.assert_array_equal(schedule.trajectory.position, again.trajectory.position)


def test_arms_whose_ways_cross_wait_or_make_way_and_the_report_says_so(tasks_folder):
    """Two robots face to face change sides: no straight moves serve."""
    job = load_job(tasks_folder / "05_two_robots" / "tasks.yaml")
    schedule = plan_without_bound(job, QUICK)
    assert least(schedule, job) >= 0.0
    [note] = [note for note in schedule.notes if note.startswith("clearance:")]
    assert "detour" in note or "waits" in note
    assert "costs" in note


def test_a_target_within_an_obstacle_is_infeasible_with_pair_and_depth(packing):
    """A box about the first target: whatever the posture, the tool is in it."""
    target = packing.tasks[0].stops[0].target.pose.translation
    job = with_obstacle(packing, "box", (0.05, 0.05, 0.05), target)
    with pytest.raises(InfeasibleError, match=r"left_tool and thing lack"):
        plan_without_bound(job, dataclasses.replace(QUICK, platform="fixed"))


@pytest.mark.parametrize(
    ("name", "some", "effort"),
    [
        ("07_two_shelves", 4, "quick"),
        pytest.param("06_shared_bin", 4, "normal", marks=pytest.mark.slow),
        pytest.param("07_two_shelves", 4, "normal", marks=pytest.mark.slow),
        pytest.param("08_narrow_bin", 5, "normal", marks=pytest.mark.slow),
        pytest.param("06_shared_bin", None, "normal", marks=pytest.mark.slow),
        pytest.param("07_two_shelves", None, "normal", marks=pytest.mark.slow),
        pytest.param("08_narrow_bin", None, "normal", marks=pytest.mark.slow),
    ],
)
def test_crowded_cells_have_proven_plans_and_the_cost_of_it_is_what_is_said(
    tasks_folder, name, some, effort, monkeypatch
):
    """Shared bins, shelves, tools, carried boxes; the easiest one within a tenth of the unchecked plan."""
    job = load_job(tasks_folder / name / "tasks.yaml")
    job = dataclasses.replace(job, tasks=job.tasks[:some])
    stopping = PlanSettings(blend="none", effort=effort)
    # The cost is that of the plans before refinement.
    full = EFFORTS[effort]
    search = dataclasses.replace(full.search, refinements=0)
    monkeypatch.setitem(EFFORTS, effort, dataclasses.replace(full, search=search))
    schedule = plan_without_bound(job, stopping)
    assert least(schedule, job) >= 0.0
    unchecked = plan_without_bound(job, stopping, check_collisions=False)
    # The shorter plan of both would be possible without checking.
    cost = max(0.0, schedule.duration - unchecked.duration)
    assert schedule.clearance_cost == pytest.approx(cost, abs=1e-9)
    assert not verify(unchecked, job, clearance=True).passed
    if name == "06_shared_bin":
        assert schedule.clearance_cost <= 0.1 * unchecked.duration


@pytest.mark.parametrize("method", ["fixed", "exact", "minimum_time"])
def test_every_kind_of_method_keeps_clear(packing, method):
    """Those that decide stage by stage."""
    job = dataclasses.replace(packing, tasks=packing.tasks[:2])
    schedule = plan_without_bound(job, dataclasses.replace(QUICK, platform=method))
    assert least(schedule, job) >= 0.0


def test_a_part_is_in_the_way_only_while_it_is_carried(tasks_folder):
    """Boxes so long that they reach through the table where the approach to the shelf begins; without them it goes."""
    job = load_job(tasks_folder / "06_shared_bin" / "tasks.yaml")
    job = dataclasses.replace(job, tasks=job.tasks[:2])
    empty = dataclasses.replace(
        job, tasks=tuple(dataclasses.replace(task, part="") for task in job.tasks)
    )
    long = Shape("box", (0.06, 0.06, 0.3), pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.15])))
    cell = dataclasses.replace(job.cell, parts={"box": (long,)})
    carried = dataclasses.replace(job, cell=cell)
    with pytest.raises(
        InfeasibleError, match=r"'box' reaches [0-9.]+ mm into '(table|left_board_1|right_board_1)'"
    ):
        plan_without_bound(carried, QUICK)
    schedule = plan_without_bound(empty, QUICK)
    assert least(schedule, empty) >= 0.0


def slower_platform(job):
    """The platform at a quarter of its speed and acceleration: arms wait for it after their detours."""
    robot = job.cell.robot
    share = np.where(np.isin(robot.joints, robot.platform), 0.25, 1.0)
    limits = dataclasses.replace(
        robot.limits,
        velocity=share * robot.limits.velocity,
        acceleration=share * robot.limits.acceleration,
    )
    return in_robot(job, limits)


def without_jerk_limits(job):
    """Acceleration may jump."""
    limits = job.cell.robot.limits
    return in_robot(job, dataclasses.replace(limits, jerk=np.full(len(limits.joints), np.inf)))


def in_robot(job, limits):
    """The job with other limits of its robot."""
    robot = dataclasses.replace(job.cell.robot, limits=limits)
    return dataclasses.replace(job, cell=dataclasses.replace(job.cell, robot=robot))


def capped(job):
    """A cap on the tools' speed that most transfers feel."""
    return dataclasses.replace(job, tool_speed=1.0)


def slowed(job):
    """Everything at a fifth of its pace."""
    return dataclasses.replace(job, speed=0.2)


def picked_without_approach(job):
    """The motion begins at the first pick, whose part lies on the table."""
    tasks = tuple(
        dataclasses.replace(
            task, stops=(dataclasses.replace(task.stops[0], approach=0.0), *task.stops[1:])
        )
        for task in job.tasks
    )
    return dataclasses.replace(job, tasks=tasks[:2], start="free")


def one_arm(job):
    """Only the left arm has anything to do; the right one hangs about."""
    return dataclasses.replace(job, tasks=tuple(t for t in job.tasks if t.arm == "left"))


def one_way(job):
    """Nothing returns."""
    return dataclasses.replace(job, returns=False)


CHANGES = [
    slower_platform,
    without_jerk_limits,
    slowed,
    picked_without_approach,
    one_arm,
    one_way,
]


@pytest.mark.parametrize(
    ("changed", "method"),
    [(changed, "exact") for changed in CHANGES]
    + [pytest.param(changed, "sequence", marks=pytest.mark.slow) for changed in (*CHANGES, capped)],
)
def test_whatever_is_planned_passes_the_verifier(tasks_folder, changed, method):
    """Crowded cell, carried parts, detours: limits, lines, stillness, order and clearance by the independent judge."""
    job = load_job(tasks_folder / "07_two_shelves" / "tasks.yaml")
    job = changed(dataclasses.replace(job, tasks=job.tasks[:4]))
    schedule = plan_without_bound(job, dataclasses.replace(QUICK, platform=method))
    assert least(schedule, job) >= 0.0


def test_a_start_that_touches_is_refused_with_its_posture_and_pair(packing):
    """A ball about the left elbow link where the job starts; the search would look for a way out for a minute."""
    job = with_obstacle(packing, "sphere", (0.05,), elbow_at_home(packing))
    with pytest.raises(
        InfeasibleError, match=r"start: in posture 'home' .*thing.* lack \d+\.\d mm"
    ):
        plan_without_bound(job, QUICK)


def elbow_at_home(job):
    """Where the joint between the left arm's links is in the world."""
    robot = job.cell.robot
    model = pin.buildModelFromXML(robot.urdf)
    data = model.createData()
    home = np.array(robot.postures["home"])
    pin.forwardKinematics(model, data, home[[robot.joints.index(n) for n in model.names[1:]]])
    return (job.cell.base * data.oMi[model.getJointId("left_u")]).translation


def test_a_part_that_would_reach_into_something_where_it_is_placed_is_infeasible(tasks_folder):
    """A post of 30 mm beside the middle of the place, within the box's 30 mm on either side, whatever its turn."""
    job = load_job(tasks_folder / "06_shared_bin" / "tasks.yaml")
    target = job.tasks[0].stops[1].target.pose
    place = target.translation + target.rotation @ np.array([0.029, 0.0, 0.03])
    blocked = with_obstacle(
        dataclasses.replace(job, tasks=job.tasks[:2]), "box", (0.01, 0.01, 0.03), place
    )
    with pytest.raises(InfeasibleError, match=r"part 'box' reaches [0-9.]+ mm into 'thing'"):
        plan_without_bound(blocked, QUICK)


def test_a_part_is_turned_where_only_one_of_its_turns_fits(tasks_folder):
    """A long box beside a post: along it fits, across it does not; the plan takes a turn that does."""
    job = load_job(tasks_folder / "06_shared_bin" / "tasks.yaml")
    long = Shape("box", (0.02, 0.09, 0.06), pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.03])))
    job = dataclasses.replace(
        job, tasks=job.tasks[:2], cell=dataclasses.replace(job.cell, parts={"box": (long,)})
    )
    target = job.tasks[0].stops[1].target.pose
    beside = with_obstacle(
        job,
        "box",
        (0.01, 0.01, 0.03),
        target.translation + target.rotation @ np.array([0.0, 0.035, 0.04]),
    )
    schedule = plan_without_bound(beside, QUICK)
    assert least(schedule, beside) >= 0.0
    event = next(e for e in schedule.events if e.arm == "left" and e.action == "place")
    across = abs(float(event.pose.rotation[:, 1] @ target.rotation[:, 1]))
    assert across < 1e-6


@pytest.mark.slow
def test_detours_keep_a_cap_on_the_tools_speed_and_cost_little(tasks_folder, monkeypatch):
    """Shelves with 0.5 m/s: curves about them, timed so that no tool is faster; a quarter longer at most.

    Under a cap detours are between stops.
    """
    found, bent = blended_plan.moving_detours, []

    def noted(*args):
        bent.append(found(*args))
        return bent[-1]

    monkeypatch.setattr(blended_plan, "moving_detours", noted)
    job = load_job(tasks_folder / "07_two_shelves" / "tasks.yaml")
    job = dataclasses.replace(job, tasks=job.tasks[:4], tool_speed=0.5)
    schedule = plan_without_bound(job, QUICK)
    assert least(schedule, job) >= 0.0
    assert any("detour" in note for note in schedule.notes)
    assert bent and not any(bent)
    unchecked = plan_without_bound(job, QUICK, check_collisions=False)
    assert schedule.duration < 1.25 * unchecked.duration


def two_arms_at(job, gap):
    """The tasks of two robots with their targets so far apart, at one height between them, tools down."""
    [a, b] = [next(task for task in job.tasks if task.id == name) for name in "ab"]
    middle = np.array([0.0, 0.1, a.stops[0].target.pose.translation[2]])
    moved = []
    for task, side in ((a, -0.5), (b, 0.5)):
        pose = pin.SE3(pin.rpy.rpyToMatrix(np.pi, 0.0, 0.0), middle + side * gap * np.eye(3)[0])
        target = dataclasses.replace(task.stops[0].target, pose=pose)
        stop = dataclasses.replace(task.stops[0], target=target)
        moved.append(dataclasses.replace(task, stops=(stop,)))
    return dataclasses.replace(
        job, tasks=tuple(moved), returns=False, start="free", tool_speed=None
    )


def test_arms_whose_targets_are_too_near_are_told_by_what_they_touch(tasks_folder, monkeypatch):
    """Targets 8 cm apart, wrists 10 cm wide: the bodies, what is missing, when, and what helps.

    No transfer parts arms that touch at the end of the stage: no repair is tried.
    """
    monkeypatch.setattr(repairs, "quickest_curve", lambda *_: pytest.fail("a curve"))
    monkeypatch.setattr(repairs, "_least_delay", lambda *_: pytest.fail("a delay"))
    job = load_job(tasks_folder / "05_two_robots" / "tasks.yaml")
    with pytest.raises(InfeasibleError, match="lack") as caught:
        plan_without_bound(two_arms_at(job, 0.08), QUICK)
    text = str(caught.value)
    assert "left_" in text
    assert "right_" in text
    assert "mm of clearance" in text
    assert "take turns" in text


@pytest.mark.parametrize("method", ["sequence", "fixed"])
def test_a_plan_of_no_length_may_be_the_one_that_keeps_clear(tasks_folder, method):
    """A free start at the one target, without dwell: of its two configurations one touches the other arm."""
    job = load_job(tasks_folder / "05_two_robots" / "tasks.yaml")
    task = next(task for task in job.tasks if task.id == "c")
    [stop] = task.stops
    free = [1.5, -0.5, 0.0, -0.5, 0.0, 0.5, 0.0]
    both = np.array([stop.target.configurations[0], free])
    still = dataclasses.replace(
        stop.dwell, **{field.name: 0.0 for field in dataclasses.fields(stop.dwell)}
    )
    target = dataclasses.replace(stop.target, configurations=both)
    task = dataclasses.replace(task, stops=(dataclasses.replace(stop, target=target, dwell=still),))
    job = dataclasses.replace(job, tasks=(task,), returns=False, start="free")
    schedule = plan_without_bound(job, dataclasses.replace(QUICK, platform=method))
    assert schedule.duration == 0.0
    columns = job.cell.robot.columns(job.cell.robot.arm(task.arm).joints)
    np.testing.assert_allclose(schedule.trajectory.position[-1, columns], free)


def test_where_keeping_clear_is_dear_simpler_plans_are_looked_at(tasks_folder):
    """A method that dawdles to avoid collisions, and a simpler one that does not: its plan is taken, repaired."""
    job = load_job(tasks_folder / "07_two_shelves" / "tasks.yaml")
    job = dataclasses.replace(job, tasks=job.tasks[:2])
    model, timing = CellModel.from_cell(job.cell), TIMING_SOLVERS["ruckig"]
    problem = MethodProblem(model, job, "arm_angle")

    def found(simpler):
        def solve(asked):
            plans = choose_stages(
                MethodProblem(model, job, "arm_angle", holding=asked.holding), "exact"
            )
            if asked.holding is None:
                return Decided(plans)
            late = [dataclasses.replace(plan, waits={"left": 2.0}) for plan in plans]
            return Decided(late, simpler=simpler and (lambda: simpler(plans)))

        return quickest_clear(problem, solve, timing)

    quick, slow = found(lambda plans: [plans]), found(None)
    assert not quick.cleared.blocked
    assert quick.cost < slow.cost - 1.0
    # Where the simpler methods have no plan, the method's own one counts.
    assert found(lambda _: []).cost == slow.cost


@pytest.mark.parametrize("lesser", ["quicker", "slower", "none"])
def test_where_keeping_clear_is_dear_more_effort_is_no_slower_than_less(tasks_folder, lesser):
    """The plan of normal effort waits for 2 s, that of quick effort not at all, for longer, or there is none."""
    job = load_job(tasks_folder / "07_two_shelves" / "tasks.yaml")
    job = dataclasses.replace(job, tasks=job.tasks[:2])
    model, timing = CellModel.from_cell(job.cell), TIMING_SOLVERS["ruckig"]

    def found(effort):
        def solve(asked):
            if asked.effort == "quick" and lesser == "none":
                raise InfeasibleError(Refusal("no_plan_on_grid"))
            plans = choose_stages(
                MethodProblem(model, job, "arm_angle", holding=asked.holding), "exact"
            )
            wait = {"normal": 2.0, "quick": 0.0 if lesser == "quicker" else 4.0}[asked.effort]
            if asked.holding is not None:
                plans = [dataclasses.replace(plan, waits={"left": wait}) for plan in plans]
            return Decided(plans)

        problem = MethodProblem(model, job, "arm_angle", effort=effort)
        return quickest_clear(problem, solve, timing)

    normal = found("normal").cleared.motion.trajectory.duration
    if lesser == "none":
        assert normal > 2.0 * len(job.stages())
    else:
        quick = found("quick").cleared.motion.trajectory.duration
        assert normal <= quick
        assert (normal == quick) is (lesser == "quicker")


@pytest.mark.parametrize(("proposals", "rounds"), [("the same", 2), ("by turns", 12)])
def test_rounds_end_where_nothing_new_is_proposed_or_after_twelve(packing, proposals, rounds):
    """A ball about a target, and a method that knows no obstacles: one plan, or two of different postures by turns."""
    job = dataclasses.replace(packing, tasks=packing.tasks[:1])
    model, timing = CellModel.from_cell(job.cell), TIMING_SOLVERS["ruckig"]
    plans = [
        choose_stages(MethodProblem(model, job, "arm_angle"), name)
        for name in ("fixed", "minimum_time")
    ]
    if proposals == "the same":
        plans = plans[:1]
    target = model.tool_position(job.tasks[0].arm, plans[0][0].arrival)
    job = with_obstacle(job, "sphere", (0.1,), target)
    asked = []

    def solve(problem):
        asked.append(problem)
        return Decided(plans[len(asked) % len(plans)])

    problem = MethodProblem(CellModel.from_cell(job.cell), job, "arm_angle")
    with pytest.raises(BlockedError):
        quickest_clear(problem, solve, timing)
    # The first plan is made without collision checking; after each round there is something new to avoid.
    assert len(asked) == 1 + rounds
    assert [one.holding is None for one in asked] == [True] + rounds * [False]
    assert not asked[1].no_goods
    counts = [len(one.no_goods) for one in asked[1:]]
    assert counts == sorted(set(counts))


def test_a_start_that_collides_names_all_pairs_at_once(packing):
    """Home without allowed contacts, and with a ball about the left tool: coal finds the same pairs."""
    tool = CellModel.from_cell(packing.cell).tool_position("left", packing.start_joints)
    job = with_obstacle(packing, "sphere", (0.15,), tool)
    robot = dataclasses.replace(job.cell.robot, allowed_contacts=())
    job = dataclasses.replace(job, cell=dataclasses.replace(job.cell, robot=robot))
    with pytest.raises(InfeasibleError) as refused:
        plan_without_bound(job, QUICK)
    # Links that are near each other in every posture have a refusal of their own.
    never, refusal = (
        next(one for one in refused.value.refusals if one.key == key)
        for key in ("never_clear", "start_touches")
    )
    named = [
        frozenset((pair.data["body_a"], pair.data["body_b"]))
        for listed in (never, refusal)
        for pair in listed.data["pairs"]
    ]
    model = pin.buildModelFromXML(robot.urdf)
    solids = cell_solids(job.cell, model, [])
    pairs = pairs_that_must_keep_apart(model, solids, job.cell)
    geometry = geometry_model(solids, [(pair.first, pair.second) for pair in pairs])
    data, found = model.createData(), pin.GeometryData(geometry)
    pin.computeDistances(model, data, geometry, found, np.asarray(job.start_joints))
    lacking = {
        frozenset((solids[pair.first].label, solids[pair.second].label))
        for pair, result in zip(pairs, found.distanceResults, strict=True)
        if result.min_distance < pair.required
    }
    assert set(named) == lacking
    assert len(named) == len(lacking) > 2
    margins = [pair.measured for pair in refusal.data["pairs"]]
    assert margins == sorted(margins, reverse=True)


def test_a_stage_is_judged_anew_with_every_way_of_passing_its_lines(packing):
    """Four stages, then the same with lines that are passed in motion: whether those collide is not known yet."""
    job = dataclasses.replace(packing, tasks=packing.tasks[:2])
    model, timing = CellModel.from_cell(job.cell), TIMING_SOLVERS["ruckig"]
    plans = choose_stages(MethodProblem(model, job, "arm_angle"), "fixed")
    drive = Drive.of(model, job, timing)
    clearing = Clearing(model, job, Holding.of(job), timing, 0, MotionCache())
    ways = passing_launches(drive, plans)
    assert {k for k, _ in ways} >= {1, 2}
    for chosen in ({}, ways, {key: way for key, way in ways.items() if key[0] == 1}):
        own = with_launches(plans, chosen)
        motion = realise(model, job, own, timing)
        fresh = Clearing(model, job, Holding.of(job), timing, 0, MotionCache())
        assert clearing.colliding_stages(own, motion) == fresh.colliding_stages(own, motion)
    # With no way, with all of them, and the first two stages with those about the second stage's transfers.
    assert len(clearing.seen) == 2 * len(plans) + 2


@pytest.mark.parametrize("slow", [False, True])
def test_known_launches_are_those_of_plans_timed_alone(packing, slow, monkeypatch):
    """Plans of two methods, one with stages of both, and the first one again: one cache for all against none.

    The last time no launches are chosen but those of the return, or all where a tool's speed is limited.
    """
    job = dataclasses.replace(packing, tasks=packing.tasks[:4], returns=True)
    job = dataclasses.replace(job, tool_speed=1.0 if slow else None)
    model, timing = CellModel.from_cell(job.cell), TIMING_SOLVERS["ruckig"]
    problem, shared = MethodProblem(model, job, "arm_angle"), Drive.of(model, job, timing)
    plain, fast = (choose_stages(problem, name) for name in ("fixed", "exact"))
    mixed = [*plain[:2], dataclasses.replace(fast[2], start=plain[2].start), *fast[3:]]
    for plans, widths in product((plain, fast, mixed, plain), (0, 2)):
        alone = passing_launches(Drive.of(model, job, timing), plans, (), widths)
        assert alone
        assert passing_launches(shared, plans, (), widths) == alone
    chosen = []
    blends = blending._blends
    monkeypatch.setattr(blending, "_blends", lambda *a: chosen.append(a[2]) or blends(*a))
    passing_launches(shared, plain, (), 2)
    assert {bool(plan.stops) for plan in chosen} == ({False, True} if slow else {False})


@pytest.mark.parametrize("copied", [False, True])
def test_transfers_in_motion_are_timed_once(packing, copied, monkeypatch):
    """Six stages: what chose their ways has timed all transfers, whichever process it was; the motion is the same."""
    model, timing = CellModel.from_cell(packing.cell), TIMING_SOLVERS["ruckig"]
    plans = choose_stages(MethodProblem(model, packing, "arm_angle"), "fixed")
    drive = Drive.of(model, packing, timing)
    with allow_workers(copied):
        own = with_launches(plans, passing_launches(drive, plans))
    assert sum(len(plan.passes) for plan in own) >= 4
    apart = realise(model, packing, own, timing).trajectory

    def refused(problem):
        raise AssertionError(f"{problem} is timed again")

    monkeypatch.setattr("dualarm_cli.motion.transfers.solve_moving_transfer", refused)
    together = realise(model, packing, own, timing, drive.cache).trajectory
    np.testing.assert_array_equal(together.time, apart.time)
    np.testing.assert_array_equal(together.position, apart.position)
