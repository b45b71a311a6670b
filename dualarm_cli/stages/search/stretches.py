"""Stretches of a sequence that are planned independently, and their assembly."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from dualarm_cli.background import map_halves
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.records import dataclass
from dualarm_cli.stages.plans.clearance import SequenceClearance
from dualarm_cli.stages.plans.problem import ArmDecisions, Decisions, SequenceProblem
from dualarm_cli.stages.plans.times import Evaluated, TransferChain, evaluate, start_joints
from dualarm_cli.stages.search.corridor import best_combination

Part = TypeVar("Part")
Progress = Callable[[str], None]
"""Receiver of progress messages."""


@dataclass(frozen=True)
class Stretch:
    """Consecutive stages with the stages that depend on them."""

    problem: SequenceProblem
    """Problem of these stages alone, without the return, starting from the plan."""
    stages: IntArray
    """Indices in the whole sequence."""
    loose: BoolArray
    """Flags of stages to re-plan; the others keep their decisions."""

    def put(self, decisions: Decisions, part: Decisions) -> Decisions:
        """Insert a stretch's decisions into the whole sequence; fixed stages stay exact."""
        rows = np.flatnonzero(self.loose)
        return decisions.put_all(self.stages[rows], part.take(rows))


def loose_stretches(problem: SequenceProblem, plan: Evaluated, loose: BoolArray) -> list[Stretch]:
    """Split loose stages into independent stretches.

    A stage depends on the previous positions of platform and arms, and the next stage of each arm depends on it. An arm
    without a next stage obstructs the other to the end. If a stage affects the return, all stages form one stretch.

    Args:
        problem: the sequence.
        plan: its plan.
        loose: flags of stages to re-plan, shape (n,).
    """
    n = problem.stages
    chains = [TransferChain.of(work) for work in problem.arms]
    if loose.all() or (problem.returns and loose[_closing(problem, chains)].any()):
        return [Stretch(problem, np.arange(n), loose)]
    spans: list[tuple[int, int]] = []
    for k in np.flatnonzero(loose).tolist():
        past = max([min(k + 1, n - 1), *(_next(problem, chain, k) for chain in chains)]) + 1
        if spans and k < spans[-1][1]:
            spans[-1] = spans[-1][0], max(past, spans[-1][1])
        else:
            spans.append((k, past))
    return [
        Stretch(stretch_of(problem, *span, plan), np.arange(*span), loose[slice(*span)])
        for span in spans
    ]


def _next(problem: SequenceProblem, chain: TransferChain, k: int) -> int:
    """Return the last stage that depends on an arm's position after stage k."""
    later = chain.active[chain.active > k]
    if len(later):
        return int(later[0])
    stands = problem.clearance is not None and len(chain.active) > 0 and chain.active[-1] == k
    return problem.stages - 1 if stands else k


def _closing(problem: SequenceProblem, chains: list[TransferChain]) -> list[int]:
    """Return the stages that determine the return."""
    last = [problem.stages - 1, *(int(chain.active[-1]) for chain in chains if len(chain.active))]
    return [*last, 0] if problem.free_start else last


def stretch_of(
    problem: SequenceProblem, first: int, past: int, plan: Evaluated | None = None
) -> SequenceProblem:
    """Extract stages `first` to before `past` as a sequence without a return.

    Args:
        problem: the whole sequence.
        first: number of the first one.
        past: number of the stage past them.
        plan: of the whole sequence: it begins where that is before them; None for anywhere, but that an arm that is
            idle in the first stage starts as the whole sequence does.
    """
    here, start = slice(first, past), problem.platform_start
    if first and problem.turns and plan is not None:
        start = plan.decisions.angle[first - 1 : first]
    arms = tuple(
        replace(
            work,
            stops=work.stops[here],
            start=work.start if plan is None else _joints_before(problem, plan, a, first),
        )
        for a, work in enumerate(problem.arms)
    )
    test = problem.clearance
    return replace(
        problem,
        platform_start=start,
        arms=arms,
        free_start=problem.free_start if first == 0 else plan is None,
        returns=False,
        handing=problem.handing[here],
        clearance=None if test is None else _test_of(test, first, past),
        launches=None
        if problem.launches is None
        else tuple(rows[here] for rows in problem.launches),
    )


