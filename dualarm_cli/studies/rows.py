"""Rows of a study: one point, what its plans came to, and which rows are best."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.model.evaluation import STATUSES, Evaluation, Status
from dualarm_cli.model.study import OBJECTIVES, Objective, Point
from dualarm_cli.records import dataclass

_BLOCK = 256


def pareto_set(costs: FloatArray) -> BoolArray:
    """Returns which rows no other row dominates, shape (n,).

    Equal rows do not dominate each other.

    Args:
        costs: shape (n, k), the smaller the better; finite.
    """
    count = len(costs)
    kept = np.ones(count, dtype=bool)
    for start in range(0, count, _BLOCK):
        own = costs[start : start + _BLOCK, None, :]
        at_least = np.all(costs <= own, axis=2)
        better = np.any(costs < own, axis=2)
        kept[start : start + _BLOCK] = ~np.any(at_least & better, axis=1)
    return kept


TOGETHER: Mapping[str, Callable[[Sequence[float]], float]] = {
    "cycle_time": sum,
    "gap": max,
    "clearance": min,
    "travel": sum,
}
"""How the figures of several task files become one."""


@dataclass(frozen=True)
class StudyRow:
    """A point and what came of it."""

    number: int
    """Its place among the points, in the order in which they were made."""
    point: Point
    """The values of the parameters; empty for the files as they are."""
    evaluations: tuple[Evaluation, ...]
    """By task file."""

    @property
    def status(self) -> Status:
        """The worst of all task files'."""
        found = {evaluation.status for evaluation in self.evaluations}
        return max(found, key=STATUSES.index)

    @property
    def is_planned(self) -> bool:
        """Whether every task file has a plan that the verifier passes."""
        return self.status == "planned"

    @property
    def figures(self) -> dict[str, float | None]:
        """By objective what all task files come to together; None where it is not known, or where there is no plan."""
        found: dict[str, float | None] = {}
        for name in OBJECTIVES:
            values = [getattr(evaluation, name) for evaluation in self.evaluations]
            known = self.is_planned and all(value is not None for value in values)
            found[name] = float(TOGETHER[name](values)) if known else None
        return found

    def costs(self, objectives: Sequence[Objective]) -> list[float] | None:
        """Returns numbers that are the smaller the better; None where one is not known."""
        figures = self.figures
        values = [figures[objective.name] for objective in objectives]
        if any(value is None for value in values):
            return None
        return [o.cost(v) for o, v in zip(objectives, values, strict=True) if v is not None]


@dataclass(frozen=True)
class Ranking:
    """Rows with a plan, best first."""

    rows: tuple[StudyRow, ...]
    """The Pareto set first, by the first objective, then the others by it; what cannot be ranked last."""
    pareto: frozenset[int]
    """Numbers of the rows of the Pareto set."""


def rank(rows: Sequence[StudyRow], objectives: Sequence[Objective]) -> Ranking:
    """Returns the rows that have a plan, best first.

    Args:
        rows: all of them.
        objectives: what counts, most important first.
    """
    planned = [row for row in rows if row.is_planned]
    costs = {row.number: row.costs(objectives) for row in planned}
    known = [row for row in planned if costs[row.number] is not None]
    matrix: FloatArray = np.array([costs[row.number] for row in known], dtype=np.float64)
    matrix = matrix.reshape(len(known), len(objectives))
    best = {row.number for row, kept in zip(known, pareto_set(matrix), strict=True) if kept}
    known.sort(key=lambda row: (row.number not in best, costs[row.number], row.number))
    rest = [row for row in planned if costs[row.number] is None]
    return Ranking((*known, *rest), frozenset(best))
