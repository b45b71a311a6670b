"""The lower bound: its cells enclose every posture, its lines are never too long, and no plan is faster."""

from collections.abc import Callable

import numpy as np
import pytest

from dualarm_cli.bound.bound import lower_bound, platform_edges
from dualarm_cli.bound.cells import pose_cells
from dualarm_cli.bound.layers import line_bounds
from dualarm_cli.effort import Resolution
from dualarm_cli.files.cells.cells import load_cell
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.kinematics.platform_chain import rotation_z
from dualarm_cli.model.job import Job
from dualarm_cli.postures.platform_reach import AngleCells, reachable_cells, shape_rates, turned
from dualarm_cli.stages.search.problem import SequenceProblem
from dualarm_cli.stages.search.search import search
from dualarm_cli.stages.search.stops import StopTable, flange_poses
from dualarm_cli.stages.search.times import evaluate
from dualarm_cli.stages.search.variables import Variables
from dualarm_cli.stages.sequence import decisions_of
from dualarm_cli.stages.sequence_problem import sequence_problem
from dualarm_cli.stages.stage_by_stage import choose_stages
from dualarm_cli.timing.line_profile import estimate_line_durations

Problems = Callable[..., SequenceProblem]
ROBOTS = ["amiro_like", "sda10f", "iiwa7", "iiwa14", "openarm", "bottin_planar"]
COARSE = Resolution(np.radians(12.0), 12, 2)


def _no_lines(intervals: AngleCells) -> np.ndarray:
    return np.zeros(len(intervals.index))


@pytest.fixture(scope="module", params=ROBOTS)
def arms(request, tmp_path_factory):
    """The arms of a bundled robot."""
    folder = tmp_path_factory.mktemp("cell")
    (folder / ".git").mkdir()
    (folder / "cell.yaml").write_text(f"dualarm: cell/1\nrobot: {request.param}\n")
    cell = load_cell(folder / "cell.yaml").cell
    return [arm.kinematics for arm in CellModel.from_cell(cell).arms.values()]


@pytest.mark.parametrize("kind", ["any", "singular wrist", "stretched"])
def test_every_posture_lies_in_a_cell(arms, kind: str) -> None:
    """Random postures, turned with the platform: the cells of their poses hold them and all others of the pose."""
    random = np.random.default_rng(3)
    edges = np.linspace(-2.9, 2.9, 30)
    for arm in arms:
        low, high = np.maximum(arm.lower, -3.1), np.minimum(arm.upper, 3.1)
        for _ in range(2):
            q = random.uniform(low, high)
            if kind == "singular wrist":
                q[5] = np.clip(-arm.canonical.offset[5] + 1e-3, low[5], high[5])
            if kind == "stretched":
                q[3] = np.clip(-arm.canonical.offset[3] + 0.05, low[3], high[3])
            R, p = arm.forward(q)
            cells = pose_cells(arm, R, p, edges, COARSE, False, _no_lines)
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
            cells = pose_cells(arm, R, p, edges, resolution, False, _no_lines)
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


def test_distances_stay_within_their_bounds(arms) -> None:
    """Shoulder-wrist distance at many angles of each interval."""
    random = np.random.default_rng(5)
    edges = np.linspace(-3.0, 3.0, 20)
    for arm in arms:
        wrist = arm.geometry.shoulder + random.normal(scale=0.3, size=3)
        cells = reachable_cells(arm, wrist, edges)
        rates = shape_rates(arm, wrist, cells)
        for share in np.linspace(0.0, 1.0, 21):
            phi = cells.low + share * (cells.high - cells.low)
            gap = np.linalg.norm(turned(wrist, phi) - arm.geometry.shoulder, axis=1)
            assert (gap >= rates.distance_low - 1e-9).all()
            assert (gap <= rates.distance_high + 1e-9).all()


def test_lines_take_at_least_their_bound(random_problem: Problems) -> None:
    """Thousands of lines with any branch and any course of the arm angle, each against its interval's bound."""
    problem = random_problem(1, (6, 6), line=0.08)
    random = np.random.default_rng(6)
    edges = np.linspace(-1.5, 1.5, 13)
    checked, tightest = 0, 0.0
    for work in problem.arms:
        table, arm = StopTable.of(work), work.kinematics
        for k in range(6):
            R, p, z = (
                x[0]
                for x in flange_poses(
                    problem.platform, work, table, np.array([k]), np.zeros(1), np.zeros((1, 1))
                )
            )
            outer = p - 0.08 * z
            wrist, end = arm.wrist_center(R, outer), arm.wrist_center(R, p)
            cells = reachable_cells(arm, wrist, edges)
            bound = line_bounds(work, R, wrist, end, cells)
            for c in range(len(bound)):
                m = 60
                phi = random.uniform(cells.low[c], cells.high[c], m)
                share = np.linspace(0.0, 1.0, 9)
                psi = random.uniform(-np.pi, np.pi, m)[:, None]
                psi = psi + random.normal(scale=0.4, size=(m, 1)) * share
                psi = psi + random.normal(scale=0.05, size=(m, 1)) * np.sin(np.pi * share)
                turn = rotation_z(-phi)
                points = outer + 0.08 * share[:, None] * z
                moved = np.einsum("mij,sj->msi", turn, points)
                q, ok = arm.solve_branch(
                    (turn @ R)[:, None], moved, psi, random.integers(0, 8, m)[:, None]
                )
                q = np.unwrap(q, axis=1)
                ok = ok.all(axis=1) & (np.abs(np.diff(q, axis=1)).max(axis=(1, 2)) < 1.0)
                if ok.any():
                    # Rest-to-rest times of the displacements bound the line's true time from below.
                    straight = work.law.duration(q[ok, -1] - q[ok, 0])
                    asked = estimate_line_durations(q[ok], share, work.limits)
                    assert (bound[c] <= np.maximum(asked, straight) * 1.02).all()
                    checked += int(ok.sum())
                    tightest = max(tightest, float((bound[c] / asked).max()))
    assert checked > 2000
    assert tightest > 0.7  # a bound that says something


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
    tables = tuple(StopTable.of(work) for work in problem.arms)
    start = decisions_of(problem, model, choose_stages(model, job, "fixed", "arm_angle"))
    found = search(problem, [start], "quick", 0)
    assert found is not None
    totals = [found.best.total, evaluate(problem, tables, start).total]
    variables = Variables.of(problem)
    for _ in range(100):
        step = random.normal(scale=random.choice([0.02, 0.2]), size=variables.count)
        totals.append(evaluate(problem, tables, variables.moved(found.best.decisions, step)).total)
    assert max(bounds) <= min(totals)


def test_finer_cells_give_a_better_bound(random_problem: Problems) -> None:
    """Three resolutions, each at least a tenth better."""
    problem = random_problem(0, (4, 4))
    values = [lower_bound(problem, effort).value for effort in ("quick", "normal", "thorough")]
    assert values[1] > 1.1 * values[0]
    assert values[2] > 1.02 * values[1]


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
