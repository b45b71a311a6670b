"""A method's quickest collision-free plan: first without collision checking, then with it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from dualarm_cli.clearing.blended_plan import (
    blended_plan,
    has_blends,
    shortest_blended,
    with_room,
)
from dualarm_cli.clearing.blocked import (
    grip_faults,
    refuse_touching_lines,
    why_blocked,
)
from dualarm_cli.clearing.cleared_plan import ClearedPlan
from dualarm_cli.clearing.repairs import Cleared, Clearing
from dualarm_cli.clearing.stage_samples import StageSamples, alone_clear, stage_samples
from dualarm_cli.effort import less_effort
from dualarm_cli.errors import BlockedError, InfeasibleError
from dualarm_cli.motion.builder import Motion
from dualarm_cli.motion.motion import realise
from dualarm_cli.motion.transfers import Known
from dualarm_cli.motion.waiting import transfer_ends
from dualarm_cli.postures.holding import Holding
from dualarm_cli.postures.stage_plan import StagePlan, same_postures
from dualarm_cli.stages.method import Decided, MethodProblem
from dualarm_cli.stages.plans.clearance import Barred
from dualarm_cli.timing import TimingSolver

COSTLY = 1.5
"""What repairing a stage costs that is worth looking for another one, at full speed [s]."""


def bars_of(clearing: Clearing, tried: Cleared) -> list[Barred]:
    """Returns what a plan's blocked stages have to be different in, and what its repaired ones really cost."""
    found = []
    everything = tuple(range(len(clearing.job.cell.robot.joints)))
    # With a cap on the tools' speed all takes longer than the search thinks.
    thought = sum(plan.duration for plan in tried.plans) / clearing.holding.pace
    slow = clearing.holding.pace
    if thought > 0.0:
        slow = max(slow, tried.motion.trajectory.duration / thought)
    for k, (plan, stage) in enumerate(zip(tried.plans, tried.motion.stages, strict=True)):
        if not plan.detours and not plan.waits:
            continue
        straight = clearing.alone(replace(plan, detours={}, waits={}))
        cost = stage.end - stage.start - straight.trajectory.duration
        if cost > COSTLY * slow:
            found.append(Barred(k, everything, plan.start, plan.arrival, cost))
    for k in tried.blocked:
        plan, stage = tried.plans[k], tried.motion.stages[k]
        samples = stage_samples(tried.motion, k, k, clearing.holding)
        margins = clearing.holding.cell.margins(samples.position, samples.held)
        ends = transfer_ends(tried.motion.segments, stage.start, stage.end)
        length = stage.end - stage.start
        arrived = (min(ends, default=stage.end) - stage.start) / length if length > 0 else 0.0
        worst = int(np.argmin(margins)) / (len(margins) - 1)
        start = None if plan.stops and worst >= arrived else plan.start
        found.append(Barred(k, _joints_at_fault(clearing, samples), start, plan.arrival))
    return found


def _joints_at_fault(clearing: Clearing, samples: StageSamples) -> tuple[int, ...]:
    """Returns the columns of the arm that collides by itself, or else of all joints."""
    model, cell = clearing.model, clearing.holding.cell
    for a, name in enumerate(cell.arms):
        if not alone_clear(cell, samples, a):
            return (*model.platform_columns, *model.arms[name].columns)
    return tuple(range(samples.position.shape[1]))


NEGLIGIBLE = 0.005
"""Share of the cycle time; where repairing the unchecked plan costs no more, no other plan is looked for."""
FEW = 0.34
"""Share of stages; an unchecked plan in which more of them collide is not repaired."""
RIVALS = 0.08
"""Share of the cycle time; where avoiding collisions costs more, simpler methods' plans may do better."""
UNLUCKY = 0.03
"""Share of the cycle time; where avoiding collisions costs more, the plan of less effort may do better: it starts
elsewhere."""
LITTLE_GAIN = 0.03
"""Share of the cycle time; where blending gains less, the plan that is searched for with stops competes."""
ALIKE = 0.03
"""Share of the cycle time with stops; a plan that takes longer by more is hardly shorter when both are blended."""
ROUNDS, MOST_ROUNDS = 3, 12
"""Rounds in which a method re-plans without blocked stages, and the most where no plan is collision-free."""


