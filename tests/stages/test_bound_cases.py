"""The lower bound where it is easily wrong: idle arms, endless platforms, poles, pruning, motions that turn back."""

from collections.abc import Callable
from dataclasses import replace
from itertools import product
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import linprog

from dualarm_cli.bound import bound as bound_pairs
from dualarm_cli.bound.bound import lower_bound, platform_edges
from dualarm_cli.bound.cells import free_cells, point_cells, pose_cells
from dualarm_cli.bound.layers import StopCells, StopReach, StopWork
from dualarm_cli.effort import Resolution
from dualarm_cli.files.cells.cells import load_cell
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.kinematics.platform_chain import rotation_z
from dualarm_cli.model.dwell import Dwell
from dualarm_cli.model.job import Job, JointTarget, Place, PoseTarget, Stop, Task
from dualarm_cli.model.motion.rest_to_rest import PassingLaw, RestToRest
from dualarm_cli.stages.plans.problem import ArmWork, Decisions, SequenceProblem
from dualarm_cli.stages.plans.times import evaluate
from dualarm_cli.stages.search.potentials import transfer_table
from dualarm_cli.stages.search.search import search
from dualarm_cli.stages.sequence_problem import sequence_problem
from dualarm_cli.timing.transfer_table import Pairs, PostureBoxes, TransferTable
from tests.posture_cells_numpy import within_reach

Problems = Callable[..., SequenceProblem]


def _task(name: str, arm: str, target: PoseTarget | JointTarget) -> Task:
    return Task(name, arm, (Stop("move", target, 0.0, 0.0, Dwell(), Place("hand", 1, 1)),))


def test_an_idle_arm_does_not_turn_the_platform_back_twice(packing: Job) -> None:
    """The left arm's only stop needs a slow platform turned far; it comes back while the right arm is busy.

    Counting its way back from there with the left arm's return as well gave 7.7 s for a plan of 6.5 s.
    """
    robot = packing.cell.robot
    home = robot.postures["home"][robot.columns(robot.arms[1].joints)]
    far = home.copy()
    far[0] -= np.copysign(2.5, home[0])
    behind = pin.SE3(pin.rpy.rpyToMatrix(np.pi, 0.0, 0.0), np.array([-0.7, -0.45, 0.9]))
    tasks = [_task("l", "left", PoseTarget(behind, False, 1))]
    tasks += [
        _task(f"r{k}", "right", JointTarget(q[None])) for k, q in enumerate([home, far, home])
    ]
    job = replace(packing, tasks=tuple(tasks), start="home", returns=True)
    problem = sequence_problem(CellModel.from_cell(job.cell), job)
    law = problem.platform_law
    assert law is not None
    slow = RestToRest(0.3 * law.velocity, 0.3 * law.acceleration, 0.3 * law.jerk)
    problem = replace(problem, platform_law=slow)
    found = search(problem, [], "quick", 0)
    assert found is not None
    assert abs(found.best.decisions.angle[0]) > 1.0
    assert 0.5 * found.best.total < lower_bound(problem, "normal").value <= found.best.total


@pytest.mark.parametrize("turns", [np.inf, 3.0])
def test_a_platform_may_go_round_and_round(random_problem: Problems, turns: float) -> None:
    """Eight targets a third of a turn apart each: one posture, carried round far beyond two turns."""
    problem = random_problem(3, (1, 0))
    found = search(problem, [], "quick", 0)
    assert found is not None
    third = 2.0 * np.pi / 3.0
    work, stop = problem.arms[0], problem.arms[0].stops[0]
    assert stop is not None
    _, p = problem.platform.pose(np.zeros(1))
    stops = tuple(
        replace(
            stop,
            R_world_tool=turn @ stop.R_world_tool,
            p_world_tool=p + turn @ (stop.p_world_tool - p),
        )
        for turn in rotation_z(third * np.arange(8))
    )
    idle = replace(problem.arms[1], stops=(None,) * 8)
    problem = replace(
        problem,
        arms=(replace(work, stops=stops), idle),
        platform_range=(-turns * 2.0 * np.pi, turns * 2.0 * np.pi),
    )
    rows = np.zeros(8, dtype=np.int64)
    plan = found.best.decisions
    going = Decisions(
        plan.angle[0] + third * np.arange(8), tuple(arm.take(rows) for arm in plan.arms)
    )
    total = evaluate(problem, going).total
    assert problem.platform_law is not None
    assert total == pytest.approx(
        found.best.total + 7 * problem.platform_law.duration(np.array([third]))
    )
    assert np.ptp(platform_edges(problem, 0.3)) == pytest.approx(2.0 * np.pi)
    assert lower_bound(problem, "normal").value <= total


