"""A good plan on the nodes: both arms together, stage by stage, guided by what is left to do at least."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.records import dataclass
from dualarm_cli.stages.plans.clearance import SequenceClearance
from dualarm_cli.stages.plans.problem import ArmDecisions, Decisions, SequenceProblem
from dualarm_cli.stages.plans.source import given_postures
from dualarm_cli.stages.search.plan_clearance import step_waits
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


WAYS = 4
"""How many times more candidates than wanted states are looked at: several lead to the same pair of nodes."""
MORE, LIKE = 8, 2
"""So many times more are sorted where collisions are checked, of which only so many of a kind are looked at first:
else all the best ones touch the same thing."""
EVERY = 16
"""Nodes of each arm that are paired at each platform angle, from the best state and all with one another, where
something has to touch in all the best steps."""


@dataclass(frozen=True)
class KindsOfPostures:
    """Settings of a beam in which postures of all kinds count, and not the best ones alone."""

    states: int = 64
    """Least number of states that are kept: the pairs of eight branches of two arms."""
    pairs: int = 4096
    """Pairs of nodes whose clearance is tested in a stage."""
    options: int = 1_000_000
    """Pairs of nodes that are sorted in a stage."""
    border: float = 0.3
    """Offset of the quadrants' borders from the multiples of a quarter turn, where many joints are [rad]."""


@dataclass(frozen=True)
class _Beam:
    """Nodes of both arms, and how widely they are searched."""

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
    kinds: KindsOfPostures | None = None
    """Settings by which nodes and states of all kinds of postures are kept; None for the best ones alone."""

    def nodes_per_angle(self, rows: int, arms: int) -> int:
        """Return the number of nodes of each working arm to pair at each of some states' angles."""
        if self.kinds is None:
            return self.per_angle
        most = self.kinds.options // rows
        return max(self.per_angle, math.isqrt(most) if arms == 2 else most)


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
    found = _searched(beam, plans)
    if problem.clearance is None or (found and found[0].is_possible):
        return found
    kinds = KindsOfPostures()
    varied = _searched(replace(beam, width=max(width, kinds.states), kinds=kinds), plans)
    return varied if varied and varied[0].is_possible else found


def _searched(beam: _Beam, plans: int) -> list[NodePath]:
    """Search stage by stage for the best plans, see `beam_search`."""
    problem, arms, angles = beam.problem, beam.arms, beam.angles
    states = _first(problem, arms)
    steps: list[BeamStep] = []
    for k in range(problem.stages):
        extended = _extend(beam, states, k)
        if extended is None:
            return []
        step, states = extended
        steps.append(step)
    total = states.spent + closing_times(problem, arms, angles, steps)
    total += np.minimum(_return_costs(beam, states, steps), IMPOSSIBLE).astype(np.float32)
    if plans == 1:
        best = int(np.argmin(total))
        return [path_to(problem, arms, angles, steps, best, float(total[best]))]
    found: dict[bytes, NodePath] = {}
    for state in np.argsort(total, kind="stable").tolist():
        path = path_to(problem, arms, angles, steps, state, float(total[state]))
        found.setdefault(kind_of(path.decisions), path)
        if len(found) == plans:
            break
    return list(found.values())


def _return_costs(beam: _Beam, states: _States, steps: list[BeamStep]) -> FloatArray:
    """Compute what returns like barred ones cost from the final states [s], shape (b,)."""
    problem, test, b = beam.problem, beam.problem.clearance, len(states.spent)
    n = problem.stages
    if test is None or not problem.returns or all(bar.stage != n for bar in test.barred):
        return np.zeros(b)
    state = np.arange(b)
    for step in steps[:0:-1]:
        state = step.parent[state]
    home = problem.platform_start if problem.turns else np.zeros(1)
    angle = np.repeat(home, b)
    if problem.free_start:
        angle = beam.angles[0, steps[0].angle_index[state]]
    begins: list[FloatArray | None] = []
    ends: list[FloatArray | None] = []
    for a, (arm, work) in enumerate(zip(beam.arms, problem.arms, strict=True)):
        layer = arm.layers[0] if problem.free_start else None
        first = np.tile(work.start, (b, 1))
        if layer is not None:
            first = arm.table.joints(rows_of(layer.approach, steps[0].node[a, state]))
        begins.append(first[:, : work.joints])
        ends.append(arm.table.joints(states.joints[a])[:, : work.joints])
    last = beam.angles[-1, steps[-1].angle_index]
    return test.known_costs(n, test.positions(last, ends), test.positions(angle, begins))


def _first(problem: SequenceProblem, arms: tuple[ArmLayers, ...]) -> _States:
    joints = tuple(start_coordinates(problem, a, arm.table) for a, arm in enumerate(arms))
    return _States(
        np.zeros(1, dtype=np.float32),
        np.full((len(arms), 1), -1, dtype=np.int64),
        joints,
        np.zeros(1, dtype=np.int64),
        np.zeros((len(arms), 1), dtype=np.float32),
    )


