"""A start for optimisers that need a possible one: other arm angles where a plan's lines are too close to a limit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.stages.plans.problem import Decisions, SequenceProblem
from dualarm_cli.stages.plans.stops import StopTable
from dualarm_cli.stages.plans.times import Evaluated, evaluate
from dualarm_cli.stages.search.corridor import best_combination

SHIFTS = np.concatenate([[0.0], np.outer([0.003, 0.01, 0.03, 0.1, 0.3], [1.0, -1.0]).ravel()])
"""What is added to the arm angles of a stop [rad]."""
SWINGS = (1.0, 0.95, 0.8, 0.5, 0.0)
"""Shares of the arm angle's change along the lines."""


def repaired(
    problem: SequenceProblem, tables: tuple[StopTable, ...], plan: Decisions
) -> Evaluated | None:
    """Returns the plan if it is possible, or else the fastest near it; None if there is none.

    Methods that follow a line on other samples than `postures` may end a hair from a position limit; `postures` keeps a
    margin for what is between its samples. Only stages that are impossible change.

    Args:
        problem: the sequence.
        tables: the arms' stops.
        plan: a plan that may be impossible.
    """
    start = evaluate(problem, tables, plan)
    broken: list[tuple[int, IntArray]] = []
    for a, table in enumerate(tables):
        bad = np.flatnonzero(~start.arms[a].possible & table.active)
        if not len(bad):
            continue
        broken.append((a, bad))
        near = _near(plan, a, bad)
        work = np.array([evaluate(problem, tables, other).arms[a].work[bad] for other in near])
        # Any possible choice will do here; together they are weighed below.
        first = np.argmax(np.isfinite(work), axis=0)
        for k, m in zip(bad.tolist(), first.tolist(), strict=True):
            row = np.array([k])
            arms = list(plan.arms)
            arms[a] = arms[a].put(row, near[m].arms[a].take(row))
            plan = Decisions(plan.angle, tuple(arms))
    start = evaluate(problem, tables, plan)
    for a, bad in broken:
        if np.isfinite(start.total):
            start = best_combination(problem, tables, start, _near(start.decisions, a, bad))
    return start if np.isfinite(start.total) else None


def _near(plan: Decisions, a: int, stages: IntArray) -> list[Decisions]:
    """Returns plans with other arm angles of one arm in some stages."""
    return [_changed(plan, a, stages, shift, swing) for swing in SWINGS for shift in SHIFTS]


def _changed(plan: Decisions, a: int, stages: IntArray, shift: float, swing: float) -> Decisions:
    """Returns a plan with other arm angles of one arm in some stages."""
    rows = plan.arms[a].take(stages)
    psi = rows.psi_target + shift

    def end(before: FloatArray) -> FloatArray:
        return psi + swing * (before - rows.psi_target)

    moved = replace(
        rows,
        psi_target=psi,
        psi_approach=end(rows.psi_approach),
        psi_retract=end(rows.psi_retract),
    )
    arms = list(plan.arms)
    arms[a] = arms[a].put(stages, moved)
    return Decisions(plan.angle, tuple(arms))
