"""Plans from task files: verified, as fast as their closed forms, the same every time."""

from __future__ import annotations

import dataclasses

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.errors import InfeasibleError, UnknownSolverError, UnsupportedError
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import PoseTarget
from dualarm_cli.model.motion.rest_to_rest import RestToRest
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan, plan_without_bound
from dualarm_cli.stages.method import MethodProblem
from dualarm_cli.verification import verify
from tests.packing_tasks import packing_job

JOBS = [
    "01_first_pick",
    "02_two_trays",
    "03_bottin_planar",
    "04_packing",
    "05_two_robots",
    "13_hand_over",
]


@pytest.fixture(scope="module")
def packing(tasks_folder):
    """The packing job, its first eight tasks."""
    return packing_job(tasks_folder, 8)


@pytest.mark.parametrize("name", JOBS)
def test_every_shipped_job_gives_a_verified_plan(tasks_folder, quick_plan, name):
    """All checks pass, against the files and not only against what the schedule says."""
    job = load_job(tasks_folder / name / "tasks.yaml")
    verification = verify(quick_plan(name), job)
    assert verification.passed, verification.failures
    passed = {check.name for check in verification.checks if check.verdict == "passed"}
    assert {"order", "return", "jerk", "tool_position_at_events"} <= passed
    # The planar job has bare moves, so no line to be straight.
    assert ("lines_straight" in passed) == (name != "03_bottin_planar")


@pytest.mark.parametrize("platform", ["fixed", "linearised", "exact"])
def test_every_platform_solver_gives_a_verified_plan(packing, platform):
    """One contract test for all members of the family."""
    schedule = plan_without_bound(packing, PlanSettings(platform=platform), check_collisions=False)
    assert verify(schedule, packing).passed
    angles = {stage.platform_angle for stage in schedule.stages}
    assert (len(angles) == 1) == (platform == "fixed")


def test_transfers_last_as_long_as_their_slowest_joint(packing):
    """With all stops each arm's transfer takes the closed form of its own slowest joint or of the platform."""
    schedule = plan_without_bound(packing, PlanSettings(platform="exact", blend="none"))
    robot = packing.cell.robot
    law = RestToRest(robot.limits.velocity, robot.limits.acceleration, robot.limits.jerk)
    platform = robot.columns(robot.platform)
    checked = 0
    for segment in schedule.segments:
        if segment.kind != "transfer":
            continue
        q = schedule.trajectory.at(np.array([segment.start, segment.end]))[0]
        alone = law.per_joint(q[1] - q[0])
        own = robot.columns(robot.arm(segment.arm).joints)
        # The platform may still be turning when an arm with nothing to wait for has arrived, but here both work.
        expected = max(alone[own].max(), alone[platform].max())
        assert segment.end - segment.start == pytest.approx(expected, rel=1e-9)
        checked += 1
    assert checked == 16


@pytest.mark.parametrize(
    "name",
    [name if name != "04_packing" else pytest.param(name, marks=pytest.mark.slow) for name in JOBS],
)
def test_the_default_is_never_slower_than_a_simpler_method(tasks_folder, quick_plan, name):
    """Exactly timed, on every shipped job, whatever simpler method serves it."""
    job = load_job(tasks_folder / name / "tasks.yaml")
    model = CellModel.from_cell(job.cell)
    default = quick_plan(name)
    for simpler in MethodProblem(model, job, "arm_angle").simpler:
        found = plan_without_bound(job, PlanSettings(platform=simpler))
        assert default.duration <= found.duration + 1e-9


def test_more_effort_says_so_and_finds_a_plan_of_its_own(packing):
    """The grid's gap stands beside the plan, and a greedy method has none."""
    schedule = plan_without_bound(packing, PlanSettings(effort="quick"), check_collisions=False)
    assert schedule.provenance.settings["effort"] == "quick"
    assert 0.0 <= schedule.grid_gap < 0.1
    fixed = plan_without_bound(packing, PlanSettings(platform="fixed"), check_collisions=False)
    assert fixed.grid_gap is None


