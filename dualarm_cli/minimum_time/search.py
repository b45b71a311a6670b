"""The fastest plan of a whole sequence: nodes, potentials, beam, polish; never slower than where it starts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.minimum_time.beam import NodePath, beam_search
from dualarm_cli.minimum_time.nodes import Grid, grid_nodes
from dualarm_cli.minimum_time.polish import polish
from dualarm_cli.minimum_time.potentials import ArmLayers, arm_layers, with_potentials
from dualarm_cli.minimum_time.problem import Decisions, SequenceProblem
from dualarm_cli.minimum_time.stops import StopTable
from dualarm_cli.minimum_time.times import Evaluated, evaluate
from dualarm_cli.minimum_time.yaws import with_yaws


@dataclass(frozen=True)
class Effort:
    """How hard the search tries."""

    angle_step: float
    """Spacing of the grid's platform angles [rad]."""
    arm_angles: int
    """Arm angles around the circle."""
    most_nodes: int
    """Most nodes of one stop."""
    width: int
    """States that the beam keeps."""
    trial_rounds: int
    """Rounds of polishing after which the most promising plan is chosen."""
    rounds: int
    """Rounds of polishing of that plan."""
    random_steps: int
    """Random steps that are offered in each round."""


EFFORTS = {
    "quick": Effort(np.radians(15.0), 12, 1500, 20, 1, 4, 0),
    "normal": Effort(np.radians(10.0), 18, 2000, 40, 2, 8, 6),
    "thorough": Effort(np.radians(6.0), 30, 5000, 200, 6, 60, 24),
}
"""By name."""
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

    The nodes of all stops on a grid; backward dynamic programming per arm with the other one relaxed; a beam guided by
    it. The beam's plan and the given ones are polished, all of them a little, then the best one thoroughly. The result is
    never slower, in closed-form times, than any of the starts.

    Args:
        problem: the sequence.
        starts: plans of simpler methods.
        effort: one of EFFORTS.
        seed: of the random steps of polishing.
    """
    how = EFFORTS[effort]
    tables = tuple(StopTable.of(work) for work in problem.arms)
    pool = [evaluate(problem, tables, start) for start in starts]
    path, bound = _on_nodes(problem, tables, how)
    if path is not None:
        pool.append(evaluate(problem, tables, path.decisions))
    pool = _different([plan for plan in pool if np.isfinite(plan.total)])
    if not pool:
        return None
    tried = [polish(problem, tables, plan, how.trial_rounds, 0, seed) for plan in pool]
    best = min(tried, key=lambda plan: plan.total)
    best = polish(problem, tables, best, how.rounds, how.random_steps, seed)
    return Found(best, bound, None if path is None else path.total)


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
    return here + step * np.arange(-below, above + 1), below


def _on_nodes(
    problem: SequenceProblem, tables: tuple[StopTable, ...], how: Effort
) -> tuple[NodePath | None, float | None]:
    """Returns the beam's plan, with all its lines possible, and the grid's bound."""
    angles, start = grid_angles(problem, how.angle_step)
    grid = Grid(angles, how.arm_angles, how.most_nodes)
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
        path = beam_search(problem, tuple(arms), angles, how.width)
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
