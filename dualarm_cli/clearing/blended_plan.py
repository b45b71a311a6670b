"""Blending: let tools pass line ends and targets in motion wherever that is collision-free."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from dualarm_cli.background import BackgroundCall, allow_workers, map_halves
from dualarm_cli.clearing.cleared_plan import ClearedPlan
from dualarm_cli.clearing.repairs import Clearing, TimedPlan
from dualarm_cli.clearing.stage_samples import alone_clear, stage_samples
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.model.job import Job
from dualarm_cli.model.motion.trajectory import SAME_TIME
from dualarm_cli.model.motion_limits import is_slowed
from dualarm_cli.motion.blending import Launches, passing_launches, with_launches
from dualarm_cli.motion.builder import Motion
from dualarm_cli.motion.detours_in_motion import moving_detours, with_moving_detours
from dualarm_cli.motion.motion import realise
from dualarm_cli.motion.passed_targets import passed_targets, with_passed_targets
from dualarm_cli.motion.transfers import Drive
from dualarm_cli.postures.stage_plan import StagePlan
from dualarm_cli.records import dataclass
from dualarm_cli.stages.method import Decided, DrivenStages, MethodProblem
from dualarm_cli.stages.serving import with_stopping_room
from dualarm_cli.stages.stage_choice import REACH
from dualarm_cli.timing import TimingSolver


def with_room(
    problem: MethodProblem, solve: Callable[[MethodProblem], Decided]
) -> Callable[[MethodProblem], Decided]:
    """Wrap a method so that joints keep a margin for blending from their limits.

    Args:
        problem: the problem that the method solves, also in variations.
        solve: the method; used without a margin once no plan exists with it.
    """
    with_margin = with_stopping_room(problem)
    has_margin = True

    def solve_with_margin(variant: MethodProblem) -> Decided:
        nonlocal has_margin
        if has_margin:
            try:
                job = replace(variant.job, cell=with_margin.job.cell)
                decided = solve(
                    replace(variant, model=with_margin.model, job=job, without_margin=variant)
                )
            except InfeasibleError:
                if variant.neighbourhood_only:
                    raise
                decided = None
            # The margin may put a target just out of reach at the platform angle that a method chose.
            if decided is not None and all(stage.solver != REACH for stage in decided.stages):
                return decided
            # A margin that fails once fails in every variation.
            has_margin = False
        return solve(variant)

    return solve_with_margin


def shortest_blended(
    problem: MethodProblem,
    plan: ClearedPlan,
    timing: TimingSolver,
) -> ClearedPlan:
    """Blend a plan and its rivals; return the shortest, see `blended_plan`."""
    plans = [replace(plan, rivals=()), *plan.rivals]

    def blended(batch: Sequence[ClearedPlan]) -> list[TimedPlan | None]:
        timed: list[TimedPlan | None] = []
        for candidate in batch:
            try:
                timed.append(blended_plan(problem, candidate, timing).cleared)
            except InfeasibleError:
                if candidate is plans[0]:
                    raise
                timed.append(None)
        return timed

    pairs = [
        (candidate, cleared)
        for candidate, cleared in zip(plans, map_halves(blended, plans), strict=True)
        if cleared is not None
    ]
    best, shortest = min(pairs, key=lambda pair: pair[1].duration)
    return replace(best, cleared=shortest, stopping=best.cleared)


def blended_plan(
    problem: MethodProblem,
    plan: ClearedPlan,
    timing: TimingSolver,
    stopping: Collection[tuple[int, str]] = (),
    widths: int | None = None,
) -> ClearedPlan:
    """Blend the lines and transfers of a plan where that is collision-free.

    Args:
        problem: the problem that the plan solves.
        plan: the plan with stops at every line end.
        timing: solver that times motions.
        stopping: transfers that stay at rest at both ends, as (stage they lead to, arm).
        widths: number of step widths for the refinement of launches; that of the effort by default.
    """
    model, job, cache = problem.model, problem.job, plan.cache
    drive = Drive.of(model, job, timing, cache)
    clearing = plan.clearing(problem, timing)
    before = plan.cleared.motion
    through = passed_targets(drive, plan.cleared.plans, stopping)
    widths = problem.settings.widths if widths is None else widths

    def passing() -> list[StagePlan]:
        return with_passed_targets(drive, plan.cleared.plans, through)

    def chosen(widths: int) -> Launches:
        return passing_launches(drive, passing(), stopping, widths)

    def launched(launches: Launches) -> list[StagePlan]:
        return with_launches(passing(), launches)

    def timed(launches: Launches) -> _Blend:
        plans = launched(launches)
        motion = realise(model, job, plans, timing, cache)
        colliding = clearing.colliding_stages(plans, motion) if clearing is not None else []
        return _Blend(plans, motion, launches, tuple(colliding))

    launches = chosen(widths)
    while launches or through:
        try:
            blend = timed(launches)
        except InfeasibleError:
            if not through:
                raise
            # A target passed in motion cannot wait for the end of the stage.
            through = {}
            launches = chosen(widths)
            continue
        passed = {k for k in through if {k, k + 1} & set(blend.colliding)}
        if not passed:
            break
        # The neighbouring launches were chosen for a passed target.
        launches = {
            key: launch
            for key, launch in blend.without_colliding().items()
            if not {key[0], key[0] - 1} & passed
        }
        through = {k: target for k, target in through.items() if k not in passed}
    else:
        blend = _Blend(plan.cleared.plans, before, {}, ())
    if clearing is not None and blend.colliding:
        least = problem.settings.widths
        coarser = chosen(least) if least < widths else {}
        blend = _cleared(blend, clearing, launched, timed, coarser)
    plans, motion = blend.plans, blend.motion
    if blend.colliding or not (blend.launches or through):
        plans, motion = plan.cleared.plans, before
    plans, motion = _with_detours_in_motion(drive, job, clearing, plans, motion, stopping)
    gain = before.trajectory.duration - motion.trajectory.duration
    if gain <= 0.0:
        same = replace(plan.cleared, motion=replace(before, gain=0.0))
        return replace(plan, cleared=same, stopping=plan.cleared)
    motion = _with_gain(motion, before, gain)
    return replace(plan, cleared=TimedPlan(plans, motion), stopping=plan.cleared)


def _with_gain(motion: Motion, before: Motion, gain: float) -> Motion:
    """Set the gain of each stage and of the motion against stops at line ends [s]."""
    stages = tuple(
        replace(stage, saved=(stop_stage.end - stop_stage.start) - (stage.end - stage.start))
        for stage, stop_stage in zip(motion.stages, before.stages, strict=True)
    )
    return replace(motion, stages=stages, gain=gain)


@dataclass(frozen=True)
class _Blend:
    """Timed stages with the launches of their lines."""

    plans: list[StagePlan]
    """The stages."""
    motion: Motion
    """Their motion."""
    launches: Launches
    """Launches at the ends of lines."""
    colliding: tuple[int, ...]
    """Indices of colliding stages."""

    def without_colliding(self) -> Launches:
        """Leave out the launches before colliding stages, or, if those have none, after them."""
        for later in (0, 1):
            kept = {k: v for k, v in self.launches.items() if k[0] - later not in self.colliding}
            if len(kept) < len(self.launches):
                return kept
        return self.launches

    def with_fewer(self, clearing: Clearing, k: int, coarser: Launches) -> Iterator[Launches]:
        """Yield launches with one arm at rest before stage k: at its retract, approach or both.

        If arms collide alone, one of them, else any, first the one that is done first.

        Args:
            clearing: collision checks.
            k: index of the stage.
            coarser: launches that are tried before those at rest.
        """
        samples, cell = stage_samples(self.motion, k, k, clearing.holding), clearing.holding.cell
        alone = [name for a, name in enumerate(cell.arms) if not alone_clear(cell, samples, a)]
        start, end = self.motion.stages[k].start, self.motion.stages[k].end

        def done(arm: str) -> float:
            parts = (part for part in self.motion.segments if part.arm == arm)
            busy = (p.end for p in parts if p.kind != "wait" and start < p.end < end + SAME_TIME)
            return max(busy, default=start)

        # Limits of tool speed hold for the launches as they were chosen, and at rest.
        is_capped = is_slowed(clearing.job)
        for arm in sorted(alone or cell.arms, key=done):
            retract, approach = self.launches.get((k, arm), (None, None))
            halves = () if is_capped else ((None, approach), (retract, None))
            first = (coarser[k, arm],) if (k, arm) in coarser else ()
            for pair in dict.fromkeys((*first, *halves, (None, None))):
                if pair != (retract, approach):
                    yield {**self.launches, (k, arm): pair}


def _cleared(
    blend: _Blend,
    clearing: Clearing,
    launched: Callable[[Launches], list[StagePlan]],
    timed: Callable[[Launches], _Blend],
    coarser: Launches,
) -> _Blend:
    """Leave out launches until no stage collides.

    One that suffices is left out, else all before the stage. A launch changes two stages. Only those are timed to find
    the launches of all colliding stages.

    Args:
        blend: stages with all launches.
        clearing: collision checks.
        launched: builds the stages with other launches.
        timed: times the stages with other launches.
        coarser: launches that are tried before those at rest.
    """
    coarser = dict(coarser)
    while blend.colliding:
        launches = blend.launches
        for k in blend.colliding:
            fewer = replace(blend, launches=launches).with_fewer(clearing, k, coarser)
            start = blend.motion.stages[max(0, k - 2)].start
            clear = (c for c in fewer if clearing.is_clear_at(launched(c), k, start))
            candidate = next(clear, None)
            launches = launches if candidate is None else candidate
            # They are tried once, so that each round leaves fewer launches.
            for arm in clearing.holding.cell.arms:
                coarser.pop((k, arm), None)
            # Arms that may be late join more than two stages.
            if candidate is None or clearing.holding.cell.skew > 0.0:
                break
        tried = None
        for fewer_launches in (launches, blend.without_colliding()):
            if tried is None and fewer_launches is not blend.launches:
                with suppress(InfeasibleError):  # a passed target cannot wait
                    tried = timed(fewer_launches)
        if tried is None:
            break
        blend = tried
    return blend


def refined_plans(
    problem: MethodProblem, plans: Sequence[ClearedPlan], timing: TimingSolver
) -> list[ClearedPlan]:
    """Refine one or two plans, the second in a second process, see `refined_plan`."""
    if len(plans) == 1:
        return [refined_plan(problem, plans[0], timing)]
    silent = replace(problem, progress=lambda _: None)
    with BackgroundCall(lambda: refined_plan(silent, plans[1], timing).sent()) as second:
        with allow_workers(False):
            first = refined_plan(problem, plans[0], timing)
        return [first, replace(second.result(), holding=first.holding)]


def refined_plan(problem: MethodProblem, plan: ClearedPlan, timing: TimingSolver) -> ClearedPlan:
    """Refine a plan by its method; return the shortest one as it is driven.

    Args:
        problem: the problem that the plan solves.
        plan: a collision-free plan, blended if the problem allows it.
        timing: solver that times motions.
    """
    clearing, best = plan.clearing(problem, timing), plan
    if problem.refine is None or not problem.refines:
        return plan

    def driven(stages: list[StagePlan], widths: int | None) -> DrivenStages | None:
        nonlocal best
        try:
            motion = realise(problem.model, problem.job, stages, timing, plan.cache)
            colliding = clearing.colliding_stages(stages, motion) if clearing is not None else []
            if colliding:
                return DrivenStages(np.zeros(0), tuple(colliding))
            cleared = TimedPlan(stages, motion)
            # The cost of clearance is that of the plans before refinement.
            unchecked = cleared.duration - (plan.cost or 0.0)
            tried = replace(plan, cleared=cleared, unchecked=unchecked, stopping=None)
            if problem.blends:
                tried = blended_plan(problem, tried, timing, widths=widths)
        except InfeasibleError:
            return None
        if tried.cleared.duration < best.cleared.duration:
            best = tried
        return _driven(tried)

    given = replace(problem, holding=plan.holding)
    problem.refine(given, (plan.stopping or plan.cleared).plans, _driven(plan), driven)
    return best


def _driven(plan: ClearedPlan) -> DrivenStages:
    spans = [(stage.start, stage.end) for stage in plan.cleared.motion.stages]
    return DrivenStages(np.diff(spans, axis=1)[:, 0])


def _with_detours_in_motion(
    drive: Drive,
    job: Job,
    clearing: Clearing | None,
    plans: list[StagePlan],
    motion: Motion,
    stopping: Collection[tuple[int, str]],
) -> tuple[list[StagePlan], Motion]:
    """Let detours begin and end in motion where that is shorter and collision-free."""
    candidates = moving_detours(drive, plans, stopping)
    while candidates:
        chosen = {key: detours[0] for key, detours in candidates.items()}
        moving = with_moving_detours(drive, plans, chosen)
        try:
            realised = realise(drive.model, job, moving, drive.timing, drive.cache)
        except InfeasibleError:
            # With the platform's motion, one of the detours cannot be timed.
            rejected = set(candidates)
        else:
            colliding_stages = (
                clearing.colliding_stages(moving, realised) if clearing is not None else []
            )
            rejected = {key for key in candidates if key[0] in colliding_stages}
            rejected = rejected or {key for key in candidates if key[0] - 1 in colliding_stages}
            if not colliding_stages and realised.trajectory.duration < motion.trajectory.duration:
                return moving, realised
            if not rejected:
                break
        # Colliding detours move on to their next via point.
        candidates = {key: detours[key in rejected :] for key, detours in candidates.items()}
        candidates = {key: detours for key, detours in candidates.items() if detours}
    return plans, motion
