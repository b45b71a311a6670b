"""Best stage-by-stage combination of several plans, by dynamic programming."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray, distinct
from dualarm_cli.records import dataclass
from dualarm_cli.stages.plans.candidates import CandidatePostures
from dualarm_cli.stages.plans.passing import transfer_times
from dualarm_cli.stages.plans.problem import ArmDecisions, Decisions, SequenceProblem
from dualarm_cli.stages.plans.source import postures
from dualarm_cli.stages.plans.times import (
    Evaluated,
    TransferChain,
    held,
    in_seconds,
    left_with,
    platform_times,
    rest_times,
    start_joints,
)
from dualarm_cli.stages.search.plan_clearance import PlanClearance, plan_clearance
from dualarm_cli.timing.stage_length import stage_length


@dataclass(frozen=True)
class Pool:
    """Several plans with joints and times, stage by stage."""

    problem: SequenceProblem
    plans: list[Decisions]
    """Decisions of the m plans."""
    angle: FloatArray
    """Platform angles [rad], shape (n, m)."""
    arms: list[CandidatePostures]
    """Postures of each arm, arrays of shape (n, m, ...)."""

    @classmethod
    def of(
        cls,
        problem: SequenceProblem,
        best: Evaluated,
        others: list[Decisions],
    ) -> Pool:
        """Build a pool of plans, the best one first."""
        plans = [best.decisions, *others]
        angle = np.stack([plan.angle for plan in plans], axis=1)
        arms = [candidates_of(problem, plans, angle, a) for a in range(len(problem.arms))]
        return cls(problem, plans, angle, arms)

    def plan(self, picked: IntArray) -> Evaluated:
        """Assemble a plan from the plan chosen for each stage, shape (n,)."""
        decisions = self.plans[int(picked[0])]
        for m in distinct(picked):
            decisions = decisions.put(np.nonzero(picked == m)[0], self.plans[m])
        stage = np.arange(len(picked))
        arms = tuple(
            CandidatePostures(*(getattr(arm, f.name)[stage, picked] for f in fields(arm)))
            for arm in self.arms
        )
        return in_seconds(self.problem, decisions, arms)


def best_combination(
    problem: SequenceProblem,
    best: Evaluated,
    others: list[Decisions],
) -> Evaluated:
    """Combine plans stage by stage into the fastest; never slower than `best`.

    Exact for costs between neighbouring stages. An arm that was idle before a stage, or before the return, is assumed
    where `best` has it; the result is therefore evaluated as a whole and used only if it is faster and its lines hold.

    Args:
        problem: the sequence.
        best: a feasible plan.
        others: plans to combine it with.
    """
    if not others:
        return best
    pool = Pool.of(problem, best, others)
    return combined(problem, pool, best, lambda plan: held(problem, plan))


def combined(
    problem: SequenceProblem,
    pool: Pool,
    best: Evaluated,
    judged: Callable[[Evaluated], Evaluated] = lambda plan: plan,
) -> Evaluated:
    """Combine a pool's plans into the fastest, see `best_combination`.

    Args:
        problem: the sequence.
        pool: plans, `best` first.
        best: a possible plan.
        judged: check of the result that makes infeasible stages infinite.
    """
    cost = stage_costs(problem, best, pool.arms, pool.angle)
    closing = closing_costs(problem, best, pool.arms, pool.angle)
    objective = best.total
    raised: set[tuple[int, int, int]] = set()
    if problem.clearance is not None:
        clear = plan_clearance(problem, best)
        objective += clear.penalty
        _raise_blocked(cost, closing, np.zeros(len(cost), dtype=np.int64), clear, raised)
    for _ in range(problem.settings.clear_tries):
        picked = _shortest(cost, closing)
        if not picked.any() or not _length(cost, closing, picked) < objective:
            break
        result = pool.plan(picked)
        if result.total < objective:
            result = judged(result)
            infeasible = np.flatnonzero(np.isinf(result.stages))
            cost[infeasible, :, picked[infeasible]] = np.inf
            if len(infeasible):
                continue
        if problem.clearance is None:
            return result if result.total < objective else best
        clear = plan_clearance(problem, result)
        if result.total + clear.penalty < objective:
            return result
        if not _raise_blocked(cost, closing, picked, clear, raised):
            break
    return best


def _length(cost: FloatArray, closing: FloatArray, picked: IntArray) -> float:
    """Sum the costs of a path [s]."""
    n = len(picked)
    before = np.concatenate([[0], picked[:-1]])
    total = cost[np.arange(n), before, picked].sum() + closing[picked[-1], picked[0]]
    return float(total)


def _raise_blocked(
    cost: FloatArray,
    closing: FloatArray,
    picked: IntArray,
    clear: PlanClearance,
    raised: set[tuple[int, int, int]],
) -> bool:
    """Raise the costs of collisions along a path; return whether any cost changed.

    Colliding stops and moves become infinite; moves that need a delay cost that delay.

    Args:
        cost: stage costs by the choices before and in it, shape (n, m, m).
        closing: return costs, shape (m, m).
        picked: path as one choice per stage, shape (n,).
        clear: collision check of the path.
        raised: (stage, choices) whose costs were raised already, added to.
    """
    n, before = len(picked), np.concatenate([[0], picked[:-1]])
    is_changed = False
    for k in np.flatnonzero(~clear.stops).tolist():
        is_changed |= bool(np.isfinite(cost[k, :, picked[k]]).any())
        cost[k, :, picked[k]] = np.inf
    for k in np.flatnonzero(~clear.moves | (clear.waits > 0.0)).tolist():
        table, place = (
            (closing, (picked[-1], picked[0])) if k == n else (cost[k], (before[k], picked[k]))
        )
        key = (k, int(place[0]), int(place[1]))
        if key not in raised:
            raised.add(key)
            is_changed = True
            table[place] += clear.waits[k] if clear.moves[k] else np.inf
    return is_changed


def candidates_of(
    problem: SequenceProblem,
    plans: list[Decisions],
    angle: FloatArray,
    a: int,
) -> CandidatePostures:
    """Compute one arm's postures for every stage and plan, arrays (n, m, ...)."""
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
    rows = postures(problem, a, stage, angle.ravel(), candidates)
    parts = {field.name: getattr(rows, field.name) for field in fields(CandidatePostures)}
    return CandidatePostures(**{name: x.reshape(n, m, *x.shape[1:]) for name, x in parts.items()})


