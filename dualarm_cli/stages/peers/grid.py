"""Local search: one stage's decisions at a time, by steps of a pattern that shrinks."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.stages.search.corridor import candidates_of, closing_costs, stage_costs
from dualarm_cli.stages.search.problem import Decisions, SequenceProblem
from dualarm_cli.stages.search.stops import StopTable
from dualarm_cli.stages.search.times import Evaluated, evaluate
from dualarm_cli.stages.search.variables import Variables

FIRST_STEP = 0.35
"""Step of the pattern in the first round [rad]."""
SMALLEST_STEP = {"quick": 0.05, "normal": 0.01, "thorough": 0.002}
"""Step at which the search ends, by effort [rad]."""
ROUNDS = 400
"""Most rounds of the pattern over all stages."""


def local_search(
    problem: SequenceProblem, tables: tuple[StopTable, ...], start: Evaluated, effort: str
) -> Evaluated:
    """Returns a plan that no single step of the pattern at one stage makes faster; never slower than the start.

    A compass search [Kolda2003]: every variable of a stage up and down by the step, its neighbours as they
    are; the best one is taken if the two stages it touches become faster. Stages of one parity move
    together, since they do not touch each other. Where nothing helps any more the step is halved.

    Args:
        problem: the sequence.
        tables: the arms' stops.
        start: a possible plan.
        effort: one of SMALLEST_STEP.
    """
    variables = Variables.of(problem)
    best, step = start, FIRST_STEP
    pattern = _pattern(variables)
    for _ in range(ROUNDS):
        gained = False
        for parity in (0, 1):
            found = _round(problem, tables, variables, best, step * pattern, parity)
            gained |= found.total < best.total - 1e-9
            best = found
        if not gained:
            step *= 0.5
            if step < SMALLEST_STEP[effort]:
                break
    return best


def _pattern(variables: Variables) -> FloatArray:
    """Returns unit steps of each kind of variable, up and down, at all stages at once, shape (m, count)."""
    kinds = [variables.angle, *(arm[:, c] for arm in variables.arms for c in range(arm.shape[1]))]
    steps = np.zeros((2 * len(kinds), variables.count))
    for k, columns in enumerate(kinds):
        used = columns[columns >= 0]
        steps[2 * k, used], steps[2 * k + 1, used] = 1.0, -1.0
    return steps[np.abs(steps).any(axis=1)]


def _round(
    problem: SequenceProblem,
    tables: tuple[StopTable, ...],
    variables: Variables,
    best: Evaluated,
    steps: FloatArray,
    parity: int,
) -> Evaluated:
    plans = [best.decisions, *(variables.moved(best.decisions, step) for step in steps)]
    angle = np.stack([plan.angle for plan in plans], axis=1)
    if problem.turns:
        angle = np.clip(angle, *problem.platform_range)
    found = [candidates_of(problem, tables, plans, angle, a) for a in range(len(tables))]
    cost = stage_costs(problem, best, found, angle)
    # A stage's change with both neighbours as they are: its own length, and that of the next one.
    change = cost[:, 0, :] - cost[:, 0, :1]
    change[:-1] += cost[1:, :, 0] - cost[1:, :1, 0]
    closing = closing_costs(problem, best, found, angle)
    if problem.stages == 1:
        change[0] += closing.diagonal() - closing[0, 0]
    else:
        change[-1] += closing[:, 0] - closing[0, 0]
        change[0] += closing[0] - closing[0, 0]
    change[np.arange(problem.stages) % 2 != parity] = 0.0
    picked = np.argmin(change, axis=1)
    better = np.flatnonzero(change[np.arange(len(picked)), picked] < -1e-9).tolist()
    together = _changed(best.decisions, plans, angle, {k: int(picked[k]) for k in better})
    after = evaluate(problem, tables, together)
    if after.total < best.total:
        return after
    # Across idle stages, or the closing of a cycle, stages of one parity touch after all.
    for k in better:
        alone = evaluate(
            problem, tables, _changed(best.decisions, plans, angle, {k: int(picked[k])})
        )
        best = min(best, alone, key=lambda plan: plan.total)
    return best


def _changed(
    decisions: Decisions, plans: list[Decisions], angle: FloatArray, picked: dict[int, int]
) -> Decisions:
    """Returns decisions with some stages as other plans have them, at the angles of shape (stages, plans)."""
    angles = np.array(decisions.angle)
    arms = decisions.arms
    for k, m in picked.items():
        row = np.array([k])
        angles[k] = angle[k, m]
        arms = tuple(
            mine.put(row, other.take(row)) for mine, other in zip(arms, plans[m].arms, strict=True)
        )
    return Decisions(angles, arms)
