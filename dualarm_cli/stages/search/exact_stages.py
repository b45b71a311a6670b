"""Exact platform angles for stages without a common angle on the grid."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import field, replace

import numpy as np

from dualarm_cli.collision.clearance import SLACK
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray, distinct
from dualarm_cli.geometry.elementary import TURN
from dualarm_cli.kinematics.srs.arm_angle_intervals import ArmAngleIntervals
from dualarm_cli.postures.platform_reach import reachable_cells, reachable_spans
from dualarm_cli.records import dataclass
from dualarm_cli.stages.plans.candidates import (
    Grid,
    Nodes,
    flange_poses,
    platform_positions,
    thinned,
)
from dualarm_cli.stages.plans.problem import ArmDecisions, SequenceProblem
from dualarm_cli.stages.plans.source import grid_nodes, postures
from dualarm_cli.stages.search.potentials import ArmLayers, layer_of

Interval = tuple[float, float]


def shared_intervals(problem: SequenceProblem, stage: int, around: Interval) -> list[Interval]:
    """Find the platform angles from which all arms reach their stops of a stage.

    Exact over arm angle and reach. If limits decide, every interval wider than the scan step is found, with exact ends;
    so are the intervals that two arms share, however narrow.

    Args:
        problem: the sequence; its platform turns.
        stage: its number.
        around: lowest and highest platform angle [rad].

    Returns:
        Lowest and highest angles, ascending [rad].
    """
    shared = [around]
    for a, work in enumerate(problem.arms):
        if work.stops[stage] is None:
            continue
        arm_intervals = _intervals(problem, a, stage, around)
        both = [(max(p[0], q[0]), min(p[1], q[1])) for p in shared for q in arm_intervals]
        shared = sorted((low, high) for low, high in both if low <= high)
    return shared


def spread(intervals: Sequence[Interval], count: int) -> FloatArray:
    """Spread a number of angles over intervals, ascending [rad], shape (c,)."""
    if not intervals:
        return np.zeros(0)
    widest = sorted(intervals, key=lambda interval: interval[0] - interval[1])[:count]
    width = np.array([high - low for low, high in widest])
    spare = count - len(widest)
    shares = width / max(float(width.sum()), 1e-12)
    numbers = 1 + np.floor(spare * shares).astype(np.int64)
    return np.sort(
        np.concatenate(
            [
                low + (high - low) * (np.arange(n) + 0.5) / n
                for (low, high), n in zip(widest, numbers.tolist(), strict=True)
            ]
        )
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
    yaws = _yaws(problem, a, stage)
    f = np.repeat(np.arange(len(angles)), len(yaws))
    yaw = np.tile(yaws, len(angles))
    intervals = _intervals_of_arm_angles(problem, a, stage, angles[f], yaw)
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
        stop.free_yaw and work.yaw_turns_last_joint,
    )
    return thinned(nodes, most)


def _yaws(problem: SequenceProblem, a: int, stage: int) -> FloatArray:
    stop = problem.arms[a].stops[stage]
    assert stop is not None
    if stop.free_yaw:
        return np.linspace(-np.pi, np.pi, problem.settings.scan_yaws, endpoint=False)
    return stop.yaw


def _poses(
    problem: SequenceProblem,
    a: int,
    stage: int,
    angles: FloatArray,
    yaw: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Compute target, approach and retract poses, (m, 1, 3, 3), (m, 3, 3).

    They are poses of the flange.
    """
    table = problem.arms[a].stop_table
    work = problem.arms[a]
    row = np.full(len(angles), table.first[stage])
    R, p, z = flange_poses(problem.platform, work, row, yaw, platform_positions(problem, angles))
    depths = np.array([0.0, table.approach[stage], table.retract[stage]])
    return R[:, None], p[:, None, :] - z[:, None, :] * depths[:, None]


def _intervals_of_arm_angles(
    problem: SequenceProblem,
    a: int,
    stage: int,
    angles: FloatArray,
    yaw: FloatArray,
) -> ArmAngleIntervals:
    """Compute feasible arm angles at target, approach and retract, arrays (m, 3, 8, k)."""
    R, points = _poses(problem, a, stage, angles, yaw)
    return problem.arms[a].closed_form.feasible_arm_angles(R, points)


