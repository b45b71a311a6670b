"""Stages of whose nodes the arms share no platform angle: they get angles and nodes of their own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dualarm_cli.collision.clearance import SLACK
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.minimum_time.nodes import Nodes
from dualarm_cli.minimum_time.own_angles import exact_nodes, shared_intervals, spread
from dualarm_cli.minimum_time.potentials import ArmLayers, layer_of
from dualarm_cli.minimum_time.problem import SequenceProblem
from dualarm_cli.minimum_time.stops import StopTable

LOOKED_AT = 48
"""Platform angles that are looked at in such a stage."""
PAIRED = 8
"""Nodes of each arm at each of them that are looked at together."""


def stages_without_angle(arms: Sequence[ArmLayers], angles: int) -> list[int]:
    """Returns the stages with no platform angle at which all arms that work in them have nodes left.

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


def with_own_angles(
    problem: SequenceProblem,
    tables: Sequence[StopTable],
    arms: Sequence[ArmLayers],
    angles: FloatArray,
    stages: Sequence[int],
    most: int,
) -> tuple[ArmLayers, ...] | None:
    """Returns the arms' layers with some stages on platform angles of their own; None where a stage has none.

    Args:
        problem: the sequence.
        tables: the arms' stops.
        arms: their layers.
        angles: the platform angles of all stages [rad], shape (n, f); rows of those stages are replaced.
        stages: their numbers.
        most: most nodes of one stop.
    """
    layers = [list(arm.layers) for arm in arms]
    for k in stages:
        made = _own_nodes(problem, tables, k, angles.shape[1], most)
        if made is None:
            return None
        angles[k], nodes = made
        for a, (arm, own) in enumerate(zip(arms, nodes, strict=True)):
            if own is not None:
                partner = nodes[1 - a] if k in problem.together else None
                layers[a][k] = layer_of(problem, arm.table, angles[k], taking_turns(own, partner))
    return tuple(replace(arm, layers=own) for arm, own in zip(arms, layers, strict=True))


def taking_turns(nodes: Nodes, partner: Nodes | None) -> Nodes:
    """Returns nodes whose work counts the other arm's in a hand-over, which comes before or after: this at least.

    Args:
        nodes: of one arm.
        partner: of the other one; None in other stages.
    """
    if partner is None or not len(nodes.work) or not len(partner.work):
        return nodes
    return replace(nodes, work=nodes.work + partner.work.min())


def free_nodes(problem: SequenceProblem, a: int, k: int, angles: FloatArray, nodes: Nodes) -> Nodes:
    """Returns the nodes at which the arm keeps clear of itself and of what stands still.

    Args:
        problem: the sequence.
        a: index of the arm.
        k: number of the stage.
        angles: its platform angles [rad], shape (f,).
        nodes: the arm's nodes there.
    """
    test = problem.clearance
    if test is None or not len(nodes.work):
        return nodes
    free = np.ones(len(nodes.work), dtype=np.bool_)
    before, after = int(test.before[k, a]), int(test.after[k, a])
    places = [(nodes.decisions.near, int(test.at_targets[k, a])), (nodes.q_approach, before)]
    if before != after or not np.array_equal(nodes.q_approach, nodes.q_retract):
        places.append((nodes.q_retract, after))
    for q, held in places:
        rows = np.flatnonzero(free)
        free[rows] = test.arm_free(a, angles[nodes.angle_index[rows]], q[rows], held)
    return nodes.take(np.flatnonzero(free))


def _own_nodes(
    problem: SequenceProblem, tables: Sequence[StopTable], k: int, count: int, most: int
) -> tuple[FloatArray, list[Nodes | None]] | None:
    """Returns platform angles (count,) [rad] at which all arms make their stops of a stage, and the nodes there."""
    angles = np.zeros(1)
    if problem.turns:
        low, high = problem.platform_range
        here = float(problem.platform_start[0])
        around = max(low, here - np.pi), min(high, here + np.pi)
        angles = spread(shared_intervals(problem, tables, k, around), max(LOOKED_AT, count))
    if not len(angles):
        return None
    nodes = [
        None
        if work.stops[k] is None
        else free_nodes(problem, a, k, angles, exact_nodes(problem, a, tables[a], k, angles, most))
        for a, work in enumerate(problem.arms)
    ]
    working = [own for own in nodes if own is not None]
    shared = np.logical_and.reduce(
        [np.bincount(own.angle_index, minlength=len(angles)) > 0 for own in working]
    )
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
    return padded, [None if own is None else _renumbered(own, number) for own in nodes]


def _renumbered(nodes: Nodes, number: IntArray) -> Nodes:
    """Returns the nodes at the platform angles that have a new number, with that."""
    kept = nodes.take(np.flatnonzero(number[nodes.angle_index] >= 0))
    return replace(kept, angle_index=number[kept.angle_index])


def _apart(
    problem: SequenceProblem,
    k: int,
    angles: FloatArray,
    nodes: Sequence[Nodes | None],
    shared: IntArray,
) -> BoolArray:
    """Returns the platform angles, among shared ones, at which some nodes of two arms keep clear of each other (f,)."""
    free = np.zeros(len(angles), dtype=np.bool_)
    test = problem.clearance
    if test is None:
        return free
    one, other = nodes
    assert one is not None  # callers ask for stages in which both work
    assert other is not None
    for f in shared.tolist():
        rows = [np.flatnonzero(own.angle_index == f) for own in (one, other)]
        some = [r[np.linspace(0, len(r) - 1, min(len(r), PAIRED)).astype(int)] for r in rows]
        i, j = (x.ravel() for x in np.meshgrid(*some, indexing="ij"))
        places = [(one.q_retract[i], other.q_retract[j], test.after[k])]
        if test.handing[k]:
            places.append((one.decisions.near[i], other.decisions.near[j], test.at_targets[k]))
        clear = np.ones(len(i), dtype=np.bool_)
        for q, r, held in places:
            position = test.positions(np.full(len(i), angles[f]), [q, r])
            margins = test.cell.cross_margins(position, np.tile(held, (len(i), 1)))
            clear &= margins >= SLACK
        free[f] = clear.any()
    return free
