"""Rows of a study: points with their results, and their ranking."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.model.studies.evaluation import STATUSES, Evaluation, Status
from dualarm_cli.model.studies.study import OBJECTIVES, Objective, Point
from dualarm_cli.records import dataclass

_BLOCK = 256


def pareto_set(costs: FloatArray) -> BoolArray:
    """Mark the rows that no other row dominates, shape (n,).

    Equal rows do not dominate each other.

    Args:
        costs: to be minimised, finite, shape (n, k).
    """
    count = len(costs)
    non_dominated = np.ones(count, dtype=bool)
    for start in range(0, count, _BLOCK):
        block = costs[start : start + _BLOCK, None, :]
        at_least = np.all(costs <= block, axis=2)
        better = np.any(costs < block, axis=2)
        non_dominated[start : start + _BLOCK] = ~np.any(at_least & better, axis=1)
    return non_dominated


TOGETHER: Mapping[str, Callable[[Sequence[float]], float]] = {
    "cycle_time": sum,
    "gap": max,
    "clearance": min,
    "travel": sum,
    "torque": max,
}
"""Aggregation of each figure over several task files."""


@dataclass(frozen=True)
class StudyRow:
    """Point of a study with its evaluations."""

    number: int
    """Index of the point, in order of creation."""
    point: Point
    """Values of the parameters; empty for the unchanged files."""
    evaluations: tuple[Evaluation, ...]
    """Evaluations by task file."""

    @property
    def status(self) -> Status:
        """Worst status of all task files."""
        statuses = {evaluation.status for evaluation in self.evaluations}
        return max(statuses, key=STATUSES.index)

    @property
    def is_planned(self) -> bool:
        """Flag of a row in which every task file has a verified plan."""
        return self.status == "planned"

    @property
    def figures(self) -> dict[str, float | None]:
        """Total figure of all task files by objective.

        None if unknown or without a plan.
        """
        totals: dict[str, float | None] = {}
        for name in OBJECTIVES:
            values = [getattr(evaluation, name) for evaluation in self.evaluations]
            is_known = self.is_planned and all(value is not None for value in values)
            totals[name] = float(TOGETHER[name](values)) if is_known else None
        return totals

    def costs(self, objectives: Sequence[Objective]) -> list[float] | None:
        """Compute the costs to minimise; None if a figure is unknown."""
        figures = self.figures
        values = [figures[objective.name] for objective in objectives]
        if any(value is None for value in values):
            return None
        return [o.cost(v) for o, v in zip(objectives, values, strict=True) if v is not None]


@dataclass(frozen=True)
class Ranking:
    """Rows with a plan, best first."""

    rows: tuple[StudyRow, ...]
    """Pareto set sorted by the first objective, then the other rows, then rest ones."""
    pareto: frozenset[int]
    """Row numbers of the Pareto set."""


def rank(rows: Sequence[StudyRow], objectives: Sequence[Objective]) -> Ranking:
    """Rank the rows with a plan, best first.

    Args:
        rows: all of them.
        objectives: most important first.
    """
    planned = [row for row in rows if row.is_planned]
    costs = {row.number: row.costs(objectives) for row in planned}
    valued = [row for row in planned if costs[row.number] is not None]
    matrix: FloatArray = np.array([costs[row.number] for row in valued], dtype=np.float64)
    matrix = matrix.reshape(len(valued), len(objectives))
    best = {row.number for row, flag in zip(valued, pareto_set(matrix), strict=True) if flag}
    valued.sort(key=lambda row: (row.number not in best, costs[row.number], row.number))
    rest = [row for row in planned if costs[row.number] is None]
    return Ranking((*valued, *rest), frozenset(best))
