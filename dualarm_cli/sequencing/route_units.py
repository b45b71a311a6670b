"""Tasks that go together on one arm's route, in arrays: single ones and sequences, with the ways to do them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.sequencing.problem import SequencingProblem

NEIGHBOURS = 40
"""So many of a task's nearest tasks are thought of when pieces about it are removed."""


@dataclass(frozen=True)
class Unit:
    """Tasks that go together: one, or a sequence."""

    tasks: tuple[int, ...]
    """In their order."""
    nodes: tuple[IntArray, ...]
    """By arm the ways to do it, each a row of nodes, shape (ways, tasks)."""
    inside: tuple[FloatArray, ...]
    """By arm the time of each way, transfers between its tasks included [s], infinite where there is none."""


@dataclass(frozen=True)
class UnitNodes:
    """One arm's units in arrays, shape (units, ways) each."""

    first: IntArray
    """First nodes."""
    last: IntArray
    """Last nodes."""
    inside: FloatArray
    """Times [s], infinite where there is no such way."""

    @classmethod
    def of(cls, units: list[Unit], a: int) -> UnitNodes:
        """Returns the arrays of arm a."""
        return cls(
            np.array([unit.nodes[a][:, 0] for unit in units]),
            np.array([unit.nodes[a][:, -1] for unit in units]),
            np.array([unit.inside[a] for unit in units]),
        )


def route_units(problem: SequencingProblem) -> list[Unit]:
    """Returns sequences, and all other tasks by themselves."""
    in_sequence = {t for row in problem.sequences for t in row}
    rows = [*problem.sequences, *((t,) for t in range(problem.tasks) if t not in in_sequence)]
    return [_unit(problem, row) for row in sorted(rows)]


def _unit(problem: SequencingProblem, tasks: tuple[int, ...]) -> Unit:
    w, nodes, inside = problem.ways, [], []
    for a in range(len(problem.arms)):
        between, length = problem.between[a], problem.length[a]
        # Every way to begin with; from there on what is quickest by itself.
        value = length[tasks[0] * w : (tasks[0] + 1) * w].copy()
        rows = np.arange(tasks[0] * w, (tasks[0] + 1) * w)[:, None]
        for task in tasks[1:]:
            own = np.arange(task * w, (task + 1) * w)
            total = value[:, None] + between[rows[:, -1][:, None], own] + length[own]
            way = total.argmin(axis=1)
            value = total[np.arange(w), way]
            rows = np.concatenate([rows, own[way][:, None]], axis=1)
        nodes.append(rows)
        inside.append(value)
    return Unit(tasks, tuple(nodes), tuple(inside))


def neighbours(problem: SequencingProblem, units: list[Unit]) -> list[list[int]]:
    """Returns the nearest other units of each, by the least transfer of any arm in the ways that are quickest."""
    n = len(units)
    least = np.full((n, n), np.inf)
    for a in range(len(problem.arms)):
        way = [int(unit.inside[a].argmin()) for unit in units]
        first = np.array([unit.nodes[a][k][0] for unit, k in zip(units, way, strict=True)])
        last = np.array([unit.nodes[a][k][-1] for unit, k in zip(units, way, strict=True)])
        one = problem.between[a][last[:, None], first[None, :]]
        possible = np.array([np.isfinite(unit.inside[a]).any() for unit in units])
        one = np.where(possible[:, None] & possible[None, :], np.minimum(one, one.T), np.inf)
        least = np.minimum(least, one)
    order = np.argsort(least, axis=1, kind="stable")[:, : NEIGHBOURS + 1]
    return [[int(v) for v in row if v != u] for u, row in enumerate(order)]


def ranks(before: list[set[int]]) -> list[int]:
    """Returns the largest number of units that have to be over one after the other before each."""
    rank = [0] * len(before)
    for _ in before:
        changed = False
        for u, firsts in enumerate(before):
            new = max((rank[v] + 1 for v in firsts), default=0)
            if new > rank[u]:
                rank[u], changed = min(new, len(before)), True
        if not changed:
            break
    return rank
