"""The search: brute force on small cases, bounds, starts, and every shape of job."""

import itertools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from dualarm_cli.effort import EFFORTS
from dualarm_cli.effort.stages import Mesh
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job
from dualarm_cli.model.motion.rest_to_rest import RestToRest
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.stages import sequence
from dualarm_cli.stages.method import MethodProblem
from dualarm_cli.stages.plans.candidates import Grid, Nodes
from dualarm_cli.stages.plans.problem import SequenceProblem
from dualarm_cli.stages.plans.source import grid_nodes
from dualarm_cli.stages.plans.times import evaluate
from dualarm_cli.stages.search.beam import beam_search
from dualarm_cli.stages.search.corridor import best_combination
from dualarm_cli.stages.search.exact_stages import ExactStages
from dualarm_cli.stages.search.linear_steps import _windows
from dualarm_cli.stages.search.node_plans import NodePlans, grid_angles, plans_on_nodes, with_yaws
from dualarm_cli.stages.search.polish import Polishing
from dualarm_cli.stages.search.potentials import arm_layers, with_potentials
from dualarm_cli.stages.search.search import search
from dualarm_cli.stages.search.variables import FIELDS, Variables, slopes
from dualarm_cli.stages.sequence import decisions_of
from dualarm_cli.stages.sequence_problem import sequence_problem
from dualarm_cli.stages.stage_by_stage import choose_stages
from dualarm_cli.verification import verify

Problems = Callable[..., SequenceProblem]
ANGLES = np.array([-0.7, -0.35, 0.0, 0.35, 0.7])
"""Platform angles of brute-force cases."""
FEW = 9
"""Nodes of one arm at one stop in brute-force cases."""


def _few_nodes(problem: SequenceProblem, seed: int) -> tuple[list[list[Nodes]], np.ndarray, int]:
    """A few nodes per stop at five platform angles, spread at random."""
    angles, start = ANGLES, 2
    random = np.random.default_rng(seed)
    nodes = []
    for a in range(len(problem.arms)):
        per_stage = []
        for k in range(problem.stages):
            every = grid_nodes(problem, a, k, Grid(angles, 6, 10_000))
            some = random.choice(len(every.work), size=min(FEW, len(every.work)), replace=False)
            per_stage.append(every.take(np.sort(some)))
        nodes.append(per_stage)
    return nodes, angles, start


def _at(problem: SequenceProblem, arm: int, stage: int, angles: tuple[int, ...]) -> Nodes:
    """The first few nodes of a stop at each of some of the five platform angles."""
    every = grid_nodes(problem, arm, stage, Grid(ANGLES, 6, 10_000))
    some = [np.flatnonzero(every.angle_index == angle)[:FEW] for angle in angles]
    assert all(len(rows) for rows in some)
    return every.take(np.concatenate(some))


def _with_one_law(problem: SequenceProblem) -> SequenceProblem:
    """The same with every joint at full speed after 0.3 s: times are then looked up without merging laws."""

    def law(old: RestToRest) -> RestToRest:
        return RestToRest(old.velocity, old.velocity / 0.3, old.velocity / 0.03)

    arms = tuple(replace(work, law=law(work.law)) for work in problem.arms)
    return replace(problem, arms=arms, platform_law=law(problem.platform_law))


def _cheapest(problem: SequenceProblem, nodes: list[list[Nodes]], angles: np.ndarray) -> float:
    """Least cost over every path of node pairs, one by one: no pruning, no tables."""
    states = [(np.append(problem.platform_start, 0)[0], [w.start for w in problem.arms], 0.0)]
    for k in range(problem.stages):
        pairs = [
            (i, j)
            for i, j in itertools.product(*(range(len(nodes[a][k].work)) for a in (0, 1)))
            if nodes[0][k].angle_index[i] == nodes[1][k].angle_index[j]
        ]
        arrivals: dict[tuple[int, int], tuple] = {}
        for angle, joints, spent in states:
            for pair in pairs:
                goal = angles[nodes[0][k].angle_index[pair[0]]]
                waiting = float(problem.platform_law.duration(np.array([goal - angle])))
                length, ends = 0.0, []
                for a, i in enumerate(pair):
                    node, law = nodes[a][k], problem.arms[a].law
                    transfer = float(law.duration(node.q_approach[i] - joints[a]))
                    length = max(length, max(transfer, waiting) + node.work[i])
                    ends.append(node.q_retract[i])
                now = (goal, ends, spent + length)
                # Bellman: the same pair reached sooner is never worse.
                if pair not in arrivals or now[2] < arrivals[pair][2]:
                    arrivals[pair] = now
        states = list(arrivals.values())
    return min(state[2] for state in states)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("line", [0.0, 0.06])
