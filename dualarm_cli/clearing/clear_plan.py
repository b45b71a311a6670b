"""Clearance loop: turn a planning method's proposals into the shortest collision-free plan.

Start here if avoiding collisions makes a plan too long, or if a job is refused because stages stay blocked.

The method first plans without collision checking. If that plan is collision-free, or if repairs cost next to nothing,
it is the result. Otherwise the method plans again with collision checking; stages that no repair fixes become no-goods
of the next round. If clearance still costs much, plans of simpler methods and of the next lower effort compete.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext, suppress
from dataclasses import field, replace
from functools import cached_property, partial
from operator import attrgetter

import numpy as np

from dualarm_cli.background import BackgroundCall, allow_workers
from dualarm_cli.clearing.blended_plan import (
    blended_plan,
    refined_plans,
    shortest_blended,
    with_room,
)
from dualarm_cli.clearing.blocked import (
    grip_faults,
    refuse_touching_lines,
    why_blocked,
)
from dualarm_cli.clearing.cleared_plan import ClearedPlan
from dualarm_cli.clearing.repairs import Clearing, TimedPlan
from dualarm_cli.clearing.stage_samples import StageSamples, alone_clear, stage_samples
from dualarm_cli.effort import ClearanceSettings, further_searches, less_effort
from dualarm_cli.effort.stages import SCALING
from dualarm_cli.errors import BlockedError, InfeasibleError
from dualarm_cli.model.blending import STOPPING
from dualarm_cli.model.motion_limits import is_slowed
from dualarm_cli.model.part_flow import NO_CARE
from dualarm_cli.motion.motion import realise
from dualarm_cli.motion.transfers import MotionCache
from dualarm_cli.motion.waiting import transfer_ends
from dualarm_cli.postures.holding import Holding
from dualarm_cli.postures.stage_plan import StagePlan, same_postures
from dualarm_cli.records import dataclass
from dualarm_cli.stages.method import Decided, MethodProblem
from dualarm_cli.stages.plans.clearance import NoGood
from dualarm_cli.timing import TimingSolver


def quickest_clear(
    problem: MethodProblem,
    solve: Callable[[MethodProblem], Decided],
    timing: TimingSolver,
    *,
    check_collisions: bool = True,
    alone: str | None = None,
) -> ClearedPlan:
    """Plan a job without collisions, blended where the problem allows it.

    Where care or a tool speed limit costs more than a few percent, two searches may compete, without and with these
    limits: what is estimated best need not be best when blended.

    For blending, the method keeps joints away from their position limits: tools need that room to pass the outer ends
    of lines in motion. If blending gains little, postures that are chosen for stops compete.

    Args:
        problem: problem that the method solves.
        solve: the method.
        timing: solver that times motions.
        check_collisions: whether collisions are checked.
        alone: the only arm that is checked, ignoring the other arm; None for all arms.

    Raises:
        InfeasibleError: no posture reaches a target, or every plan collides.
    """
    once = partial(_quickest_clear, check_collisions=check_collisions, alone=alone)
    if not (problem.compares_care and problem.job.tasks and is_slowed(problem.job)):
        return once(problem, solve, timing)
    try:
        plan = once(problem, solve, timing)
    except InfeasibleError:
        return once(replace(problem, is_careful=True), solve, timing)
    if _cost_of_care(problem, plan.cleared.plans, timing) < problem.settings.clearing.cost_of_care:
        return plan
    plans = [plan]
    with suppress(InfeasibleError):
        plans.append(once(replace(problem, is_careful=True), solve, timing))
    return min(plans, key=attrgetter("cleared.duration"))


def _cost_of_care(problem: MethodProblem, plans: list[StagePlan], timing: TimingSolver) -> float:
    """Compute how much longer stages take, with stops, than without care and tool speed limit [fraction]."""
    job = problem.job
    tasks = (replace(task, care=NO_CARE, holding=NO_CARE) for task in job.tasks)
    free = replace(job, tasks=tuple(tasks), tool_speed=None)
    slow, quick = (
        realise(problem.model, timed, plans, timing).trajectory.duration for timed in (job, free)
    )
    return slow / max(quick, 1e-9) - 1.0  # a plan may have no length


def _quickest_clear(
    problem: MethodProblem,
    solve: Callable[[MethodProblem], Decided],
    timing: TimingSolver,
    *,
    check_collisions: bool,
    alone: str | None,
) -> ClearedPlan:
    """Plan a job with one method, see `quickest_clear`, and refine the plan.

    Sequences that are not long are searched again on the grids of `further_searches`, in a second process. No estimate
    ranks their plans: the shortest ones are refined as they are driven, two of a short sequence.
    """
    holding = None
    if check_collisions:
        # Colliding grips have no plan: refuse them before the search.
        holding = Holding.of(problem.job, alone=alone)
        if faults := grip_faults(problem.job):
            raise InfeasibleError(*faults)
    loop = ClearanceLoop(problem, solve, timing, holding)
    stages, duration = len(problem.job.stages()), attrgetter("cleared.duration")
    has_grids = problem.refines and problem.model.has_arm_angles
    searches = further_searches(problem.effort, stages) if has_grids else []

    def further_plans() -> list[ClearedPlan]:
        plans = []
        for effort, grids in searches:
            variant = replace(problem, effort=effort, meshes=grids, progress=lambda _: None)
            with suppress(InfeasibleError):
                plans.append(_shortest(replace(loop, problem=variant)).sent())
        return plans

    # Searches of the same effort keep both cores busy, those of a lower one do not.
    is_busy = any(effort == problem.effort for effort, _ in searches)
    with BackgroundCall(further_plans, is_long=bool(searches)) as further:
        with allow_workers(False) if is_busy else nullcontext():
            plans = [_shortest(loop)]
        if searches:
            problem.progress("searching on further grids")
        plans += [replace(plan, holding=holding) for plan in further.result()]
    plans = sorted(plans, key=duration)[: 2 if stages <= SCALING.short else 1]
    return min(refined_plans(problem, plans, timing), key=duration)


def _shortest(loop: ClearanceLoop) -> ClearedPlan:
    """Plan a job with one grid, blended where allowed, without refinement."""
    problem, timing = loop.problem, loop.timing
    if not problem.blends:
        solve = with_room(problem, loop.solve) if problem.keeps_room else loop.solve
        return replace(loop, solve=solve).run()

    def chosen_for_stops() -> ClearedPlan:
        plan = replace(loop, problem=replace(problem, blending=STOPPING)).run()
        problem.progress("blending lines and transfers")
        return plan

    stopping = replace(loop, solve=with_room(problem, loop.solve)).run()
    problem.progress("blending lines and transfers")
    blended = shortest_blended(problem, stopping, timing)
    plan = blended.cleared
    if (plan.motion.gain or 0.0) > problem.settings.clearing.sufficient_gain * plan.duration:
        return blended
    # Where blending gains little, postures chosen for stops may be quicker.
    rival = shortest_blended(problem, chosen_for_stops(), timing)
    return min(blended, rival, key=attrgetter("cleared.duration"))


def quickest_for_stops(
    problem: MethodProblem,
    solve: Callable[[MethodProblem], Decided],
    timing: TimingSolver,
    *,
    check_collisions: bool = True,
) -> ClearedPlan:
    """Plan a job with stops at every line end, then blend it if allowed.

    The parameters are those of `quickest_clear`; blending keeps the final posture.
    """
    stopping = replace(problem, blending=STOPPING)
    plan = quickest_clear(stopping, solve, timing, check_collisions=check_collisions)
    if not problem.blends:
        return plan
    problem.progress("blending lines and transfers")
    return blended_plan(problem, plan, timing)


@dataclass
class ClearanceLoop:
    """Search for a method's shortest collision-free plan with stops at every line end.

    `run` is the whole loop: propose, repair, re-plan round by round, compare.
    """

    problem: MethodProblem
    """Problem that the method solves."""
    solve: Callable[[MethodProblem], Decided]
    """The method: proposes stages."""
    timing: TimingSolver
    """Solver that times motions."""
    holding: Holding | None
    """Bodies that must not collide; None disables collision checking."""
    cache: MotionCache = field(default_factory=MotionCache, init=False)
    """Motions timed so far."""
    best: ClearedPlan | None = field(default=None, init=False)
    """Best plan so far; stages of it may be blocked."""
    clear: list[ClearedPlan] = field(default_factory=list, init=False)
    """Collision-free plans so far; blending may make any of them the fastest."""
    unchecked: Decided = field(init=False)
    """The method's proposal without collision checking."""
    proposals: list[TimedPlan] = field(init=False)
    """That proposal and its alternatives, timed, fastest first."""

    @property
    def settings(self) -> ClearanceSettings:
        """Numbers of the loop."""
        return self.problem.settings.clearing

    def run(self) -> ClearedPlan:
        """Run all steps and return the shortest plan, with its rivals if it will be blended.

        Raises:
            InfeasibleError: a target is out of reach, or every plan collides.
        """
        stages = len(self.problem.job.stages())
        doing = f"deciding platform angles and postures of {stages} stages"
        doing = doing if stages else "planning a transfer"
        self.unchecked = self._decided(self.problem, doing)
        self.problem.progress("timing the motion")
        self.proposals = self._time(self.unchecked)
        if self.holding is None:
            self.clear = [self._cleared(self.unchecked, plan) for plan in self.proposals]
            return self._with_rivals(self.clear[0])
        if final := self._repair_unchecked():
            return self._with_rivals(final)
        decided, failure = self._replan()
        best = self._compare_simpler(decided)
        if best is None or best.cleared.blocked:
            raise failure or self._explain_blocked()
        return self._with_rivals(self._compare_less_effort(best))

    def _decided(self, problem: MethodProblem, doing: str) -> Decided:
        """Solve a problem by the method, whose share of the work follows what it does."""
        progress = self.problem.progress
        progress(doing)
        return self.solve(replace(problem, progress=lambda share: progress(f"{doing}, {share}")))

    def _with_rivals(self, best: ClearedPlan) -> ClearedPlan:
        """Join the shortest plan with the other collision-free plans that may win when blended.

        Without collision checking the shortest plan of all would be possible, too: no plan is shorter than unchecked.
        """
        shortest = best.cleared.duration
        unchecked = min(shortest, *(plan.unchecked for plan in (best, *self.clear)))
        different = [best]
        for plan in self.clear:
            stages = plan.cleared.plans
            if self._may_win_blended(plan.cleared, shortest) and not any(
                stages is kept.cleared.plans or same_postures(stages, kept.cleared.plans)
                for kept in different
            ):
                different.append(plan)
        best, *rivals = (replace(plan, unchecked=unchecked) for plan in different)
        return replace(best, rivals=tuple(rivals))

    @cached_property
    def clearing(self) -> Clearing:
        """Collision checks and repairs."""
        assert self.holding is not None  # else `run` has ended
        model, job, seed = self.problem.model, self.problem.job, self.problem.seed
        timing, cache = self.timing, self.cache
        return Clearing(model, job, self.holding, timing, seed, cache, settings=self.settings)

    def _time(self, decided: Decided) -> list[TimedPlan]:
        """Time a proposal and its alternatives; sort them by duration."""
        model, job = self.problem.model, self.problem.job
        plans = [
            TimedPlan(stages, realise(model, job, stages, self.timing, self.cache))
            for stages in (decided.stages, *decided.alternatives)
            if stages
        ]
        return sorted(plans, key=attrgetter("duration"))

    def _colliding_stages(self, plan: TimedPlan) -> list[int]:
        """Return the stages of a plan that collide."""
        return self.clearing.colliding_stages(plan.plans, plan.motion)

    def _cleared(
        self, decided: Decided, plan: TimedPlan, *, replanned: bool = False
    ) -> ClearedPlan:
        """Join a plan with the proposal that it came from."""
        reference = self.proposals[0].duration
        return ClearedPlan(decided, plan, reference, replanned, self.holding, self.cache)

    def _may_win_blended(self, plan: TimedPlan, shortest: float) -> bool:
        """Return whether a plan may be the shortest one when blended."""
        return self.problem.blends and plan.duration <= shortest * (
            1.0 + self.settings.blending_rival
        )

    def _repair_unchecked(self) -> ClearedPlan | None:
        """Repair the unchecked plans, fastest first; return the best if it is final."""
        best, shortest = None, self.proposals[0].duration
        for plan in self.proposals:
            is_slower = best is not None and best.is_done_within(plan.duration)
            if is_slower and not self._may_win_blended(plan, shortest):
                break
            colliding_stages = self._colliding_stages(plan)
            is_repairable = len(colliding_stages) <= max(
                1, self.settings.repairable_stages * len(plan.plans)
            )
            if not colliding_stages:
                self.clear.append(self._cleared(self.unchecked, plan))
                best = _better(best, plan)
            elif not is_slower and is_repairable:
                count, total = len(colliding_stages), len(plan.plans)
                self.problem.progress(f"avoiding collisions in {count} of {total} stages")
                best = _better(best, self.clearing.repaired(plan, colliding_stages, give_up=True))
        if best is None:
            return None
        self.best = self._cleared(self.unchecked, best)
        self._keep(self.best)
        return None if self.best.costs_more_than(self.settings.negligible_cost) else self.best

    def _keep(self, plan: ClearedPlan) -> None:
        """Keep a collision-free plan for blending."""
        if not plan.cleared.blocked:
            self.clear.append(plan)

    def _replan(self) -> tuple[Decided, InfeasibleError | None]:
        """Plan with collision checking, round by round, until nothing new is learned.

        Returns:
            The method's last proposal, and its refusal if the last round failed.
        """
        decided, problem = self.unchecked, self._near(self.problem, self.proposals[0])
        for round_ in range(self.settings.rounds_while_blocked):
            if round_ >= self.settings.rounds and self.best and not self.best.cleared.blocked:
                break
            doing = f"choosing postures again, avoiding collisions (round {round_ + 1})"
            is_cheap = self.best and not self.best.costs_more_than(
                self.settings.compare_less_effort
            )
            try:
                near = replace(problem, neighbourhood_only=bool(is_cheap))
                decided = self._decided(near, doing)
            except InfeasibleError as failure:
                return decided, failure
            if (following := self._next_problem(problem, decided)) is None:
                break
            problem = following
        return decided, None

    def _near(
        self, problem: MethodProblem, plan: TimedPlan, no_goods: Sequence[NoGood] = ()
    ) -> MethodProblem:
        """Return a problem with collision checking near a plan that collides, without its no-goods."""
        return replace(
            problem,
            holding=self.holding,
            no_goods=(*problem.no_goods, *no_goods),
            unchecked=tuple(plan.plans),
            colliding_stages=(
                *self._colliding_stages(plan),
                *(no_good.stage for no_good in no_goods),
            ),
        )

    def _next_problem(self, problem: MethodProblem, decided: Decided) -> MethodProblem | None:
        """Repair a proposal; return the problem of the next round, or None to stop."""
        plans = self._time(decided)
        if not problem.repair_touching_stops:
            refuse_touching_lines(self.clearing, plans[0])
        repaired = self._shortest_repaired(plans)
        cleared = self._cleared(decided, repaired, replanned=True)
        self._keep(cleared)
        if self.best is None or repaired.rank < self.best.cleared.rank:
            self.best = cleared
        no_goods = [*self._expensive_repairs(repaired), *self._blocked_stages(repaired)]
        # Only a method over the whole sequence uses no-goods.
        if (
            decided.is_infeasible
            or not no_goods
            or (repaired.blocked and not problem.repair_touching_stops)
        ):
            return None
        if problem.no_goods and same_postures(decided.stages, problem.unchecked):
            return None
        [proposed] = [plan for plan in plans if plan.plans is decided.stages]
        return self._near(problem, proposed, no_goods)

    def _shortest_repaired(
        self, plans: Sequence[TimedPlan], best: TimedPlan | None = None
    ) -> TimedPlan:
        """Repair plans, fastest first; return the best of them and of `best`."""
        for plan in plans:
            if best is not None and best.is_done_within(plan.duration):
                break
            best = _better(best, self.clearing.repaired(plan, self._colliding_stages(plan)))
        assert best  # a method always has a plan of its own
        return best

    def _expensive_repairs(self, plan: TimedPlan) -> Iterator[NoGood]:
        """Yield no-goods, with their true costs, of stages whose repairs take long."""
        all_joints = tuple(range(len(self.problem.job.cell.robot.joints)))
        pace = self.clearing.holding.pace
        # With a limit on the tools' speed all stages take longer than the search estimates.
        estimate = sum(stage.duration for stage in plan.plans) / pace
        if estimate > 0.0:
            pace = max(pace, plan.duration / estimate)
        for k, (stage, span) in enumerate(zip(plan.plans, plan.motion.stages, strict=True)):
            if not stage.detours and not stage.waits:
                continue
            straight = self.clearing.alone(replace(stage, detours={}, waits={}))
            cost = span.end - span.start - straight.trajectory.duration
            if cost > self.settings.expensive_repair * pace:
                yield NoGood(k, all_joints, stage.start, stage.arrival, cost)

    def _blocked_stages(self, plan: TimedPlan) -> Iterator[NoGood]:
        """Yield no-goods of stages that no repair fixes.

        A collision after the transfers depends on the stops alone: its no-good leaves the start open.
        """
        holding = self.clearing.holding
        for k in plan.blocked:
            stage, span = plan.plans[k], plan.motion.stages[k]
            samples = stage_samples(plan.motion, k, k, holding)
            margins = holding.cell.margins(samples.position, samples.held)
            ends = transfer_ends(plan.motion.segments, span.start, span.end)
            length = span.end - span.start
            arrived = (min(ends, default=span.end) - span.start) / length if length > 0 else 0.0
            worst = int(np.argmin(margins)) / (len(margins) - 1)
            start = None if stage.stops and worst >= arrived else stage.start
            yield NoGood(k, self._colliding_columns(samples), start, stage.arrival)

    def _colliding_columns(self, samples: StageSamples) -> tuple[int, ...]:
        """Return the columns of platform and arm if it collides alone, else all."""
        model, cell = self.problem.model, self.clearing.holding.cell
        for a, name in enumerate(cell.arms):
            if not alone_clear(cell, samples, a):
                return (*model.platform_columns, *model.arms[name].columns)
        return tuple(range(samples.position.shape[1]))

    def _compare_simpler(self, decided: Decided) -> ClearedPlan | None:
        """Return the best plan, of simpler methods as well if it is blocked or expensive."""
        best = self.best
        if (
            not best
            or not decided.simpler
            or not best.costs_more_than(self.settings.compare_simpler)
        ):
            return best
        self.problem.progress("comparing with simpler plans")
        plans = self._time(Decided([], alternatives=tuple(decided.simpler())))
        repaired = self._shortest_repaired(plans, best.cleared)
        if repaired.rank < best.cleared.rank:
            return replace(best, decided=Decided(repaired.plans), cleared=repaired, replanned=True)
        return best

    def _explain_blocked(self) -> BlockedError:
        """Return a refusal that names what collides in the best plan."""
        best = self.best.cleared if self.best else None
        blocked = best.blocked if best else ()
        alone = best is not None and any(self.clearing.fails_alone(best, k) for k in blocked)
        return BlockedError(*why_blocked(self.clearing, best), stages=blocked, alone=alone)

    def _compare_less_effort(self, best: ClearedPlan) -> ClearedPlan:
        """Return the best plan, of the next lower effort as well if clearance is expensive."""
        less = less_effort(self.problem.effort)
        if less is None or not best.costs_more_than(self.settings.compare_less_effort):
            return best
        self.problem.progress("comparing with the plan of less effort")
        try:
            rival = replace(self, problem=replace(self.problem, effort=less)).run()
        except InfeasibleError:
            return best
        self.clear += replace(rival, rivals=()), *rival.rivals
        return min(best, rival, key=attrgetter("cleared.rank"))


def _better(best: TimedPlan | None, candidate: TimedPlan) -> TimedPlan:
    return candidate if best is None or candidate.rank < best.rank else best