def stage_costs(
    problem: SequenceProblem, best: Evaluated, arms: list[CandidatePostures], angle: FloatArray
) -> FloatArray:
    """Compute stage durations by the previous and present plan [s], (n, m, m)."""
    n, m = angle.shape
    before = np.empty((n, m))
    before[1:] = angle[:-1]
    before[0] = problem.platform_start[0] if problem.turns else 0.0
    moved = angle[:, None, :] - before[:, :, None]
    if problem.free_start:
        moved[0] = 0.0
    waiting = platform_times(problem, moved)
    arrived, work_times = np.zeros((2, len(arms), n, m, m))
    rows = zip(problem.arms, arms, best.arms, strict=True)
    for a, (work, arm, best_postures) in enumerate(rows):
        chain = TransferChain.of(work)
        k = chain.active
        if not len(k):
            continue
        previous = chain.previous[k]
        q_from = np.empty((len(k), m, work.joints))
        q_from[:] = start_joints(problem, work, chain, best_postures)
        has_previous = previous >= 0
        q_from[has_previous] = best_postures.q_retract[previous[has_previous], None]
        is_adjacent = has_previous & (previous == k - 1)
        q_from[is_adjacent] = arm.q_retract[previous[is_adjacent]]
        if problem.launches is not None:
            rates = np.empty((len(k), m, 2, work.joints))
            rates[:] = left_with(best_postures, previous)[:, None]
            rates[is_adjacent] = arm.rates[previous[is_adjacent], :, 1]
            arriving = arm.q_approach[k], arm.rates[k, :, 0]
            transfer = transfer_times(work, (q_from, rates), arriving)
        else:
            begin = q_from[:, :, None], before[k][:, :, None]
            goal = arm.q_approach[k][:, None], angle[k][:, None]
            transfer = rest_times(problem, work, k, begin, goal)
        if problem.free_start and k[0] == 0:
            transfer[0] = 0.0
        arrived[a, k] = np.maximum(transfer, waiting[k])
        work_times[a, k] = arm.work[k][:, None, :]
    return stage_length(arrived, work_times, is_handover=problem.hands_over[:, None, None])


def closing_costs(
    problem: SequenceProblem, best: Evaluated, arms: list[CandidatePostures], angle: FloatArray
) -> FloatArray:
    """Compute return durations by the last and first stage's plans [s], shape (m, m).

    The first stage matters only if the start is free: the cycle then closes at the end of its first transfer.
    """
    n, m = angle.shape
    if not problem.returns:
        return np.zeros((m, m))
    home: FloatArray = np.zeros(1)
    if problem.turns:
        home = angle[0] if problem.free_start else problem.platform_start[:1]
    closing = np.zeros((m, m))
    closing[:] = platform_times(problem, home[None, :] - angle[-1, :, None])
    for work, arm, best_postures in zip(problem.arms, arms, best.arms, strict=True):
        chain = TransferChain.of(work)
        if not len(chain.active) or chain.active[-1] != n - 1:
            continue
        start = start_joints(problem, work, chain, best_postures)[None]
        if problem.free_start and chain.active[0] == 0:
            start = arm.q_approach[0]
        begin = arm.q_retract[None, -1, :, None], angle[None, -1, :, None]
        goal = start[None, None, :], home[None, None, :]
        return_times = rest_times(problem, work, np.array([n]), begin, goal)[0]
        np.maximum(closing, return_times, out=closing)
    return closing


def _shortest(cost: FloatArray, closing: FloatArray) -> IntArray:
    """Return the choice at every stage along the shortest path, shape (n,).

    If the return depends on the first stage, each choice there is solved separately.

    Args:
        cost: stage costs by the choices before and in it, shape (n, m, m).
        closing: return costs, by the choices in the last and the first stage, shape (m, m).
    """
    n, m = cost.shape[:2]
    total = cost[0, :1]
    if (closing != closing[:, :1]).any():
        total = np.where(np.eye(m, dtype=np.bool_), total, np.inf)
    parents = np.zeros((n, *total.shape), dtype=np.int64)
    for k in range(1, n):
        through = total[:, :, None] + cost[k]
        parents[k] = np.argmin(through, axis=1)
        total = np.take_along_axis(through, parents[k][:, None, :], axis=1)[:, 0]
    total = total + closing.T[: len(total)]
    first, last = np.unravel_index(int(np.argmin(total)), total.shape)
    picked = np.zeros(n, dtype=np.int64)
    picked[-1] = last
    for k in range(n - 1, 0, -1):
        picked[k - 1] = parents[k, first, picked[k]]
    return picked