def test_the_beam_with_all_states_equals_brute_force(
    random_problem: Problems, seed: int, line: float
) -> None:
    """Three stages with a few nodes each: the same least cost, and the grid's bound is not above it."""
    problem = _with_one_law(random_problem(seed, (3, 3), line=line))
    nodes, angles, _ = _few_nodes(problem, seed)
    every = np.tile(angles, (3, 1))
    layers = [arm_layers(problem, a, every, nodes[a]) for a in (0, 1)]
    arms = with_potentials(problem, layers, len(angles))
    [path] = beam_search(problem, arms, every, width=10_000, per_angle=FEW)
    expected = _cheapest(problem, nodes, angles)
    # The table's steps make less than a millisecond in three stages.
    assert path.total == pytest.approx(expected, abs=1e-3)
    assert path.total <= expected + 1e-5
    chosen = [[n.take(path.nodes[a, [k]]) for k, n in enumerate(nodes[a])] for a in (0, 1)]
    assert _cheapest(problem, chosen, angles) == pytest.approx(expected, abs=1e-4)
    assert max(arm.bound for arm in arms) <= expected + 1e-5


@pytest.mark.parametrize("start", ["home", "free"])
@pytest.mark.parametrize("seed", range(3))
def test_combination_equals_brute_force(random_problem: Problems, seed: int, start: str) -> None:
    """Four stages, three plans: all 81 combinations one by one, closed cycles too."""
    problem = random_problem(seed, (4, 4), line=0.05, returns=True, start=start)
    found = search(problem, [], "quick", 0)
    assert found is not None
    random = np.random.default_rng(0)
    variables = Variables.of(problem)
    best = found.best
    others = [
        variables.moved(best.decisions, random.normal(scale=0.05, size=variables.count))
        for _ in range(2)
    ]
    plans = [best.decisions, *others]
    totals = []
    for pick in itertools.product(range(3), repeat=4):
        angle = np.array([plans[m].angle[k] for k, m in enumerate(pick)])
        arms = []
        for a in (0, 1):
            rows = plans[0].arms[a]
            for k, m in enumerate(pick):
                rows = rows.put(np.array([k]), plans[m].arms[a].take(np.array([k])))
            arms.append(rows)
        totals.append(evaluate(problem, type(best.decisions)(angle, tuple(arms))).total)
    result = best_combination(problem, best, others)
    assert result.total == pytest.approx(min(totals), abs=1e-12)


def _with_slow_platform(problem: SequenceProblem) -> SequenceProblem:
    """The same with a platform of 0.1 rad/s: the way back of 0.7 rad outlasts that of any joint."""
    speed = np.array([0.1])
    return replace(
        _with_one_law(problem), platform_law=RestToRest(speed, speed / 0.3, speed / 0.03)
    )


@pytest.mark.parametrize("start", ["home", "free"])
@pytest.mark.parametrize("returns", [False, True])
def test_the_bound_of_an_arm_that_works_alone_is_the_best_plan(
    random_problem: Problems, start: str, returns: bool
) -> None:
    """Nothing is relaxed then; nodes far to one side, so that the platform decides the way back."""
    problem = _with_slow_platform(random_problem(2, (3, 0), start=start, returns=returns))
    every = np.tile(ANGLES, (3, 1))
    nodes = [_at(problem, 0, k, at) for k, at in enumerate([(4,), (3, 4), (3, 4)])]
    layers = [
        arm_layers(problem, 0, every, nodes),
        arm_layers(problem, 1, every, [None] * 3),
    ]
    arms = with_potentials(problem, layers, len(ANGLES))
    [path] = beam_search(problem, arms, every, width=10_000, per_angle=FEW)
    total = evaluate(problem, path.decisions).total
    # Two steps of 2e-4 rad are rounded away in each of four transfers, at 10 s/rad.
    assert path.total == pytest.approx(total, abs=4 * 4e-3)
    if not (returns and start == "free"):  # the way back to a free start is not known from behind
        assert max(arm.bound for arm in arms) == pytest.approx(path.total, abs=4e-3)
    assert max(arm.bound for arm in arms) <= path.total + 1e-5


