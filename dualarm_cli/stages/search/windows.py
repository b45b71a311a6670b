"""Stretches of a sequence that are decided by themselves, all else as a plan has it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, IntArray
from dualarm_cli.stages.search.clearance import SequenceClearance
from dualarm_cli.stages.search.problem import ArmWork, SequenceProblem
from dualarm_cli.stages.search.times import Evaluated, TransferChain, start_joints


@dataclass(frozen=True)
class Stretch:
    """Stages one after the other, with those behind them on which they depend."""

    problem: SequenceProblem
    """They alone: it begins where the plan is before them."""
    stages: IntArray
    """Their numbers in the whole sequence."""
    loose: BoolArray
    """Which of them are decided; the others are as the plan has them."""


def loose_windows(problem: SequenceProblem, plan: Evaluated, loose: BoolArray) -> list[Stretch]:
    """Returns the windows in which all loose stages are, each of which is decided whatever the others are.

    A stage depends on where platform and arms come from, and so does the next stage of each arm on it. With a return,
    which ends where everything begins, the whole sequence is one window.

    Args:
        problem: the sequence.
        plan: its plan.
        loose: the stages that are decided, shape (n,).
    """
    n = problem.stages
    if problem.returns or loose.all():
        return [Stretch(problem, np.arange(n), loose)]
    chains = [TransferChain.of(work) for work in problem.arms]
    found: list[tuple[int, int]] = []
    for k in np.flatnonzero(loose).tolist():
        after = [stage for one in chains for stage in one.active[one.active > k][:1].tolist()]
        past = max(min(k + 2, n), *(stage + 1 for stage in after)) if after else min(k + 2, n)
        if found and k < found[-1][1]:
            found[-1] = found[-1][0], max(past, found[-1][1])
        else:
            found.append((k, past))
    return [_window(problem, plan, loose, np.arange(*span)) for span in found]


def _window(
    problem: SequenceProblem, plan: Evaluated, loose: BoolArray, stages: IntArray
) -> Stretch:
    first, past = int(stages[0]), int(stages[-1]) + 1
    here = slice(first, past)
    start, handing = problem.platform_start, problem.handing[here]
    if first and problem.turns:
        start = plan.decisions.angle[first - 1 : first]
    arms = tuple(
        replace(work, stops=work.stops[here], start=_start(problem, plan, a, work, first))
        for a, work in enumerate(problem.arms)
    )
    test = problem.clearance
    own = replace(
        problem,
        platform_start=start,
        arms=arms,
        free_start=problem.free_start and first == 0,
        handing=handing,
        clearance=None if test is None else _of_stages(test, first, past),
    )
    return Stretch(own, stages, loose[here])


def _start(
    problem: SequenceProblem, plan: Evaluated, a: int, work: ArmWork, first: int
) -> np.ndarray:
    """Returns an arm's joints before a stage [rad]."""
    chain = TransferChain.of(work)
    before = chain.active[chain.active < first]
    if first == 0:
        return work.start
    if len(before):
        return plan.arms[a].q_retract[before[-1]]
    return start_joints(problem, work, chain, plan.arms[a])


def _of_stages(test: SequenceClearance, first: int, past: int) -> SequenceClearance:
    """Returns the quick test of stages from the first one to before the one past them."""
    here = slice(first, past)
    return replace(
        test,
        before=test.before[here],
        after=test.after[here],
        handing=test.handing[here],
        barred=tuple(
            replace(bar, stage=bar.stage - first)
            for bar in test.barred
            if first <= bar.stage < past
        ),
        settled=frozenset(k - first for k in test.settled if first <= k < past),
    )
