"""Beam search on the nodes: both arms together, stage by stage, guided by the potentials."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dualarm_cli.geometry.arrays import FloatArray, IntArray, best_of_each
from dualarm_cli.records import dataclass
from dualarm_cli.stages.plans.clearance import SequenceClearance
from dualarm_cli.stages.plans.problem import Decisions, SequenceProblem
from dualarm_cli.stages.search.plan_clearance import step_waits
from dualarm_cli.stages.search.potentials import (
    ArmLayers,
    Layer,
    free_columns,
    platform_columns,
    slowed_times,
    start_coordinates,
)
from dualarm_cli.timing.transfer_table import Coordinates, rows_of


@dataclass(frozen=True)
class BeamStep:
    """Back-pointers of the states of one stage."""

    parent: IntArray
    """Index among the states before, shape (b,)."""
    node: IntArray
    """Each arm's node, -1 where idle, shape (arms, b)."""
    angle_index: IntArray
    """Platform angle within the grid's, shape (b,)."""

    def take(self, rows: IntArray) -> BeamStep:
        """Select steps by their indices."""
        return BeamStep(self.parent[rows], self.node[:, rows], self.angle_index[rows])


IMPOSSIBLE = 1e6
"""Penalty of a step with an unavoidable collision [s]."""


@dataclass(frozen=True)
class NodePath:
    """Plan on the grid's nodes."""

    decisions: Decisions
    """Decisions of the plan."""
    nodes: IntArray
    """Each arm's node in every stage, -1 where idle, shape (arms, n)."""
    total: float
    """Its time with the nodes' own line times [s], and about what it costs for clearance."""

    @property
    def is_possible(self) -> bool:
        """Whether no stop has an unavoidable collision, by the fast test."""
        return self.total < IMPOSSIBLE


@dataclass(frozen=True)
class _Beam:
    """Nodes of both arms and the widths of the beam."""

    problem: SequenceProblem
    """The sequence."""
    arms: tuple[ArmLayers, ...]
    """Layers with potentials."""
    angles: FloatArray
    """The grid's platform angles at each stage [rad], shape (n, f)."""
    width: int
    """States that are kept."""
    per_angle: int
    """Nodes of each arm that are paired at each platform angle."""
    varied: bool = False
    """Flag of a beam that keeps nodes and states of every kind of posture."""

    def nodes_per_angle(self, rows: int, arms: int) -> int:
        """Return the number of nodes per working arm for each state's angle."""
        if not self.varied:
            return self.per_angle
        most = self.problem.settings.varied_options // rows
        return max(self.per_angle, math.isqrt(most) if arms == 2 else most)

    @property
    def rated_pairs(self) -> int:
        """Number of pairs rated in a stage."""
        if self.varied:
            return self.problem.settings.varied_pairs
        return self.problem.settings.oversampling * len(self.arms) * self.width


@dataclass(frozen=True)
class _States:
    """Partial plans; b of them."""

    spent: NDArray[np.float32]
    """Time so far [s], shape (b,)."""
    node: IntArray
    """Each arm's last node, -1 before its first stop, shape (arms, b)."""
    joints: tuple[Coordinates, ...]
    """Each arm's joints and the platform, in steps, shape (c, b)."""
    angle: IntArray
    """Platform angle in the arms' last common coordinates, in steps, shape (b,)."""
    left: NDArray[np.float32]
    """Lower bound of each arm's remaining time [s], shape (arms, b)."""

    def take(self, rows: IntArray) -> _States:
        """Select plans by their indices."""
        joints = tuple(rows_of(q, rows) for q in self.joints)
        left = self.left[:, rows]
        return _States(self.spent[rows], self.node[:, rows], joints, self.angle[rows], left)


@dataclass(frozen=True)
class _Candidates:
    """Possible steps into one stage, best first; b of them."""

    step: BeamStep
    """Nodes, and the states that they are reached from."""
    spent: NDArray[np.float32]
    """Time at the end of the stage [s], shape (b,)."""
    total: NDArray[np.floating[Any]]
    """Lower bound on the time of the whole plan [s], shape (b,)."""

    def take(self, rows: IntArray) -> _Candidates:
        """Select steps by their indices."""
        return _Candidates(self.step.take(rows), self.spent[rows], self.total[rows])