def test_the_platform_turns_back_with_whichever_arm_works_last(random_problem: Problems) -> None:
    """Both arms at 0.7 rad twice, then one at 0: the other's way back does not turn the platform once more."""
    problem = _with_slow_platform(random_problem(2, (2, 3), returns=True))
    every = np.tile(ANGLES, (3, 1))
    layers = [
        arm_layers(problem, 0, every, [*(_at(problem, 0, k, (4,)) for k in (0, 1)), None]),
        arm_layers(
            problem, 1, every, [_at(problem, 1, k, at) for k, at in enumerate([(4,), (4,), (2,)])]
        ),
    ]
    arms = with_potentials(problem, layers, len(ANGLES))
    [path] = beam_search(problem, arms, every, width=10_000, per_angle=FEW)
    # There and back once each: two turns of 0.7 rad at 0.1 rad/s, with 0.3 s + 0.1 s of ramps.
    assert path.total > 2.0 * 7.0
    for arm in arms:
        assert 0.9 * path.total < arm.bound <= path.total + 1e-5


SHAPES = {
    "both arms": {"stages": (5, 5)},
    "lines": {"stages": (4, 4), "line": 0.08, "dwell": 0.17},
    "one arm longer": {"stages": (2, 5), "line": 0.05},
    "one arm only": {"stages": (4, 0)},
    "returns": {"stages": (4, 3), "returns": True},
    "free start": {"stages": (4, 4), "start": "free"},
    "free start returns": {"stages": (4, 4), "start": "free", "returns": True},
    "free yaw": {"stages": (4, 4), "free_yaw": True, "line": 0.05},
    "symmetry": {"stages": (3, 3), "symmetry": 4},
    "joint targets": {"stages": (4, 4), "joints": True, "returns": True, "line": 0.04},
    "many joint targets": {"stages": (6, 6), "joints": True, "returns": True, "line": 0.05},
}


@pytest.mark.parametrize("name", SHAPES)
def test_a_plan_of_every_shape_is_realised_and_verified(
    random_job: Callable[..., Job], name: str
) -> None:
    """From the search to exact timing to the verifier."""
    job = random_job(12, **SHAPES[name])
    schedule = plan_without_bound(job, PlanSettings(effort="quick"), check_collisions=False)
    assert [check.name for check in verify(schedule, job).failures] == []


@pytest.mark.parametrize("name", SHAPES)
def test_the_search_is_never_slower_than_its_starts(
    random_job: Callable[..., Job], name: str
) -> None:
    """For every shape of job; and twice the same is the same."""
    job = random_job(11, **SHAPES[name])
    model = CellModel.from_cell(job.cell)
    problem = sequence_problem(model, job)
    starts = [
        decisions_of(problem, model, choose_stages(MethodProblem(model, job, "arm_angle"), method))
        for method in ("fixed", "exact")
    ]
    found = search(problem, starts, "quick", 0)
    again = search(problem, starts, "quick", 0)
    assert found is not None
    assert again is not None
    for start in starts:
        assert found.best.total <= evaluate(problem, start).total + 1e-12
    assert found.best.total == again.best.total
    for a, work in enumerate(problem.arms):
        active = [k for k, stop in enumerate(work.stops) if stop is not None]
        reached = found.best.arms[a]
        for q in (reached.q_approach, reached.q_target, reached.q_retract):
            assert (q[active] >= work.limits.lower).all()
            assert (q[active] <= work.limits.upper).all()


@pytest.mark.parametrize("line", [0.0, 0.08])
def test_without_starts_a_plan_is_found_too(random_problem: Problems, line: float) -> None:
    """The grid alone suffices, and its gap is between 0 and 1."""
    problem = random_problem(2, (5, 5), line=line)
    found = search(problem, [], "quick", 0)
    assert found is not None
    assert found.grid_bound is not None
    assert found.grid_total is not None
    assert 0.0 < found.grid_bound <= found.grid_total


