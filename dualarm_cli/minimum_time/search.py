"""The fastest plan of a whole sequence: nodes, potentials, beam, polish; never slower than where it starts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.minimum_time.beam import NodePath, beam_search
from dualarm_cli.minimum_time.corridor import best_combination
from dualarm_cli.minimum_time.nodes import Grid, grid_nodes
from dualarm_cli.minimum_time.polish import polish
from dualarm_cli.minimum_time.potentials import ArmLayers, arm_layers, with_potentials
from dualarm_cli.minimum_time.problem import Decisions, SequenceProblem
from dualarm_cli.minimum_time.stops import StopTable
from dualarm_cli.minimum_time.times import Evaluated, evaluate
from dualarm_cli.minimum_time.yaws import with_yaws


@dataclass(frozen=True)
class Mesh:
    """How finely one grid of nodes is set, and how wide a beam goes through it."""

    angle_step: float
    """Spacing of the platform angles [rad]."""
    arm_angles: int
    """Arm angles around the circle."""
    most_nodes: int
    """Most nodes of one stop."""
    width: int
    """States that the beam keeps."""
    per_angle: int = 4
    """Nodes of each arm that the beam pairs at each platform angle."""


@dataclass(frozen=True)
class Effort:
    """How hard the search tries."""

    meshes: tuple[Mesh, ...]
    """Grids of nodes, each with a plan of its own; the first one's bound is reported."""
    trial_rounds: int
    """Rounds of polishing of every plan before they are combined."""
    rounds: int
    """Rounds of polishing of the combination."""
    random_steps: int
    """Random steps that are offered in each round."""


EFFORTS = {
    "quick": Effort((Mesh(np.radians(15.0), 12, 1500, 20),), 2, 4, 0),
    "normal": Effort(
        (
            Mesh(np.radians(12.0), 14, 1500, 40),
            Mesh(np.radians(15.0), 12, 1500, 20),
        ),
        3,
        6,
        4,
    ),
    "thorough": Effort(
        (
            Mesh(np.radians(8.0), 22, 3000, 200, 8),
            Mesh(np.radians(6.0), 30, 5000, 100, 8),
            Mesh(np.radians(10.0), 18, 3000, 100, 8),
            Mesh(np.radians(12.0), 16, 3000, 100, 8),
            Mesh(np.radians(15.0), 12, 3000, 100, 8),
            Mesh(np.radians(18.0), 14, 3000, 100, 8),
        ),
        12,
        60,
        24,
    ),
}
"""By name."""
PROMISING = 1.06
"""A plan that is slower than the best one by more than this factor is not polished."""
BANS = 12
"""How often the beam is repeated without nodes whose lines turned out to be impossible."""


@dataclass(frozen=True)
class Found:
    """What the search found."""

    best: Evaluated
    """The plan."""
    grid_bound: float | None
    """No plan on the grid's nodes is faster, with the nodes' own line times [s]; None without a plan there."""
    grid_total: float | None
    """The best plan found on the nodes, before polishing [s]."""


def search(
    problem: SequenceProblem, starts: Sequence[Decisions], effort: str, seed: int
) -> Found | None:
    """Returns the fastest plan found, None if there is none at all.

    The nodes of all stops on several grids; backward dynamic programming per arm with the other one relaxed; a beam
    guided by it. The beams' plans and the given ones are polished a little, combined stage by stage, and the
    combination is polished thoroughly. The result is never slower, in closed-form times, than any of the starts.

    Args:
        problem: the sequence.
        starts: plans of simpler methods.
        effort: one of EFFORTS.
        seed: of the random steps of polishing.
    """
    how = EFFORTS[effort]
    tables = tuple(StopTable.of(work) for work in problem.arms)
    pool = [evaluate(problem, tables, start) for start in starts]
    paths = []
    bound = None
    for k, mesh in enumerate(how.meshes):
        path, mesh_bound = _on_nodes(problem, tables, mesh)
        bound = mesh_bound if k == 0 else bound
        paths.append(path)
        if path is not None:
            pool.append(evaluate(problem, tables, path.decisions))
    pool = _different([plan for plan in pool if np.isfinite(plan.total)])
    if not pool:
        return None
    least = min(plan.total for plan in pool)
    tried = [
        polish(problem, tables, plan, how.trial_rounds, 0, seed)
        for plan in pool
        if plan.total <= PROMISING * least
    ]
    tried.sort(key=lambda plan: plan.total)
    best = best_combination(
        problem, tables, tried[0], [plan.decisions for plan in (*tried[1:], *pool)]
    )
    best = polish(problem, tables, best, how.rounds, how.random_steps, seed)
    return Found(best, bound, None if paths[0] is None else paths[0].total)


def _different(pool: list[Evaluated]) -> list[Evaluated]:
    """Returns plans of different length; equal to a nanosecond is the same plan."""
    return list({round(plan.total, 9): plan for plan in reversed(pool)}.values())


def grid_angles(problem: SequenceProblem, step: float) -> tuple[FloatArray, int]:
    """Returns platform angles around the start, which is one of them, and its index.

    Args:
        problem: the sequence.
        step: their spacing [rad].
    """
    if not problem.turns:
        return np.zeros(1), 0
    here = float(problem.platform_start[0])
    low, high = problem.platform_range
    low, high = max(low, here - np.pi), min(high, here + np.pi)
    below, above = int((here - low) / step + 1e-9), int((high - here) / step + 1e-9)
    return here + step * np.arange(-below, above + 1, dtype=np.float64), below


def _on_nodes(
    problem: SequenceProblem,
    tables: tuple[StopTable, ...],
    mesh: Mesh,
) -> tuple[NodePath | None, float | None]:
    """Returns the beam's plan, with all its lines possible, and the grid's bound."""
    angles, start = grid_angles(problem, mesh.angle_step)
    grid = Grid(angles, mesh.arm_angles, mesh.most_nodes)
    arms = []
    for a, work in enumerate(problem.arms):
        nodes = (
            None if stop is None else grid_nodes(problem, a, tables[a], k, grid)
            for k, stop in enumerate(work.stops)
        )
        layers = arm_layers(problem, a, angles, nodes)
        if any(layer is not None and not len(layer.work) for layer in layers.layers):
            return None, None
        arms.append(layers)
    arms = list(with_potentials(problem, arms, start, len(angles)))
    bound = max(arm.bound for arm in arms)
    for _ in range(BANS):
        path = beam_search(problem, tuple(arms), angles, mesh.width, mesh.per_angle)
        if path is None:
            return None, bound
        path = replace(path, decisions=with_yaws(problem, tables, path.decisions))
        plan = evaluate(problem, tables, path.decisions)
        if np.isfinite(plan.total):
            return path, bound
        arms = [_without(arm, a, path, plan) for a, arm in enumerate(arms)]
    return None, bound


def _without(arm: ArmLayers, a: int, path: NodePath, plan: Evaluated) -> ArmLayers:
    """Returns an arm's layers without the nodes of a plan whose lines are impossible."""
    layers = list(arm.layers)
    for k in arm.chain.active:
        layer = layers[k]
        if layer is not None and not plan.arms[a].possible[k]:
            work = layer.work.copy()
            work[path.nodes[a, k]] = np.inf
            layers[k] = replace(layer, work=work)
    return replace(arm, layers=layers)
