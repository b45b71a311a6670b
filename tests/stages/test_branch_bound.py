"""The lower bound of six-axis arms with closed forms: its cells, every plan, and all sequences of postures."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from dualarm_cli.bound.bound import lower_bound
from dualarm_cli.bound.job_bound import job_bound
from dualarm_cli.bound.layers import branch_cells
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan, plan_without_bound
from dualarm_cli.stages.plans.candidates import flange_poses
from dualarm_cli.stages.plans.problem import ArmWork
from dualarm_cli.stages.search.potentials import transfer_table
from dualarm_cli.stages.sequence_problem import sequence_problem
from dualarm_cli.verification import verify

TURN = 2.0 * np.pi
QUICK = PlanSettings(effort="quick")


def write_tasks(file, seed: int, count: int, line: float = 0.05, more: str = "") -> None:
    """Random picks and places of both arms in front of the UR pair, tools down."""
    rng = np.random.default_rng(seed)
    lines = [
        f"dualarm: tasks/1\ncell: cell.yaml\nreturn: true\norder: given\n{more}"
        f"defaults: {{approach: {line}, retract: {line}, dwell: 0.1 s}}\ntasks:"
    ]
    for k, (arm, side) in product(range(count), (("left", 1.0), ("right", -1.0))):
        low, high = np.array([[0.3, 0.2, 0.05, -np.pi], [0.55, 0.6, 0.2, np.pi]])
        poses = [
            f"{{xyz: [{x:.3f}, {side * y:.3f}, {z:.3f}], rpy: [180 deg, 0, {yaw:.3f}]}}"
            for x, y, z, yaw in rng.uniform(low, high, (2, 4))
        ]
        lines.append(f"  - {{id: {arm} {k}, arm: {arm}, pick: {poses[0]}, place: {poses[1]}}}")
    file.write_text("\n".join(lines) + "\n")


@pytest.mark.parametrize("name", ["ur5", "spherical"])
def test_every_posture_and_turn_at_a_line_s_ends_is_in_a_cell(general_robots, tmp_path, name):
    """Random postures within limits: their own cells are there, and their lines take no longer than any motion."""
    job = load_job(general_robots.write_cell(tmp_path, name))
    problem = sequence_problem(CellModel.from_cell(job.cell), job)
    work = problem.arms[0]
    arm, stop = work.kinematics, work.stops[0]
    rng = np.random.default_rng(1)
    met = 0
    for _ in range(40):
        q = rng.uniform(arm.lower, arm.upper)
        R, p = arm.forward(q)
        z = R @ work.R_tool_flange.T[:, 2]
        # The posture is where the approach begins; the target is ahead of it, and other postures reach that.
        pose = R[None], (p + 0.05 * z)[None], np.array([[-z, -z]])
        own = replace(stop, approach=0.05, retract=0.0)
        approach, retract = branch_cells(
            work, transfer_table(problem, work), own, pose, free_last=False
        )
        inside = ((q >= approach.low[:, :6]) & (q <= approach.high[:, :6])).all(axis=1)
        assert inside.any()
        if not arm.solve(*(x[0] for x in pose[:2])).reachable.any():
            continue
        met += 1
        # From the posture to every one at the target, by numeric continuation along the line's middle.
        ends = 0.5 * (retract.low + retract.high)[:, :6]
        times = work.law.duration(ends - q)
        assert approach.line[inside].max() <= times.min() + 1e-9
    assert met > 10


@pytest.mark.parametrize("seed", [0, 1, 3, 4])
def test_no_plan_of_a_random_job_is_faster(general_robots, tmp_path, seed):
    """Whatever method plans it; with free yaw, symmetry, and a free start as well."""
    file = general_robots.write_cell(tmp_path, "ur5")
    write_tasks(file, seed, 1 + seed % 2, more=("", "start: free\n")[seed % 2])
    if seed >= 3:
        text = file.read_text().replace("]}, place", "], free: yaw}, place", 2)
        file.write_text(text.replace("]}}", "], symmetry: 2}}", 1))
    job = load_job(file)
    bound = job_bound(job, "quick").value
    blended = job_bound(job, "quick", "lines").value
    assert bound is not None and blended is not None
    for method in ("sequence", "fixed"):
        settings = PlanSettings(method, effort="quick", blend="none")
        found = plan_without_bound(job, settings, check_collisions=False)
        assert verify(found, job).passed
        assert 0.6 * found.duration < bound <= found.duration
        found = plan_without_bound(job, replace(settings, blend="lines"), check_collisions=False)
        assert verify(found, job).passed
        assert blended <= found.duration


def test_asynchronous_arms_and_open_orders_have_their_bounds(general_robots, tmp_path):
    """`mode: free`, and any order: below the plan in both."""
    file = general_robots.write_cell(tmp_path, "ur5", tasks=1)
    text = file.read_text()
    for more in ("mode: free", "order: optimise"):
        file.write_text(text.replace("return: true\n", f"return: true\n{more}\n", 1))
        job = load_job(file)
        schedule = plan(job, QUICK)
        assert verify(schedule, job).passed
        assert schedule.lower_bound is not None
        assert 0.0 < schedule.lower_bound <= schedule.duration


def _turned(work: ArmWork, q: np.ndarray) -> np.ndarray:
    """Postures (k, 6) in (-pi, pi] with all whole turns within limits."""
    kept = []
    for row in q:
        for turn in product((-1, 0, 1), repeat=6):
            moved = row + TURN * np.array(turn)
            if ((moved >= work.limits.lower) & (moved <= work.limits.upper)).all():
                kept.append(moved)
    return np.array(kept)


def test_without_lines_the_bound_of_one_arm_is_the_fastest_of_all_sequences(
    general_robots, tmp_path
):
    """Left arm, two stops without lines: all pairs of some 250 postures each, to the table's laws."""
    file = general_robots.write_cell(tmp_path, "ur5")
    write_tasks(file, 11, 1, line=0.0)
    job = load_job(file)
    problem = sequence_problem(CellModel.from_cell(job.cell), job)
    work = problem.arms[0]
    alone = replace(problem, arms=(work,))
    least = _sequences(problem, 0).sum(axis=1).min()
    bound = lower_bound(alone, "quick").value
    assert 0.99 * least <= bound <= least


