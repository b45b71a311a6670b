"""A method's quickest plan that keeps clear: blind first, then with clearance, then without what would not do."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from dualarm_cli.errors import BlockedError, InfeasibleError
from dualarm_cli.planning.clear_bars import bars_of
from dualarm_cli.planning.clear_checks import check_grips, check_parts, check_start
from dualarm_cli.planning.clear_words import refuse_touching_lines, why_blocked
from dualarm_cli.planning.clearing import Cleared, Clearing
from dualarm_cli.planning.holding import Holding
from dualarm_cli.planning.method import Decided, MethodProblem
from dualarm_cli.planning.motion import Motion, realise
from dualarm_cli.planning.stage_plan import StagePlan, same_postures
from dualarm_cli.planning.stop_motion import Known
from dualarm_cli.timing import TimingSolver

NEGLIGIBLE = 0.005
"""Share of the cycle time that keeping clear may cost a blind plan for no other one to be looked for."""
FEW = 0.34
"""Share of stages; a blind plan with more that do not keep clear is not mended."""
DEAR = 0.25
"""Share of the cycle time; where keeping clear costs more that is said."""
SHOWN = 5e-4
"""Costs that are shown as more than nothing [s]."""
RIVALS = 0.08
"""Share of the cycle time; where keeping clear costs more, simpler methods' plans may do better."""
ROUNDS = 3
"""So many times a method decides anew without the stages that would not do."""


@dataclass(frozen=True)
class Found:
    """A method's plan, mended and timed."""

    decided: Decided
    """What it came from."""
    cleared: Cleared
    """The plan that keeps clear."""
    blind: float
    """Duration of the method's plan where nothing has to keep clear [s]."""
    replanned: bool
    """Whether other postures or platform angles were needed."""
    checked: bool = True
    """Whether anything had to keep clear."""

    @property
    def cost(self) -> float | None:
        """How much longer the plan is than the blind one [s]; None where nothing had to keep clear."""
        if not self.checked:
            return None
        return self.cleared.motion.trajectory.duration - self.blind


def quickest_clear(
    problem: MethodProblem,
    solve: Callable[[MethodProblem], Decided],
    timing: TimingSolver,
    progress: Callable[[str], None],
    *,
    clear: bool = True,
    crossing: bool = True,
) -> Found:
    """Returns the quickest plan of a method that keeps clear.

    The method decides as if nothing could touch; where that plan keeps clear, or mending it costs next to nothing, it
    is the plan. Otherwise the method decides anew with clearance, and again without stages that do not keep clear when
    they are timed, whatever is done about them.

    Args:
        problem: what the method is asked.
        solve: the method.
        timing: how motions are timed.
        progress: is told what is being done.
        clear: whether anything has to keep clear.
        crossing: whether arms have to keep clear of one another.

    Raises:
        InfeasibleError: no posture reaches a target, or nothing that was found keeps clear.
    """
    model, job = problem.model, problem.job
    holding = None
    if clear:
        # What no plan can mend is told before one is looked for.
        holding = Holding.of(job, crossing=crossing)
        check_start(problem, holding)
        check_parts(problem, holding)
        check_grips(problem)
    blind = solve(problem)
    progress("timing the motion")
    known = Known()
    timed = _timed(problem, blind, timing, known)
    reference = timed[0][1].trajectory.duration
    if holding is None:
        return Found(blind, Cleared(*timed[0], ()), reference, replanned=False, checked=False)
    clearing = Clearing(model, job, holding, timing, problem.seed, known, problem.paths)
    best = None
    for plans, motion in timed:
        if best is not None and best.is_done_within(motion.trajectory.duration):
            break
        touching = clearing.touching(plans, motion)
        if not touching:
            best = Cleared(plans, motion, ())
        elif len(touching) <= max(1, FEW * len(plans)):
            progress("keeping clear")
            best = _better(best, clearing.cleared(plans, motion, touching, give_up=True))
    if best is not None and not best.blocked:
        cost = best.motion.trajectory.duration - reference
        if cost <= NEGLIGIBLE * reference:
            return Found(blind, best, reference, replanned=False)
    found = Found(blind, best, reference, replanned=False) if best is not None else None
    blind_plan = timed[0]
    asked = replace(
        problem,
        holding=holding,
        blind=tuple(blind_plan[0]),
        touching=tuple(clearing.touching(*blind_plan)),
    )
    failure: InfeasibleError | None = None
    decided = blind
    before: list[StagePlan] | None = None
    for _ in range(ROUNDS):
        progress("deciding again, keeping clear")
        try:
            decided = solve(asked)
        except InfeasibleError as error:
            failure = error
            break
        timed = _timed(problem, decided, timing, known)
        if not problem.patient:
            refuse_touching_lines(clearing, *timed[0])
        tried = _cleared(clearing, timed)
        if found is None or _badness(tried) < _badness(found.cleared):
            found = Found(decided, tried, reference, replanned=True)
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
            blind=tuple(before),
            touching=(*_touching(clearing, timed, before), *(bar.stage for bar in bars)),
        )
    if found is not None and decided.simpler is not None and _is_dear(found):
        progress("looking at simpler plans")
        simpler = Decided([], alternatives=tuple(decided.simpler()))
        found = _with_rivals(found, clearing, _timed(problem, simpler, timing, known))
    if found is not None and not found.cleared.blocked:
        return found
    blocked = () if found is None else found.cleared.blocked
    words = why_blocked(clearing, None if found is None else found.cleared)
    alone = found is not None and any(clearing.fails_alone(found.cleared, k) for k in blocked)
    raise failure or BlockedError(words, blocked, alone=alone)