def test_a_hundred_stages_add_up(packing: Job) -> None:
    """Two configurations in turns: the closed form of one move, a hundred times over, but for the table's steps."""
    robot = packing.cell.robot
    tasks, longest = [], 0.0
    for arm in robot.arms:
        home = robot.postures["home"][robot.columns(arm.joints)]
        limits = robot.limits.select(arm.joints)
        law = RestToRest(limits.velocity, limits.acceleration, limits.jerk)
        longest = max(longest, float(law.duration(np.full(7, 0.4))))
        for k in range(100):
            tasks.append(
                _task(f"{arm.name}{k}", arm.name, JointTarget((home + 0.4 * (1 - k % 2))[None]))
            )
    job = replace(packing, tasks=tuple(tasks), start="home", returns=False)
    problem = sequence_problem(CellModel.from_cell(job.cell), job)
    value = lower_bound(problem, "normal").value
    assert 0.99 * 100 * longest < value <= 100 * longest


@pytest.mark.parametrize("start", ["home", "free"])
@pytest.mark.parametrize("returns", [False, True])
def test_a_stage_lasts_as_long_as_the_slower_arm(packing: Job, start: str, returns: bool) -> None:
    """The arms dwell 2.0 and 0.1 s, then 0.3 and 1.5 s, then 0.2 and 0.7 s, all in one place: 2.0 + 1.5 + 0.7 s.

    From home they come there first, by the closed form of one move, and go back; a free start is already there.
    """
    robot, law = packing.cell.robot, None
    tasks = []
    for arm, dwells in zip(robot.arms, ((2.0, 0.3, 0.2), (0.1, 1.5, 0.7)), strict=True):
        home = JointTarget(robot.postures["home"][robot.columns(arm.joints)][None] + 0.4)
        limits = robot.limits.select(arm.joints)
        law = law or RestToRest(limits.velocity, limits.acceleration, limits.jerk)
        for k, dwell in enumerate(dwells):
            stop = Stop("move", home, 0.0, 0.0, Dwell(dwell), Place("hand", 1, 1))
            tasks.append(Task(f"{arm.name}{k}", arm.name, (stop,)))
    job = replace(packing, tasks=tuple(tasks), start=start, returns=returns)
    problem = sequence_problem(CellModel.from_cell(job.cell), job)
    value = lower_bound(problem, "quick").value
    assert law is not None
    moves = (0 if start == "free" else 1 + returns) * float(law.duration(np.full(7, 0.4)))
    assert 4.2 + 0.99 * moves - 1e-4 < value <= 4.2 + moves


def _boxes(problem: SequenceProblem, tilt: float, **changes: object) -> StopWork:
    """Returns the cells of the first arm's first stop, changed, its tool tilted, over two platform cells."""
    work = problem.arms[0]
    stop = replace(work.stops[0], **changes)
    R = pin.rpy.rpyToMatrix(tilt, 0.0, 0.0) @ work.R_tool_flange
    work = replace(work, R_tool_flange=R, stops=(stop, *work.stops[1:]))
    problem = replace(problem, arms=(work, *problem.arms[1:]))
    cells = StopCells(problem, np.array([-0.5, 0.0, 0.5]), Resolution(0.5, 9, 1))
    return cells.work(0, 0, cells.reach(0, 0))


