"""The quickest single stage: never slower than other angles, and near brute force over everything."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import JointTarget, PoseTarget
from dualarm_cli.motion.motion import realise
from dualarm_cli.postures.stage_plan import StagePlan
from dualarm_cli.postures.stage_problems import Clock
from dualarm_cli.stages import minimum_time_move as move
from dualarm_cli.stages.method import MethodProblem
from dualarm_cli.stages.minimum_time_move import MINIMUM_TIME, choose_quickest
from dualarm_cli.stages.stage_by_stage import choose_stages, choose_stages_with
from dualarm_cli.stages.stage_choice import OpenStage, choose_stage
from dualarm_cli.timing import TIMING_SOLVERS

SIMPLER = ["fixed", "exact", "linearised"]


@pytest.fixture(scope="module")
def packing(tasks_folder):
    """The packing job."""
    return load_job(tasks_folder / "04_packing" / "tasks.yaml")


@pytest.fixture(scope="module")
def model(packing):
    """Its cell."""
    return CellModel.from_cell(packing.cell)


def random_job(
    packing, seed, *, stages=2, line=0.0, free=False, symmetry=1, arms=("left", "right")
):
    """Bare moves to random places around the robot, tools down."""
    rng = np.random.default_rng(seed)
    tasks = []
    for task in packing.tasks:
        if task.arm not in arms or sum(t.arm == task.arm for t in tasks) == stages:
            continue
        side = 1.0 if task.arm == "left" else -1.0
        r, azimuth = rng.uniform(0.45, 0.8), side * rng.uniform(0.0, 1.3)
        place = np.array([r * np.cos(azimuth), r * np.sin(azimuth), rng.uniform(0.7, 1.0)])
        pose = pin.SE3(pin.rpy.rpyToMatrix(np.pi, 0.0, rng.uniform(-np.pi, np.pi)), place)
        stop = dataclasses.replace(
            task.stops[0], target=PoseTarget(pose, free, symmetry), approach=line, retract=line
        )
        tasks.append(dataclasses.replace(task, stops=(stop,)))
    return dataclasses.replace(packing, tasks=tuple(tasks), returns=False)


def stage_of(model, job, number=0):
    """One stage of a job, and where it starts from."""
    stage = OpenStage(model, Clock.of(model, job), job.stages()[number], True, None, "arm_angle")
    return stage, np.array(job.cell.robot.postures["home"])


KINDS = {
    "bare": {},
    "lines": {"line": 0.06},
    "free yaw": {"free": True},
    "free yaw and lines": {"free": True, "line": 0.06},
    "symmetric": {"symmetry": 2},
    "left arm alone": {"arms": ("left",)},
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(2))
def test_no_simpler_solver_makes_a_quicker_stage_from_the_same_position(packing, model, kind, seed):
    """Stage by stage along its own plan; ever the same for the same start."""
    job = random_job(packing, seed, **KINDS[kind])
    for number, plan in enumerate(
        choose_stages(MethodProblem(model, job, "arm_angle"), MINIMUM_TIME)
    ):
        assert plan.solver == MINIMUM_TIME
        stage, _ = stage_of(model, job, number)
        others = choose_stage(stage, dict.fromkeys(SIMPLER, plan.start))
        for other in others.values():
            if isinstance(other, StagePlan):
                assert plan.duration <= other.duration + 1e-9
        again = choose_quickest(stage, np.array(plan.start))
        assert again.duration == plan.duration


@pytest.mark.parametrize("seed", range(5))
def test_brute_force_over_angles_and_arm_angles_is_hardly_quicker(packing, model, seed):
    """Every 2 degrees of the platform, every 3 degrees of the arm angle, all branches, no lines: within 1 %."""
    job = random_job(packing, seed)
    stage, home = stage_of(model, job)
    plan = choose_quickest(stage, home)
    limits = job.cell.robot.limits
    column = model.platform_columns[0]
    angles = np.radians(np.arange(-180.0, 180.0, 2.0))
    angles = angles[(angles > limits.lower[column]) & (angles < limits.upper[column])]
    psi = np.radians(np.arange(0.0, 360.0, 3.0))
    least = np.zeros(len(angles))
    problems = dataclasses.replace(stage, refine=False).from_position(home, angles[:, None])
    for name in stage.work:
        own = np.full(len(angles), np.inf)
        for k, at in enumerate(problems):
            one = at[name]
            R = one.R_base_tool[0] @ one.R_tool_flange
            p = one.p_base_tool[0] + one.R_base_tool[0] @ one.p_tool_flange
            found = one.arm.solve(R, p, psi)
            q = one.arm.nearest_turns(found.q, one.start)
            ok = one.arm.within_limits(q) & found.reachable[:, None]
            if ok.any():
                own[k] = max(one.waiting, one.transfer_time(q[ok] - one.start).min())
        least = np.maximum(least, own + stage.work[name][1].dwell.total)
    assert plan.duration <= 1.01 * least.min()
    # And it is a stage that can really be made, not a number.
    assert plan.duration >= 0.9 * least.min()


def test_its_stages_last_as_long_as_the_exact_motion(packing, model):
    """Without lines every stage is the closed form of what ruckig makes of it."""
    job = random_job(packing, 11, stages=3)
    plans = choose_stages(MethodProblem(model, job, "arm_angle"), MINIMUM_TIME)
    made = realise(model, job, plans, TIMING_SOLVERS["ruckig"])
    for plan, stage in zip(plans, made.stages, strict=True):
        assert plan.duration == pytest.approx(stage.end - stage.start, rel=1e-9)


def test_joint_targets_leave_the_platform_where_it_is(packing, model):
    """Every angle is as quick as long as the platform is not the slower one: of those the shortest way."""
    job = random_job(packing, 3, stages=1)
    tasks = []
    for task, q in zip(job.tasks, ([0.3] * 7, [0.5] * 7), strict=True):
        stop = dataclasses.replace(task.stops[0], target=JointTarget(np.array([q])))
        tasks.append(dataclasses.replace(task, stops=(stop,)))
    plans = choose_stages(
        MethodProblem(model, dataclasses.replace(job, tasks=tuple(tasks)), "arm_angle"),
        MINIMUM_TIME,
    )
    assert plans[0].arrival[model.platform_columns] == pytest.approx([0.0], abs=1e-12)


def test_a_robot_without_a_platform_gets_what_the_fixed_one_gives(tasks_folder):
    """Two robots on bases of their own."""
    job = load_job(tasks_folder / "05_two_robots" / "tasks.yaml")
    model = CellModel.from_cell(job.cell)
    found = choose_stages_with(MethodProblem(model, job, "arm_angle"), ["fixed", MINIMUM_TIME])
    for one, other in zip(found["fixed"], found[MINIMUM_TIME], strict=True):
        assert other.arrival == pytest.approx(one.arrival, abs=1e-9)
        assert other.solver == (MINIMUM_TIME if other.stops else "return")


def test_one_arm_at_work_may_turn_the_platform_too(packing, model):
    """A target beside the robot: turning towards it is quicker than reaching for it, and the platform does turn."""
    plans = [
        choose_stages(
            MethodProblem(model, random_job(packing, seed, stages=1, arms=("left",)), "arm_angle"),
            name,
        )
        for seed in range(6)
        for name in ("fixed", MINIMUM_TIME)
    ]
    fixed, ours = plans[::2], plans[1::2]
    assert sum(b[0].duration < a[0].duration - 1e-3 for a, b in zip(fixed, ours, strict=True)) >= 2


def test_the_platform_keeps_its_limits(packing, model):
    """A platform that may hardly turn does not turn farther."""
    robot = packing.cell.robot
    lower, upper = robot.limits.lower.copy(), robot.limits.upper.copy()
    column = model.platform_columns[0]
    lower[column], upper[column] = -0.1, 0.07
    limits = dataclasses.replace(robot.limits, lower=lower, upper=upper)
    cell = dataclasses.replace(packing.cell, robot=dataclasses.replace(robot, limits=limits))
    narrow = CellModel.from_cell(cell)
    for seed in range(3):
        job = dataclasses.replace(random_job(packing, seed), cell=cell)
        for plan in choose_stages(MethodProblem(narrow, job, "arm_angle"), MINIMUM_TIME):
            assert -0.1 <= plan.arrival[column] <= 0.07


def test_a_free_start_takes_no_transfer(packing, model):
    """The first stage lasts its lines and its dwell only, whoever plans it."""
    job = dataclasses.replace(random_job(packing, 1, line=0.05), start="free")
    for plans in choose_stages_with(
        MethodProblem(model, job, "arm_angle"), ["fixed", MINIMUM_TIME]
    ).values():
        made = realise(model, job, plans, TIMING_SOLVERS["ruckig"])
        first = made.stages[0]
        assert plans[0].duration == pytest.approx(first.end - first.start, rel=0.08)
        assert plans[0].start == pytest.approx(plans[0].arrival)


def test_an_unreachable_target_is_refused_with_its_place(packing, model):
    """As every platform solver does."""
    job = random_job(packing, 0, stages=1)
    target = job.tasks[0].stops[0].target
    pose = target.pose.copy()
    pose.translation[:] = [10.0, 0.0, 1.0]
    stop = dataclasses.replace(job.tasks[0].stops[0], target=PoseTarget(pose))
    task = dataclasses.replace(job.tasks[0], stops=(stop,))
    far = dataclasses.replace(job, tasks=(task, *job.tasks[1:]))
    with pytest.raises(InfeasibleError, match=re.escape(f"task '{task.id}'")):
        choose_stages(MethodProblem(model, far, "arm_angle"), MINIMUM_TIME)


@pytest.mark.parametrize("seed", range(4))
def test_without_grid_and_brackets_it_is_the_best_of_the_simpler_ones(
    packing, model, seed, monkeypatch
):
    """What is certain does not hang on what is searched besides."""
    stage, home = stage_of(model, random_job(packing, seed, line=0.06))
    monkeypatch.setattr(move, "_promising", lambda *_: np.zeros(0))
    monkeypatch.setattr(move, "MOVE", dataclasses.replace(move.MOVE, zoom_rounds=0))
    others = choose_stage(stage, dict.fromkeys(SIMPLER, home))
    least = min(plan.duration for plan in others.values() if isinstance(plan, StagePlan))
    assert choose_quickest(stage, home).duration == pytest.approx(least, abs=1e-9)


def test_brackets_gain_and_never_lose(packing, model, monkeypatch):
    """Also where all that a bracket holds is a degree or five away from the best so far."""
    gained = []
    for seed in range(5):
        stage, home = stage_of(model, random_job(packing, seed, line=0.06 * (seed % 2)))
        plans = choose_stage(stage, dict.fromkeys(SIMPLER, home))
        for plan in plans.values():
            gained.append(plan.duration - move._zoomed(stage, home, plan).duration)
    assert min(gained) >= 0.0
    assert np.mean(np.array(gained) > 1e-3) > 0.5
    for places in ([0.2], [1.0], [-1.0]):
        monkeypatch.setattr(move, "MOVE", dataclasses.replace(move.MOVE, zoom=tuple(places)))
        best = choose_quickest(stage, home)
        assert move._zoomed(stage, home, best).duration <= best.duration + 1e-9
