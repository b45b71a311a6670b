"""Refinement of plans of method `sequence` as they are driven. The method is ours.

The search's times are estimates, so its steps are judged by a driver: random steps of all stages, the better stages of
two plans, and random steps of a single stage.
"""

from __future__ import annotations

from collections.abc import Collection, Generator, Sequence
from dataclasses import replace

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.postures.stage_plan import StagePlan
from dualarm_cli.records import dataclass
from dualarm_cli.stages.method import DrivenStages, Driver, MethodProblem
from dualarm_cli.stages.plans.launches import with_best_launches
from dualarm_cli.stages.plans.problem import Decisions, SequenceProblem
from dualarm_cli.stages.plans.times import Evaluated, evaluate
from dualarm_cli.stages.search.search import refined, search_effort
from dualarm_cli.stages.search.stretches import Stretch, loose_stretches, stretch_of
from dualarm_cli.stages.search.variables import Variables
from dualarm_cli.stages.sequence import decisions_of, numbers_of, stage_plans, within_limits
from dualarm_cli.stages.serving import with_stopping_room


def refined_sequence(
    problem: MethodProblem, stages: Sequence[StagePlan], given: DrivenStages, driver: Driver
) -> None:
    """Shorten a plan by random steps, see `Refine`."""
    if problem.blends or problem.keeps_room:
        problem = replace(with_stopping_room(problem), without_margin=problem)
    problem, numbers = within_limits(problem, numbers_of(problem))
    refinement = _Refinement(problem, numbers, stages, driver)
    best = _Driven(decisions_of(numbers, problem.model, list(stages)), given)
    best = refinement.with_random_steps(best)
    if problem.blends:
        finest = refinement.driven(best.decisions, refinement.widths)
        best = min([best, *finest], key=_duration)
    refinement.step_single_stages(best)


@dataclass(frozen=True)
class _Driven:
    """Plan with its times."""

    decisions: Decisions
    """The plan."""
    stages: DrivenStages
    """Its stages as they are driven."""


def _duration(plan: _Driven) -> float:
    return plan.stages.duration


@dataclass(frozen=True)
class _Refinement:
    """Steps from a plan to shorter ones."""

    problem: MethodProblem
    """The problem that the plan solves."""
    numbers: SequenceProblem
    """Its sequence."""
    stages: Sequence[StagePlan]
    """Stages of the plan, whose waits and detours later plans keep between moved postures."""
    driver: Driver
    """Timing of plans as they are driven."""

    @property
    def widths(self) -> int:
        """Number of step widths for the refinement of the final launches."""
        return self.problem.settings.sequence.refinement.widths

    def driven(self, decisions: Decisions, widths: int | None = None) -> list[_Driven]:
        """Time a plan; empty if it cannot be timed."""
        plans = stage_plans(
            self.problem.model, self.problem.job, self.numbers, decisions, "sequence"
        )
        pairs = zip(plans, self.stages, strict=True)
        plans = [replace(plan, waits=now.waits, detours=now.detours) for plan, now in pairs]
        driven = self.driver(plans, widths)
        if driven is None:
            return []
        return [_Driven(decisions_of(self.numbers, self.problem.model, plans), driven)]

    def loose(self, kept: Collection[int] = ()) -> BoolArray:
        """Return flags of the stages that may change, all but some, shape (n,)."""
        return ~np.isin(np.arange(self.numbers.stages), list(kept))

    def with_random_steps(self, best: _Driven) -> _Driven:
        """Change all stages at once, and keep the better stages of each attempt."""
        problem, how, kept = self.problem, self.problem.settings.search, set[int]()
        for attempt in range(how.refinements):
            problem.progress(f"refining the plan, attempt {attempt + 1} of {how.refinements}")
            seed, loose = problem.seed + attempt, self.loose(kept)
            if not loose.any():
                kept.clear()
                loose = self.loose()
            changed = refined(self.numbers, best.decisions, loose, problem.effort, seed)
            for tried in self.driven(changed):
                failed: Collection[int] = tried.stages.colliding
                if not failed:
                    growth = tried.stages.lengths - best.stages.lengths
                    better = shorter_stages(growth, self.numbers.stages)
                    plans = [best, tried]
                    if 0 < len(better) < self.numbers.stages:
                        mixed = best.decisions.put(better, tried.decisions)
                        plans += self.driven(mixed)
                    shortest = min(plans, key=_duration)
                    if shortest is not best:
                        best = shortest
                        continue
                    failed = [int(np.argmax(growth))]
                kept.update(stage for k in failed for stage in (k - 1, k))
        return best

    def step_single_stages(self, best: _Driven) -> None:
        """Change one stage at a time."""
        count = search_effort(self.numbers, self.problem.effort).single_steps
        if not count:
            return
        self.problem.progress("refining single stages")
        free = replace(self.numbers, clearance=None, with_margin=())
        loose = self.loose()
        steps = shorter_steps(free, best.decisions, loose, self.problem.seed)
        step = next(steps)
        for _ in range(count):
            shorter = [] if step is None else self.driven(step, self.widths)
            is_kept = bool(shorter) and _duration(shorter[0]) < _duration(best)
            best = shorter[0] if is_kept else best
            step = steps.send(is_kept)


