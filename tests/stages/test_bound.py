"""The lower bound: its cells enclose every posture, its lines are never too long, and no plan is faster."""

from collections.abc import Callable

import numpy as np
import pytest

from dualarm_cli.bound.bound import lower_bound, platform_edges
from dualarm_cli.bound.cells import LineToTarget, pose_cells
from dualarm_cli.effort import Resolution
from dualarm_cli.files.cells.cells import load_cell
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.kinematics.platform_chain import rotation_z
from dualarm_cli.kinematics.srs_arm import SrsArm
from dualarm_cli.model.job import Job
from dualarm_cli.model.motion.rest_to_rest import RestToRest
from dualarm_cli.postures.platform_reach import AngleCells, reachable_cells, turned
from dualarm_cli.stages.method import MethodProblem
from dualarm_cli.stages.plans.candidates import flange_poses
from dualarm_cli.stages.plans.problem import SequenceProblem
from dualarm_cli.stages.plans.times import evaluate
from dualarm_cli.stages.search.search import search
from dualarm_cli.stages.search.variables import Variables
from dualarm_cli.stages.sequence import decisions_of
from dualarm_cli.stages.sequence_problem import sequence_problem
from dualarm_cli.stages.stage_by_stage import choose_stages
from dualarm_cli.timing.line_profile import estimate_line_durations
from tests.posture_cells_numpy import within_reach

Problems = Callable[..., SequenceProblem]
ROBOTS = ["amiro_like", "sda10f", "iiwa7", "iiwa14", "openarm", "bottin_planar"]
COARSE = Resolution(np.radians(12.0), 12, 2)


def no_floor(intervals: AngleCells) -> np.ndarray:
    return np.zeros(len(intervals.index))


@pytest.fixture(scope="module", params=ROBOTS)
def arms(request, tmp_path_factory):
    """The arms of a bundled robot."""
    folder = tmp_path_factory.mktemp("cell")
    (folder / ".git").mkdir()
    (folder / "cell.yaml").write_text(f"dualarm: cell/1\nrobot: {request.param}\n")
    cell = load_cell(folder / "cell.yaml").cell
    return [arm.kinematics for arm in CellModel.from_cell(cell).arms.values()]


def _posture(arm: SrsArm, kind: str, random: np.random.Generator) -> np.ndarray:
    """A random posture within limits and a turn, of a kind: any, with a nearly singular wrist, or nearly stretched."""
    low, high = np.maximum(arm.lower, -3.1), np.minimum(arm.upper, 3.1)
    q = random.uniform(low, high)
    joint, near = {"singular wrist": (5, 1e-3), "stretched": (3, 0.05)}.get(kind, (0, None))
    if near is not None:
        q[joint] = np.clip(near - arm.canonical.offset[joint], low[joint], high[joint])
    return q


@pytest.mark.parametrize("kind", ["any", "singular wrist", "stretched"])
def test_every_posture_lies_in_a_cell(arms, kind: str) -> None:
    """Random postures, turned with the platform: the cells of their poses hold them and all others of the pose."""
    random = np.random.default_rng(3)
    edges = np.linspace(-2.9, 2.9, 30)
    for arm in arms:
        for _ in range(2):
            q = _posture(arm, kind, random)
            R, p = arm.forward(q)
            cells = pose_cells(
                arm, (R, p), within_reach(arm, R, p, edges, COARSE), COARSE, False, None
            )
            phi = random.uniform(-2.9, 2.9, 300)
            phi[0] = 0.0
            psi = random.uniform(-np.pi, np.pi, 300)
            psi[0] = float(arm.arm_angle(q))
            turn = rotation_z(-phi)
            found = arm.solve(turn @ R, turn @ p, psi)
            joints = arm.nearest_turns(found.q, np.zeros(7))
            some, branch = np.nonzero(found.reachable[:, None] & arm.within_limits(joints))
            assert kind != "any" or 0 in some
            points = np.column_stack([joints[some, branch], phi[some]])[:, None]
            inside = ((points >= cells.low - 1e-9) & (points <= cells.high + 1e-9)).all(axis=2)
            assert inside.any(axis=1).all()


def test_cells_of_finer_intervals_are_narrower(arms) -> None:
    """A quarter of the intervals' lengths: what the joints can have is at most six tenths as wide on average."""
    random = np.random.default_rng(5)
    coarse, fine = (Resolution(np.radians(12.0 / k), 12 * k, 2) for k in (1, 4))
    for arm in arms:
        low, high = np.maximum(arm.lower, -3.1), np.minimum(arm.upper, 3.1)
        R, p = arm.forward(low + (high - low) * random.uniform(0.3, 0.7, 7))
        widths = []
        for k, resolution in ((1, coarse), (4, fine)):
            edges = np.linspace(-0.2, 0.2, 2 * k + 1)
            within = within_reach(arm, R, p, edges, resolution)
            cells = pose_cells(arm, (R, p), within, resolution, False, None)
            widths.append(float((cells.high - cells.low)[:, :7].mean()))
        assert widths[1] < 0.6 * widths[0]