def test_the_same_job_gives_the_same_numbers(packing):
    """Two runs, every knot equal bit for bit."""
    job = dataclasses.replace(packing, tasks=packing.tasks[:2])
    one, two = (plan_without_bound(job, PlanSettings()) for _ in range(2))
    for name in ("time", "position", "velocity", "acceleration"):
        assert np.array_equal(getattr(one.trajectory, name), getattr(two.trajectory, name))


def test_half_speed_moves_take_twice_as_long_and_dwells_as_long_as_before(packing):
    """`speed` scales limits so that the same postures are passed at half the pace."""
    job = dataclasses.replace(packing, returns=False)
    slow = dataclasses.replace(job, speed=0.5)
    fixed = PlanSettings(platform="fixed")
    full, half = (plan_without_bound(j, fixed, check_collisions=False) for j in (job, slow))
    assert verify(half, slow).passed

    def lengths(schedule, kinds):
        return np.array([s.end - s.start for s in schedule.segments if s.kind in kinds])

    dwells = lengths(full, {"dwell"})
    assert np.allclose(lengths(half, {"dwell"}), dwells)
    assert half.duration > 1.7 * (full.duration - dwells.sum() / 2)


def test_a_tool_speed_cap_is_kept_and_costs_time(packing):
    """0.5 m/s: the verifier measures at most that, and the cycle gets longer."""
    capped = dataclasses.replace(packing, tool_speed=0.5)
    free, slow = (
        plan_without_bound(packing, PlanSettings(platform="exact"), check_collisions=False),
        plan_without_bound(capped, PlanSettings(platform="exact"), check_collisions=False),
    )
    verification = verify(slow, capped)
    assert verification.passed, verification.failures
    speed = next(check for check in verification.checks if check.name == "tool_speed")
    assert 0.45 < speed.measured <= 0.5 * (1 + 1e-4)
    assert slow.duration > free.duration


@pytest.mark.parametrize("timing", ["toppra", "trapezoid", "ruckig"])
def test_robots_without_jerk_limits_are_timed_by_every_method(packing, timing):
    """Jumps of acceleration are double knots; the plan passes the same verification."""
    robot = packing.cell.robot
    limits = dataclasses.replace(robot.limits, jerk=np.full(len(robot.joints), np.inf))
    cell = dataclasses.replace(packing.cell, robot=dataclasses.replace(robot, limits=limits))
    job = dataclasses.replace(packing, cell=cell, tasks=packing.tasks[:2])
    settings = PlanSettings(platform="fixed", timing=timing)
    verification = verify(plan_without_bound(job, settings), job)
    assert verification.passed, verification.failures


def test_timing_that_knows_no_jerk_is_refused_where_jerk_is_limited(packing):
    """The robot and the joints are named."""
    with pytest.raises(UnsupportedError, match=r"timing toppra cannot plan Yaskawa.*15 joints"):
        plan(packing, PlanSettings(timing="toppra"))


@pytest.mark.parametrize("field", ["platform", "redundancy", "timing"])
def test_unknown_solvers_are_named_with_the_known_ones(packing, field):
    """The error lists what there is."""
    with pytest.raises(UnknownSolverError, match="there is no 'exat'"):
        plan(packing, PlanSettings(**{field: "exat"}))


def test_an_unreachable_target_names_the_task_its_place_and_the_miss(tasks_folder, tmp_path):
    """Three metres away: exit 3 with file:line and millimetres."""
    (tmp_path / ".git").mkdir()
    (tmp_path / "cell.yaml").write_text("dualarm: cell/1\nrobot: sda10f\n")
    text = (
        "dualarm: tasks/1\ncell: cell.yaml\nmode: paired\norder: given\nreturn: true\ntasks:\n"
        "  - id: far\n    arm: left\n    pick: {xyz: [3, 0, 1], rpy: [180 deg, 0, 0]}\n"
        "    place: {xyz: [0.5, 0.3, 1], rpy: [180 deg, 0, 0]}\n"
    )
    (tmp_path / "tasks.yaml").write_text(text)
    job = load_job(tmp_path / "tasks.yaml")
    with pytest.raises(InfeasibleError) as caught:
        plan(job, PlanSettings())
    message = str(caught.value)
    assert caught.value.exit_code == 3
    assert "tasks.yaml:9:" in message
    assert "task 'far': left arm cannot pick" in message
    assert "mm beyond the arm's reach" in message