@pytest.mark.parametrize("stages", [(4, 4), (4, 3), (2, 4), (3, 0)])
@pytest.mark.parametrize("start", ["home", "free"])
@pytest.mark.parametrize("returns", [False, True])
def test_a_path_on_nodes_takes_what_its_decisions_take(
    random_problem: Problems, stages: tuple[int, int], start: str, returns: bool
) -> None:
    """Without lines the beam's total is exact but for the table's steps, and no bound is above it."""
    problem = _with_one_law(random_problem(2, stages, start=start, returns=returns))
    found = plans_on_nodes(problem, ExactStages(problem), Mesh(np.radians(12.0), 14, 1500, 40), 4)
    assert found.plans
    for path, plan in found.plans:
        assert path.total <= plan.total + 1e-5
        # Two steps of 2e-4 rad are rounded away, at up to 2 s/rad: T³ = 32 d / jerk for moves of 0.03 rad.
        assert path.total == pytest.approx(plan.total, abs=1e-3 * (problem.stages + 1))
        assert found.bound is not None
        assert found.bound <= plan.total + 1e-5


def test_polishing_gains_and_never_loses(random_problem: Problems) -> None:
    """From a plan on coarse nodes some percent are gained; every round is at least as good as the one before."""
    problem = random_problem(4, (6, 6))
    angles = grid_angles(problem, np.radians(15.0))
    every = np.tile(angles, (6, 1))
    layers = [
        arm_layers(
            problem,
            a,
            every,
            [grid_nodes(problem, a, k, Grid(angles, 12, 2000)) for k in range(6)],
        )
        for a in (0, 1)
    ]
    [path] = beam_search(problem, with_potentials(problem, layers, len(angles)), every, 20, 4)
    plan = evaluate(problem, path.decisions)
    polishing = Polishing(problem)
    totals = [polishing.polished(plan, rounds, 2).total for rounds in (0, 1, 3, 8)]
    assert totals[0] == plan.total
    assert totals == sorted(totals, reverse=True)
    assert totals[-1] < 0.99 * plan.total


def test_windows_divide_the_stages_and_shift_by_half_a_window() -> None:
    """All stages once and in order, none much longer or shorter than the 24 stages of a window; 36 are one."""
    assert _windows(36, 24, 0) == _windows(36, 24, 1) == [(0, 36)]
    assert _windows(37, 24, 0) == [(0, 24), (24, 37)]
    assert _windows(37, 24, 1) == [(0, 12), (12, 37)]
    assert _windows(55, 24, 0) == [(0, 24), (24, 55)]
    assert _windows(56, 24, 0) == [(0, 24), (24, 48), (48, 56)]
    for stages in range(1, 200):
        for number in (0, 1, 2):
            windows = _windows(stages, 24, number)
            assert [k for first, past in windows for k in range(first, past)] == [*range(stages)]
            if stages > 36:
                sizes = [past - first for first, past in windows]
                assert min(sizes) >= 8
                assert max(sizes) < 24 + 8
        inner = [{first for first, _ in _windows(stages, 24, number)} - {0} for number in (0, 1)]
        assert not inner[0] & inner[1]


def test_slopes_equal_central_differences(random_problem: Problems) -> None:
    """Derivatives of the joints at a stop by platform angle, arm angles and yaw, in another way."""
    problem = random_problem(8, (3, 3), line=0.07, free_yaw=True)
    found = search(problem, [], "quick", 0)
    assert found is not None
    variables, step = Variables.of(problem), 1e-5
    for a in (0, 1):
        rates = slopes(problem, a, found.best.decisions, found.best.arms[a])
        for v in range(1 + len(FIELDS)):
            column = variables.angle if v == 0 else variables.arms[a][:, v - 1]
            change = np.zeros(variables.count)
            change[column] = step
            ahead, behind = (
                evaluate(problem, variables.moved(found.best.decisions, sign * change))
                for sign in (1.0, -1.0)
            )
            for name in ("q_approach", "q_target", "q_retract"):
                central = (getattr(ahead.arms[a], name) - getattr(behind.arms[a], name)) / (
                    2 * step
                )
                assert getattr(rates, name)[:, :, v] == pytest.approx(central, abs=2e-4)


