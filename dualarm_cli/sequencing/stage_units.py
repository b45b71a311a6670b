"""Stops that are moved together: a task's or those of a sequence of tasks on one arm, both shares of a hand-over."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.sequencing.stage_problem import StageProblem

NEAR = 12
"""So many of a unit's nearest ones are thought of when some are removed together."""


@dataclass(frozen=True)
class Unit:
    """Stops that one arm makes one right after the other: a task's, or those of a sequence of tasks.

    Or both shares of a hand-over: two stops of the giver, then two of the taker, that meet in the middle.
    """

    tasks: tuple[int, ...]
    """Its tasks."""
    stops: tuple[int, ...]
    """Their stops."""
    arms: tuple[int, ...]
    """The arms that can make them all; of a hand-over those that can give while the other one takes."""
    meets: bool = False
    """Whether it is a hand-over."""

    def shares(self, giver: int) -> tuple[Unit, Unit]:
        """Returns the giver's and the taker's share of a hand-over."""
        (one, other), half = self.tasks, len(self.stops) // 2
        return (
            Unit((one,), self.stops[:half], (giver,)),
            Unit((other,), self.stops[half:], (1 - giver,)),
        )


def stage_units(problem: StageProblem) -> list[Unit]:
    """Returns sequences, hand-overs, and all other tasks by themselves."""
    within = {t for row in (*problem.sequences, *problem.handovers) for t in row}
    rows = [*problem.sequences, *((t,) for t in range(len(problem.tasks)) if t not in within)]
    found = [
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
    for one, other in problem.handovers:
        arms = (a for a in range(2) if problem.allowed(a, one) and problem.allowed(1 - a, other))
        stops = (*problem.tasks[one], *problem.tasks[other])
        found.append(Unit((one, other), stops, tuple(arms), meets=True))
    return sorted(found, key=lambda unit: unit.tasks)


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
