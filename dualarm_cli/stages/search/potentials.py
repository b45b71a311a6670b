"""Lower bounds on each node's remaining time, by dynamic programming."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dualarm_cli.compiled.transfer_times import least_through, work_times
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.records import dataclass
from dualarm_cli.stages.plans.candidates import Nodes
from dualarm_cli.stages.plans.problem import ArmDecisions, ArmWork, SequenceProblem
from dualarm_cli.stages.plans.slowing import UNLIMITED, Places, fastest
from dualarm_cli.stages.plans.source import given_postures
from dualarm_cli.stages.plans.times import TransferChain
from dualarm_cli.timing.transfer_table import Coordinates, TransferTable, rows_of

Times = NDArray[np.float32]


@dataclass(frozen=True)
class Layer:
    """Nodes of one arm in one stage, in table coordinates."""

    decisions: ArmDecisions
    """Decisions of each node in single precision, in order of platform angle."""
    angle_index: IntArray
    """Index of the platform angle within the grid's, ascending, shape (n,)."""
    free_last: bool
    """Whether the last joint is free: any yaw will do, and it turns that joint alone."""
    approach: Coordinates
    """Joints and platform where the approach starts, in steps, shape (c, n)."""
    retract: Coordinates
    """Joints and platform where the retract ends, in steps, shape (c, n)."""
    work: Times
    """Time of approach, dwell and retract [s], shape (n,)."""

    def take(self, rows: IntArray) -> Layer:
        """Select nodes, which stay in order of platform angle."""
        return Layer(
            self.decisions.take(rows),
            self.angle_index[rows],
            self.free_last,
            rows_of(self.approach, rows),
            rows_of(self.retract, rows),
            self.work[rows],
        )

    def by_angle(self, f: int) -> IntArray:
        """List each platform angle's nodes, (f, w), padded with the node count."""
        n = len(self.angle_index)
        count = np.bincount(self.angle_index, minlength=f)
        table = np.full((f, max(1, int(count.max()))), n, dtype=np.int64)
        column = np.arange(n) - np.repeat(np.cumsum(count) - count, count)
        table[self.angle_index, column] = np.arange(n)
        return table


@dataclass(frozen=True)
class ArmLayers:
    """Layers and potentials of one arm over the whole sequence."""

    table: TransferTable
    """Times of its joints and of the platform."""
    chain: TransferChain
    """Transfers of the arm."""
    layers: Sequence[Layer | None]
    """Layer of each stage; None in idle stages."""
    potential: Sequence[Times | None]
    """Least remaining time after each node's retract [s], by stage."""
    passed: FloatArray
    """Part of the potentials due to each idle stage [s], 0 elsewhere, shape (n,)."""
    bound: float
    """Least time of the whole sequence as this arm sees it [s]."""
    linked: BoolArray | None = None
    """Flags of stages that keep the target number of the arm's stage before, shape (n,).

    None for no such stage.
    """

    def decided(self, work: ArmWork, chosen: IntArray) -> ArmDecisions:
        """Convert the node chosen in each stage, -1 where idle, shape (n,), to decisions."""
        rows = ArmDecisions.idle(work.start, len(chosen))
        for k in np.nonzero(chosen >= 0)[0].tolist():
            layer, stop = self.layers[k], work.stops[k]
            assert layer is not None  # a node of it is chosen
            rows = rows.put(np.array([k]), layer.decisions.take(chosen[[k]]))
            if stop is not None and stop.configurations is not None:
                # Layers are in single precision; given configurations are exact.
                q = stop.configurations[rows.target[[k]]]
                given = given_postures(work, rows.take(np.array([k])), q)
                rows = rows.put(np.array([k]), given)
        return rows

    def quadrants(self, joints: Coordinates, border: float) -> IntArray:
        """Compute the quadrant of each joint, shape (c, n), as a class of postures.

        Args:
            joints: joints and platform, in steps, shape (c, n).
            border: offset of the quadrants' borders from the multiples of a quarter turn [rad].
        """
        turned = self.table.joints(joints).T + border
        return np.mod(np.floor(turned / (0.5 * np.pi)), 4).astype(np.int64)

    def best_of_kinds(self, layer: Layer, total: Times, border: float) -> BoolArray:
        """Flag the best node of each class at each platform angle, shape (b, n)."""
        rows = np.vstack([self.quadrants(layer.retract, border), layer.angle_index])
        kinds = np.unique(rows, axis=1, return_inverse=True)[1]
        best = np.zeros(total.shape, dtype=np.bool_)
        for kind in range(int(kinds.max(initial=-1)) + 1):
            members = np.flatnonzero(kinds == kind)
            best[np.arange(len(total)), members[np.argmin(total[:, members], axis=1)]] = True
        return best


