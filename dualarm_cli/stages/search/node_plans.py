"""Plans on one grid of nodes: potentials, beam search and exact line times."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import field, replace

import numpy as np

from dualarm_cli.background import map_halves
from dualarm_cli.collision.clearance import SLACK
from dualarm_cli.effort.stages import SCALING, Mesh
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.geometry.products import product
from dualarm_cli.records import dataclass
from dualarm_cli.stages.plans.candidates import Grid, Nodes
from dualarm_cli.stages.plans.problem import (
    ArmDecisions,
    ArmWork,
    Decisions,
    SequenceProblem,
)
from dualarm_cli.stages.plans.source import grid_nodes, postures
from dualarm_cli.stages.plans.times import Evaluated, TransferChain, evaluate, held
from dualarm_cli.stages.search.beam import NodePath, beam_search
from dualarm_cli.stages.search.corridor import best_combination
from dualarm_cli.stages.search.exact_stages import (
    ExactStages,
    free_nodes,
    stages_without_angle,
    taking_turns,
)
from dualarm_cli.stages.search.potentials import ArmLayers, arm_layers, with_potentials


def _spread(problem: SequenceProblem, decisions: Decisions) -> Evaluated:
    """Choose the yaws of a plan on nodes.

    In short sequences stops with several allowed yaws may take others. Quick plans of 15
    packing jobs of 2 to 12 stages are 0.8 % shorter in the mean; longer jobs are as often longer.
    """
    plan = evaluate(problem, with_yaws(problem, decisions))
    if problem.stages > SCALING.short:
        return plan
    turned = with_yaws(problem, decisions, turned=True)
    if turned.kind == plan.decisions.kind:
        return plan
    plans = [each for each in (plan, evaluate(problem, turned)) if np.isfinite(each.total)]
    if len(plans) < 2:
        return plans[0] if plans else plan
    return best_combination(problem, plans[0], [plans[1].decisions])


def with_yaws(problem: SequenceProblem, decisions: Decisions, *, turned: bool = False) -> Decisions:
    """Choose free yaws that spread the last joint's turn evenly over transfers.

    Between two stops of fixed yaw every transfer then turns the last joint equally far. A stop beyond the limits takes
    the nearest yaw within them; an infeasible stop takes the nearest feasible yaw of a grid around the circle.

    Args:
        problem: the sequence.
        decisions: a plan whose free yaws are arbitrary.
        turned: whether stops with several allowed yaws take those between which the last joint turns least.
    """
    arms = []
    for a, work in enumerate(problem.arms):
        free = np.array([s is not None and s.free_yaw and not s.lines_turn for s in work.stops])
        rows = decisions.arms[a]
        if work.yaw_turns_last_joint and (turned or free.any()):
            rows = _shared_out(problem, a, decisions.angle, rows, free, turned)
            rows = _repaired(problem, a, decisions.angle, rows, free)
        arms.append(rows)
    return Decisions(decisions.angle, tuple(arms))


def _sense(work: ArmWork) -> float:
    """Return +1 if positive yaw turns the last joint positively, else -1."""
    geometry = work.closed_form.geometry
    axis = product(geometry.R_flange.T, geometry.axes[-1])
    return float(np.sign(product(axis, work.R_tool_flange.T[:, 2])))


def _shared_out(
    problem: SequenceProblem,
    a: int,
    angle: FloatArray,
    rows: ArmDecisions,
    free: BoolArray,
    turned: bool,
) -> ArmDecisions:
    work = problem.arms[a]
    stages = TransferChain.of(work).active
    joints = postures(problem, a, stages, angle[stages], rows.take(stages))
    q = np.column_stack([joints.q_approach, joints.q_target, joints.q_retract]).reshape(
        -1, 3, work.joints
    )
    last = q[:, :, -1]
    loose = free[stages]
    margin = problem.settings.last_joint_margin
    low, high = work.limits.lower[-1] + margin, work.limits.upper[-1] - margin
    turn = np.zeros(len(stages))
    if turned:
        options = _options(work, stages, rows, last, low, high)
        turn = _least_turns(problem, work, last, loose, options)
        last = last + turn[:, None]
    begin = None if problem.free_start else float(work.start[-1])
    for k in range(len(stages)):
        if loose[k]:
            here = last[k, 0] if begin is None else begin + _share(k, last, loose, begin)
            room = low - last[k].min(), high - last[k].max()
            moved = float(np.clip(here - last[k, 0], min(room), max(room)))
            turn[k] += moved
            last[k] += moved
        begin = float(last[k, 2])
    yaw = rows.yaw.copy()
    near = rows.near.copy()
    yaw[stages] += _sense(work) * turn
    near[stages, -1] = last[:, 1]
    return replace(rows, yaw=yaw, near=near)


def _options(
    work: ArmWork, stages: IntArray, rows: ArmDecisions, last: FloatArray, low: float, high: float
) -> list[FloatArray]:
    """List the last joint's turns to each stop's allowed yaws [rad].

    The first one is 0, to the present yaw. A free stop has one, as its yaw is chosen between the others.
    """
    options = []
    for k, stage in enumerate(stages):
        stop, turns = work.stops[stage], np.zeros(1)
        by_yaw = stop is not None and stop.configurations is None
        if by_yaw and not (stop.free_yaw or stop.lines_turn):
            turns = _sense(work) * (stop.yaw - rows.yaw[stage])
            turns = (turns[:, None] + 2.0 * np.pi * np.arange(-1, 2)).ravel()
            turns = turns[(last[k].min() + turns >= low) & (last[k].max() + turns <= high)]
            turns = np.append(0.0, turns[np.abs(turns) > 1e-6])
        options.append(turns)
    return options


def _least_turns(
    problem: SequenceProblem,
    work: ArmWork,
    last: FloatArray,
    loose: BoolArray,
    options: Sequence[FloatArray],
) -> FloatArray:
    """Choose among the stops' allowed yaws those between which the last joint turns least.

    The sum over transfers of squared turns is least, by dynamic programming; free yaws share a turn evenly.

    Returns:
        The last joint's turn at each stop [rad], shape (m,).
    """
    turn = np.zeros(len(last))
    fixed = np.flatnonzero(~loose).tolist()
    if all(len(options[k]) == 1 for k in fixed):
        return turn
    cost, choices, before = np.zeros(1), list[IntArray](), -1
    ends = np.zeros(1) if problem.free_start else np.full(1, work.start[-1])
    for k in fixed:
        begins = last[k, 0] + options[k]
        between = range(before + 1, k)
        along = sum(last[j, 2] - last[j, 0] for j in between)
        turns = np.square(begins[None] - ends[:, None] - along) / (len(between) + 1)
        is_free = before < 0 and problem.free_start
        total = cost[:, None] + (0.0 if is_free else 1.0) * turns
        choices.append(np.argmin(total, axis=0))
        cost, ends, before = total.min(axis=0), last[k, 2] + options[k], k
    if problem.returns and not problem.free_start:
        cost = cost + np.square(work.start[-1] - ends)
    best = int(np.argmin(cost))
    for k, choice in zip(reversed(fixed), reversed(choices), strict=True):
        turn[k] = options[k][best]
        best = int(choice[best])
    return turn


def _share(k: int, last: FloatArray, loose: BoolArray, begin: float) -> float:
    """Compute the last joint's share of its remaining turn at a free stop [rad]."""
    ahead = np.nonzero(~loose[k:])[0]
    if not len(ahead):
        return 0.0
    run = k + np.arange(ahead[0])
    along = (last[run, 2] - last[run, 0]).sum()
    total = last[k + ahead[0], 0] - begin - along
    return float(total / (len(run) + 1))


