"""Postures of general arms in the search over the whole sequence: what they mean, and that nothing is lost."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.dwell import Dwell
from dualarm_cli.model.job import JointTarget, Place, PoseTarget, Stop, Task
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.stages.plans import general
from dualarm_cli.stages.plans.candidates import Grid, flange_poses, platform_positions
from dualarm_cli.stages.plans.source import grid_nodes, postures
from dualarm_cli.stages.plans.times import evaluate
from dualarm_cli.stages.search.corridor import best_combination
from dualarm_cli.stages.search.node_plans import grid_angles, own_node
from dualarm_cli.stages.search.search import search
from dualarm_cli.stages.search.variables import Variables
from dualarm_cli.stages.sequence_problem import sequence_problem
from dualarm_cli.verification import verify

PLACE = Place("test", 1, 1)


@pytest.fixture
def numeric(random_job):
    """Random sequences of the SDA10F, whose arms are then measured as general ones."""

    def make(*args, **options):
        job = random_job(*args, **options)
        return sequence_problem(CellModel.from_cell(job.cell, numeric=True), job)

    return make


@pytest.mark.parametrize("free_yaw", [False, True])
def test_nodes_reach_their_targets_and_the_ends_of_their_lines(numeric, free_yaw):
    """By forward kinematics: at every node the flange is where target, yaw and platform angle ask for it."""
    problem = numeric(3, (1, 1), line=0.05, free_yaw=free_yaw)
    angles = grid_angles(problem, np.radians(30.0))
    for a, work in enumerate(problem.arms):
        nodes = grid_nodes(problem, a, 0, Grid(angles, 12, 400))
        assert len(nodes.work) > 20
        assert (np.diff(nodes.angle_index) >= 0).all()
        rows = np.full(len(nodes.work), work.stop_table.first[0])
        at = platform_positions(problem, angles[nodes.angle_index])
        R, p, outward = flange_poses(problem.platform, work, rows, nodes.decisions.yaw, at)
        for q, away in (
            (nodes.q_target, 0.0),
            (nodes.q_approach, 0.05),
            (nodes.q_retract, 0.05),
        ):
            assert work.kinematics.within_limits(q).all()
            R_found, p_found = work.kinematics.forward(q)
            assert np.abs(R_found - R).max() < 1e-8
            assert np.abs(p_found - (p + away * outward[:, 0])).max() < 1e-8


def test_what_was_evaluated_means_the_same_again(numeric):
    """Ways along the self-motion are counted from the posture found: evaluating that moves nothing."""
    problem = numeric(1, (3, 2), line=0.05)
    best = search(problem, [], "quick", 0).best
    variables = Variables.of(problem)
    step = np.random.default_rng(0).normal(scale=0.01, size=variables.count)
    moved = evaluate(problem, variables.moved(best.decisions, step))
    again = evaluate(problem, moved.decisions)
    assert np.isfinite(moved.stages[1:]).all()
    assert again.stages == pytest.approx(moved.stages, abs=1e-9)
    for one, other in zip(moved.arms, again.arms, strict=True):
        for name in ("q_approach", "q_target", "q_retract"):
            apart = np.abs(getattr(one, name) - getattr(other, name)).max(axis=1)
            assert apart[one.possible].max() < 1e-8


def test_an_idle_arm_does_not_mix_up_the_places_of_a_stop(numeric):
    """Candidates of stages with and without work at once are what each of them is alone."""
    problem = numeric(2, (3, 1), line=0.05)
    best = search(problem, [], "quick", 0).best
    stages = np.arange(problem.stages)
    rows, angle = best.decisions.arms[1], best.decisions.angle
    every = postures(problem, 1, stages, angle, rows)
    alone = postures(problem, 1, stages[:1], angle[:1], rows.take(stages[:1]))
    assert problem.arms[1].stops[1] is None
    for name in ("q_approach", "q_target", "q_retract", "work"):
        assert np.allclose(getattr(every, name)[:1], getattr(alone, name), atol=1e-9)
    assert np.abs(every.q_approach[0] - every.q_target[0]).max() > 1e-3


def test_the_node_of_a_plan_is_where_the_plan_is(random_job):
    """Moved arm angles leave `near` behind: the plan's own node has the joints at the target."""
    job = random_job(1, (3, 2), line=0.05)
    problem = sequence_problem(CellModel.from_cell(job.cell), job)
    variables, angles = Variables.of(problem), grid_angles(problem, np.radians(30.0))
    best = search(problem, [], "quick", 0).best
    step = np.random.default_rng(0).normal(scale=0.02, size=variables.count)
    plan = evaluate(problem, variables.moved(best.decisions, step))
    apart = 0.0
    for a, work in enumerate(problem.arms):
        for k in np.flatnonzero([stop is not None for stop in work.stops]):
            node = own_node(problem, a, int(k), angles, plan)
            np.testing.assert_array_equal(node.q_target[0], plan.arms[a].q_target[k])
            apart += np.abs(plan.decisions.arms[a].near[k] - node.q_target[0]).max()
    assert apart > 1e-3


@pytest.mark.parametrize("start", ["home", "free"])
def test_a_combination_equals_brute_force(numeric, start):
    """Three stages, three plans: all 27 combinations one by one, in closed cycles."""
    problem = numeric(0, (3, 3), line=0.05, returns=True, start=start)
    best = search(problem, [], "quick", 0).best
    random, variables = np.random.default_rng(0), Variables.of(problem)
    others = [
        variables.moved(best.decisions, random.normal(scale=0.05, size=variables.count))
        for _ in range(2)
    ]
    plans = [best.decisions, *others]
    totals = []
    for pick in itertools.product(range(3), repeat=3):
        one = plans[pick[0]]
        for k, m in enumerate(pick):
            one = one.put(np.array([k]), plans[m])
        totals.append(evaluate(problem, one).total)
    result = best_combination(problem, best, others)
    assert result.total == pytest.approx(min(totals), abs=1e-9)