def test_reachable_cells_are_the_reachable_angles(arms) -> None:
    """Angle by angle: within some interval exactly where the wrist's distance is within reach."""
    random = np.random.default_rng(4)
    edges = np.linspace(-3.0, 3.0, 25)
    for arm in arms:
        for _ in range(20):
            wrist = arm.geometry.shoulder + random.normal(scale=0.4, size=3)
            cells = reachable_cells(arm, wrist, edges)
            phi = random.uniform(-3.0, 3.0, 500)
            gap = np.linalg.norm(turned(wrist, phi) - arm.geometry.shoulder, axis=1)
            least, most = arm.reach
            clear = (np.abs(gap - least) > 1e-6) & (np.abs(gap - most) > 1e-6)
            expected = (gap >= least) & (gap <= most)
            inside = ((phi[:, None] >= cells.low) & (phi[:, None] <= cells.high)).any(axis=1)
            assert (inside == expected)[clear].all()


@pytest.mark.parametrize("kind", ["any", "singular wrist", "stretched", "short"])
def test_no_line_is_shorter_than_to_the_nearest_posture(arms, kind: str) -> None:
    """Postures where lines begin, and all postures at the target: 720 arm angles of all branches, whatever turns.

    The time of the nearest one is at least the bound of every cell that holds the posture.
    """
    random = np.random.default_rng(6)
    edges = np.linspace(-2.9, 2.9, 30)
    law = RestToRest(random.uniform(1.0, 4.0, 7), random.uniform(3.0, 12.0, 7), np.full(7, 90.0))
    round_it = np.linspace(-np.pi, np.pi, 720, endpoint=False)
    told = 0
    for arm in arms:
        for _ in range(4):
            q = _posture(arm, kind, random)
            R, p = arm.forward(q)
            length = 0.2 * (arm.geometry.upper + arm.geometry.fore) * (kind != "short") + 0.005
            end = p + length * (lambda v: v / np.linalg.norm(v))(random.normal(size=3))
            within = within_reach(arm, R, p, edges, COARSE)
            cells = pose_cells(arm, (R, p), within, COARSE, False, LineToTarget(end, law, no_floor))
            phi = np.append(0.0, random.uniform(-2.9, 2.9, 40))
            turn = rotation_z(-phi)
            found = arm.solve(
                turn @ R, turn @ p, np.append(arm.arm_angle(q), random.uniform(-3, 3, 40))
            )
            ends = arm.solve((turn @ R)[:, None], (turn @ end)[:, None], round_it)
            joints = arm.nearest_turns(found.q, np.zeros(7))
            some = found.reachable & ends.reachable[:, 0]
            for i, branch in zip(
                *np.nonzero(some[:, None] & arm.within_limits(joints)), strict=True
            ):
                point = np.append(joints[i, branch], phi[i])
                inside = ((point >= cells.low - 1e-9) & (point <= cells.high + 1e-9)).all(axis=1)
                off = ends.q[i].reshape(-1, 7) - joints[i, branch]
                off -= 2.0 * np.pi * np.round(off / (2.0 * np.pi))
                # The bound of the cell that suits it best is not above the nearest of the samples.
                bound = cells.line[inside].min()
                assert bound <= law.duration(off).min() + 1e-6
                told += bound > 0.0
    assert told > 10 or kind != "any"


def test_bounds_of_lines_are_near_what_lines_take(random_problem: Problems) -> None:
    """Lines with any course of the arm angle, timed by the search: never below the bound, and the best close to it."""
    problem = random_problem(1, (6, 6), line=0.08)
    random = np.random.default_rng(6)
    edges = np.linspace(-1.5, 1.5, 31)
    checked, shares = 0, []
    for work in problem.arms:
        arm = work.kinematics
        for k in range(6):
            R, p, (away, _) = (
                x[0]
                for x in flange_poses(
                    problem.platform, work, np.array([k]), np.zeros(1), np.zeros((1, 1))
                )
            )
            z, m = -away, 400
            outer = p - 0.08 * z
            fine, to = Resolution(0.1, 36, 2), LineToTarget(p, work.law, no_floor)
            within = within_reach(arm, R, outer, edges, fine)
            cells = pose_cells(arm, (R, outer), within, fine, False, to)
            phi = random.uniform(-1.5, 1.5, m)
            share = np.linspace(0.0, 1.0, 9)
            psi = random.uniform(-np.pi, np.pi, m)[:, None]
            psi = psi + random.normal(scale=0.2, size=(m, 1)) * share
            psi = psi + random.normal(scale=0.02, size=(m, 1)) * np.sin(np.pi * share)
            turn = rotation_z(-phi)
            moved = np.einsum("mij,sj->msi", turn, outer + 0.08 * share[:, None] * z)
            branch = random.integers(0, 8, m)
            q, ok = arm.solve_branch((turn @ R)[:, None], moved, psi, branch[:, None])
            q = np.unwrap(q, axis=1)
            ok = ok.all(axis=1) & (np.abs(np.diff(q, axis=1)).max(axis=(1, 2)) < 1.0)
            ok &= arm.within_limits(q[:, 0])
            asked = estimate_line_durations(q, share, work.limits)
            for i in np.flatnonzero(ok):
                point = np.append(q[i, 0], phi[i])
                inside = ((point >= cells.low - 1e-9) & (point <= cells.high + 1e-9)).all(axis=1)
                bound = cells.line[inside].min()
                # The estimate is of samples, and the bound of displacements: 2 % are for that.
                assert bound <= 1.02 * asked[i]
                checked += 1
                shares.append(bound / asked[i])
    assert checked > 500
    assert np.max(shares) > 0.95