def beam_search(
    problem: SequenceProblem,
    arms: tuple[ArmLayers, ...],
    angles: FloatArray,
    width: int,
    per_angle: int,
    plans: int = 1,
) -> list[NodePath]:
    """Find the best plans on the nodes, of different branches, targets or yaws.

    From every kept state and at every platform angle the arms' best nodes are paired; a pair costs what the slower arm
    needs, plus the larger of what the arms still need at least. The best `width` different states are kept. Where
    something has to be collision-free, a pair counts about what that costs as well, as far as it is among the best.
    If the best states all collide, a second beam pairs one node of every kind of posture and keeps states of all kinds.

    Args:
        problem: the sequence.
        arms: layers with potentials.
        angles: the grid's platform angles at each stage [rad], shape (n, f).
        width: how many states are kept.
        per_angle: how many nodes of each arm are paired at each platform angle; with all of them and all states kept,
            the first plan is the best one on the nodes.
        plans: how many plans at most.
    """
    beam = _Beam(problem, arms, angles, width, per_angle)
    node_paths = _searched(beam, plans)
    if problem.clearance is None or (node_paths and node_paths[0].is_possible):
        return node_paths
    width = max(width, problem.settings.varied_states)
    varied = _searched(replace(beam, width=width, varied=True), plans)
    return varied if varied and varied[0].is_possible else node_paths


def _searched(beam: _Beam, plans: int) -> list[NodePath]:
    """Search stage by stage for the best plans, see `beam_search`."""
    states = _first(beam.problem, beam.arms)
    steps: list[BeamStep] = []
    for k in range(beam.problem.stages):
        extended = _extend(beam, states, k, beam.rated_pairs)
        if extended is None:
            return []
        step, states = extended
        steps.append(step)
    trace = _trace(steps)
    total = states.spent + _closing_times(beam, steps, trace)
    total += np.minimum(_return_costs(beam, states, steps, trace), IMPOSSIBLE).astype(np.float32)
    best = [int(np.argmin(total))] if plans == 1 else np.argsort(total, kind="stable").tolist()
    paths: dict[bytes, NodePath] = {}
    for state in best:
        path = _path(beam, steps, trace[:, state], float(total[state]))
        paths.setdefault(path.decisions.kind, path)
        if len(paths) == plans:
            break
    return list(paths.values())


def _trace(steps: list[BeamStep]) -> IntArray:
    """Trace every final state back: its state in each stage, shape (n, b)."""
    states = [np.arange(len(steps[-1].parent))]
    for step in steps[:0:-1]:
        states.append(step.parent[states[-1]])
    return np.stack(states[::-1])


def _closing_times(beam: _Beam, steps: list[BeamStep], trace: IntArray) -> NDArray[np.float32]:
    """Time the return from every final state [s], shape (b,); 0 without one.

    Where the start is free, a cycle closes wherever its first transfer would have ended.
    """
    problem = beam.problem
    closing = np.zeros(trace.shape[1], dtype=np.float32)
    if not problem.returns:
        return closing
    for a, arm in enumerate(beam.arms):
        if not len(arm.chain.active):
            continue
        k = int(arm.chain.active[-1])
        end = arm.layers[k]
        assert end is not None  # the arm is active there
        begin = arm.layers[0] if problem.free_start else None
        origin = rows_of(end.retract, steps[k].node[a, trace[k]])
        without = (*free_columns(problem, a, end, begin), *platform_columns(problem, a))
        if begin is None:
            home = start_coordinates(problem, a, arm.table)
            times = arm.table.times(origin, home, without)[:, 0]
        else:
            first = rows_of(begin.approach, steps[0].node[a, trace[0]])
            times = arm.table.times(origin, first, without).diagonal()
        np.maximum(closing, times, out=closing)
    if problem.platform_law is not None:
        back_to: FloatArray = problem.platform_start
        if problem.free_start:
            back_to = beam.angles[0, steps[0].angle_index[trace[0]]]
        moved = back_to - beam.angles[-1, steps[-1].angle_index]
        np.maximum(closing, problem.platform_law.duration(moved[:, None]), out=closing)
    return closing