def quickest_clear(
    problem: MethodProblem,
    solve: Callable[[MethodProblem], Decided],
    timing: TimingSolver,
    progress: Callable[[str], None],
    *,
    clear: bool = True,
    alone: str | None = None,
    for_stops: bool = False,
) -> ClearedPlan:
    """Returns the quickest plan of a method that is collision-free, see `_quickest_with_stops`.

    Where the problem allows it, tools then pass the outer ends of lines in motion; the method plans with joints so
    far from their limits of position that they can, as well or only.

    Args:
        problem: what the method is asked.
        solve: the method.
        timing: how motions are timed.
        progress: receives what is being done.
        clear: whether anything has to be collision-free.
        alone: the only arm that has to be clear, and not of the other one; None for all arms.
        for_stops: whether postures are chosen as if tools stopped at all lines' ends; it ends as that plan does.

    Raises:
        InfeasibleError: no posture reaches a target, or nothing that was found is collision-free.
    """
    holding = None
    if clear:
        # What no plan of these arms can repair is refused before one is looked for.
        holding = Holding.of(problem.job, alone=alone)
        if faults := grip_faults(problem.job):
            raise InfeasibleError(*faults)
    if not has_blends(problem):
        return _quickest_with_stops(problem, solve, timing, progress, holding)

    def chosen_for_stops() -> ClearedPlan:
        stopping = replace(problem, blend=False)
        found = _quickest_with_stops(stopping, solve, timing, progress, holding)
        progress("blending lines and transfers")
        return found

    if for_stops:
        # Its rivals may end elsewhere.
        return blended_plan(problem, chosen_for_stops(), timing)
    roomy = with_room(problem, solve)
    found = _quickest_with_stops(problem, roomy, timing, progress, holding)
    progress("blending lines and transfers")
    best = shortest_blended(problem, found, timing)
    if (best.cleared.motion.gain or 0.0) > LITTLE_GAIN * _duration(best):
        return best
    # Where blending gains little, postures chosen for stops may be quicker.
    return min(best, shortest_blended(problem, chosen_for_stops(), timing), key=_duration)


def _duration(found: ClearedPlan) -> float:
    return found.cleared.motion.trajectory.duration


def _quickest_with_stops(
    problem: MethodProblem,
    solve: Callable[[MethodProblem], Decided],
    timing: TimingSolver,
    progress: Callable[[str], None],
    holding: Holding | None,
) -> ClearedPlan:
    """Returns the quickest plan of a method that is collision-free, with all tools stopping at both ends of lines.

    The method decides without collision checking. Where that plan is collision-free, or repairing it costs next to
    nothing, it is the plan. Otherwise the method decides anew with collision checking, and again without stages that
    collide when they are timed, whatever is done about them.

    Args:
        problem: what the method is asked.
        solve: the method.
        timing: how motions are timed.
        progress: receives what is being done.
        holding: what has to be collision-free; None: nothing.

    Raises:
        InfeasibleError: no posture reaches a target, or nothing that was found is collision-free.
    """
    unchecked = solve(problem)
    progress("timing the motion")
    known = Known()
    timed = _timed(problem, unchecked, timing, known)
    reference = timed[0][1].trajectory.duration
    if holding is None:
        return ClearedPlan(
            unchecked,
            Cleared(*timed[0], ()),
            reference,
            replanned=False,
            holding=None,
            known=known,
            rivals=tuple(
                Cleared(*one, ())
                for one in timed[1:]
                if problem.blend and one[1].trajectory.duration <= (1.0 + ALIKE) * reference
            ),
        )
    clearing = Clearing(problem.model, problem.job, holding, timing, problem.seed, known)
    best, clear_plans = None, list[Cleared]()
    for plans, motion in timed:
        done = best is not None and best.is_done_within(motion.trajectory.duration)
        near = motion.trajectory.duration <= (1.0 + ALIKE) * reference
        if done and not (problem.blend and near):
            break
        touching = clearing.touching(plans, motion)
        if not touching:
            clear_plans.append(Cleared(plans, motion, ()))
            best = _better(best, clear_plans[-1])
        elif not done and len(touching) <= max(1, FEW * len(plans)):
            progress("avoiding collisions")
            best = _better(best, clearing.cleared(plans, motion, touching, give_up=True))
    if best is not None and not best.blocked:
        cost = best.motion.trajectory.duration - reference
        if cost <= NEGLIGIBLE * reference:
            rivals = tuple(one for one in clear_plans if one is not best)
            return ClearedPlan(
                unchecked,
                best,
                reference,
                replanned=False,
                known=known,
                holding=holding,
                rivals=rivals,
            )
    found = None
    if best is not None:
        found = ClearedPlan(
            unchecked, best, reference, replanned=False, known=known, holding=holding
        )
    unchecked_plan = timed[0]
    asked = replace(
        problem,
        holding=holding,
        unchecked=tuple(unchecked_plan[0]),
        touching=tuple(clearing.touching(*unchecked_plan)),
    )
    failure: InfeasibleError | None = None
    decided = unchecked
    before: list[StagePlan] | None = None
    for round_ in range(MOST_ROUNDS):
        if round_ >= ROUNDS and found is not None and not found.cleared.blocked:
            break
        progress("choosing postures again, avoiding collisions")
        good = found is not None and not found.cleared.blocked and not _is_unlucky(found)
        try:
            decided = solve(replace(asked, only_near=good))
        except InfeasibleError as error:
            failure = error
            break
        timed = _timed(problem, decided, timing, known)
        if not problem.patient:
            refuse_touching_lines(clearing, *timed[0])
        tried = _cleared(clearing, timed)
        if found is None or _badness(tried) < _badness(found.cleared):
            found = ClearedPlan(
                decided, tried, reference, replanned=True, known=known, holding=holding
            )
        bars = bars_of(clearing, tried)
        # Only a method over the whole sequence does something else with what is known now.
        if decided.hopeless or not bars or (tried.blocked and not problem.patient):
            break
        if before is not None and same_postures(decided.stages, before):
            break
        before = decided.stages
        asked = replace(
            asked,
            barred=(*asked.barred, *bars),
            unchecked=tuple(before),
            touching=(*_touching(clearing, timed, before), *(bar.stage for bar in bars)),
        )
    if found is not None and decided.simpler is not None and _is_dear(found):
        progress("comparing with simpler plans")
        simpler = Decided([], alternatives=tuple(decided.simpler()))
        found = _with_rivals(found, clearing, _timed(problem, simpler, timing, known))
    if found is not None and not found.cleared.blocked:
        less = less_effort(problem.effort)
        if less is None or not _is_unlucky(found):
            return found
        progress("comparing with the plan of less effort")
        try:
            easier = replace(problem, effort=less)
            other = _quickest_with_stops(easier, solve, timing, progress, holding)
        except InfeasibleError:
            return found
        quicker = min(found, other, key=lambda one: _badness(one.cleared))
        return replace(quicker, unchecked=min(found.unchecked, other.unchecked))
    blocked = () if found is None else found.cleared.blocked
    reasons = why_blocked(clearing, None if found is None else found.cleared)
    alone = found is not None and any(clearing.fails_alone(found.cleared, k) for k in blocked)
    raise failure or BlockedError(*reasons, stages=blocked, alone=alone)


