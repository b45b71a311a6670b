"""A good plan on the nodes: both arms together, stage by stage, guided by what is left to do at least."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dualarm_cli.collision.clearance import SLACK
from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.records import dataclass
from dualarm_cli.stages.plans.clearance import SAMPLES, SequenceClearance
from dualarm_cli.stages.plans.problem import ArmDecisions, Decisions, SequenceProblem
from dualarm_cli.stages.plans.source import given_postures
from dualarm_cli.stages.search.plan_clearance import TURNS, move_waits
from dualarm_cli.stages.search.potentials import (
    ArmLayers,
    Layer,
    free_columns,
    platform_columns,
    start_coordinates,
)
from dualarm_cli.stages.search.transfer_table import Coordinates, rows_of


@dataclass(frozen=True)
class BeamStep:
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
    problem: SequenceProblem, arms: tuple[ArmLayers, ...], angles: FloatArray, steps: list[BeamStep]
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
        without = (*free_columns(problem, a, end, begin), *platform_columns(problem, a))
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


def _nodes_of_all(steps: list[BeamStep]) -> IntArray:
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
    steps: list[BeamStep],
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
            own = given_postures(problem.arms[a], rows.take(np.array([k])), q)
            rows = rows.put(np.array([k]), own)
    return rows


def step_waits(
    test: SequenceClearance,
    stage: int,
    start: FloatArray,
    arrival: FloatArray,
    target: FloatArray,
    end: FloatArray,
) -> FloatArray:
    """Returns about what n steps into a stage cost for clearance [s], infinite for none, shape (n,).

    Each arm by itself is free at its stops, which are nodes. What is looked at is each arm on its straight move, and
    both arms together there and at their stops; as in `plan_clearance`.

    Args:
        test: what is collision-free.
        stage: its number.
        start: all joints before it [rad], shape (n, columns).
        arrival: after the transfer, shape (n, columns).
        target: at the targets, shape (n, columns).
        end: after the retracts, shape (n, columns).
    """
    n, before, after = len(start), test.before[stage], test.after[stage]
    way = test.along(start, arrival)
    held = np.repeat([before, test.at_targets[stage], after], [len(way) + n, n, n], axis=0)
    cross = test.cell.cross_margins(np.concatenate([way, arrival, target, end]), held)
    lacks = np.zeros(len(way))
    for a in range(len(before)):
        own = test.cell.own_margins(a, way, np.full(len(way), before[a]))
        lacks = np.maximum(lacks, -own)
    apart = np.all((cross[: len(way)] >= 0.0).reshape(n, SAMPLES), axis=1)
    stops = (cross[len(way) :] >= SLACK).reshape(3, n)
    waits = move_waits(test.pace, lacks.reshape(n, SAMPLES).max(axis=1), apart)
    waits = np.maximum(waits, test.known_costs(stage, start, arrival))
    must = test.handing[stage] and stage not in test.settled
    turns = np.inf if must else test.pace * TURNS
    waits += np.where(stops[:2].all(axis=0), 0.0, turns)
    return waits if stage in test.settled else np.where(stops[2], waits, np.inf)


WAYS = 4
"""How many times more candidates than wanted states are looked at: several lead to the same pair of nodes."""
MORE, LIKE = 8, 2
"""So many times more are sorted where collisions are checked, of which only so many of a kind are looked at first:
else all the best ones touch the same thing."""
EVERY = 16
"""Nodes of each arm that are paired at each platform angle, from the best state and all with one another, where
something has to touch in all the best steps."""


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
    """What each arm still needs at least [s], shape (arms, b)."""

    def best(self) -> _States:
        """Returns the most promising one alone."""
        k = [int(np.argmin(self.spent + self.left.max(axis=0)))]
        joints = tuple(rows_of(q, np.array(k)) for q in self.joints)
        return _States(self.spent[k], self.node[:, k], joints, self.angle[k], self.left[:, k])


def beam_search(
    problem: SequenceProblem,
    arms: tuple[ArmLayers, ...],
    angles: FloatArray,
    width: int,
    per_angle: int,
    plans: int = 1,
) -> list[NodePath]:
    """Returns the best plan found on the nodes, and the next best ones of other branches, targets or yaws.

    From every kept state and at every platform angle the arms' best nodes are paired; a pair costs what the slower arm
    needs, plus the larger of what the arms still need at least. The best `width` different states are kept. Where
    something has to be collision-free, a pair counts about what that costs as well, as far as it is among the best.

    Args:
        problem: the sequence.
        arms: layers with potentials.
        angles: the grid's platform angles at each stage [rad], shape (n, f).
        width: how many states are kept.
        per_angle: how many nodes of each arm are paired at each platform angle; with all of them and all states kept,
            the first plan is the best one on the nodes.
        plans: how many plans at most.
    """
    states = _first(problem, arms)
    steps: list[BeamStep] = []
    for k in range(problem.stages):
        found = _extend(problem, arms, angles[k], states, k, width, per_angle)
        if found is None:
            return []
        step, states = found
        steps.append(step)
    total = states.spent + closing_times(problem, arms, angles, steps)
    if plans == 1:
        best = int(np.argmin(total))
        return [path_to(problem, arms, angles, steps, best, float(total[best]))]
    found_plans: dict[bytes, NodePath] = {}
    for state in np.argsort(total, kind="stable").tolist():
        path = path_to(problem, arms, angles, steps, state, float(total[state]))
        found_plans.setdefault(kind_of(path.decisions), path)
        if len(found_plans) == plans:
            break
    return list(found_plans.values())


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
    problem: SequenceProblem,
    arms: tuple[ArmLayers, ...],
    angles: FloatArray,
    states: _States,
    k: int,
    width: int,
    per_angle: int,
) -> tuple[BeamStep, _States] | None:
    """Returns the best states after stage k, None where no pair of nodes fits together.

    Where something has to be collision-free, the best steps count as long as that takes, about.
    """
    f = len(angles)
    working = [a for a, arm in enumerate(arms) if arm.layers[k] is not None]
    b = len(states.spent)
    # By arm: cost (b, f, w), what is left after (b, f, w), node (b, f, w).
    options = [_options(problem, arms[a], states, a, k, f, per_angle) for a in working]
    cost, left, nodes = options[0]
    chosen = [nodes[..., None]]
    if len(options) == 2:
        cost_2, left_2, nodes_2 = options[1]
        cost = np.maximum(cost[..., :, None], cost_2[..., None, :])
        left = np.maximum(left[..., :, None], left_2[..., None, :])
        shape = cost.shape
        chosen = [
            np.broadcast_to(nodes[..., :, None], shape),
            np.broadcast_to(nodes_2[..., None, :], shape),
        ]
    idle = [a for a in range(len(arms)) if a not in working]
    for a in idle:
        waiting = states.left[a] - np.float32(arms[a].passed[k])
        left = np.maximum(left, waiting.reshape(b, *(1,) * (left.ndim - 1)))
    spent = states.spent.reshape(b, *(1,) * (cost.ndim - 1)) + cost
    key = (spent + left).ravel()
    possible = np.nonzero(np.isfinite(key))[0]
    if not len(possible):
        return None
    count = WAYS * len(arms) * width
    if per_angle == EVERY:
        count = key.size
    looked_at = count if problem.clearance is None else MORE * count
    some = possible[np.argsort(key[possible], kind="stable")[:looked_at]]
    parent = some // (key.size // b)
    angle = (some // (key.size // (b * f))) % f
    node = np.full((len(arms), len(some)), -1, dtype=np.int64)
    for a, rows in zip(working, chosen, strict=True):
        node[a] = rows.ravel()[some]
    lasts = spent.ravel()[some]
    if problem.clearance is not None:
        rows = _varied(_kinds(arms, node, angle, k), LIKE, count)
        step = BeamStep(parent[rows], node[:, rows], angle[rows])
        waits = _waits(problem, problem.clearance, arms, states, step, angles, k)
        if per_angle < EVERY and len(working) > 1 and not np.isfinite(waits).any():
            return _extend(problem, arms, angles, states.best(), k, width, EVERY)
        worth = key[some[rows]] + waits
        # Impossible ones come last; if there are no others, what is wrong with them is found out when they are timed.
        waits = np.minimum(waits, IMPOSSIBLE)
        order = np.argsort(worth, kind="stable")
        lasts = (lasts[rows] + waits.astype(np.float32))[order]
        rows = rows[order]
        parent, angle, node = parent[rows], angle[rows], node[:, rows]
    same = np.where(node >= 0, node, states.node[:, parent] + 1_000_000)
    _, first = np.unique(same, axis=1, return_index=True)
    kept = np.sort(first)[:width]
    step = BeamStep(parent[kept], node[:, kept], angle[kept])
    return step, _moved(problem, arms, states, step, lasts[kept], k)


def _kinds(arms: tuple[ArmLayers, ...], node: IntArray, angle: IntArray, k: int) -> IntArray:
    """Returns numbers of what pairs of nodes have in common: platform angle, branches and yaws, shape (b,)."""
    columns = [angle.astype(np.float64)]
    for arm, own in zip(arms, node, strict=True):
        layer = arm.layers[k]
        if layer is not None:
            columns += [layer.decisions.branch[own], layer.decisions.yaw[own]]
    kinds: IntArray = np.unique(np.round(columns, 5), axis=1, return_inverse=True)[1]
    return kinds


def _varied(kinds: IntArray, most: int, count: int) -> IntArray:
    """Returns so many of b rows, best first as they are: first no more than `most` of every kind, then the others."""
    order = np.argsort(kinds, kind="stable")
    first = np.searchsorted(kinds[order], kinds)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    early = rank - first < most
    return np.concatenate([np.flatnonzero(early), np.flatnonzero(~early)])[:count]


def _waits(
    problem: SequenceProblem,
    test: SequenceClearance,
    arms: tuple[ArmLayers, ...],
    states: _States,
    step: BeamStep,
    angles: FloatArray,
    k: int,
) -> FloatArray:
    """Returns about what steps into stage k cost for clearance [s], shape (b,)."""
    starts, arrivals, targets, ends = [], [], [], []
    for a, arm in enumerate(arms):
        layer, node = arm.layers[k], step.node[a]
        before = arm.table.joints(rows_of(states.joints[a], step.parent))
        starts.append(before)
        if layer is None:
            arrivals.append(before)
            targets.append(before)
            ends.append(before)
        else:
            arrivals.append(arm.table.joints(rows_of(layer.approach, node)))
            targets.append(layer.decisions.near[node].astype(np.float64))
            ends.append(arm.table.joints(rows_of(layer.retract, node)))
    turned = angles[step.angle_index]
    here = starts[0][:, -1] if problem.turns else turned
    at = [
        test.positions(angle, [q[:, : w.joints] for q, w in zip(joints, problem.arms, strict=True)])
        for angle, joints in ((here, starts), (turned, arrivals), (turned, targets), (turned, ends))
    ]
    if k == 0 and problem.free_start:
        at[0] = at[1]
    return step_waits(test, k, *at)


def _options(
    problem: SequenceProblem,
    arm: ArmLayers,
    states: _States,
    a: int,
    k: int,
    f: int,
    per_angle: int,
) -> tuple[NDArray[np.float32], NDArray[np.float32], IntArray]:
    """Returns one arm's best nodes from every state at every platform angle: cost, what is left, node: (b, f, w)."""
    layer, potential = arm.layers[k], arm.potential[k]
    assert layer is not None
    assert potential is not None
    if k == 0 and problem.free_start:
        cost = np.zeros((1, len(potential)), dtype=np.float32)
    else:
        came = int(arm.chain.previous[k])
        without = free_columns(problem, a, layer, arm.layers[came] if came >= 0 else None)
        cost = arm.table.times(states.joints[a], layer.approach, without)
    cost = cost + layer.work
    at = _by_angle(layer.angle_index, f)
    padded = np.concatenate([cost, np.full((len(cost), 1), np.inf, dtype=np.float32)], axis=1)
    cost = padded[:, at]
    left = np.append(potential, np.float32(np.inf))[at]
    total = cost + left
    w = min(per_angle, total.shape[2])
    best = np.argsort(total, axis=2, kind="stable")[..., :w]
    cost = np.take_along_axis(cost, best, axis=2)
    nodes = np.take_along_axis(np.broadcast_to(at, total.shape), best, axis=2)
    left = np.take_along_axis(np.broadcast_to(left, total.shape), best, axis=2)
    return cost, left, nodes


def _by_angle(angle_index: IntArray, f: int) -> IntArray:
    """Returns the nodes of each platform angle, shape (f, w), padded with the number of nodes."""
    n = len(angle_index)
    count = np.bincount(angle_index, minlength=f)
    table = np.full((f, max(1, int(count.max()))), n, dtype=np.int64)
    column = np.arange(n) - np.repeat(np.cumsum(count) - count, count)
    table[angle_index, column] = np.arange(n)
    return table


def _moved(
    problem: SequenceProblem,
    arms: tuple[ArmLayers, ...],
    states: _States,
    step: BeamStep,
    spent: NDArray[np.float32],
    k: int,
) -> _States:
    """Returns the states after a step."""
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
    return _States(spent, node, tuple(joints), step.angle_index, left)