def _path(beam: _Beam, steps: list[BeamStep], states: IntArray, total: float) -> NodePath:
    """Return the plan that takes a state in each stage, shape (n,)."""
    rows = list(zip(steps, states.tolist(), strict=True))
    angle = np.array([beam.angles[k, step.angle_index[i]] for k, (step, i) in enumerate(rows)])
    nodes = np.stack([step.node[:, i] for step, i in rows], axis=1)
    decisions = tuple(map(ArmLayers.decided, beam.arms, beam.problem.arms, nodes))
    return NodePath(Decisions(angle, decisions), nodes, total)


def _return_costs(
    beam: _Beam, states: _States, steps: list[BeamStep], trace: IntArray
) -> FloatArray:
    """Compute the no-good costs of the return from the final states [s], shape (b,)."""
    problem, test, b = beam.problem, beam.problem.clearance, len(states.spent)
    n = problem.stages
    if test is None or not problem.returns or all(no_good.stage != n for no_good in test.no_goods):
        return np.zeros(b)
    home = problem.platform_start if problem.turns else np.zeros(1)
    angle = np.repeat(home, b)
    if problem.free_start:
        angle = beam.angles[0, steps[0].angle_index[trace[0]]]
    begins, ends = list[FloatArray | None](), list[FloatArray | None]()
    for a, (arm, work) in enumerate(zip(beam.arms, problem.arms, strict=True)):
        layer = arm.layers[0] if problem.free_start else None
        first = np.tile(work.start, (b, 1))
        if layer is not None:
            first = arm.table.joints(rows_of(layer.approach, steps[0].node[a, trace[0]]))
        begins.append(first[:, : work.joints])
        ends.append(arm.table.joints(states.joints[a])[:, : work.joints])
    last = beam.angles[-1, steps[-1].angle_index]
    return test.no_good_costs(n, test.positions(last, ends), test.positions(angle, begins))


def _first(problem: SequenceProblem, arms: tuple[ArmLayers, ...]) -> _States:
    joints = tuple(start_coordinates(problem, a, arm.table) for a, arm in enumerate(arms))
    return _States(
        np.zeros(1, dtype=np.float32),
        np.full((len(arms), 1), -1, dtype=np.int64),
        joints,
        np.zeros(1, dtype=np.int64),
        np.zeros((len(arms), 1), dtype=np.float32),
    )


def _extend(
    beam: _Beam, states: _States, k: int, rated: int | None
) -> tuple[BeamStep, _States] | None:
    """Extend states by stage k; None if no pair of nodes matches.

    Where something has to be collision-free, the best steps count as long as that takes, about. If all of them
    collide, the best state alone is extended by more nodes.

    Args:
        beam: nodes and how widely they are searched.
        states: partial plans up to the stage.
        k: the stage.
        rated: maximum number of pairs that are rated; None rates all.
    """
    candidates = _paired(beam, states, k, rated)
    if candidates is None:
        return None
    if beam.problem.clearance is not None:
        kinds = _kinds(beam, states, candidates.step, k)
        rows = best_of_each(kinds, beam.problem.settings.first_per_kind, rated)
        candidates, kinds = candidates.take(rows), kinds[rows]
        waits = _waits(beam, beam.problem.clearance, states, candidates.step, k)
        if not np.isfinite(waits).any():
            if beam.varied:
                return None
            if rated is not None and sum(arm.layers[k] is not None for arm in beam.arms) > 1:
                return _extend_best(beam, states, k)
        candidates = _delayed(candidates, waits, kinds if beam.varied else None)
    step = candidates.step
    last = np.where(step.node >= 0, step.node, states.node[:, step.parent] + 1_000_000)
    _, first = np.unique(last, axis=1, return_index=True)
    kept = candidates.take(np.sort(first)[: beam.width])
    return kept.step, _moved(beam, states, kept, k)


def _extend_best(beam: _Beam, states: _States, k: int) -> tuple[BeamStep, _States] | None:
    """Extend the best state alone by stage k.

    More nodes are paired, and all pairs are rated.
    """
    best = np.argmin(states.spent + states.left.max(axis=0), keepdims=True)
    wide = replace(beam, per_angle=max(beam.per_angle, beam.problem.settings.fallback_per_angle))
    if (extended := _extend(wide, states.take(best), k, None)) is None:
        return None
    step, after = extended
    # Its parents are counted among the states it was given.
    return replace(step, parent=best[step.parent]), after