def test_a_stage_whose_lines_do_not_hold_is_not_taken(numeric, monkeypatch):
    """A plan that is faster in two stages, of which one does not hold between its samples: the other one is taken."""
    problem = numeric(4, (3, 3), line=0.05)
    best = search(problem, [], "quick", 0).best
    random, variables = np.random.default_rng(1), Variables.of(problem)
    slow = best
    for _ in range(40):
        step = random.normal(scale=0.1, size=variables.count)
        tried = evaluate(problem, variables.moved(best.decisions, step))
        if np.isfinite(tried.total) and tried.total > slow.total:
            slow = tried
    whole = best_combination(problem, slow, [best.decisions])
    assert whole.total == pytest.approx(best.total)

    def lines_hold(problem, arm, angle, rows):
        held = np.ones(problem.stages, dtype=np.bool_)
        held[1] = not np.allclose(rows.near[1], best.decisions.arms[arm].near[1], atol=1e-6)
        return held

    monkeypatch.setattr(general, "lines_hold", lines_hold)
    found = best_combination(problem, slow, [best.decisions])
    assert best.total < found.total < slow.total
    for a, rows in enumerate(found.decisions.arms):
        assert np.allclose(rows.near[1], slow.decisions.arms[a].near[1], atol=1e-6)


def test_given_configurations_are_taken_to_the_last_digit(numeric):
    """Of two alternatives one is where the arm is, whatever inverse kinematics would find."""
    problem = numeric(5, (2, 2), joints=True)
    found = search(problem, [], "quick", 0)
    for work, plan in zip(problem.arms, found.best.arms, strict=True):
        given = work.stops[1].configurations
        assert any(np.array_equal(plan.q_target[1], q) for q in given)


def test_general_arms_are_refined_like_arms_with_closed_forms(random_job, numeric):
    """The same sequence by both sources: within a few percent of each other, at any platform angle."""
    job = random_job(6, (2, 2), line=0.05)
    closed = sequence_problem(CellModel.from_cell(job.cell), job)
    totals = [
        search(p, [], "normal", 0).best.total for p in (closed, numeric(6, (2, 2), line=0.05))
    ]
    assert totals[1] <= 1.05 * totals[0]


@pytest.mark.parametrize("returns", [False, True])
def test_arms_of_six_and_of_seven_joints_share_a_waist(general_robots, tmp_path, returns):
    """Targets made by forward kinematics; one arm is idle in a stage, and carried along."""
    general_robots.MIXED.write(tmp_path)
    (tmp_path / "dualarm.toml").write_text("")
    (tmp_path / "cell.yaml").write_text("dualarm: cell/1\nrobot: robot.yaml\n")
    (tmp_path / "tasks.yaml").write_text(
        "dualarm: tasks/1\ncell: cell.yaml\ntasks: [{id: t, arm: left, move: {joints: [0, 0.3, -1.7, 0, 1.4, 0]}}]\n"
    )
    job = load_job(tmp_path / "tasks.yaml")
    model, random, tasks = CellModel.from_cell(job.cell, numeric=True), np.random.default_rng(0), []
    home = job.cell.robot.postures["home"]
    for name, count in (("left", 2), ("right", 3)):
        arm = model.arms[name]
        for k in range(count):
            R, p = arm.kinematics.forward(
                home[arm.columns] + random.uniform(-0.3, 0.3, len(arm.columns))
            )
            pose = model.platform.pose(home[model.platform_columns])
            world = pin.SE3(pose[0] @ R, pose[1] + pose[0] @ p) * arm.T_flange_tcp
            stop = Stop("move", PoseTarget(world, False, 1), 0.0, 0.0, Dwell(0.1), PLACE)
            tasks.append(Task(f"{name}-{k}", name, (stop,)))
    there = Stop(
        "move", JointTarget(home[model.arms["left"].columns][None]), 0.0, 0.0, Dwell(0.0), PLACE
    )
    tasks.append(Task("left-home", "left", (there,)))
    job = replace(job, tasks=tuple(tasks), returns=returns)
    schedule = plan_without_bound(job, PlanSettings(effort="quick"), check_collisions=False)
    assert verify(schedule, job).passed
    assert {len(one.columns) for one in model.arms.values()} == {6, 7}


def test_too_many_turns_leave_every_posture_with_those_nearest_to_the_start(
    general_robots, tmp_path
):
    """A UR5, any yaw, room for four turns of each posture: against all turns within limits, by the way from start."""
    file = general_robots.write_cell(tmp_path, "ur5", tasks=1)
    file.write_text(
        file.read_text().replace("rpy: [180 deg, 0, 0]}", "free: yaw, rpy: [180 deg, 0, 0]}")
    )
    job = load_job(file)
    problem = sequence_problem(CellModel.from_cell(job.cell), job)
    work = problem.arms[0]
    every = grid_nodes(problem, 0, 0, Grid(np.zeros(1), 12, 100_000)).q_target
    turn = 2.0 * np.pi

    def by_posture(q):
        found = {}
        for row in q:
            found.setdefault(tuple(np.round(np.mod(row, turn), 6)), []).append(row)
        return found

    everyone = by_posture(every)
    most = 5 * len(everyone) - 1
    kept = by_posture(grid_nodes(problem, 0, 0, Grid(np.zeros(1), 12, most)).q_target)
    assert len(every) > most
    assert kept.keys() == everyone.keys()
    for key, rows in kept.items():
        away = np.sort([np.abs(q - work.start).sum() for q in everyone[key]])
        assert sorted(np.abs(q - work.start).sum() for q in rows) == pytest.approx(away[:4])