def test_a_target_behind_the_robot_makes_the_platform_turn(tmp_path):
    """Only one arm works, so no elbows are to be balanced: the nearest reachable angle is taken."""
    (tmp_path / ".git").mkdir()
    (tmp_path / "cell.yaml").write_text("dualarm: cell/1\nrobot: sda10f\n")
    text = (
        "dualarm: tasks/1\ncell: cell.yaml\nmode: paired\norder: given\nreturn: true\n"
        "tasks:\n  - {id: behind, arm: left, move: {xyz: [-0.3, -0.6, 1.0], rpy: [180 deg, 0, 0], free: yaw}}\n"
    )
    (tmp_path / "tasks.yaml").write_text(text)
    job = load_job(tmp_path / "tasks.yaml")
    schedule = plan(job, PlanSettings(platform="exact"))
    assert schedule.stages[0].platform_solver == "reach"
    assert abs(schedule.stages[0].platform_angle) > 0.5
    assert verify(schedule, job).passed


def test_an_arm_without_work_stays_where_it_is(tasks_folder):
    """In 05 the right arm has one task, the left three: the right one, if it need not make way, stands still later."""
    job = load_job(tasks_folder / "05_two_robots" / "tasks.yaml")
    schedule = plan_without_bound(job, PlanSettings(effort="quick"), check_collisions=False)
    start, end = schedule.stages[2].start, schedule.stages[4].end
    right = [k for k, name in enumerate(schedule.trajectory.joints) if name.startswith("right")]
    q, v, _ = schedule.trajectory.at(np.linspace(start, end, 200))
    assert np.ptp(q[:, right], axis=0).max() < 1e-12
    assert np.abs(v[:, right]).max() < 1e-12


@pytest.mark.parametrize("line", [0.0, 0.04])
@pytest.mark.parametrize(
    "joints",
    [[0.3, 0.4, 0.4, 0.5, 0.2, 0.0, 0.3], [0.3, 0.0, 0.4, 0.5, 0.2, 0.4, 0.3], [0.1] * 7],
)
def test_joint_targets_are_taken_as_given(packing, joints, line):
    """Also with a straight wrist or shoulder, whose pose has other postures; with lines or a clear refusal."""
    from dualarm_cli.model.job import JointTarget

    first = packing.tasks[0]
    stop = dataclasses.replace(
        first.stops[0], target=JointTarget(np.array([joints])), approach=line, retract=line
    )
    task = dataclasses.replace(first, stops=(stop,))
    job = dataclasses.replace(packing, tasks=(task,))
    try:
        schedule = plan_without_bound(job, PlanSettings(effort="quick"))
    except InfeasibleError as error:
        assert line > 0
        assert "no given configuration can follow" in str(error)
    else:
        verification = verify(schedule, job)
        assert verification.passed, verification.failures
        columns = job.cell.robot.columns(job.cell.robot.arm(task.arm).joints)
        q = schedule.trajectory.at(np.array([schedule.events[0].time]))[0][0, columns]
        assert np.abs(q - joints).max() < 1e-9


def test_joint_targets_of_both_arms_leave_the_platform_alone(packing):
    """They turn with it: no angle changes an elbow."""
    from dualarm_cli.model.job import JointTarget

    tasks = []
    for task, q in zip(packing.tasks[:2], ([0.3] * 7, [0.5] * 7), strict=True):
        target = JointTarget(np.array([q]))
        stop = dataclasses.replace(task.stops[0], target=target, approach=0.0, retract=0.0)
        tasks.append(dataclasses.replace(task, stops=(stop,)))
    job = dataclasses.replace(packing, tasks=tuple(tasks))
    schedule = plan(job, PlanSettings(platform="exact"))
    assert {stage.platform_angle for stage in schedule.stages} == {0.0}


