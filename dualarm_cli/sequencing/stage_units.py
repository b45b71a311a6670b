"""Stops that one arm makes one right after the other: a task's, or those of a sequence of tasks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.sequencing.stage_problem import StageProblem

NEAR = 12
"""So many of a unit's nearest ones are thought of when some are removed together."""


@dataclass(frozen=True)
class Unit:
    """Stops that one arm makes one right after the other: a task's, or those of a sequence of tasks."""

    tasks: tuple[int, ...]
    """Its tasks."""
    stops: tuple[int, ...]
    """Their stops."""
    arms: tuple[int, ...]
    """The arms that can make them all."""


def stage_units(problem: StageProblem) -> list[Unit]:
    """Returns sequences, and all other tasks by themselves."""
    within = {t for row in problem.sequences for t in row}
    rows = [*problem.sequences, *((t,) for t in range(len(problem.tasks)) if t not in within)]
    return [
        Unit(
            tuple(row),
            tuple(stop for t in row for stop in problem.tasks[t]),
            tuple(
                a
                for a in range(len(problem.length))
                if all(problem.allowed(a, task) for task in row)
            ),
        )
        for row in sorted(rows)
    ]


def near_units(problem: StageProblem, units: list[Unit]) -> list[list[int]]:
    """Returns the nearest other units of each: those that follow it soonest on any arm, wherever the platform is."""
    first = np.array([unit.stops[0] for unit in units])
    last = np.array([unit.stops[-1] for unit in units])
    least: FloatArray = np.full((len(units), len(units)), np.inf)
    for length in problem.length:
        quickest = length.min(axis=(2, 3))[last[:, None], first[None, :]]
        least = np.minimum(least, np.minimum(quickest, quickest.T))
    order = np.argsort(least, axis=1, kind="stable")
    return [[int(v) for v in row if v != u][:NEAR] for u, row in enumerate(order)]