@dataclass(frozen=True)
class _Edges:
    """Transfers of one arm into one stage."""

    times: Times
    """Longer of arm and platform, and the stop's work [s], shape (n before, n)."""
    angle_before: IntArray
    """Index of the platform angle of each node before; 0 where it does not count."""
    adjacent: bool
    """Whether it counts: else another stage lies between, or nothing is before."""
    angle: IntArray
    """Index of the platform angle of each node."""
    relaxed: Times
    """Least time for every pair of platform angles [s], shape (f, f), infinite for none."""


def arm_layers(
    problem: SequenceProblem, arm: int, angles: FloatArray, nodes: Iterable[Nodes | None]
) -> ArmLayers:
    """Build an arm's layers without potentials.

    Args:
        problem: the sequence.
        arm: index of the arm.
        angles: the grid's platform angles at each stage [rad], shape (n, f).
        nodes: the arm's nodes by stage, in order of their platform angle; None where it is idle.
    """
    work = problem.arms[arm]
    table = transfer_table(problem, work)
    layers = [
        None if stage_nodes is None else layer_of(problem, table, here, stage_nodes)
        for here, stage_nodes in zip(angles, nodes, strict=True)
    ]
    n = problem.stages
    return ArmLayers(table, TransferChain.of(work), layers, [None] * n, np.zeros(n), 0.0)


def transfer_table(problem: SequenceProblem, work: ArmWork) -> TransferTable:
    """Build the table of joint and platform times between any two postures."""
    laws, lower, upper = [work.law], work.limits.lower, work.limits.upper
    if problem.platform_law is not None:
        laws.append(problem.platform_law)
        low, high = problem.platform_range
        lower, upper = np.append(lower, low), np.append(upper, high)
    return TransferTable.of(laws, lower, upper)


def with_potentials(
    problem: SequenceProblem, arms: Sequence[ArmLayers], angles: int
) -> tuple[ArmLayers, ...]:
    """Compute the arms' potentials by backward dynamic programming over the stages.

    A stage lasts at least max(platform, own transfer) + own work, and at least what the other arm needs for the same
    two platform angles with whatever nodes suit it best. So a potential never exceeds what any plan on the nodes still
    needs, and the larger of both arms' at the start is a bound on all such plans (up to the table's resolution). Across
    stages in which an arm is idle, its platform angle is left open.

    Args:
        problem: the sequence.
        arms: its layers.
        angles: number of the grid's platform angles at a stage.
    """
    n = problem.stages
    potential: list[list[Times | None]] = [[None] * n for _ in arms]
    value: list[Times | None] = [None] * len(arms)
    # What the stages after an arm's last stop need, as the other arm sees them.
    rest = [0.0] * len(arms)
    passed = np.zeros((len(arms), n))
    for k in range(n - 1, -1, -1):
        edges = {
            a: _edges(problem, a, arm, k, angles)
            for a, arm in enumerate(arms)
            if arm.layers[k] is not None
        }
        # For an idle arm the stage takes at least the other arm's least time.
        for a, arm in enumerate(arms):
            if a in edges:
                layer = arm.layers[k]
                assert layer is not None
                left = value[a]
                if left is None:
                    left = _return_times(problem, a, arm, layer, k) + np.float32(rest[a])
                potential[a][k] = left
                value[a] = _least(edges[a], left, [e.relaxed for b, e in edges.items() if b != a])
                continue
            least = min(float(e.times.min()) for e in edges.values())
            passed[a, k] = least
            now = value[a]
            if now is None:
                rest[a] += least
            else:
                value[a] = now + np.float32(least)
    bounds = [0.0 if v is None else float(v.min()) for v in value]
    return tuple(
        replace(arm, potential=potential[a], passed=passed[a], bound=bounds[a])
        for a, arm in enumerate(arms)
    )


def platform_columns(problem: SequenceProblem, a: int) -> tuple[int, ...]:
    """Return the platform's coordinate among an arm's, or nothing."""
    return (problem.arms[a].joints,) if problem.turns else ()


def start_coordinates(problem: SequenceProblem, arm: int, table: TransferTable) -> Coordinates:
    """Return an arm's start in table steps, shape (c, 1)."""
    q = problem.arms[arm].start[None]
    if problem.turns:
        q = np.column_stack([q, problem.platform_start[None]])
    return table.coordinates(q)


def free_columns(problem: SequenceProblem, a: int, *layers: Layer | None) -> tuple[int, ...]:
    """Return the coordinates ignored between layers: the last joint if yaw is free."""
    free = any(layer is not None and layer.free_last for layer in layers)
    return (problem.arms[a].joints - 1,) if free else ()