def _is_dear(found: Found) -> bool:
    """Returns whether simpler plans are worth a look: this one does not keep clear, or at a cost."""
    return bool(found.cleared.blocked) or (found.cost or 0.0) > RIVALS * found.blind


def _with_rivals(
    found: Found, clearing: Clearing, timed: list[tuple[list[StagePlan], Motion]]
) -> Found:
    """Returns the best of what was found and of simpler plans after mending."""
    if not timed:
        return found
    tried = _cleared(clearing, timed, None if found.cleared.blocked else found.cleared)
    if _badness(tried) < _badness(found.cleared):
        return replace(found, decided=Decided(tried.plans), cleared=tried, replanned=True)
    return found


def _touching(
    clearing: Clearing, timed: list[tuple[list[StagePlan], Motion]], plan: list[StagePlan]
) -> list[int]:
    """Returns the stages that do not keep clear of one of several timed plans."""
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
    """Returns the best of some plans after mending, or one that is known if that is better."""
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


def clearance_notes(found: Found, first: int = 1) -> list[str]:
    """Returns what was done for clearance, and what it cost against the plan where nothing could touch.

    Args:
        found: a plan.
        first: number of its first stage.
    """
    done = []
    for k, stage in enumerate(found.cleared.plans, first):
        done += [f"{arm} waits {wait:.2f} s in stage {k}" for arm, wait in stage.waits.items()]
        for arm, detour in stage.detours.items():
            waits = f" and waits there {detour.pause:.2f} s" if detour.pause else ""
            done.append(f"{arm} makes a detour{waits} in stage {k}")
        if stage.path is not None:
            done.append(f"all joints follow a free path in stage {k}")
    if found.replanned:
        done.insert(0, "other postures or platform angles were taken")
    if found.cost is None or (not done and abs(found.cost) < SHOWN):
        return []
    if not done:
        done.append("a slower plan was taken that touches nothing")
    costs = f"this costs {found.cost:.3f} s"
    if found.cost < 0.0:
        shorter = f"it is {-found.cost:.3f} s shorter"
        costs = f"{shorter}: the method does not find the quickest plan of all"
    notes = [
        f"clearance: {', '.join(done)}; against the plan that could touch ({found.blind:.3f} s) {costs}"
    ]
    if found.cost > DEAR * found.blind:
        notes.append(
            f"clearance costs {found.cost / found.blind:.0%} of the cycle time: other methods, see `dualarm compare "
            "solvers`, or another cell layout may do better"
        )
    if any(stage.waits or stage.detours or stage.path is not None for stage in found.cleared.plans):
        notes.append(
            "sensitivity: transfers that wait or are bent to keep clear count as straight ones there, and what "
            "they take longer as constant"
        )
    return notes
