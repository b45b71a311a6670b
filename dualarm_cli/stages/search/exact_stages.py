"""Exact platform angles for stages without a common angle on the grid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field, replace

import numpy as np

from dualarm_cli.collision.clearance import SLACK
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.geometry.elementary import TURN
from dualarm_cli.records import dataclass
from dualarm_cli.stages.plans.candidates import (
    Grid,
    Nodes,
    thinned,
)
from dualarm_cli.stages.plans.problem import ArmDecisions, SequenceProblem
from dualarm_cli.stages.plans.source import grid_nodes, postures
from dualarm_cli.stages.search.potentials import ArmLayers, layer_of
from dualarm_cli.stages.search.shared_angles import (
    Interval,
    arm_angle_intervals,
    scanned_yaws,
    shared_intervals,
    spread,
)


def exact_nodes(
    problem: SequenceProblem, a: int, stage: int, angles: FloatArray, most: int
) -> Nodes:
    """Compute exact nodes of one arm at one stop within its arm-angle intervals.

    Args:
        problem: the sequence.
        a: index of the arm.
        stage: its number.
        angles: platform angles [rad], shape (f,).
        most: maximum number of nodes.
    """
    work = problem.arms[a]
    stop = work.stops[stage]
    assert stop is not None  # callers ask for active stages only
    if stop.configurations is not None or not work.kinematics.has_arm_angle:
        grid = Grid(angles, problem.settings.scan_arm_angles, most)
        return grid_nodes(problem, a, stage, grid)
    yaws = scanned_yaws(problem, a, stage)
    f = np.repeat(np.arange(len(angles)), len(yaws))
    yaw = np.tile(yaws, len(angles))
    intervals = arm_angle_intervals(problem, a, stage, angles[f], yaw)
    first, last = intervals.start[:, 0], intervals.end[:, 0]
    shares = problem.settings.interval_shares
    m, branch, k = (np.repeat(x, len(shares)) for x in np.nonzero(np.isfinite(first)))
    share = np.tile(shares, len(m) // len(shares))
    psi = first[m, branch, k] + (last - first)[m, branch, k] * share
    psi_approach = _nearest(psi, intervals.start[m, 1, branch], intervals.end[m, 1, branch])
    psi_retract = _nearest(psi, intervals.start[m, 2, branch], intervals.end[m, 2, branch])
    rows = np.flatnonzero(np.isfinite(psi_approach) & np.isfinite(psi_retract))
    looked_at = min(len(rows), problem.settings.node_oversampling * most)
    rows = rows[np.linspace(0, len(rows) - 1, looked_at).astype(np.int64)]
    n = len(rows)
    candidates = ArmDecisions(
        np.zeros(n, dtype=np.int64),
        yaw[m[rows]],
        branch[rows].astype(np.int64),
        psi[rows],
        psi_approach[rows],
        psi_retract[rows],
        np.tile(work.kinematics.middle, (n, 1)),
    )
    index = f[m[rows]]
    joints = postures(problem, a, np.full(n, stage), angles[index], candidates)
    possible = np.flatnonzero(joints.possible)
    nodes = Nodes(
        index[possible],
        candidates.at(joints.q_target).take(possible),
        joints.q_approach[possible],
        joints.q_retract[possible],
        joints.work[possible],
        work.frees_last_joint(stop),
    )
    return thinned(nodes, most)


def _nearest(psi: FloatArray, start: FloatArray, end: FloatArray) -> FloatArray:
    """Move angles (n,) into their nearest intervals (n, k) [rad]; NaN without."""
    width = end - start
    inset = 0.05 * width
    along = np.mod(psi[:, None] - start, TURN)
    # From beyond the interval's end back to it, or on to its start.
    back, on = width - inset - along, TURN + inset - along
    moved = np.where(np.abs(back) < on, back, on)
    moved = np.where(along < inset, inset - along, moved)
    moved = np.where((along >= inset) & (along <= width - inset), 0.0, moved)
    moved = np.where(width >= TURN, 0.0, moved)
    size = np.where(np.isfinite(moved), np.abs(moved), np.inf)
    best: IntArray = np.argmin(size, axis=1)
    return psi + moved[np.arange(len(psi)), best]


def stages_without_angle(arms: Sequence[ArmLayers], angles: int) -> list[int]:
    """Return the stages without a platform angle that all working arms share.

    Args:
        arms: layers of each arm.
        angles: number of the grid's platform angles at a stage.
    """
    lacking = []
    for k, layers in enumerate(zip(*(arm.layers for arm in arms), strict=True)):
        shared = np.ones(angles, dtype=np.bool_)
        for layer in layers:
            if layer is not None:
                index = layer.angle_index[np.isfinite(layer.work)]
                shared &= np.bincount(index, minlength=angles) > 0
        if not shared.any():
            lacking.append(k)
    return lacking


@dataclass(frozen=True)
class ExactStages:
    """Cache of exact nodes of single stages."""

    problem: SequenceProblem
    """The sequence; what has to be collision-free in it does not matter."""
    _shared: dict[int, list[Interval]] = field(default_factory=dict)
    _node_cache: dict[tuple[int, int, int], tuple[FloatArray, list[Nodes | None]]] = field(
        default_factory=dict
    )

    def nodes(self, k: int, count: int, most: int) -> tuple[FloatArray, list[Nodes | None]]:
        """Return shared platform angles of a stage, and each arm's nodes there.

        Args:
            k: number of the stage, in which the arms share platform angles.
            count: maximum number of angles.
            most: maximum number of nodes of one stop.
        """
        if (k, count, most) not in self._node_cache:
            self._node_cache[k, count, most] = self._nodes(k, count, most)
        return self._node_cache[k, count, most]

    def shared(self, k: int) -> list[Interval]:
        """Return the shared platform angles of a stage [rad], see `shared_intervals`."""
        if k not in self._shared:
            start = float(self.problem.platform_start[0])
            around = self.problem.platform.around(start, *self.problem.platform_range)
            self._shared[k] = shared_intervals(self.problem, k, around)
        return self._shared[k]

    def _nodes(self, k: int, count: int, most: int) -> tuple[FloatArray, list[Nodes | None]]:
        problem = self.problem
        angles = spread(self.shared(k), count) if problem.turns else np.zeros(1)
        return angles, [
            None if work.stops[k] is None else exact_nodes(problem, a, k, angles, most)
            for a, work in enumerate(problem.arms)
        ]

    def layers(
        self,
        problem: SequenceProblem,
        arms: Sequence[ArmLayers],
        angles: FloatArray,
        stages: Sequence[int],
        most: int,
        spares: Sequence[float] = (SLACK, 0.0),
    ) -> tuple[ArmLayers, ...] | None:
        """Move stages to exact platform angles; None if a stage has none.

        Args:
            problem: the sequence.
            arms: layers of each arm.
            angles: the platform angles of all stages [rad], shape (n, f); rows of those stages are replaced.
            stages: their numbers.
            most: maximum number of nodes of one stop.
            spares: margins beyond the required clearance [m]; each is tried if the previous one leaves no angle.
        """
        # Shared angles are found much faster than the nodes at them.
        if problem.turns and not all(self.shared(k) for k in stages):
            return None
        layers = [list(arm.layers) for arm in arms]
        for k in stages:
            exact = _own_nodes(problem, self, k, angles.shape[1], most, spares)
            if exact is None:
                return None
            angles[k], nodes = exact
            for a, (arm, arm_nodes) in enumerate(zip(arms, nodes, strict=True)):
                if arm_nodes is not None:
                    partner = nodes[1 - a] if k in problem.handover_stages else None
                    layers[a][k] = layer_of(
                        problem, arm.table, angles[k], taking_turns(arm_nodes, partner)
                    )
        return tuple(replace(arm, layers=rows) for arm, rows in zip(arms, layers, strict=True))


def taking_turns(nodes: Nodes, partner: Nodes | None) -> Nodes:
    """Add the other arm's least work to a hand-over's nodes.

    Args:
        nodes: of one arm.
        partner: of the other one; None in other stages.
    """
    if partner is None or not len(nodes.work) or not len(partner.work):
        return nodes
    return replace(nodes, work=nodes.work + partner.work.min())


def free_nodes(
    problem: SequenceProblem,
    a: int,
    k: int,
    angles: FloatArray,
    nodes: Nodes,
    spare: float = SLACK,
) -> Nodes:
    """Select the nodes at which an arm is clear of itself and its surroundings.

    Args:
        problem: the sequence.
        a: index of the arm.
        k: number of the stage.
        angles: its platform angles [rad], shape (f,).
        nodes: the arm's nodes there.
        spare: margin beyond the clearance that is asked for [m].
    """
    test = problem.clearance
    if test is None or not len(nodes.work):
        return nodes
    free = np.ones(len(nodes.work), dtype=np.bool_)
    holding = test.holding
    before, after = int(holding.before[k, a]), int(holding.after[k, a])
    places = [(nodes.decisions.near, int(holding.at_targets[k, a])), (nodes.q_approach, before)]
    if before != after or not np.array_equal(nodes.q_approach, nodes.q_retract):
        places.append((nodes.q_retract, after))
    for q, held in places:
        rows = np.flatnonzero(free)
        free[rows] = test.arm_free(a, angles[nodes.angle_index[rows]], q[rows], held, spare)
    return nodes.take(np.flatnonzero(free))


def _own_nodes(
    problem: SequenceProblem,
    exact: ExactStages,
    k: int,
    count: int,
    most: int,
    spares: Sequence[float],
) -> tuple[FloatArray, list[Nodes | None]] | None:
    """Choose shared platform angles (count,) [rad] of a stage and the nodes there."""
    angles, every = exact.nodes(k, max(problem.settings.exact_angles, count), most)
    for spare in spares:
        nodes = [
            None if arm_nodes is None else free_nodes(problem, a, k, angles, arm_nodes, spare)
            for a, arm_nodes in enumerate(every)
        ]
        working = [arm_nodes for arm_nodes in nodes if arm_nodes is not None]
        shared = np.logical_and.reduce(
            [np.bincount(arm_nodes.angle_index, minlength=len(angles)) > 0 for arm_nodes in working]
        )
        if shared.any():
            break
    if len(working) > 1:
        apart = _apart(problem, k, angles, nodes, np.flatnonzero(shared))
        shared = apart if apart.any() else shared
    usable = np.flatnonzero(shared)
    if not len(usable):
        return None
    chosen = usable[np.linspace(0, len(usable) - 1, min(count, len(usable))).round().astype(int)]
    number = np.full(len(angles), -1)
    number[chosen] = np.arange(len(chosen))
    # Rows of the grid are all of one length: the last angle is repeated, without nodes.
    padded = np.append(angles[chosen], np.full(count - len(chosen), angles[chosen[-1]]))
    return padded, [None if rows is None else _renumbered(rows, number) for rows in nodes]


def _renumbered(nodes: Nodes, number: IntArray) -> Nodes:
    """Select the nodes at renumbered platform angles."""
    kept = nodes.take(np.flatnonzero(number[nodes.angle_index] >= 0))
    return replace(kept, angle_index=number[kept.angle_index])


def _apart(
    problem: SequenceProblem,
    k: int,
    angles: FloatArray,
    nodes: Sequence[Nodes | None],
    shared: IntArray,
) -> BoolArray:
    """Flag the shared platform angles with a collision-free pair of nodes (f,)."""
    free = np.zeros(len(angles), dtype=np.bool_)
    test = problem.clearance
    if test is None:
        return free
    left, right = nodes
    assert left is not None  # callers ask for stages in which both work
    assert right is not None
    max_pairs = problem.settings.paired_nodes
    for f in shared.tolist():
        rows = [np.flatnonzero(nodes_of_arm.angle_index == f) for nodes_of_arm in (left, right)]
        chosen = [r[np.linspace(0, len(r) - 1, min(len(r), max_pairs)).astype(int)] for r in rows]
        i, j = (x.ravel() for x in np.meshgrid(*chosen, indexing="ij"))
        holding = test.holding
        places = [(left.q_retract[i], right.q_retract[j], holding.after[k])]
        if holding.is_handover[k]:
            places.append((left.decisions.near[i], right.decisions.near[j], holding.at_targets[k]))
        clear = np.ones(len(i), dtype=np.bool_)
        for q, r, held in places:
            position = test.positions(np.full(len(i), angles[f]), [q, r])
            margins = holding.cell.cross_margins(position, np.tile(held, (len(i), 1)))
            clear &= margins >= SLACK
        free[f] = clear.any()
    return free