SHAPES = {
    "both arms": {"stages": (4, 4)},
    "lines": {"stages": (3, 3), "line": 0.07, "dwell": 0.1},
    "one arm longer": {"stages": (2, 4), "line": 0.05},
    "one arm only": {"stages": (3, 0)},
    "returns": {"stages": (3, 2), "returns": True},
    "free start returns": {"stages": (3, 3), "start": "free", "returns": True},
    "free yaw": {"stages": (3, 3), "free_yaw": True, "line": 0.05},
    "symmetry": {"stages": (3, 3), "symmetry": 3},
    "joint targets": {"stages": (4, 4), "joints": True, "returns": True},
    "joint targets with lines": {"stages": (2, 2), "joints": True, "line": 0.04},
}


@pytest.mark.parametrize("name", SHAPES)
def test_no_plan_is_faster_than_the_bound(random_job: Callable[..., Job], name: str) -> None:
    """Searched and greedy plans, and hundreds of random ones around the best, for every shape of job."""
    random = np.random.default_rng(8)
    job = random_job(0, **SHAPES[name])
    model = CellModel.from_cell(job.cell)
    problem = sequence_problem(model, job)
    bounds = [lower_bound(problem, effort).value for effort in ("quick", "normal")]
    assert min(bounds) > 0.0
    start = decisions_of(
        problem, model, choose_stages(MethodProblem(model, job, "arm_angle"), "fixed")
    )
    found = search(problem, [start], "quick", 0)
    assert found is not None
    totals = [found.best.total, evaluate(problem, start).total]
    variables = Variables.of(problem)
    for _ in range(100):
        step = random.normal(scale=random.choice([0.02, 0.2]), size=variables.count)
        totals.append(evaluate(problem, variables.moved(found.best.decisions, step)).total)
    assert max(bounds) <= min(totals)


def test_finer_cells_give_a_better_bound(random_problem: Problems) -> None:
    """Three resolutions, each better by a good deal."""
    problem = random_problem(0, (4, 4))
    values = [lower_bound(problem, effort).value for effort in ("quick", "normal", "thorough")]
    assert values[1] > 1.03 * values[0]
    assert values[2] > 1.03 * values[1]


def test_robots_without_a_turning_platform_have_a_bound_too(tasks_folder) -> None:
    """Two robots with bases of their own: one cell of the platform, without width."""
    job = load_job(tasks_folder / "05_two_robots" / "tasks.yaml")
    problem = sequence_problem(CellModel.from_cell(job.cell), job)
    assert platform_edges(problem, 0.1).tolist() == [0.0, 0.0]
    found = search(problem, [], "quick", 0)
    assert found is not None
    assert 0.3 * found.best.total < lower_bound(problem, "normal").value <= found.best.total


def test_the_bound_of_joint_targets_is_the_plan_itself(random_job: Callable[..., Job]) -> None:
    """One target of one configuration per arm: hand arithmetic, the slowest joint's rest-to-rest time."""
    from dataclasses import replace

    from dualarm_cli.model.job import JointTarget

    job = random_job(0, (1, 1))
    home = job.cell.robot.postures["home"]
    tasks, longest = [], 0.0
    for task, arm in zip(job.tasks, job.cell.robot.arms, strict=True):
        q = home[job.cell.robot.columns(arm.joints)] + 0.4
        tasks.append(replace(task, stops=(replace(task.stops[0], target=JointTarget(q[None])),)))
        limits = job.cell.robot.limits.select(arm.joints)
        # 0.4 rad is too short for any of them to reach full speed, and long enough for full acceleration where
        # 2 a³/j² < 0.4: then T = a/j + sqrt((a/j)² + 4 d/a), else T = (32 d/j)^(1/3).
        for a, j in zip(limits.acceleration, limits.jerk, strict=True):
            ramp = a / j
            full = 2.0 * a * ramp**2 < 0.4
            time = ramp + np.sqrt(ramp**2 + 1.6 / a) if full else (12.8 / j) ** (1 / 3)
            longest = max(longest, time)
    job = replace(job, tasks=tuple(tasks))
    problem = sequence_problem(CellModel.from_cell(job.cell), job)
    # The table's steps and the merging of laws that differ by less than 3 % leave half a percent.
    assert lower_bound(problem, "normal").value == pytest.approx(longest, rel=8e-3)
    assert lower_bound(problem, "normal").value <= longest