def _extend(beam: _Beam, states: _States, k: int) -> tuple[BeamStep, _States] | None:
    """Extend states by stage k; None where no pair of nodes fits together.

    Where something has to be collision-free, the best steps count as long as that takes, about.
    """
    problem, arms, angles = beam.problem, beam.arms, beam.angles[k]
    f = len(angles)
    working = [a for a, arm in enumerate(arms) if arm.layers[k] is not None]
    b = len(states.spent)
    # By arm: cost (b, f, w), what is left after (b, f, w), node (b, f, w).
    most = beam.nodes_per_angle(b * f, len(working))
    options = [_options(beam, states, a, k, most) for a in working]
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
    count = WAYS * len(arms) * beam.width if beam.kinds is None else beam.kinds.pairs
    if beam.per_angle == EVERY:
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
        kinds = _kinds(beam, states, BeamStep(parent, node, angle), k)
        rows = _varied(kinds, LIKE, count)
        step = BeamStep(parent[rows], node[:, rows], angle[rows])
        waits = _waits(problem, problem.clearance, arms, states, step, angles, k)
        if beam.kinds is not None and not np.isfinite(waits).any():
            return None
        if beam.per_angle < EVERY and len(working) > 1 and not np.isfinite(waits).any():
            return _extend(replace(beam, per_angle=EVERY), states.best(), k)
        worth = key[some[rows]] + waits
        # Impossible ones come last; if there are no others, what is wrong with them is found out when they are timed.
        waits = np.minimum(waits, IMPOSSIBLE)
        order = np.argsort(worth, kind="stable")
        if beam.kinds is not None:
            order = order[: np.isfinite(waits).sum()]
            order = order[_varied(kinds[rows[order]], 1, len(order))]
        lasts = (lasts[rows] + waits.astype(np.float32))[order]
        rows = rows[order]
        parent, angle, node = parent[rows], angle[rows], node[:, rows]
    same = np.where(node >= 0, node, states.node[:, parent] + 1_000_000)
    _, first = np.unique(same, axis=1, return_index=True)
    kept = np.sort(first)[: beam.width]
    step = BeamStep(parent[kept], node[:, kept], angle[kept])
    return step, _moved(problem, arms, states, step, lasts[kept], k)


def _kinds(beam: _Beam, states: _States, step: BeamStep, k: int) -> IntArray:
    """Number what steps into stage k have in common, shape (b,): platform angle, branches and yaws.

    In a varied beam it is the platform angle and the quadrants of all joints after the stage.
    """
    columns = [step.angle_index.astype(np.float64)]
    for a, (arm, own) in enumerate(zip(beam.arms, step.node, strict=True)):
        layer = arm.layers[k]
        if beam.kinds is not None:
            rows = states.joints[a][:, step.parent] if layer is None else layer.retract[:, own]
            columns += list(_quadrants(arm, rows, beam.kinds.border))
        elif layer is not None:
            columns += [layer.decisions.branch[own], layer.decisions.yaw[own]]
    kinds: IntArray = np.unique(np.round(columns, 5), axis=1, return_inverse=True)[1]
    return kinds


def _quadrants(arm: ArmLayers, joints: Coordinates, border: float) -> IntArray:
    """Compute the quadrant of each joint, shape (c, n): postures that whole turns tell apart are one kind."""
    turned = arm.table.joints(joints).T + border
    return np.mod(np.floor(turned / (0.5 * np.pi)), 4).astype(np.int64)


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
    beam: _Beam, states: _States, a: int, k: int, most: int
) -> tuple[NDArray[np.float32], NDArray[np.float32], IntArray]:
    """Select an arm's best nodes from each state at each platform angle: cost, rest, node: (b, f, w).

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
    cost = cost + layer.work
    if beam.kinds is not None:
        best_ones = _best_of_kinds(arm, layer, cost + potential, beam.kinds.border)
        cost = np.where(best_ones, cost, np.float32(np.inf))
    at = _by_angle(layer.angle_index, f)
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


def _best_of_kinds(
    arm: ArmLayers, layer: Layer, total: NDArray[np.float32], border: float
) -> BoolArray:
    """Find the best node of each kind of posture at each platform angle, shape (b, n), by totals (b, n)."""
    rows = np.vstack([_quadrants(arm, layer.retract, border), layer.angle_index])
    kinds = np.unique(rows, axis=1, return_inverse=True)[1]
    best = np.zeros(total.shape, dtype=np.bool_)
    for kind in range(int(kinds.max(initial=-1)) + 1):
        own = np.flatnonzero(kinds == kind)
        best[np.arange(len(total)), own[np.argmin(total[:, own], axis=1)]] = True
    return best


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
