"""Plans on nodes: how a beam's states came about, what closing a cycle costs, and what a path means."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.minimum_time.potentials import (
    ArmLayers,
    Layer,
    free_columns,
    platform_columns,
    start_coordinates,
)
from dualarm_cli.minimum_time.problem import ArmDecisions, Decisions, SequenceProblem
from dualarm_cli.minimum_time.transfer_table import rows_of


@dataclass(frozen=True)
class Step:
    """How the states of one stage came about."""

    parent: IntArray
    """Index among the states before, shape (b,)."""
    node: IntArray
    """Each arm's node, -1 where idle, shape (arms, b)."""
    angle_index: IntArray
    """Platform angle within the grid's, shape (b,)."""


IMPOSSIBLE = 1e6
"""What a step counts for which something has to touch [s]."""


@dataclass(frozen=True)
class NodePath:
    """A plan on the nodes."""

    decisions: Decisions
    """What it means."""
    nodes: IntArray
    """Each arm's node in every stage, -1 where idle, shape (arms, n)."""
    total: float
    """Its time with the nodes' own line times [s], and about what it costs for clearance."""

    @property
    def is_possible(self) -> bool:
        """Whether nothing has to touch at its stops, as far as that is known."""
        return self.total < IMPOSSIBLE


def closing_times(
    problem: SequenceProblem, arms: tuple[ArmLayers, ...], angles: FloatArray, steps: list[Step]
) -> NDArray[np.float32]:
    """Returns how long the return takes from the final states [s], shape (b,); 0 without one.

    Where the start is free, a cycle closes wherever its first transfer would have ended.
    """
    closing = np.zeros(len(steps[-1].parent), dtype=np.float32)
    if not problem.returns:
        return closing
    nodes = _nodes_of_all(steps)
    for a, arm in enumerate(arms):
        if not len(arm.chain.active):
            continue
        k = int(arm.chain.active[-1])
        end = arm.layers[k]
        assert end is not None  # the arm is active there
        begin = arm.layers[0] if problem.free_start else None
        origin = rows_of(end.retract, nodes[k, a])
        without = (*free_columns(end, begin), *platform_columns(problem))
        if begin is None:
            home = start_coordinates(problem, a, arm.table)
            times = arm.table.times(origin, home, without)[:, 0]
        else:
            first = rows_of(begin.approach, nodes[0, a])
            times = arm.table.times(origin, first, without).diagonal()
        np.maximum(closing, times, out=closing)
    if problem.platform_law is not None:
        back_to: FloatArray = problem.platform_start
        if problem.free_start:
            state = np.arange(len(closing))
            for step in steps[:0:-1]:
                state = step.parent[state]
            back_to = angles[0, steps[0].angle_index[state]]
        moved = back_to - angles[-1, steps[-1].angle_index]
        np.maximum(closing, problem.platform_law.duration(moved[:, None]), out=closing)
    return closing


def _nodes_of_all(steps: list[Step]) -> IntArray:
    """Returns each arm's node in every stage for every final state, shape (n, arms, b)."""
    state = np.arange(len(steps[-1].parent))
    nodes = []
    for step in reversed(steps):
        nodes.append(step.node[:, state])
        state = step.parent[state]
    return np.stack(nodes[::-1])


def kind_of(decisions: Decisions) -> bytes:
    """Returns what two plans have in common if polishing may turn one into the other."""
    rows = [np.stack([arm.branch, arm.target, np.round(arm.yaw, 6)]) for arm in decisions.arms]
    return np.concatenate(rows).tobytes()


def path_to(
    problem: SequenceProblem,
    arms: tuple[ArmLayers, ...],
    angles: FloatArray,
    steps: list[Step],
    best: int,
    total: float,
) -> NodePath:
    """Returns the plan that led to a final state."""
    n = problem.stages
    angle = np.zeros(n)
    nodes = np.full((len(arms), n), -1, dtype=np.int64)
    for k in range(n - 1, -1, -1):
        step = steps[k]
        angle[k] = angles[k, step.angle_index[best]]
        nodes[:, k] = step.node[:, best]
        best = int(step.parent[best])
    decisions = tuple(_arm(problem, a, arm, nodes[a]) for a, arm in enumerate(arms))
    return NodePath(Decisions(angle, decisions), nodes, total)


def _arm(problem: SequenceProblem, a: int, arm: ArmLayers, chosen: IntArray) -> ArmDecisions:
    rows = ArmDecisions.idle(problem.arms[a].start, len(chosen))
    for k in np.nonzero(chosen >= 0)[0].tolist():
        layer = arm.layers[k]
        assert isinstance(layer, Layer)
        rows = rows.put(np.array([k]), layer.decisions.take(chosen[[k]]))
        stop = problem.arms[a].stops[k]
        if stop is not None and stop.configurations is not None:
            # Layers are in single precision; a given configuration is given.
            q = stop.configurations[rows.target[[k]]]
            psi = problem.arms[a].kinematics.arm_angle(q)
            rows = rows.put(
                np.array([k]), replace(rows.take(np.array([k])), psi_target=psi, near=q)
            )
    return rows