def _intervals(problem: SequenceProblem, a: int, stage: int, around: Interval) -> list[Interval]:
    """Find the platform angles from which one arm reaches its stop [rad]."""
    stop = problem.arms[a].stops[stage]
    if stop is None or stop.configurations is not None:
        # Given configurations turn with the platform: reach does not depend on its angle.
        return [around]

    settings = problem.settings

    def has_nodes(angles: FloatArray) -> BoolArray:
        grid = Grid(angles, settings.scan_arm_angles, settings.every_node)
        nodes = grid_nodes(problem, a, stage, grid)
        return np.bincount(nodes.angle_index, minlength=len(angles)) > 0

    if not problem.arms[a].kinematics.has_arm_angle:
        step = problem.platform.spacing(settings.coarse_scan_step, *around)
        angles = np.append(np.arange(*around, step), around[1])
        return _runs(angles, has_nodes, settings.coarse_scan_rounds)
    yaws = _yaws(problem, a, stage)

    def feasible(angles: FloatArray) -> BoolArray:
        yaw = np.tile(yaws, len(angles))
        at = np.repeat(angles, len(yaws))
        intervals = _intervals_of_arm_angles(problem, a, stage, at, yaw)
        # On one branch all along the lines, at any yaw.
        branches = np.all(intervals.count > 0, axis=1)
        return np.asarray(branches.reshape(len(angles), -1).any(axis=1))

    angles = np.arange(*around, problem.platform.spacing(settings.scan_step, *around))
    arcs = _arcs(problem, a, stage, yaws, around)
    angles = distinct(np.concatenate([angles, [around[1]], *arcs]))
    return _runs(angles, feasible, settings.scan_rounds)


def _arcs(
    problem: SequenceProblem,
    a: int,
    stage: int,
    yaws: FloatArray,
    around: Interval,
) -> list[FloatArray]:
    """Sample platform angles at which a stop's points are within reach [rad]."""
    R, points = _poses(problem, a, stage, np.zeros(len(yaws)), yaws)
    arm = problem.arms[a].closed_form
    angles, count = [], problem.settings.angles_in_reach
    for wrists in arm.wrist_center(R, points):
        arcs = [around]
        for wrist in wrists:
            if problem.platform.is_rail:
                reachable = reachable_spans(arm, wrist)
            else:
                cells = reachable_cells(arm, wrist, np.array(around))
                reachable = list(zip(cells.low.tolist(), cells.high.tolist(), strict=True))
            arcs = [(max(p[0], q[0]), min(p[1], q[1])) for q in reachable for p in arcs]
        angles += [np.linspace(*arc, count) for arc in arcs if arc[0] <= arc[1]]
    return angles


def _runs(
    angles: FloatArray, feasible: Callable[[FloatArray], BoolArray], rounds: int
) -> list[Interval]:
    """Refine the intervals of feasibility among ascending angles (n,)."""
    ok = feasible(angles)
    if not ok.any():
        return []
    begins = np.flatnonzero(ok & ~np.append(False, ok[:-1]))
    ends = np.flatnonzero(ok & ~np.append(ok[1:], False))
    # Between an angle that is feasible and its neighbour that is not.
    inner = np.concatenate([angles[begins], angles[ends]])
    outer = np.concatenate(
        [angles[np.maximum(begins - 1, 0)], angles[np.minimum(ends + 1, len(angles) - 1)]]
    )
    parts, rows = 32, np.arange(len(inner))
    fraction = np.arange(parts + 1) / parts
    for _ in range(rounds):
        between = inner[:, None] + fraction * (outer - inner)[:, None]
        within = feasible(between[:, 1:].ravel()).reshape(len(inner), parts)
        # The last one before the first that is not; where all are, the outer end is no end.
        last = np.where(within.all(axis=1), parts, within.argmin(axis=1))
        inner, outer = between[rows, last], between[rows, np.minimum(last + 1, parts)]
    low, high = np.split(inner, 2)
    return list(zip(low.tolist(), high.tolist(), strict=True))


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