def test_a_straight_tool_turns_the_last_joint_alone(random_problem: Problems, packing: Job) -> None:
    """The preset's tool lies on the last axis; leaning or shifted beside it, it does not."""
    work = random_problem(0, (1, 1)).arms[0]
    assert work.yaw_turns_last_joint
    c, s = np.cos(0.1), np.sin(0.1)
    lean = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    assert not replace(work, R_tool_flange=lean @ work.R_tool_flange).yaw_turns_last_joint
    beside = work.p_tool_flange + np.array([0.02, 0.0, 0.0])
    assert not replace(work, p_tool_flange=beside).yaw_turns_last_joint


def _method_problem(job: Job, **more: bool) -> MethodProblem:
    model = CellModel.from_cell(job.cell)
    return MethodProblem(model, job, "arm_angle", "quick", **more)


@pytest.mark.full_effort
@pytest.mark.parametrize(("beyond", "asked"), [(0, 1), (1, 0)])
def test_simpler_methods_begin_short_sequences_only(
    random_job: Callable[..., Job], monkeypatch: pytest.MonkeyPatch, beyond: int, asked: int
) -> None:
    """Longer ones have a plan on the grid, and no use for theirs."""
    count = int(EFFORTS["quick"].search.begun) + beyond
    calls, starts = [], sequence._starts
    monkeypatch.setattr(sequence, "_starts", lambda *of: (calls.append(1), starts(*of))[1])
    decided = sequence.solve_sequence(_method_problem(random_job(3, (count, count))))
    assert len(decided.stages) == count
    assert len(calls) == asked


@pytest.mark.parametrize("count", [2, 13])
def test_where_the_grids_have_no_plan_simpler_methods_plans_serve(
    random_job: Callable[..., Job], monkeypatch: pytest.MonkeyPatch, count: int
) -> None:
    """But for a problem that is only tried: there nothing else is looked for."""
    job = random_job(3, (count, count))
    monkeypatch.setattr(
        "dualarm_cli.stages.search.search.plans_on_nodes", lambda *_, **__: NodePlans([], None)
    )
    found = sequence.solve_sequence(_method_problem(job))
    single = choose_stages(
        MethodProblem(CellModel.from_cell(job.cell), job, "arm_angle"), "minimum_time"
    )
    assert sum(one.duration for one in found.stages) <= 1.1 * sum(one.duration for one in single)
    monkeypatch.setattr(sequence, "_starts", lambda *_: pytest.fail("asked"))
    with pytest.raises(InfeasibleError):
        sequence.solve_sequence(_method_problem(job, without_margin=_method_problem(job)))


@pytest.mark.parametrize("seed", [5, 6, 7])
def test_symmetric_stops_take_the_yaws_between_which_the_last_joint_turns_least(
    random_problem, seed
):
    """Brute force over all allowed yaws and whole turns within the limits, by the sum of squared turns."""
    problem = random_problem(seed, (3, 3), symmetry=3)
    mesh = Mesh(angle_step=np.radians(20.0), arm_angles=10, most_nodes=400, width=10)
    [(_, plan)] = plans_on_nodes(problem, ExactStages(problem), mesh, 1).plans
    turned = evaluate(problem, with_yaws(problem, plan.decisions, turned=True))
    for work, before, after in zip(problem.arms, plan.arms, turned.arms, strict=True):
        assert np.allclose(before.q_target[:, :-1], after.q_target[:, :-1])
        margin = problem.settings.last_joint_margin
        low, high = work.limits.lower[-1] + margin, work.limits.upper[-1] - margin
        options = []
        for last in before.q_target[:, -1]:
            angles = last + 2.0 * np.pi / 3.0 * np.arange(-6, 7)
            options.append(angles[(angles >= low) & (angles <= high)])
        sums = [
            np.square(np.diff([work.start[-1], *choice])).sum()
            for choice in itertools.product(*options)
        ]
        chosen = np.square(np.diff([work.start[-1], *after.q_target[:, -1]])).sum()
        assert len(sums) > 1
        assert chosen == pytest.approx(min(sums))