def shorter_stages(growth: FloatArray, stages: int) -> IntArray:
    """Select the stages whose own time and that of the next one shrink together.

    Args:
        growth: how much longer each stage becomes, the return included [s].
        stages: number of stages without the return.
    """
    following = np.append(growth[1:], 0.0)
    return np.flatnonzero((growth + following)[:stages] < 0.0)


def shorter_steps(
    problem: SequenceProblem, decisions: Decisions, loose: BoolArray, seed: int
) -> Generator[Decisions | None, bool, None]:
    """Yield changed plans that are shorter by estimate; each answer is whether the plan is kept.

    A step moves variables of one stage. The estimate chooses the launches that suit it best. After each stage without a
    kept step the value is None, so that the search can end there.

    Args:
        problem: the sequence.
        decisions: the plan, possible at rest.
        loose: flags of stages that may change, shape (n,).
        seed: seed of the steps.
    """
    random, how = np.random.default_rng(seed), problem.settings.refinement
    candidates = np.flatnonzero(loose)
    while len(candidates):
        chosen = np.arange(problem.stages) == random.choice(candidates)
        whole = evaluate(replace(problem, launches=None), decisions)
        (changed_stages,) = loose_stretches(problem, whole, chosen)
        stretch = _with_retract_before(problem, whole, changed_stages, chosen)
        part = decisions.take(stretch.stages)
        # The time of the plan is estimated as that of the steps is.
        suited, now = _estimated(_estimated(stretch.problem, part, near=False)[0], part, near=True)
        variables = Variables.of(stretch.problem, stretch.loose)
        is_kept = False
        for _ in range(how.tries if np.isfinite(now) else 0):
            size = np.ldexp(how.largest_step, -random.integers(how.halvings))
            step = size * random.normal(size=variables.count)
            step *= random.random(variables.count) < how.moved
            moved = variables.moved(part, step)
            if _estimated(suited, moved, near=True)[1] > now - how.least:
                continue
            changed = stretch.put(decisions, moved)
            is_kept = yield changed
            if is_kept:
                decisions = changed
                break
        if not is_kept:
            yield None


def _with_retract_before(
    problem: SequenceProblem, whole: Evaluated, stretch: Stretch, loose: BoolArray
) -> Stretch:
    """Extend a stretch by the stage before it, whose retract its first transfer continues."""
    first, past = max(0, int(stretch.stages[0]) - 1), int(stretch.stages[-1]) + 1
    if len(stretch.stages) == problem.stages:
        return stretch
    part = stretch_of(problem, first, past, whole)
    return Stretch(part, np.arange(first, past), loose[first:past])


def _estimated(
    problem: SequenceProblem, part: Decisions, *, near: bool
) -> tuple[SequenceProblem, float]:
    """Estimate the time of stages with the launches that suit them best [s]; also return these."""
    at_rest = evaluate(replace(problem, launches=None), part)
    if not np.isfinite(at_rest.total):
        return problem, np.inf
    suited, plan = with_best_launches(problem, at_rest, near=near)
    return suited, plan.total
