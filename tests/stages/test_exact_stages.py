"""Stages of whose nodes the arms share no platform angle of the grid: one of them never refuses the whole."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.collision.clearance import SLACK, CellClearance
from dualarm_cli.effort.stages import Mesh
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.dwell import Dwell
from dualarm_cli.model.job import Job, Place, PoseTarget, Stop, Task
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.postures.holding import Holding
from dualarm_cli.stages import sequence
from dualarm_cli.stages.plans.candidates import Grid
from dualarm_cli.stages.plans.problem import SequenceProblem
from dualarm_cli.stages.plans.source import grid_nodes, postures
from dualarm_cli.stages.search import beam, exact_stages
from dualarm_cli.stages.search.exact_stages import (
    ExactStages,
    exact_nodes,
)
from dualarm_cli.stages.search.node_plans import grid_angles, plans_on_nodes
from dualarm_cli.stages.search.plan_clearance import plan_clearance
from dualarm_cli.stages.search.potentials import arm_layers, with_potentials
from dualarm_cli.stages.search.search import SequenceResult, search, search_near
from dualarm_cli.stages.search.shared_angles import shared_intervals, spread, stages_apart
from dualarm_cli.stages.sequence_problem import sequence_problem
from dualarm_cli.verification import verify

WHOLE = (-np.pi, np.pi)
CROWDED = (9, 12)
"""Seeds of stages in which the quickest postures touch, and others do not."""
PLACE = Place("random", 1, 1)


def pose(radius: float, azimuth: float, height: float, yaw: float) -> pin.SE3:
    """Returns a tool pose that points down, about the platform's axis."""
    place = np.array([radius * np.cos(azimuth), radius * np.sin(azimuth), height])
    return pin.SE3(pin.rpy.rpyToMatrix(np.pi, 0.0, yaw), place)


def stage_job(job: Job, stages: list[dict[str, pin.SE3]]) -> Job:
    """Returns bare moves of both arms, stage by stage."""
    tasks = []
    for arm in ("left", "right"):
        for k, stage in enumerate(stages):
            stop = Stop("move", PoseTarget(stage[arm]), 0.0, 0.0, Dwell(), PLACE)
            tasks.append(Task(f"{arm}-{k}", arm, (stop,)))
    return replace(job, tasks=tuple(tasks), start="home", returns=False)


def problem_of(job: Job) -> SequenceProblem:
    return sequence_problem(CellModel.from_cell(job.cell), job)


def reached(problem: SequenceProblem, a: int, k: int, angle: float) -> bool:
    """Returns whether some of 1,440 arm angles of some branch is within limits, by plain inverse kinematics."""
    work = problem.arms[a]
    stop = work.stops[k]
    assert stop is not None
    position = np.array([[angle]])
    R_world, p_world = problem.platform.pose(position)
    R = R_world[0].T @ stop.R_world_tool
    p = R_world[0].T @ (stop.p_world_tool - p_world[0])
    R_flange, p_flange = R @ work.R_tool_flange, p + R @ work.p_tool_flange
    if work.kinematics.reach_miss(R_flange, p_flange) > 0.0:
        return False
    psi = np.linspace(-np.pi, np.pi, 1440, endpoint=False)
    q = work.kinematics.solve(R_flange, p_flange, psi).q
    middle = 0.5 * (work.limits.lower + work.limits.upper)
    turned = work.kinematics.nearest_turns(q, middle)
    return bool(work.kinematics.within_limits(turned).any())