def layer_of(
    problem: SequenceProblem, table: TransferTable, angles: FloatArray, nodes: Nodes
) -> Layer:
    """Build one arm's layer of one stage from its nodes.

    Args:
        problem: the sequence.
        table: times of the arm's joints and of the platform.
        angles: the grid's platform angles at this stage [rad], shape (f,).
        nodes: the nodes, in order of their platform angle.
    """

    def steps(q: FloatArray) -> Coordinates:
        if problem.turns:
            q = np.column_stack([q, angles[nodes.angle_index]])
        return table.coordinates(q)

    return Layer(
        nodes.decisions.compact(),
        nodes.angle_index,
        nodes.free_last,
        steps(nodes.q_approach),
        steps(nodes.q_retract),
        nodes.work.astype(np.float32),
    )


def _edges(problem: SequenceProblem, a: int, arm: ArmLayers, k: int, angles: int) -> _Edges:
    """Compute one arm's transfers into stage k, in which it works."""
    layer, came = arm.layers[k], int(arm.chain.previous[k])
    assert layer is not None
    before = arm.layers[came] if came >= 0 else None
    angle, adjacent = layer.angle_index, came == k - 1
    if came < 0 and k == 0 and problem.free_start:
        columns, first = np.unique(angle, return_index=True)
        relaxed = np.full((angles, angles), np.inf, dtype=np.float32)
        relaxed[:, columns] = np.minimum.reduceat(layer.work, first)
        return _Edges(layer.work[None], np.zeros(1, dtype=np.int64), False, angle, relaxed)
    without = (
        *free_columns(problem, a, layer, before),
        *(() if adjacent else platform_columns(problem, a)),
    )
    start = start_coordinates(problem, a, arm.table) if before is None else before.retract
    # There is but one angle at the start: by any number.
    angle_before = np.zeros(start.shape[1], dtype=np.int64)
    if adjacent and before is not None:
        angle_before = before.angle_index
    times, relaxed = work_times(
        arm.table.laws(without), start, layer.approach, layer.work, (angle_before, angle, angles)
    )
    relaxed = relaxed if adjacent else np.tile(relaxed[0], (angles, 1))
    return _Edges(times, angle_before, adjacent, angle, relaxed)


def _least(edges: _Edges, left: Times, others: Sequence[Times]) -> Times:
    """Compute the least time from every node before, both arms considered, (n before,)."""
    # No stage is shorter than 0: alone an arm is as long as it needs.
    floor = np.zeros_like(edges.relaxed)
    for times in others:
        np.maximum(floor, times if edges.adjacent else times.min(axis=0), out=floor)
    return least_through(edges.times, (edges.angle_before, edges.angle), floor, left)


def _return_times(problem: SequenceProblem, a: int, arm: ArmLayers, layer: Layer, k: int) -> Times:
    """Compute return times from every node of an arm's last stop [s].

    The platform counts only where the stop is in the last stage k: else it turns on with the other arm.
    """
    if not problem.returns or problem.free_start:
        return np.zeros(len(layer.work), dtype=np.float32)
    goal = start_coordinates(problem, a, arm.table)
    without = free_columns(problem, a, layer)
    if k < problem.stages - 1:
        without = (*without, *platform_columns(problem, a))
    return arm.table.times(layer.retract, goal, without)[:, 0]


def slowed_times(
    problem: SequenceProblem,
    a: int,
    k: int,
    times: Times,
    ends: tuple[Coordinates, Coordinates],
    table: TransferTable,
) -> Times:
    """Slow transfers (b, n) into stage k to about their care.

    A tool with a speed limit takes at least as long as at that speed throughout.

    Args:
        problem: the sequence.
        a: index of the arm.
        k: the stage.
        times: times without care [s], shape (b, n).
        ends: joints of the states (c, b) and of the nodes (c, n), in steps.
        table: table of its transfers.
    """
    work = problem.arms[a]
    slowing = work.slowing
    assert slowing is not None  # only then
    times = times * np.float32(slowing.stretch(k, work.law))
    if slowing.cap[k] == UNLIMITED:
        return times
    start, goal = (
        slowing.places(
            problem.platform,
            q[:, : work.joints],
            q[:, work.joints :] if problem.turns else problem.platform_start[None],
        )
        for q in map(table.joints, ends)
    )
    start = Places(start.q[:, None], start.p[:, None], start.J[:, None])
    least = fastest([start, goal]) / slowing.cap[k]
    return np.maximum(times, least.astype(np.float32))