def test_cells_of_a_stop_are_points_poses_or_anything(random_problem: Problems) -> None:
    """Given configurations are points unless there is a line; yaw that is free is joint 7's, or anything, if tilted.

    What may be anything has one cell for each of the platform's, its ranges the joint limits.
    """
    problem = random_problem(0, (1, 1), line=0.05)
    work = problem.arms[0]
    lower, upper = work.closed_form.lower, work.closed_form.upper
    everything = [
        box[:7, :1]
        for box in transfer_table(problem, work).box(
            *(np.append(x, 0.0)[None] for x in (lower, upper))
        )
    ]

    def is_anything(boxes: StopWork) -> bool:
        ends = (boxes.approach, boxes.retract)
        return all(
            end.index.tolist() == [0, 1]
            and (end.low[:7] == everything[0]).all()
            and (end.high[:7] == everything[1]).all()
            for end in ends
        )

    given = {"configurations": np.stack([work.start, work.start + 0.1, work.start - 0.1])}
    bare = {"approach": 0.0, "retract": 0.0}
    three = {"yaw": 2.0 * np.pi / 3.0 * np.arange(3.0), "free_yaw": False}
    free = {"yaw": np.zeros(1), "free_yaw": True}
    points = _boxes(problem, 0.0, **given, **bare)
    assert points.approach.index.tolist() == [0, 0, 0, 1, 1, 1]
    assert (points.approach.high[:7] - points.approach.low[:7]).max() <= 1  # steps of the table
    assert points.same
    assert not points.ignored
    for line in ({"approach": 0.0}, {"retract": 0.0}, {}):
        for tilt in (0.0, 0.3):
            boxes = _boxes(problem, tilt, **given, **line)
            assert is_anything(boxes)
            assert (boxes.same, boxes.ignored) == (False, ())
            assert not is_anything(_boxes(problem, tilt, **line))
    assert is_anything(_boxes(problem, 0.3, **free))
    assert not _boxes(problem, 0.3, **free).ignored
    one = _boxes(problem, 0.0)
    for yaws in (free, three):
        boxes = _boxes(problem, 0.0, **yaws)
        assert boxes.ignored == (6,)
        assert len(boxes.approach.index) <= len(one.approach.index)
        assert (boxes.approach.low[6] == everything[0][6]).all()
        assert (boxes.approach.high[6] == everything[1][6]).all()
    tilted, turned = _boxes(problem, 0.3), _boxes(problem, 0.3, **three)
    assert not turned.ignored
    assert set(turned.approach.kind.tolist()) > set(tilted.approach.kind.tolist())


def _ends(
    problem: SequenceProblem, a: int, stage: int, phi: np.ndarray, psi: np.ndarray
) -> list[list[tuple[np.ndarray, np.ndarray]]]:
    """Joints (c, 8, 7) at both outer ends of one arm's lines for each yaw, and which are within limits (c, 8)."""
    work, found = problem.arms[a], []
    stop, arm = work.stops[stage], work.closed_form
    assert stop is not None
    R_platform, p_platform = problem.platform.pose(phi[:, None])
    inverse = np.swapaxes(R_platform, 1, 2)
    for yaw in stop.yaw:
        R_tool = stop.R_world_tool @ rotation_z(np.array([yaw]))[0]
        ends = []
        for length in (stop.approach, stop.retract):
            R = R_tool @ work.R_tool_flange
            p = stop.p_world_tool - length * R_tool[:, 2] + R_tool @ work.p_tool_flange
            solved = arm.solve(inverse @ R, (inverse @ (p - p_platform)[..., None])[..., 0], psi)
            joints = arm.nearest_turns(solved.q, np.zeros(7))
            ends.append((joints, solved.reachable[:, None] & arm.within_limits(joints)))
        found.append(ends)
    return found