def _repaired(
    problem: SequenceProblem,
    a: int,
    angle: FloatArray,
    rows: ArmDecisions,
    free: BoolArray,
) -> ArmDecisions:
    stages = np.nonzero(free)[0]
    joints = postures(problem, a, stages, angle[stages], rows.take(stages))
    for k in stages[~joints.possible]:
        turns = np.linspace(-np.pi, np.pi, problem.settings.repair_yaws, endpoint=False)
        same = np.full(len(turns), k)
        turns = turns[np.argsort(np.abs(turns), kind="stable")]
        tried = rows.take(same)
        tried = replace(tried, yaw=tried.yaw + turns)
        reached = postures(problem, a, same, angle[same], tried).possible
        possible = np.nonzero(reached)[0]
        if len(possible):
            rows = rows.put(np.array([k]), tried.take(possible[:1]))
    return rows


@dataclass(frozen=True)
class NodePlans:
    """Plans and lower bound of one grid."""

    plans: list[tuple[NodePath, Evaluated]]
    """Different plans with feasible lines, best on the nodes first."""
    bound: float | None
    """Lower bound of plans on the nodes, with line times [s].

    None if a stop has no node.
    """
    lacking: tuple[int, ...] = ()
    """Stages for which no nodes were found, where that is why there is no plan."""