def test_without_lines_two_arms_are_bounded_by_their_best_pair_of_sequences(
    general_robots, tmp_path
):
    """All pairs of the arms' sequences, those left out that are nowhere shorter than another one."""
    file = general_robots.write_cell(tmp_path, "ur5")
    for seed in (12, 13, 14):
        write_tasks(file, seed, 1, line=0.0)
        job = load_job(file)
        problem = sequence_problem(CellModel.from_cell(job.cell), job)
        one, other = (_undominated(_sequences(problem, a)) for a in (0, 1))
        best = np.maximum(one[:, None], other[None]).sum(axis=2).min()
        bound = lower_bound(problem, "quick").value
        assert 0.8 * best < bound <= best


def _sequences(problem, a: int) -> np.ndarray:
    """Lengths [s] of two stages and the return for all pairs of an arm's postures, the start before, shape (k, 3)."""
    work = problem.arms[a]
    table = work.stop_table
    ends = []
    for stage in (0, 1):
        row = table.first[[stage]]
        R, p, _ = flange_poses(
            problem.platform, work, row, np.zeros(1), problem.platform_start[None]
        )
        found = work.kinematics.solve(R[0], p[0])
        ends.append(_turned(work, found.q[found.reachable]))
    first, second = ends
    law, dwell = work.law, work.stops[0].dwell
    start = np.broadcast_to(law.duration(first - work.start)[:, None], (len(first), len(second)))
    between = law.duration(second[None] - first[:, None])
    back = np.broadcast_to(law.duration(second - work.start)[None], between.shape)
    return np.stack([start + dwell, between + dwell, back], axis=-1).reshape(-1, 3)


def _undominated(rows: np.ndarray) -> np.ndarray:
    """Rows that no other one is as good as everywhere."""
    kept: list[np.ndarray] = []
    for row in rows[np.argsort(rows.sum(axis=1), kind="stable")]:
        if not any((other <= row).all() for other in kept):
            kept.append(row)
    return np.array(kept)


def test_there_is_no_bound_on_a_platform_that_turns(general_robots, tmp_path):
    """And it is said."""
    folder = tmp_path
    file = general_robots.write_cell(folder, "ur5")
    robot = (folder / "robot.urdf").read_text()
    waist = general_robots.WAIST.replace("0 0 0.97", "0 0 0")
    robot = robot.replace('<link name="base"/>', f'<link name="base"/>{waist}', 1)
    for side in ("left", "right"):
        joint = f'<joint name="{side}_j1" type="revolute"><parent link="base"/>'
        assert joint in robot
        robot = robot.replace(joint, joint.replace("base", "chest"))
    (folder / "robot.urdf").write_text(robot)
    text = (folder / "robot.yaml").read_text()
    text = text.replace("arms:\n", "platform: [waist]\narms:\n")
    text = text.replace(
        "limits:\n", "limits:\n  waist: {acceleration: 8, jerk: 80, source: assumed}\n"
    )
    (folder / "robot.yaml").write_text(text)
    bound = job_bound(load_job(file), "quick")
    assert bound.value is None
    assert bound.assumptions == ("lower bound: none for arms of six axes on a platform that turns",)


def test_a_singular_pose_leaves_the_joints_free(general_robots, tmp_path):
    """The wrist aligned: one cell from limit to limit."""
    job = load_job(general_robots.write_cell(tmp_path, "ur5"))
    problem = sequence_problem(CellModel.from_cell(job.cell), job)
    work = problem.arms[0]
    R, p = work.kinematics.forward(np.array([0.3, -1.2, 1.4, -0.5, 0.0, 0.8]))
    z = R @ work.R_tool_flange.T[:, 2]
    stop = replace(work.stops[0], approach=0.0, retract=0.0)
    table, pose = transfer_table(problem, work), (R[None], p[None], z[None])
    for cells in branch_cells(work, table, stop, pose, free_last=False):
        assert cells.low[:, :6].tolist() == [work.limits.lower.tolist()]
        assert cells.high[:, :6].tolist() == [work.limits.upper.tolist()]
        assert not cells.line.any()