@pytest.mark.parametrize("ends", [(0.05, 0.05), (0.25, 0.0), (0.02, 0.3)])
@pytest.mark.parametrize("yaws", [(0.0,), (0.3, 2.2, 4.0)])
def test_every_posture_that_a_stage_can_have_lies_in_its_cells(
    random_problem: Problems,
    monkeypatch: pytest.MonkeyPatch,
    ends: tuple[float, float],
    yaws: tuple[float, ...],
) -> None:
    """Random angles from which both arms have postures: where `lower_bound` looks, and all of these in its cells.

    Tools are tilted, so that yaw moves the wrist. Most of what one arm reaches alone is not looked at.
    """
    looked_at = {}

    def noted(cells: StopCells, a: int, stage: int, reach: StopReach) -> StopWork:
        work = compute(cells, a, stage, reach)
        looked_at[a, stage] = cells, reach, work
        return work

    compute = StopCells.work
    monkeypatch.setattr(StopCells, "work", noted)
    tilt = pin.rpy.rpyToMatrix(0.5, 0.0, 0.0)
    random, checked, left_out = np.random.default_rng(16), 0, 0
    for seed in range(3):
        problem = random_problem(seed, (2, 2))
        stop = {"approach": ends[0], "retract": ends[1], "yaw": np.array(yaws)}
        arms = tuple(
            replace(
                work,
                R_tool_flange=tilt @ work.R_tool_flange,
                stops=tuple(replace(own, **stop) for own in work.stops),
            )
            for work in problem.arms
        )
        problem = replace(problem, arms=arms)
        lower_bound(problem, "quick")
        phi, psi = random.uniform(*problem.platform_range, 400), random.uniform(-np.pi, np.pi, 400)
        for stage in (1, 0):
            each = [_ends(problem, a, stage, phi, psi) for a in (0, 1)]
            can = [
                np.any([np.all([ok.any(axis=1) for _, ok in both], axis=0) for both in own], axis=0)
                for own in each
            ]
            together = can[0] & can[1]
            for a in (0, 1):
                grid, reach, boxes = looked_at[a, stage]
                edges, table = grid.edges, grid.tables[a]
                within = np.any(
                    [
                        np.all(
                            [
                                ((end.low <= phi[:, None]) & (phi[:, None] <= end.high)).any(axis=1)
                                for end in both
                            ],
                            axis=0,
                        )
                        for both in reach.ends
                    ],
                    axis=0,
                )
                assert within[together].all()
                left_out += int((can[a] & ~within).sum())
                cell = np.searchsorted(edges, phi) - 1
                for both in each[a]:
                    for cells, (joints, ok) in zip(
                        (boxes.approach, boxes.retract), both, strict=True
                    ):
                        c, branch = np.nonzero(ok & together[:, None])
                        q = np.column_stack([joints[c, branch], phi[c]])
                        low, high = table.box(q, q)
                        inside = (cell[c][:, None] == cells.index) & (
                            (cells.low[:, None] <= high[..., None])
                            & (cells.high[:, None] >= low[..., None])
                        ).all(axis=0)
                        assert inside.any(axis=1).all()
                        checked += len(c)
    assert checked > 1000
    assert left_out > 100