def test_picks_without_a_dwell_are_noted(packing):
    """A gripper that takes no time flatters the cycle."""
    from dualarm_cli.model.dwell import Dwell

    first = packing.tasks[0]
    hasty = dataclasses.replace(
        first, stops=tuple(dataclasses.replace(stop, dwell=Dwell()) for stop in first.stops)
    )
    job = dataclasses.replace(packing, tasks=(hasty, *packing.tasks[1:2]))
    fixed = PlanSettings(platform="fixed")
    notes = plan_without_bound(job, fixed, check_collisions=False).notes
    said = f"2 picks and places take no time ({first.id} (pick), {first.id} (place))"
    assert any(said in note for note in notes)
    others = plan_without_bound(packing, fixed, check_collisions=False).notes
    assert not any("no time (" in note for note in others)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(40))
def test_random_jobs_are_verified_or_refused(packing, seed):
    """Random targets around the robot: a plan that passes, or an error that names a task."""
    import pinocchio as pin

    from dualarm_cli.model.job import PoseTarget

    rng = np.random.default_rng(seed)

    def target():
        r, a, z = rng.uniform(0.45, 0.8), rng.uniform(-1.2, 1.2), rng.uniform(0.75, 1.1)
        pose = pin.SE3(
            pin.rpy.rpyToMatrix(np.pi, 0, rng.uniform(-3, 3)),
            np.array([r * np.cos(a), r * np.sin(a), z]),
        )
        return PoseTarget(pose, bool(rng.random() < 0.5), int(rng.integers(1, 4)))

    tasks = tuple(
        dataclasses.replace(
            task, stops=tuple(dataclasses.replace(s, target=target()) for s in task.stops)
        )
        for task in packing.tasks
    )
    job = dataclasses.replace(packing, tasks=tasks)
    try:
        schedule = plan(job, PlanSettings())
    except InfeasibleError as error:
        assert "task '" in str(error)
    else:
        verification = verify(schedule, job)
        assert verification.passed, verification.failures


@pytest.mark.full_effort
def test_room_for_blending_is_one_candidate_among_others(tasks_folder):
    """A verified plan of 3.4348 s was found with joints up to their limits; with room all plans took 3.61 s."""
    job = load_job(tasks_folder / "01_first_pick" / "tasks.yaml")
    schedule = plan_without_bound(job, PlanSettings(effort="quick"))
    assert verify(schedule, job).passed
    assert schedule.duration <= 3.4348
    # What is gained counts from the plan with stops that it was made from.
    assert 0.0 < schedule.blend_gain < schedule.duration


@pytest.mark.full_effort
def test_no_jerk_limit_is_not_slower_than_a_loose_one(tasks_folder):
    """A plan within jerk limits is within none; lines' ends once took 30 % longer without than estimated."""
    job = load_job(tasks_folder / "01_first_pick" / "tasks.yaml")
    robot = job.cell.robot

    def cycle(jerk):
        limits = dataclasses.replace(robot.limits, jerk=jerk)
        cell = dataclasses.replace(job.cell, robot=dataclasses.replace(robot, limits=limits))
        asked = dataclasses.replace(job, cell=cell)
        return plan_without_bound(asked, PlanSettings(effort="quick")).duration

    loose = cycle(robot.limits.acceleration / 0.01)
    assert cycle(np.full(len(robot.joints), np.inf)) <= loose


@pytest.mark.full_effort
def test_under_a_cap_on_tool_speed_no_simpler_method_is_faster(packing):
    """A short move at 10 mm/s: the search knows no cap, so that the simplest plan must win; the cap is named."""
    [task] = [task for task in packing.tasks if task.arm == "left"][:1]
    pose = pin.SE3(pin.rpy.rpyToMatrix(np.pi, 0.0, 0.0), np.array([0.45, 0.3, 0.9]))
    stop = dataclasses.replace(
        task.stops[0], action="move", target=PoseTarget(pose), approach=0.0, retract=0.0
    )
    job = dataclasses.replace(
        packing, tasks=(dataclasses.replace(task, stops=(stop,)),), tool_speed=0.01
    )
    found = {
        name: plan_without_bound(job, PlanSettings(platform=name, effort="quick"))
        for name in ("sequence", "fixed", "minimum_time")
    }
    least = min(schedule.duration for schedule in found.values())
    assert found["sequence"].duration == pytest.approx(least, abs=1e-9)
    assert {stage.bottleneck for stage in found["sequence"].stages} == {"tool_speed"}