def _is_unlucky(found: ClearedPlan) -> bool:
    """Returns whether a collision-free plan is worth another look: avoiding collisions costs much."""
    return (found.cost or 0.0) > UNLUCKY * found.unchecked


def _is_dear(found: ClearedPlan) -> bool:
    """Returns whether simpler plans are worth a look: this one collides, or it avoids that at a cost."""
    return bool(found.cleared.blocked) or (found.cost or 0.0) > RIVALS * found.unchecked


def _with_rivals(
    found: ClearedPlan, clearing: Clearing, timed: list[tuple[list[StagePlan], Motion]]
) -> ClearedPlan:
    """Returns the best of what was found and of simpler plans after repairing."""
    if not timed:
        return found
    tried = _cleared(clearing, timed, None if found.cleared.blocked else found.cleared)
    if _badness(tried) < _badness(found.cleared):
        return replace(found, decided=Decided(tried.plans), cleared=tried, replanned=True)
    return found


def _touching(
    clearing: Clearing, timed: list[tuple[list[StagePlan], Motion]], plan: list[StagePlan]
) -> list[int]:
    """Returns the stages of one of several timed plans that collide."""
    [motion] = [motion for stages, motion in timed if stages is plan]
    return clearing.touching(plan, motion)


def _timed(
    problem: MethodProblem, decided: Decided, timing: TimingSolver, known: Known
) -> list[tuple[list[StagePlan], Motion]]:
    """Returns a method's plans with their motions, quickest first."""
    plans = [stages for stages in (decided.stages, *decided.alternatives) if stages]
    timed = [
        (stages, realise(problem.model, problem.job, stages, timing, known)) for stages in plans
    ]
    return sorted(timed, key=lambda one: one[1].trajectory.duration)


def _cleared(
    clearing: Clearing,
    timed: list[tuple[list[StagePlan], Motion]],
    best: Cleared | None = None,
) -> Cleared:
    """Returns the best of some plans after repairing, or one that is known if that is better."""
    for plans, motion in timed:
        if best is not None and best.is_done_within(motion.trajectory.duration):
            break
        best = _better(best, clearing.cleared(plans, motion, clearing.touching(plans, motion)))
    assert best  # a method always has a plan of its own
    return best


def _better(one: Cleared | None, other: Cleared) -> Cleared:
    return other if one is None or _badness(other) < _badness(one) else one


def _badness(found: Cleared) -> tuple[int, float]:
    return len(found.blocked), found.motion.trajectory.duration