@dataclass(frozen=True)
class StageNodes:
    """Nodes of a grid, computed stage by stage."""

    problem: SequenceProblem
    """The sequence."""
    mesh: Mesh
    """Resolution of the grid."""
    angles: FloatArray
    """Platform angles at each stage [rad], shape (n, f)."""
    near: Evaluated | None
    """Plan around which nodes are placed."""
    loose: BoolArray | None
    """Stages with nodes around the plan, shape (n,), or None.

    None for all. The others have the plan's postures alone.
    """
    handed: dict[tuple[int, int], Nodes] = field(default_factory=dict)
    """Nodes of hand-overs, which are taken twice, by arm and stage."""

    def layers(self, arms: Sequence[int]) -> list[ArmLayers]:
        """Build the layers of given arms."""
        return [arm_layers(self.problem, a, self.angles, self._of_stages(a)) for a in arms]

    def _of_stages(self, a: int) -> Iterator[Nodes | None]:
        for k, stop in enumerate(self.problem.arms[a].stops):
            if stop is None:
                yield None
            elif k in self.problem.handover_stages:
                yield taking_turns(self._handed(a, k), self._handed(1 - a, k))
            else:
                yield self._made(a, k)

    def _handed(self, a: int, k: int) -> Nodes:
        if (a, k) not in self.handed:
            self.handed[a, k] = self._made(a, k)
        return self.handed[a, k]

    def _made(self, a: int, k: int) -> Nodes:
        problem, near, angles = self.problem, self.near, self.angles[k]
        if near is not None and self.loose is not None and not self.loose[k]:
            return own_node(problem, a, k, angles, near)
        grid = Grid(angles, self.mesh.arm_angles, self.mesh.most_nodes)
        decisions = None if near is None else near.decisions.arms[a]
        nodes = grid_nodes(problem, a, k, grid, decisions)
        return free_nodes(problem, a, k, angles, nodes)


def plans_on_nodes(
    problem: SequenceProblem,
    exact: ExactStages,
    mesh: Mesh,
    plans: int,
    near: Evaluated | None = None,
    loose: BoolArray | None = None,
) -> NodePlans:
    """Search a grid of nodes; return the beam's plans and the grid's bound.

    Args:
        problem: the sequence.
        exact: the arms' stops, with exact nodes of stages as far as they are known from other grids.
        mesh: how finely nodes are set.
        plans: how many plans at most.
        near: a plan around which the platform angles lie, if the mesh has them around one.
        loose: stages to search, shape (n,), all by default; the others have that plan's postures as their only nodes.
    """
    if mesh.around and near is not None:
        angles = angles_near(problem, near.decisions, mesh)
    else:
        angles = np.tile(grid_angles(problem, mesh.angle_step), (problem.stages, 1))
    if near is not None and loose is not None:
        angles[~loose] = near.decisions.angle[~loose, None]
    made = StageNodes(problem, mesh, angles, near, loose)
    # Few stages' nodes are made faster than a process is copied.
    least = 2 if problem.stages >= problem.settings.shared_stages else len(problem.arms) + 1
    arms = tuple(map_halves(made.layers, range(len(problem.arms)), least))
    moved_stages: set[int] = set()
    bound: float | None = None
    for _ in range(problem.settings.beam_repeats):
        lacking = stages_without_angle(arms, angles.shape[1])
        if moved_stages.intersection(lacking):
            return NodePlans([], bound, tuple(lacking))
        # Near a plan, stages with less than SLACK everywhere keep their postures of that plan.
        spares = (SLACK, 0.0) if near is None else (SLACK,)
        refined = exact.layers(problem, arms, angles, lacking, mesh.most_nodes, spares)
        if refined is None:
            return NodePlans([], bound, tuple(lacking))
        moved_stages.update(lacking)
        if bound is None or lacking:
            arms = with_potentials(problem, refined, angles.shape[1])
            bound = max(arm.bound for arm in arms)
        paths = beam_search(problem, arms, angles, mesh.width, mesh.per_angle, plans)
        candidates = []
        for path in paths:
            plan = _spread(problem, path.decisions)
            candidates.append((replace(path, decisions=plan.decisions), held(problem, plan)))
        possible = [(path, plan) for path, plan in candidates if np.isfinite(plan.total)]
        if possible or not candidates:
            return NodePlans(possible, bound)
        arms = tuple(_without(problem, angles, arm, a, candidates[0]) for a, arm in enumerate(arms))
    return NodePlans([], bound)