def test_cells_that_one_arm_reaches_alone_make_no_bound_better(
    random_problem: Problems, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With all cells of either arm, as if each reached its stops from everywhere: never a greater bound."""
    reach_of = StopCells.reach

    def from_everywhere(*given: object) -> object:
        reach = reach_of(*given)
        return replace(reach, span=np.full_like(reach.span, np.inf) * [[-1.0], [1.0]])

    for seed in range(4):
        problem = random_problem(seed, (4, 4), line=0.05)
        value = lower_bound(problem, "quick").value
        with monkeypatch.context() as patch:
            patch.setattr(StopCells, "reach", from_everywhere)
            alone = lower_bound(problem, "quick").value
        assert 0.0 < alone <= value * (1.0 + 1e-5)


def test_where_arms_share_no_angle_there_is_no_plan(random_problem: Problems) -> None:
    """A target far out for either arm, one of them turned about the platform's axis: alone each has a bound."""
    problem = random_problem(0, (1, 1))
    edges = np.linspace(*problem.platform_range, 400)
    _, axis = problem.platform.pose(np.zeros((1, 1)))
    one, other = problem.arms

    def moved(work: ArmWork, factor: float, turn: float) -> ArmWork:
        stop = work.stops[0]
        assert stop is not None
        R, out = rotation_z(np.array([turn]))[0], np.array([factor, factor, 1.0])
        p = axis[0] + R @ (out * (stop.p_world_tool - axis[0]))
        stop = replace(stop, R_world_tool=R @ stop.R_world_tool, p_world_tool=p)
        return replace(work, stops=(stop,))

    apart = 0
    for turn in np.linspace(-np.pi, np.pi, 12, endpoint=False):
        arms = moved(one, 1.3, 0.0), moved(other, 1.3, turn)
        pair = replace(problem, arms=arms)
        grid = StopCells(pair, edges, Resolution(0.5, 9, 1))
        low, high = np.stack([grid.reach(a, 0).span for a in (0, 1)], axis=1)
        shared = low.max(axis=0) <= high.min(axis=0)
        if not (low <= high).any(axis=1).all() or shared.any():
            continue
        apart += 1
        assert lower_bound(pair, "quick").value == np.inf
        for a in (0, 1):
            idle = replace(arms[1 - a], stops=(None,))
            alone = replace(pair, arms=(arms[0], idle) if a == 0 else (idle, arms[1]))
            assert np.isfinite(lower_bound(alone, "quick").value)
    assert apart > 0


def test_cells_of_anything_and_of_points_by_hand(random_problem: Problems) -> None:
    """Three platform cells: all limits and the cell's edges; two configurations in each."""
    arm = random_problem(0, (1, 1)).arms[0].closed_form
    edges = np.array([-1.0, 0.0, 0.5, 2.0])
    cells = free_cells(arm, edges)
    assert cells.index.tolist() == [0, 1, 2]
    assert cells.low.tolist() == [[*arm.lower, edge] for edge in edges[:3]]
    assert cells.high.tolist() == [[*arm.upper, edge] for edge in edges[1:]]
    q = np.arange(14.0).reshape(2, 7)
    cells = point_cells(q, edges)
    assert cells.index.tolist() == [0, 0, 1, 1, 2, 2]
    assert cells.kind.tolist() == [0, 1, 0, 1, 0, 1]
    assert cells.low.tolist() == [[*row, edge] for edge in edges[:3] for row in q]
    assert cells.high.tolist() == [[*row, edge] for edge in edges[1:] for row in q]
    assert not cells.line.any()


@pytest.mark.parametrize(
    "kind", ["wrist in the shoulder", "a joint at its limit", "shoulder singular"]
)
@pytest.mark.parametrize("robot", ["bottin_planar", "iiwa7", "sda10f"])
def test_postures_at_the_edges_lie_in_cells(tmp_path, robot: str, kind: str) -> None:
    """Postures within 1e-9 to 0.1 of where enclosures are hardest, and others of their poses close by."""
    (tmp_path / ".git").mkdir()
    (tmp_path / "cell.yaml").write_text(f"dualarm: cell/1\nrobot: {robot}\n")
    model = CellModel.from_cell(load_cell(tmp_path / "cell.yaml").cell)
    arm = next(iter(model.arms.values())).kinematics
    random = np.random.default_rng(11)
    low, high = np.maximum(arm.lower, -6.2), np.minimum(arm.upper, 6.2)
    edges = np.linspace(-1.0, 1.0, 8)
    for near in 10.0 ** np.arange(-9.0, 0.0):
        q = random.uniform(low, high)
        if kind == "wrist in the shoulder":
            q[3] = high[3] - near  # folded as far as it goes; onto itself where links are equal
        elif kind == "a joint at its limit":
            joint = random.integers(7)
            q[joint] = random.choice([low[joint] + near, high[joint] - near])
        else:
            q[1] = np.clip(near - arm.canonical.offset[1], low[1], high[1])
        R, p = arm.forward(q)
        resolution = Resolution(0.3, 9, 2)
        within = within_reach(arm, R, p, edges, resolution)
        cells = pose_cells(arm, (R, p), within, resolution, False, None)
        phi = np.append(0.0, random.normal(scale=near, size=60)).clip(-1.0, 1.0)
        psi = float(arm.arm_angle(q)) + np.append(0.0, random.normal(scale=near, size=60))
        turn = rotation_z(-phi)
        found = arm.solve(turn @ R, turn @ p, psi)
        joints = arm.nearest_turns(found.q, random.uniform(low, high))
        some, branch = np.nonzero(found.reachable[:, None] & arm.within_limits(joints))
        points = np.vstack([np.append(q, 0.0), np.column_stack([joints[some, branch], phi[some]])])[
            :, None
        ]
        inside = ((points >= cells.low - 1e-9) & (points <= cells.high + 1e-9)).all(axis=2)
        assert inside.any(axis=1).all()


@pytest.mark.parametrize("jerk", [200.0, 30.0, 8.0])
@pytest.mark.parametrize("duration", [0.4, 1.0])
def test_turning_back_does_not_add_travel(jerk: float, duration: float) -> None:
    """Greatest forth plus back of a jerk-limited joint, by linear programming, against the one-way distance."""
    n, speed, acceleration = 120, 1.0, 4.0
    step = duration / n
    law = RestToRest(np.array([speed]), np.array([acceleration]), np.array([jerk]))
    # Constant jerk in each step; acceleration and speed at its end, way in it: all linear in the jerks.
    a = step * np.tril(np.ones((n, n)))
    before = np.vstack([np.zeros(n), a[:-1]])
    v = np.cumsum(step * before + 0.5 * step**2 * np.eye(n), axis=0)
    v_before = np.vstack([np.zeros(n), v[:-1]])
    way = step * v_before + 0.5 * step**2 * before + step**3 / 6.0 * np.eye(n)
    distance = float(law.reachable_distance(np.array([duration]))[0])
    for share in (0.5, 0.7, 1.0):
        turn = int(share * n)
        sign = np.where(np.arange(n) < turn, 1.0, -1.0)
        most = linprog(
            -(sign @ way),
            A_ub=np.vstack([a, -a, sign[:, None] * v, -sign[:, None] * v]),
            b_ub=np.concatenate([np.full(2 * n, acceleration), np.full(n, speed), np.zeros(n)]),
            A_eq=np.vstack([v[-1], a[-1]]),
            b_eq=np.zeros(2),
            bounds=[(-jerk, jerk)] * n,
        )
        assert most.status == 0
        assert -most.fun <= distance * (1.0 + 1e-6)
    assert -most.fun >= 0.97 * distance  # all one way: the program finds the closed form


def _random_boxes(
    random: np.random.Generator, table: TransferTable, cells: int, n: int
) -> PostureBoxes:
    """Boxes in order of platform cell and kind, neighbours near each other."""
    index, kind = np.sort(random.integers(0, cells, n)), random.integers(0, 3, n)
    order = np.lexsort((kind, index))
    index, kind = index[order], kind[order]
    middle = np.cumsum(random.normal(scale=0.1, size=(n, 3)), axis=0).clip(-2.5, 2.5)
    size = random.uniform(0.0, 0.3, (n, 3))
    low, high = table.box(middle - size, middle + size)
    return PostureBoxes(index, kind, low, high, np.zeros(n, dtype=np.float32))


def test_pruned_pairs_give_the_minima_of_all_pairs() -> None:
    """Random boxes, floors, work and displacements: both minima written out in full, bit by bit but for chains."""
    random = np.random.default_rng(13)
    law = RestToRest(np.array([1.0, 2.0, 3.0]), np.array([4.0, 8.0, 3.0]), np.full(3, 60.0))
    for trial in range(8):
        passing = PassingLaw.of(law) if trial % 4 >= 2 else None
        table = TransferTable.of([passing or law], np.full(3, -3.0), np.full(3, 3.0))
        before, after = (
            replace(
                _random_boxes(random, table, 5, n),
                displacement=random.choice([-1, 0, 1500, 4000], (2, 3, n)).astype(np.int16),
                line=random.uniform(0.0, 0.5, n).astype(np.float32),
                late=late,
            )
            for n, late in ((300, 0.25), (400, np.inf if trial == 3 else 0.25))
        )
        own, onward, beyond = (random.uniform(0.0, 2.0, 400).astype(np.float32) for _ in range(3))
        own[random.random(400) < 0.1] = np.inf
        floor = random.uniform(0.0, 1.5, (5, 5)).astype(np.float32)
        without = (1,) if trial % 2 else ()
        times = table.gap_times(before.low, before.high, after.low, after.high, without)
        pairs = Pairs(table, before, after, without)
        plain = arriving = between = times + own
        if passing is not None:
            columns = [c for c in range(3) if c not in without]
            to_approach, from_retract, whole = _chains(table, passing, before, after, columns)
            late, lines = (x.late + times for x in (before, after)), after.line
            late_retract, late_approach = late
            moving, launched = _between_speeds(table, passing, before, after, columns) + own
            plain = np.maximum(arriving, np.minimum(from_retract, late_approach + lines) + onward)
            plain = np.maximum(plain, moving)
            between = np.maximum(between, launched if before.at_target else moving)
            assert (launched > np.maximum(times + own, moving)).mean() > 0.1
            assert (moving > times + own).mean() > 0.1
            retract = before.line[:, None]
            arriving = np.maximum(plain, launched)
            arriving = np.maximum(arriving, np.minimum(to_approach - retract, late_retract) + own)
            either = np.minimum(late_retract, late_approach) + lines
            arriving = np.maximum(arriving, np.minimum(whole - retract, either) + onward)
            assert (arriving > plain).mean() > 0.1
            assert (plain > times + own).mean() > 0.1
        # Tables of chains have coarser steps, rounded down: most of all for short distances.
        below = 0.0 if passing is None else 0.08
        for least, sums in zip(
            pairs.least_from(own, onward, floor, beyond), (arriving, plain), strict=True
        ):
            sums = np.maximum(sums, floor[before.index][:, after.index] + beyond)
            over = sums.min(axis=1) - least
            assert over.min() >= -1e-6 * bool(below) and over.max() <= below
            assert over.mean() <= 0.1 * below
        by_cells = pairs.by_cells(own, 5)
        for i in range(5):
            for k in range(5):
                some = between[np.ix_(before.index == i, after.index == k)]
                best = some.min(initial=np.inf)
                assert by_cells[i, k] == best or -1e-6 <= best - by_cells[i, k] <= below


def _between_speeds(
    table: TransferTable,
    law: PassingLaw,
    before: PostureBoxes,
    after: PostureBoxes,
    columns: list[int],
) -> FloatArray:
    """Least transfers after any motion and after the retract, by bisection of the distance [s], (2, n, m)."""
    least = np.zeros((2, len(before.index), len(after.index)))
    speeds = [law.reachable_speed(end.line[:, None].astype(float)) for end in (before, after)]
    for c in columns:
        v, a = law.velocity[c], law.rest_law.acceleration[c]
        low = after.low[c].astype(int) - before.high[c][:, None].astype(int)
        high = after.high[c].astype(int) - before.low[c][:, None].astype(int)
        distance = np.maximum(np.maximum(low, -high), 0) / table.scale[c]
        for k, first in enumerate((np.full((len(before.index), 1), v), speeds[0][:, c, None])):
            last = speeds[1][:, c]
            slow, quick = np.minimum(first, last), np.maximum(first, last)
            short, long = np.zeros_like(distance), np.full_like(distance, 8.0)
            for _ in range(24):
                time = 0.5 * (short + long)
                peak = np.minimum(v, 0.5 * (a * time + first + last))
                ramps = (2.0 * peak - first - last) / a
                area = (2.0 * peak**2 - first**2 - last**2) / (2.0 * a) + peak * (time - ramps)
                area = np.where(peak < quick, slow * time + 0.5 * a * time**2, area)
                far = area >= distance
                short, long = np.where(far, short, time), np.where(far, time, long)
            least[k] = np.maximum(least[k], np.where(distance > 0.0, long, 0.0))
    return least


def _chains(
    table: TransferTable,
    law: PassingLaw,
    before: PostureBoxes,
    after: PostureBoxes,
    columns: list[int],
) -> FloatArray:
    """Least times of chains to the approach, from the retract, and from target to target [s], (3, n, m)."""
    velocity, acceleration = law.velocity, law.rest_law.acceleration
    least = np.zeros((3, len(before.index), len(after.index)))
    for c, mirrored in product(columns, (False, True)):

        def time(kind: str, steps: FloatArray, c: int = c) -> FloatArray:
            d = np.maximum(steps, 0.0) / table.scale[c]
            v, a = velocity[c], acceleration[c]
            if kind == "turn to any":
                return np.where(d < v * v / (2 * a), np.sqrt(2 * d / a), d / v + v / (2 * a))
            if kind == "turn to turn":
                return np.where(d < v * v / a, 2 * np.sqrt(d / a), d / v + v / a)
            every = np.zeros((*d.shape, 3))
            every[..., c] = d
            if kind == "rest to turn":
                return law.from_turn(every.reshape(-1, 3)).reshape(every.shape)[..., c]
            if kind == "rest to rest":
                return law.rest_law.per_joint(every)[..., c]
            grid = np.linspace(0.0, 5.0, 50_001)
            reach = law.reachable_distance(grid[:, None])[:, c]
            return np.interp(d, reach, grid)

        out = before.displacement[0 if mirrored else 1, c][:, None].astype(int)
        rise, fall = (
            after.displacement[x, c].astype(int) for x in ((1, 0) if mirrored else (0, 1))
        )
        low = after.low[c].astype(int) - before.high[c][:, None]
        high = after.high[c].astype(int) - before.low[c][:, None]
        net = -high if mirrored else low
        up, down = np.maximum(net, 0), np.maximum(low if mirrored else -high, 0)
        known, rises, falls = out >= 0, rise >= 0, fall >= 0
        begun = time("rest to turn", out + up)
        turned = time("rest to turn", out) + time("turn to any", down)
        to_approach = np.where(down > 0, turned, (up > 0) * time("rest to any", out + up))
        turning = begun + time("rest to turn", fall + down)
        twice = time("rest to turn", out) + time("turn to turn", down) + time("rest to turn", rise)
        straight = np.where(down > 0, twice, time("rest to rest", out + rise + net))
        from_retract = np.maximum(
            falls * (time("turn to any", up) + time("rest to turn", fall)),
            rises * time("rest to any", up + rise),
        )
        chains = (
            known * to_approach,
            (up > 0) * from_retract,
            known * np.maximum(falls * turning, rises * straight),
        )
        least = np.maximum(least, np.stack(chains))
    return least


@pytest.mark.parametrize("passing", [False, True])
def test_a_stop_takes_its_lines_or_the_way_between_its_cells(passing: bool) -> None:
    """Random boxes and lines: all ways to split each joint's way between both lines, over all retract cells."""
    random = np.random.default_rng(15)
    rest_law = RestToRest(np.array([1.0, 2.0, 3.0]), np.array([4.0, 8.0, 3.0]), np.full(3, 60.0))
    law = PassingLaw.of(rest_law) if passing else rest_law
    table = TransferTable.of([law], np.full(3, -3.0), np.full(3, 3.0))
    times = np.linspace(0.0, 8.0, 8001)
    reach = law.reachable_distance(times[:, None])
    for free in (None, 1):
        approach, retract = (
            replace(
                _random_boxes(random, table, 4, n),
                line=random.uniform(0.1, 0.6, n).astype(np.float32),
            )
            for n in (60, 90)
        )
        few = retract.index != 2
        retract = PostureBoxes(
            retract.index[few],
            retract.kind[few],
            *(np.ascontiguousarray(x[:, few]) for x in (retract.low, retract.high)),
            retract.line[few],
        )
        without = () if free is None else (free,)
        work = StopWork(Pairs(table, approach, retract, without), False, 0.2)
        rest = random.uniform(0.0, 1.0, len(retract.index)).astype(np.float32)
        first, last = approach.line[:, None], retract.line[None]
        longest = np.zeros((len(approach.line), len(retract.line)))
        for joint in {0, 1, 2} - {free}:
            low, high = (x[joint] / table.scale[joint] for x in (approach.low, approach.high))
            to_low, to_high = (x[joint] / table.scale[joint] for x in (retract.low, retract.high))
            gap = np.maximum(np.maximum(to_low - high[:, None], low[:, None] - to_high), 0.0)
            least = np.full(gap.shape, np.inf)
            for longer in np.append(0.0, np.geomspace(0.01, 4.0, 60)):
                for one, other in ((first, last), (last, first)):
                    left = gap - np.interp(one + longer, times, reach[:, joint])
                    rest_of_way = np.interp(np.maximum(left, 0.0), reach[:, joint], times)
                    least = np.minimum(least, one + longer + np.maximum(other, rest_of_way))
            longest = np.maximum(longest, least)
        assert (longest > (first + last) + 0.05).mean() > 0.3
        whole = np.where(approach.index[:, None] == retract.index, longest, np.inf)
        own, beyond = work.with_rest(rest, rest)
        expected = (whole + rest).min(axis=1) + 0.2
        finite = approach.index != 2
        assert (own <= expected + 1e-6).all()
        assert (own[finite] >= expected[finite] - 0.02).all()
        turned = rest + random.uniform(0.0, 0.5, len(rest)).astype(np.float32)
        late = np.maximum(whole + rest, first + last + turned)
        expected = late.min(axis=1) + 0.2
        assert (work.with_rest(rest, turned)[0] <= expected + 1e-6).all()
        assert (work.with_rest(rest, turned)[0][finite] >= expected[finite] - 0.02).all()
        assert (work.least <= whole.min(axis=1) + 0.2 + 1e-6).all()
        assert (beyond == np.where(np.isfinite(whole), rest, np.inf).min(axis=1)).all()
        assert np.isinf(own[~finite]).all()


@pytest.mark.parametrize("known", [True, False])
def test_a_stage_takes_what_the_other_arm_needs_from_the_cell_before_or_from_any(
    known: bool,
) -> None:
    """Random times by platform cell of the other arm's transfer and work."""
    transfers = np.random.default_rng(14).uniform(0.0, 2.0, (4, 4)).astype(np.float32)
    stage = SimpleNamespace(consecutive=known, by_cells=lambda cells: transfers)
    for floor in bound_pairs._floors([None, None], {0: stage, 1: stage}, 4, np.float32(0)):
        for before in range(4):
            rows = [before] if known else range(4)
            for then in range(4):
                assert floor[before, then] == min(transfers[k, then] for k in rows)
