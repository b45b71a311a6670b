"""The best combination of several plans, stage by stage: dynamic programming over what each of them does."""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.minimum_time.postures import Postures, postures
from dualarm_cli.minimum_time.problem import ArmDecisions, Decisions, SequenceProblem
from dualarm_cli.minimum_time.stops import StopTable
from dualarm_cli.minimum_time.times import (
    Chain,
    Evaluated,
    evaluate,
    platform_times,
    start_joints,
)


def best_combination(
    problem: SequenceProblem,
    tables: tuple[StopTable, ...],
    best: Evaluated,
    others: list[Decisions],
    frozen: int | None = None,
) -> Evaluated:
    """Returns the fastest plan that takes each stage from one of several plans; never slower than `best`.

    Exact over all combinations, but for what is not between neighbouring stages: an arm that was idle before a
    stage, or before the return, comes from where `best` has it. So the result is evaluated anew, and taken only if
    faster.

    Args:
        problem: the sequence.
        tables: the arms' stops.
        best: a possible plan.
        others: plans to combine it with.
        frozen: a stage that stays as it is in `best`.
    """
    plans = [best.decisions, *others]
    angle = np.stack([plan.angle for plan in plans], axis=1)
    found = [candidates_of(problem, tables, plans, angle, a) for a in range(len(tables))]
    cost = stage_costs(problem, best, found, angle)
    if frozen is not None:
        cost[frozen, :, 1:] = np.inf
    picked = _shortest(cost, closing_costs(problem, best, found, angle))
    if not picked.any():
        return best
    result = evaluate(problem, tables, _picked(plans, picked))
    return result if result.total < best.total else best


def _picked(plans: list[Decisions], picked: IntArray) -> Decisions:
    """Returns the decisions that take each stage from the plan it names."""
    result = plans[0]
    for m in np.unique(picked):
        rows = np.nonzero(picked == m)[0]
        angle = np.array(result.angle)
        angle[rows] = plans[m].angle[rows]
        arms = tuple(
            mine.put(rows, other.take(rows))
            for mine, other in zip(result.arms, plans[m].arms, strict=True)
        )
        result = Decisions(angle, arms)
    return result


def candidates_of(
    problem: SequenceProblem,
    tables: tuple[StopTable, ...],
    plans: list[Decisions],
    angle: FloatArray,
    a: int,
) -> Postures:
    """Returns one arm's postures for every stage and plan, arrays of shape (n, m, ...)."""
    n, m = angle.shape
    stage = np.repeat(np.arange(n), m)
    candidates = ArmDecisions(
        *(
            np.stack([getattr(plan.arms[a], field.name) for plan in plans], axis=1).reshape(
                n * m, *getattr(plans[0].arms[a], field.name).shape[1:]
            )
            for field in fields(ArmDecisions)
        )
    )
    found = postures(problem, a, tables[a], stage, angle.ravel(), candidates)
    parts = {field.name: getattr(found, field.name) for field in fields(Postures)}
    return Postures(**{name: x.reshape(n, m, *x.shape[1:]) for name, x in parts.items()})


def stage_costs(
    problem: SequenceProblem, best: Evaluated, found: list[Postures], angle: FloatArray
) -> FloatArray:
    """Returns the length of every stage for every plan before and in it [s], shape (n, m, m)."""
    n, m = angle.shape
    before = np.empty((n, m))
    before[1:] = angle[:-1]
    before[0] = problem.platform_start[0] if problem.turns else 0.0
    moved = angle[:, None, :] - before[:, :, None]
    if problem.free_start:
        moved[0] = 0.0
    waiting = platform_times(problem, moved)
    cost = np.zeros((n, m, m))
    for work, arm, now in zip(problem.arms, found, best.arms, strict=True):
        chain = Chain.of(work)
        k = chain.active
        if not len(k):
            continue
        came = chain.previous[k]
        q_from = np.empty((len(k), m, 7))
        q_from[:] = start_joints(problem, work, chain, now)
        later = came >= 0
        q_from[later] = now.q_retract[came[later], None]
        next_door = later & (came == k - 1)
        q_from[next_door] = arm.q_retract[came[next_door]]
        transfer = work.law.duration(arm.q_approach[k][:, None] - q_from[:, :, None])
        if problem.free_start and k[0] == 0:
            transfer[0] = 0.0
        cost[k] = np.maximum(cost[k], np.maximum(transfer, waiting[k]) + arm.work[k][:, None, :])
    return cost


def closing_costs(
    problem: SequenceProblem, best: Evaluated, found: list[Postures], angle: FloatArray
) -> FloatArray:
    """Returns the length of the return for every plan of the last stage [s], shape (m,)."""
    n, m = angle.shape
    if not problem.returns:
        return np.zeros(m)
    home = best.decisions.angle[0] if problem.free_start else 0.0
    if problem.turns and not problem.free_start:
        home = problem.platform_start[0]
    closing = platform_times(problem, home - angle[-1])
    for work, arm, now in zip(problem.arms, found, best.arms, strict=True):
        chain = Chain.of(work)
        if len(chain.active) and chain.active[-1] == n - 1:
            start = start_joints(problem, work, chain, now)
            closing = np.maximum(closing, work.law.duration(start - arm.q_retract[-1]))
    return closing


def _shortest(cost: FloatArray, closing: FloatArray) -> IntArray:
    """Returns the choice at every stage along the shortest path, shape (n,)."""
    n = len(cost)
    total = cost[0, 0]
    parents = np.zeros(cost.shape[:2], dtype=np.int64)
    for k in range(1, n):
        through = total[:, None] + cost[k]
        parents[k] = np.argmin(through, axis=0)
        total = through[parents[k], np.arange(len(closing))]
    picked = np.zeros(n, dtype=np.int64)
    picked[-1] = int(np.argmin(total + closing))
    for k in range(n - 1, 0, -1):
        picked[k - 1] = parents[k, picked[k]]
    return picked