def _paired(beam: _Beam, states: _States, k: int, rated: int | None) -> _Candidates | None:
    """Pair the arms' best nodes at every platform angle; None if no pair fits together."""
    arms, f, b = beam.arms, beam.angles.shape[1], len(states.spent)
    working = [a for a, arm in enumerate(arms) if arm.layers[k] is not None]
    most = beam.nodes_per_angle(b * f, len(working))
    # By arm: cost, what is left after, node; (b, f, w) each, with one more axis for a second arm.
    options = [_options(beam, states, a, k, most) for a in working]
    cost, left, nodes = options[0]
    chosen = [nodes]
    if len(options) == 2:
        cost_2, left_2, nodes_2 = options[1]
        cost = np.maximum(cost[..., :, None], cost_2[..., None, :])
        if any(beam.problem.handing[k : k + 1]):
            # Giver and taker have the same pair of grasps.
            pair, pair_2 = (
                _targets(arms[a].layers[k], o[2]) for a, o in zip(working, options, strict=True)
            )
            cost = np.where(pair[..., :, None] == pair_2[..., None, :], cost, np.float32(np.inf))
        left = np.maximum(left[..., :, None], left_2[..., None, :])
        chosen = [
            np.broadcast_to(nodes[..., :, None], cost.shape),
            np.broadcast_to(nodes_2[..., None, :], cost.shape),
        ]
    per_state = (b, *(1,) * (cost.ndim - 1))
    for a, arm in enumerate(arms):
        if a not in working:
            waiting = states.left[a] - np.float32(arm.passed[k])
            left = np.maximum(left, waiting.reshape(per_state))
    spent = states.spent.reshape(per_state) + cost
    total = (spent + left).ravel()
    possible = np.nonzero(np.isfinite(total))[0]
    if not len(possible):
        return None
    if rated is not None and beam.problem.clearance is not None:
        rated *= beam.problem.settings.clearance_oversampling
    best = possible[np.argsort(total[possible], kind="stable")[:rated]]
    node = np.full((len(arms), len(best)), -1, dtype=np.int64)
    for a, rows in zip(working, chosen, strict=True):
        node[a] = rows.ravel()[best]
    by_angle = best // (total.size // (b * f))
    step = BeamStep(by_angle // f, node, by_angle % f)
    return _Candidates(step, spent.ravel()[best], total[best])


def _targets(layer: Layer | None, nodes: IntArray) -> IntArray:
    """Look up the target numbers of nodes; -1 for the padding beyond the last node."""
    assert layer is not None  # the arm works
    return np.append(layer.decisions.target, -1)[nodes]


def _delayed(candidates: _Candidates, waits: FloatArray, kinds: IntArray | None) -> _Candidates:
    """Add clearance delays to candidates, (b,), and sort them again.

    The best of each class come first.

    Impossible ones come last; if there are no others, what is wrong with them is found out when they are timed.
    """
    total = candidates.total + waits
    spent = candidates.spent + np.minimum(waits, IMPOSSIBLE).astype(np.float32)
    order = np.argsort(total, kind="stable")
    if kinds is not None:
        order = order[best_of_each(kinds[order], 1, None)]
    return _Candidates(candidates.step, spent, total).take(order)


def _kinds(beam: _Beam, states: _States, step: BeamStep, k: int) -> IntArray:
    """Number the classes of steps into stage k, shape (b,): platform angle, branches, yaws.

    In a varied beam it is the platform angle and the quadrants of all joints after the stage.
    """
    columns = [step.angle_index.astype(np.float64)]
    for a, (arm, node) in enumerate(zip(beam.arms, step.node, strict=True)):
        layer = arm.layers[k]
        if beam.varied:
            rows = states.joints[a][:, step.parent] if layer is None else layer.retract[:, node]
            columns += list(arm.quadrants(rows, beam.problem.settings.quadrant_border))
        elif layer is not None:
            columns += [layer.decisions.branch[node], layer.decisions.yaw[node]]
    return np.asarray(np.unique(np.round(columns, 5), axis=1, return_inverse=True)[1])


def _waits(
    beam: _Beam, test: SequenceClearance, states: _States, step: BeamStep, k: int
) -> FloatArray:
    """Estimate the clearance cost of steps into stage k [s], shape (b,)."""
    problem = beam.problem
    # By arm: all joints at the start, at arrival, at the target and at the end.
    places: list[list[FloatArray]] = []
    for a, arm in enumerate(beam.arms):
        layer, node = arm.layers[k], step.node[a]
        places.append([arm.table.joints(rows_of(states.joints[a], step.parent))] * 4)
        if layer is not None:
            places[a][1] = arm.table.joints(rows_of(layer.approach, node))
            places[a][2] = layer.decisions.near[node].astype(np.float64)
            places[a][3] = arm.table.joints(rows_of(layer.retract, node))
    turned = beam.angles[k, step.angle_index]
    here = places[0][0][:, -1] if problem.turns else turned
    at = [
        test.positions(angle, [q[:, : w.joints] for q, w in zip(joints, problem.arms, strict=True)])
        for angle, joints in zip((here, *[turned] * 3), zip(*places, strict=True), strict=True)
    ]
    if k == 0 and problem.free_start:
        at[0] = at[1]
    return step_waits(test, k, *at)


def _options(
    beam: _Beam, states: _States, a: int, k: int, most: int
) -> tuple[NDArray[np.float32], NDArray[np.float32], IntArray]:
    """Select an arm's best nodes by state and platform angle: cost, rest, node (b, f, w).

    In a varied beam only the best node of each kind of posture counts.
    """
    problem, arm, f = beam.problem, beam.arms[a], beam.angles.shape[1]
    layer, potential = arm.layers[k], arm.potential[k]
    assert layer is not None
    assert potential is not None
    if k == 0 and problem.free_start:
        cost = np.zeros((1, len(potential)), dtype=np.float32)
    else:
        came = int(arm.chain.previous[k])
        without = free_columns(problem, a, layer, arm.layers[came] if came >= 0 else None)
        cost = arm.table.times(states.joints[a], layer.approach, without)
        if problem.arms[a].slowing is not None:
            cost = slowed_times(problem, a, k, cost, (states.joints[a], layer.approach), arm.table)
        if arm.linked is not None and arm.linked[k]:
            before = arm.layers[came]
            assert before is not None  # a linked stage follows another one of the arm
            target = before.decisions.target[states.node[a]]
            cost = np.where(target[:, None] == layer.decisions.target, cost, np.float32(np.inf))
    cost = cost + layer.work
    if beam.varied:
        border = problem.settings.quadrant_border
        best_ones = arm.best_of_kinds(layer, cost + potential, border)
        cost = np.where(best_ones, cost, np.float32(np.inf))
    at = layer.by_angle(f)
    padded = np.concatenate([cost, np.full((len(cost), 1), np.inf, dtype=np.float32)], axis=1)
    cost = padded[:, at]
    left = np.append(potential, np.float32(np.inf))[at]
    total = cost + left
    w = min(most, total.shape[2])
    best = np.argsort(total, axis=2, kind="stable")[..., :w]
    cost = np.take_along_axis(cost, best, axis=2)
    nodes = np.take_along_axis(np.broadcast_to(at, total.shape), best, axis=2)
    left = np.take_along_axis(np.broadcast_to(left, total.shape), best, axis=2)
    return cost, left, nodes


def _moved(beam: _Beam, states: _States, kept: _Candidates, k: int) -> _States:
    """Return the states after steps into stage k."""
    problem, arms, step = beam.problem, beam.arms, kept.step
    node = np.where(step.node >= 0, step.node, states.node[:, step.parent])
    joints, left = [], states.left[:, step.parent].copy()
    platform = None
    for a, arm in enumerate(arms):
        layer, potential = arm.layers[k], arm.potential[k]
        if layer is None or potential is None:
            joints.append(rows_of(states.joints[a], step.parent))
            left[a] -= np.float32(arm.passed[k])
            continue
        joints.append(rows_of(layer.retract, step.node[a]))
        left[a] = potential[step.node[a]]
        platform = joints[-1][list(platform_columns(problem, a))]
        scale = arm.table.scale[-1]
    for a, arm in enumerate(arms):
        if arm.layers[k] is None and problem.turns and platform is not None:
            # The platform carries an idle arm along; each arm's table has its own scale.
            ratio = arm.table.scale[-1] / scale
            joints[a][-1] = np.round(platform[0] * ratio).astype(np.int16)
    return _States(kept.spent, node, tuple(joints), step.angle_index, left)