def narrow(job: Job, width: float) -> tuple[Job, tuple[float, float]]:
    """Returns three stages, in the second of which the arms share so little of the platform's angles [rad], and where.

    Turning a target about the platform's axis turns the angles from which it is reached by as much. Both arms' own
    angles are looked for by plain inverse kinematics, with the ends by halving.
    """
    left, right = pose(0.78, 0.05, 0.93, -0.92), pose(0.78, -0.06, 0.74, 1.50)
    easy = {"left": pose(0.6, 0.6, 0.9, 0.3), "right": pose(0.6, -0.6, 0.9, 0.3)}
    problem = problem_of(stage_job(job, [{"left": left, "right": right}]))
    angles = np.radians(np.arange(-180.0, 181.0, 3.0))
    ok = np.array([[reached(problem, a, 0, angle) for angle in angles] for a in (0, 1)])
    last = int(np.flatnonzero(ok[0]).max())
    first = int(np.flatnonzero(ok[1]).min())
    top = halved(lambda angle: reached(problem, 0, 0, angle), angles[last], angles[last + 1])
    bottom = halved(lambda angle: reached(problem, 1, 0, angle), angles[first], angles[first - 1])
    turn = pin.SE3(pin.utils.rotate("z", top - width - bottom), np.zeros(3))
    tight = {"left": left, "right": turn * right}
    return stage_job(job, [easy, tight, easy]), (top - width, top)


def halved(ok: Callable[[float], bool], inner: float, outer: float) -> float:
    for _ in range(30):
        middle = 0.5 * (inner + outer)
        inner, outer = (middle, outer) if ok(middle) else (inner, middle)
    return inner


@pytest.mark.parametrize("seed", range(4))
def test_shared_angles_are_those_of_plain_inverse_kinematics(
    random_problem: Callable[..., SequenceProblem], seed: int
) -> None:
    """Every degree: what both arms reach lies in an interval; and both reach the middle of every interval."""
    problem = random_problem(seed, (2, 2))
    for k in range(2):
        found = shared_intervals(problem, k, WHOLE)
        for angle in np.radians(np.arange(-180.0, 180.0, 3.0)):
            if all(reached(problem, a, k, angle) for a in (0, 1)):
                assert any(low - 1e-9 <= angle <= high + 1e-9 for low, high in found)
        for low, high in found:
            if high - low > 0.02:
                assert all(reached(problem, a, k, 0.5 * (low + high)) for a in (0, 1))


@pytest.mark.parametrize("width_deg", [0.5, 0.02])
def test_an_overlap_that_is_narrower_than_any_grid_is_found(packing: Job, width_deg: float) -> None:
    """Half a degree and a fiftieth; the ends by halving on plain inverse kinematics."""
    job, (low, high) = narrow(packing, np.radians(width_deg))
    problem = problem_of(job)
    [(found_low, found_high)] = shared_intervals(problem, 1, WHOLE)
    assert found_low == pytest.approx(low, abs=1e-4)
    assert found_high == pytest.approx(high, abs=1e-4)


def test_stages_that_no_angle_serves_are_listed(packing: Job) -> None:
    """The arms' angles of the second stage overlap by half a degree, or miss one another by as much."""
    for width_deg, apart in ((0.5, []), (-0.5, [1])):
        assert stages_apart(problem_of(narrow(packing, np.radians(width_deg))[0])) == apart