def own_node(
    problem: SequenceProblem, a: int, k: int, angles: FloatArray, plan: Evaluated
) -> Nodes:
    """Return a plan's own node at a stop."""
    work, postures, row = problem.arms[a], plan.arms[a], np.array([k])
    stop = work.stops[k]
    assert stop is not None  # callers ask for active stages only
    return Nodes(
        np.array([np.argmin(np.abs(angles - plan.decisions.angle[k]))]),
        plan.decisions.arms[a].take(row).at(postures.q_target[row]),
        postures.q_approach[row],
        postures.q_retract[row],
        postures.work[row],
        work.frees_last_joint(stop),
    )


def grid_angles(problem: SequenceProblem, step: float) -> FloatArray:
    """Return platform positions around the start, start included, (f,) [rad or m].

    Args:
        problem: the sequence.
        step: their spacing [rad]; of a rail as `PlatformChain.spacing` has it.
    """
    if not problem.turns:
        return np.zeros(1)
    here = float(problem.platform_start[0])
    low, high = problem.platform.around(here, *problem.platform_range)
    step = problem.platform.spacing(step, low, high)
    below, above = int((here - low) / step + 1e-9), int((high - here) / step + 1e-9)
    return here + step * np.arange(-below, above + 1, dtype=np.float64)


def angles_near(problem: SequenceProblem, plan: Decisions, mesh: Mesh) -> FloatArray:
    """Return platform angles around those of a plan, included, shape (n, f)."""
    if not problem.turns:
        return np.zeros((problem.stages, 1))
    step = problem.platform.spacing(mesh.angle_step, *problem.platform_range)
    steps = step * np.arange(-mesh.around, mesh.around + 1)
    return np.clip(plan.angle[:, None] + steps, *problem.platform_range)


def _without(
    problem: SequenceProblem,
    angles: FloatArray,
    arm: ArmLayers,
    a: int,
    failed: tuple[NodePath, Evaluated],
) -> ArmLayers:
    """Remove the nodes with infeasible lines from stages that a plan uses.

    If no angle is left that a stage's arms share, the next round gives it angles of its own.
    """
    (path, plan), layers = failed, list(arm.layers)
    for k in arm.chain.active:
        layer = layers[k]
        if layer is None or plan.arms[a].possible[k]:
            continue
        times = layer.work.copy()
        times[path.nodes[a, k]] = np.inf
        # Free yaws are decided later, and tracing lines of arms without an arm angle is slow.
        if problem.arms[a].kinematics.has_arm_angle and not layer.free_last:
            stage, angle = np.full(len(times), k), angles[k, layer.angle_index]
            lines = postures(problem, a, stage, angle, layer.decisions)
            times[~lines.possible] = np.inf
        layers[k] = replace(layer, work=times)
    return replace(arm, layers=layers)