def _joints_before(problem: SequenceProblem, plan: Evaluated, a: int, first: int) -> FloatArray:
    """Return an arm's joints before a stage [rad]."""
    work, chain = problem.arms[a], TransferChain.of(problem.arms[a])
    if first == 0:
        return work.start
    before = chain.active[chain.active < first]
    if len(before):
        return plan.arms[a].q_retract[before[-1]]
    return start_joints(problem, work, chain, plan.arms[a])


def _test_of(test: SequenceClearance, first: int, past: int) -> SequenceClearance:
    """Restrict the fast test to stages `first` to before `past`."""
    here = slice(first, past)
    no_goods = [no_good for no_good in test.no_goods if first <= no_good.stage < past]
    holding = test.holding
    yaws = {(k - first, arm): yaw for (k, arm), yaw in holding.yaws.items() if first <= k < past}
    return replace(
        test,
        holding=replace(
            holding,
            before=holding.before[here],
            after=holding.after[here],
            is_handover=holding.is_handover[here],
            yaws=yaws,
        ),
        no_goods=tuple(replace(no_good, stage=no_good.stage - first) for no_good in no_goods),
        settled=frozenset(k - first for k in test.settled if first <= k < past),
    )


def counted(problem: SequenceProblem, parts: Sequence[Part]) -> Iterator[tuple[Part, Progress]]:
    """Yield the parts of a sequence, and report the share of them that is done.

    A worker process has the other half of them and takes as long. Each part comes with a receiver of its own progress.
    """
    for number, part in enumerate(parts):
        if len(parts) == 1:
            yield part, problem.progress
            continue
        share = f"{100 * number // len(parts)} % of its parts done"
        problem.progress(share)

        def report(step: str, share: str = share) -> None:
            problem.progress(f"{share}, {step}")

        yield part, report


def in_parts(
    problem: SequenceProblem,
    decided: Callable[[int, int, Progress], Decisions | None],
    starts: Sequence[Decisions] = (),
) -> tuple[Evaluated, BoolArray] | None:
    """Plan a long sequence in parts; flag stages to polish, shape (n,).

    The parts overlap.

    None where a part has none. Where two parts meet, the better of both is taken, stage by stage.

    Args:
        problem: the sequence, without a return: parts do not know where it ends.
        decided: decides the stages from one to before another; the last argument receives its progress.
        starts: other plans, which are combined with it.
    """
    n, common = problem.stages, problem.settings.part_overlap
    count = 2 * max(1, round(n / (2 * problem.settings.part)))
    edges = np.linspace(0, n, count + 1).round().astype(np.int64)
    spans = [
        (max(0, first - common), min(n, past + common))
        for first, past in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)
    ]
    parts = map_halves(
        lambda batch: [decided(*span, progress) for span, progress in counted(problem, batch)],
        spans,
    )
    idle = tuple(ArmDecisions.idle(work.start, n) for work in problem.arms)
    plan_a = plan_b = Decisions(np.zeros(n), idle)
    for number, (span, part) in enumerate(zip(spans, parts, strict=True)):
        if part is None:
            return None
        stages = np.arange(*span)
        inside = (stages >= edges[number]) & (stages < edges[number + 1])
        plan_a = plan_a.put_all(stages[inside], part.take(np.flatnonzero(inside)))
        # The other plan has what this one leaves out, and the same elsewhere.
        inner = (stages >= span[0] + 2 * common * (number > 0)) | (number == 0)
        inner &= (stages < span[1] - 2 * common) | (number == count - 1)
        rows = inner | ~inside
        plan_b = plan_b.put_all(stages[rows], part.take(np.flatnonzero(rows)))
    best = best_combination(problem, evaluate(problem, plan_a), [plan_b, *starts])
    near = np.abs(np.arange(n)[:, None] - edges[1:-1] + 0.5).min(axis=1) < common
    return best, near