def test_an_impossible_stage_among_many_is_refused_before_any_search(
    packing: Job, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Stage 38 of 50: its two tasks are named, and nothing is searched."""
    job, _ = narrow(packing, np.radians(-0.5))
    easy, tight, _ = (
        {task.arm: task.stops[0].target.pose for task in work}
        for work in zip(job.tasks[:3], job.tasks[3:], strict=True)
    )
    for name in ("search", "search_in_parts"):
        monkeypatch.setattr(sequence, name, lambda *_: pytest.fail("a search"))
    with pytest.raises(InfeasibleError) as refused:
        plan_without_bound(
            stage_job(job, [*[easy] * 37, tight, *[easy] * 12]), PlanSettings(effort="quick")
        )
    assert {refusal.task for refusal in refused.value.refusals} == {"left-37", "right-37"}


@pytest.mark.parametrize("width_deg", [0.5, 0.02])
def test_one_narrow_stage_does_not_refuse_the_sequence(packing: Job, width_deg: float) -> None:
    """No plan of a simpler method to begin with: the grid's angles are 15 degrees apart."""
    job, (low, high) = narrow(packing, np.radians(width_deg))
    problem = problem_of(job)
    found = search(problem, [], "quick", 0)
    assert found is not None
    assert not found.is_infeasible
    assert np.isfinite(found.best.total)
    assert low - 1e-4 <= found.best.decisions.angle[1] <= high + 1e-4


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("line", [0.0, 0.08])
def test_exact_nodes_are_postures_as_plans_have_them(
    random_problem: Callable[..., SequenceProblem], seed: int, line: float
) -> None:
    """Within limits along their lines, their times those of a plan, and at the target as forward kinematics says."""
    problem = random_problem(seed, (2, 2), line=line, free_yaw=seed == 1)
    for a, work in enumerate(problem.arms):
        angles = spread(shared_intervals(problem, 0, WHOLE), 5)
        nodes = exact_nodes(problem, a, 0, angles, 500)
        assert len(nodes.work)
        assert (np.diff(nodes.angle_index) >= 0).all()
        stages = np.zeros(len(nodes.work), dtype=np.int64)
        made = postures(problem, a, stages, angles[nodes.angle_index], nodes.decisions)
        assert made.possible.all()
        assert np.array_equal(made.work, nodes.work)
        R, p = work.kinematics.forward(nodes.decisions.near)
        R_world, p_world = problem.platform.pose(angles[nodes.angle_index][:, None])
        stop = work.stops[0]
        assert stop is not None
        tool = (R_world @ (p - R @ work.R_tool_flange.T @ work.p_tool_flange)[..., None])[..., 0]
        assert np.abs(tool + p_world - stop.p_world_tool).max() < 1e-9


class _Margins:
    """A cell in which every posture of one arm has at most a given margin beyond the clearance."""

    def __init__(self, cell: CellClearance, most: float) -> None:
        self._cell = cell
        self._most = most

    def __getattr__(self, name: str) -> object:
        return getattr(self._cell, name)

    def arm_margins(self, a: int, position: FloatArray, held: IntArray) -> FloatArray:
        return np.minimum(self._cell.arm_margins(a, position, held), self._most)


@pytest.mark.parametrize(("margin", "possible"), [(0.5 * SLACK, True), (0.0, True), (-1e-6, False)])
def test_a_stage_with_less_than_the_margin_of_nodes_everywhere_keeps_collision_free_nodes(
    packing: Job, margin: float, possible: bool
) -> None:
    """Half a degree of shared angles, and a margin below SLACK at all of them."""
    cell = replace(packing.cell, obstacles=())
    job, (low, high) = narrow(replace(packing, cell=cell), np.radians(0.5))
    problem = sequence_problem(CellModel.from_cell(job.cell), job, Holding.of(job))
    assert problem.clearance is not None
    thin: Any = _Margins(problem.clearance.holding.cell, margin)
    holding = replace(problem.clearance.holding, cell=thin)
    problem = replace(problem, clearance=replace(problem.clearance, holding=holding))
    angles = np.zeros((3, 4))
    arms = [arm_layers(problem, a, angles, [None] * 3) for a in (0, 1)]
    found = ExactStages(problem).layers(problem, arms, angles, [1], 500)
    assert (found is not None) == possible
    if found is not None:
        assert all(len(arm.layers[1].angle_index) for arm in found if arm.layers[1] is not None)
        assert ((angles[1] >= low - 1e-4) & (angles[1] <= high + 1e-4)).all()


def test_angles_are_spread_over_all_intervals() -> None:
    """By hand: of ten angles the narrow one gets one; with room for two of three, the widest two."""
    found = spread([(0.0, 9.0), (20.0, 20.0)], 10)
    assert found.tolist() == [0.5, 1.5, 2.5, 3.5, 4.5, 5.5, 6.5, 7.5, 8.5, 20.0]
    assert spread([(0.0, 1.0), (2.0, 5.0), (6.0, 8.0)], 2).tolist() == [3.5, 7.0]
    assert spread([], 4).tolist() == []


def touching_job(packing: Job) -> Job:
    """Returns three stages; in the second one no angle of the grids has a posture of each arm that is clear."""
    cell = replace(packing.cell, obstacles=())
    stages = [
        {
            arm: pin.SE3(pin.rpy.rpyToMatrix(np.pi, 0.0, np.radians(yaw)), np.array(place))
            for arm, place, yaw in (("left", left, yaw_left), ("right", right, yaw_right))
        }
        for left, yaw_left, right, yaw_right in (
            ((0.512733, 0.471455, 0.869147), -87.79, (0.411239, -0.619697, 0.812238), 107.99),
            ((0.468423, 0.056330, 0.894993), -111.20, (0.176096, -0.432861, 0.780746), -142.83),
            ((0.725046, 0.160784, 0.863022), -37.92, (0.690205, -0.122864, 0.830153), -100.61),
        )
    ]
    return stage_job(replace(packing, cell=cell), stages)


def test_a_stage_whose_nodes_touch_at_all_angles_of_the_grid_gets_others(
    packing: Job, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Near the plan that may touch as well: the search is not asked a second time, over everything."""
    job = touching_job(packing)
    asked = []

    def counted(*args: object) -> SequenceResult | None:
        asked.append(args)
        return search(*args)

    monkeypatch.setattr(sequence, "search", counted)
    planned = plan_without_bound(job, PlanSettings(effort="quick"))
    assert len(asked) == 1
    assert verify(planned, job, clearance=True).passed
    problem = sequence_problem(CellModel.from_cell(job.cell), job, Holding.of(job))
    found = search(problem, [], "quick", 0)
    assert found is not None
    assert not found.is_infeasible
    assert plan_clearance(problem, found.best).stops.all()


Target = tuple[tuple[float, float, float], float]


def tight_job(packing: Job, stages: list[dict[str, Target]]) -> Job:
    """Returns stages with lines and no obstacle, of which nothing is asked but that nothing touches."""
    poses = [
        {
            arm: pin.SE3(pin.rpy.rpyToMatrix(np.pi, 0.0, yaw), np.array(place))
            for arm, (place, yaw) in stage.items()
        }
        for stage in stages
    ]
    bare = stage_job(
        replace(packing, cell=replace(packing.cell, obstacles=(), clearance=0.0)), poses
    )
    tasks = [
        replace(
            task, stops=tuple(replace(stop, approach=0.08, retract=0.08) for stop in task.stops)
        )
        for task in bare.tasks
    ]
    return replace(bare, tasks=tuple(tasks))


NO_NODES: list[dict[str, Target]] = [
    {"left": ((0.6586, -0.0115, 0.8148), -0.8312), "right": ((0.5117, -0.3621, 0.7791), 0.5146)},
    {"left": ((0.0202, 0.4614, 0.8901), 1.1032), "right": ((0.4119, 0.1523, 0.8208), 1.8974)},
]
"""The second one has a plan with 0.3 mm of clearance and no node with 2 mm."""
NO_PAIRS: list[dict[str, Target]] = [
    {"left": ((0.1752, 0.4103, 0.7558), -0.3888), "right": ((0.577, 0.1819, 0.9424), 1.1563)},
    {"left": ((0.0863, 0.463, 0.8696), 1.4289), "right": ((0.4571, 0.0431, 0.8918), 1.8978)},
]
"""The second one has nodes, but no two of them with 2 mm all along their lines."""


@pytest.mark.parametrize(
    ("stages", "touching"),
    [*((NO_NODES, one) for one in ([], [0], [1])), *((NO_PAIRS, one) for one in ([], [0]))],
)
def test_a_stage_that_is_clear_by_less_than_nodes_must_be_stays_as_it_is(
    packing: Job, stages: list[dict[str, Target]], touching: list[int]
) -> None:
    """Whichever stages' moves are known to touch, unless it is one whose postures could be others."""
    job = tight_job(packing, stages)
    model = CellModel.from_cell(job.cell)
    found = search(sequence_problem(model, job), [], "quick", 0)
    assert found is not None
    unchecked = found.best.decisions
    problem = sequence_problem(model, job, Holding.of(job))
    near = search_near(problem, unchecked, touching, "quick", 0, local=False)
    assert near is not None
    assert near.decisions.angle[1] == unchecked.angle[1]
    for mine, theirs in zip(near.decisions.arms, unchecked.arms, strict=True):
        np.testing.assert_array_equal(mine.near[1], theirs.near[1])


def test_a_stage_that_is_known_to_touch_does_not_stay_as_it_is(packing: Job) -> None:
    """What is found near it is clear, where the plan that it is near to is not."""
    job = tight_job(packing, NO_PAIRS)
    model = CellModel.from_cell(job.cell)
    found = search(sequence_problem(model, job), [], "normal", 0)
    assert found is not None
    problem = sequence_problem(model, job, Holding.of(job))
    assert not plan_clearance(problem, found.best).stops.all()
    near = search_near(problem, found.best.decisions, [1], "normal", 0, local=False)
    assert near is not None
    assert plan_clearance(problem, near).penalty == 0.0
    assert near.decisions.angle[1] != found.best.decisions.angle[1]


def test_in_a_long_sequence_a_stage_that_has_to_touch_gets_the_plan_that_touches_least(
    packing: Job,
) -> None:
    """Tools at one place: that does not cost the whole sequence a second search, and what is far from it stays."""
    touching: dict[str, Target] = {"left": ((0.6, 0.02, 0.9), 0.0), "right": ((0.6, -0.02, 0.9), 0)}
    easy: dict[str, Target] = {"left": ((0.1, 0.6, 0.9), 1.0), "right": ((0.1, -0.6, 0.9), 1.0)}
    job = tight_job(packing, [NO_PAIRS[0], touching, *[easy] * 18])
    model = CellModel.from_cell(job.cell)
    found = search(sequence_problem(model, job), [], "quick", 0)
    assert found is not None
    unchecked = found.best.decisions
    problem = sequence_problem(model, job, Holding.of(job))
    asked: tuple[Any, ...] = (problem, unchecked, [1], "quick", 0)
    assert search_near(*asked, local=True) is None
    settings = replace(problem.settings, in_parts=problem.stages)
    near = search_near(replace(problem, settings=settings), *asked[1:], local=True)
    assert near is not None
    assert np.flatnonzero(~plan_clearance(problem, near).stops).tolist() == [1]
    # It and the next transfer touch: stages 0 to 2, one beside them, then four more.
    far = slice(8, None)
    np.testing.assert_array_equal(near.decisions.angle[far], unchecked.angle[far])
    for mine, theirs in zip(near.decisions.arms, unchecked.arms, strict=True):
        np.testing.assert_array_equal(mine.near[far], theirs.near[far])


NO_LINES: list[dict[str, Target]] = [
    {"left": ((0.1001, 0.4849, 0.9467), -0.1636), "right": ((0.4735, 0.054, 0.8789), 1.2864)}
]
"""At the one angle of the grid that they share, 45 degrees, an arm's lines meet a limit between their ends."""


def test_where_all_lines_at_shared_angles_fail_a_stage_gets_angles_of_its_own(packing: Job) -> None:
    """The nodes know the ends of lines only."""
    problem = problem_of(tight_job(packing, NO_LINES))
    mesh = Mesh(np.radians(15.0), 12, 1500, 20)
    grid = Grid(grid_angles(problem, mesh.angle_step), mesh.arm_angles, mesh.most_nodes)
    nodes = [grid_nodes(problem, a, 0, grid) for a in (0, 1)]
    shared = np.intersect1d(*(own.angle_index for own in nodes))
    np.testing.assert_allclose(np.degrees(grid.angles[shared]), [45.0])
    holds = []
    for a, own in enumerate(nodes):
        there = own.take(np.flatnonzero(own.angle_index == shared))
        n = len(there.work)
        angle = np.full(n, grid.angles[shared])
        found = postures(problem, a, np.zeros(n, dtype=np.int64), angle, there.decisions)
        holds.append(bool(found.possible.any()))
    assert holds == [True, False]
    # One node less a round would leave most of the 40 that fail.
    [(_, plan)] = plans_on_nodes(problem, ExactStages(problem), mesh, 1).plans
    assert np.isfinite(plan.total)
    assert not np.isclose(plan.decisions.angle[0], grid.angles[shared[0]])


def test_a_plan_with_little_clearance_is_verified(packing: Job) -> None:
    job = tight_job(packing, NO_NODES)
    planned = plan_without_bound(job, PlanSettings(effort="quick"))
    assert verify(planned, job, clearance=True).passed


def crowded(packing: Job, seed: int) -> SequenceProblem:
    """Return three stages in which both arms work near the front."""
    random = np.random.default_rng(seed)
    stages = [
        {
            arm: pose(
                random.uniform(0.5, 0.7),
                side * random.uniform(0.05, 0.2),
                random.uniform(0.8, 1.0),
                random.uniform(-np.pi, np.pi),
            )
            for arm, side in (("left", 1.0), ("right", -1.0))
        }
        for _ in range(3)
    ]
    job = stage_job(replace(packing, cell=replace(packing.cell, obstacles=())), stages)
    return sequence_problem(CellModel.from_cell(job.cell), job, Holding.of(job))


@pytest.mark.parametrize("seed", CROWDED)
def test_a_beam_in_which_all_the_best_steps_touch_looks_at_the_others(
    packing: Job, seed: int
) -> None:
    """Both arms near the front, and only a few steps looked at: collision-free pairs of postures are found still."""
    problem = crowded(packing, seed)
    few = replace(problem.settings, oversampling=1, clearance_oversampling=1)
    problem = replace(problem, settings=few)
    exact = ExactStages(problem)
    [(path, plan)] = plans_on_nodes(problem, exact, Mesh(0.25, 12, 1500, 1), 1).plans
    assert path.is_possible
    assert plan_clearance(problem, plan).stops.all()


def beam_of(problem: SequenceProblem, per_angle: int) -> beam._Beam:
    """Return a beam of four states on a grid of seven platform angles."""
    angles = np.tile(np.linspace(-0.6, 0.6, 7), (problem.stages, 1))
    layers = [
        arm_layers(
            problem,
            a,
            angles,
            [grid_nodes(problem, a, k, Grid(angles[k], 24, 3000)) for k in range(problem.stages)],
        )
        for a in range(len(problem.arms))
    ]
    return beam._Beam(problem, with_potentials(problem, layers, 7), angles, 4, per_angle)


def test_steps_from_the_best_state_alone_lead_back_to_it(
    packing: Job, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of four states, worst first, the last one is the best: where all rated pairs collide, it is the only parent."""
    search = beam_of(crowded(packing, CROWDED[0]), 3)
    answers = iter([0.0, np.inf, 0.0])
    monkeypatch.setattr(beam, "step_waits", lambda _, k, at, *__: np.full(len(at), next(answers)))
    extended = beam._extend(search, beam._first(search.problem, search.arms), 0, 100)
    assert extended is not None
    states = extended[1].take(np.arange(4)[::-1])
    assert int(np.argmin(states.spent + states.left.max(axis=0))) == 3
    extended = beam._extend(search, states, 1, 100)
    assert extended is not None
    assert next(answers, None) is None
    np.testing.assert_array_equal(extended[0].parent, 3)


def test_sixteen_nodes_at_each_angle_are_a_number_like_any_other(
    packing: Job, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As many pairs are rated as with fifteen and seventeen: four for each of two arms and four states."""
    problem = crowded(packing, CROWDED[0])
    rated: list[int] = []

    def waits(*args: Any) -> FloatArray:
        rated.append(len(args[2]))
        return np.zeros(rated[-1])

    monkeypatch.setattr(beam, "step_waits", waits)
    for per_angle in (15, 16, 17):
        search = beam_of(problem, per_angle)
        first = beam._first(problem, search.arms)
        assert beam._extend(search, first, 0, search.rated_pairs) is not None
    assert rated == [32, 32, 32]


def test_exact_nodes_of_a_stage_are_worked_out_once(
    packing: Job, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever grids ask for them: two of them, and the one about the best plan."""
    job = tight_job(packing, NO_PAIRS[1:])
    problem = problem_of(job)
    asked: list[int] = []

    def counted(*args: Any) -> list[tuple[float, float]]:
        asked.append(args[1])
        return shared_intervals(*args)

    monkeypatch.setattr(exact_stages, "shared_intervals", counted)
    monkeypatch.setattr(exact_stages, "stages_without_angle", lambda *_: [0])
    assert search(problem, [], "normal", 0) is not None
    assert asked == [0]
