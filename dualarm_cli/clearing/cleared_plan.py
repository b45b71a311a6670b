"""Collision-free plan with its origin, and notes on the cost of its clearance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field, replace

from dualarm_cli.clearing.repairs import Clearing, TimedPlan
from dualarm_cli.motion.transfers import MotionCache
from dualarm_cli.notes import Note, NoteTable
from dualarm_cli.postures.holding import Holding
from dualarm_cli.records import dataclass
from dualarm_cli.stages.method import Decided, MethodProblem
from dualarm_cli.timing import TimingSolver

_note = NoteTable(
    "clearance",
    done="clearance: {done:*, }; with stops at every line end, compared with the plan without collision "
    "checking ({unchecked:.3f} s), {effect}",
    replanned="other postures or platform angles were chosen",
    slower="a slower, collision-free plan was chosen",
    waits="{arm} waits {seconds:.2f} s in stage {stage}",
    detour="{arm} makes a detour in stage {stages:*}",
    detours="{arm} makes {stages:#|#} detours (stages {stages:*, })",
    longer="this costs {seconds:.3f} s",
    expensive="clearance costs {share:.0%} of the cycle time: other methods (`dualarm compare solvers`) or another "
    "cell layout may be faster",
)
DETOURS_STRAIGHT = Note(
    "sensitivity: transfers that wait or are curved to avoid collisions count as straight ones, and their extra time "
    "as constant",
    "sensitivity",
)
"""Note on the assumption of the sensitivities about repaired transfers."""


@dataclass(frozen=True)
class ClearedPlan:
    """A method's plan, repaired, timed and possibly blended."""

    decided: Decided
    """The method's proposal that was repaired."""
    cleared: TimedPlan
    """The repaired plan; stages of it may be blocked."""
    unchecked: float
    """Duration of the method's plan without collision checking [s]."""
    replanned: bool
    """Whether postures or platform angles differ from the unchecked plan."""
    holding: Holding | None = field(compare=False, repr=False)
    """Bodies that must not collide; None disables collision checking."""
    cache: MotionCache = field(default_factory=MotionCache, compare=False, repr=False)
    """Motions timed so far."""
    rivals: tuple[ClearedPlan, ...] = field(default=(), compare=False, repr=False)
    """Slower collision-free plans that blending may make the fastest."""
    stopping: TimedPlan | None = field(default=None, compare=False, repr=False)
    """The plan with all stops before blending; None before blending."""

    def clearing(self, problem: MethodProblem, timing: TimingSolver) -> Clearing | None:
        """Return the collision checks of the plan; None if checking is disabled."""
        if self.holding is None:
            return None
        cache, settings = self.cache, problem.settings.clearing
        given = problem.model, problem.job, self.holding, timing, problem.seed, cache
        return Clearing(*given, settings=settings)

    @property
    def cost(self) -> float | None:
        """Extra duration, with all stops, compared with the unchecked plan [s].

        None if collision checking is disabled.
        """
        if self.holding is None:
            return None
        return self.cleared.duration + (self.cleared.motion.gain or 0.0) - self.unchecked

    def sent(self) -> ClearedPlan:
        """Return what a worker process sends of the plan.

        The bodies are those of the process that receives it; proposal, timed motions and rivals are left out.
        """
        decided = Decided([], self.decided.grid_gap)
        return replace(self, decided=decided, holding=None, cache=MotionCache(), rivals=())

    def costs_more_than(self, fraction: float) -> bool:
        """Return whether stages are blocked, or clearance lengthens the plan by more than a fraction."""
        return bool(self.cleared.blocked) or (self.cost or 0.0) > fraction * self.unchecked


def clearance_notes(parts: Sequence[tuple[ClearedPlan, int]]) -> list[Note]:
    """List notes on clearance measures and their cost against the unchecked plan.

    Args:
        parts: checked plans of a job's sections, each with the number of its first stage.
    """
    changed, detours = list[Note](), dict[str, list[int]]()
    for plan, first in parts:
        for k, stage in enumerate(plan.cleared.plans, first):
            for arm, wait in stage.waits.items():
                changed.append(_note("waits", arm=arm, seconds=wait, stage=k))
            for arm in stage.detours:
                detours.setdefault(arm, []).append(k)
    for arm, stages in detours.items():
        changed.append(_note("detour" if len(stages) == 1 else "detours", arm=arm, stages=stages))
    replanned = any(plan.replanned for plan, _ in parts)
    done = [_note("replanned"), *changed] if replanned else changed
    costs = [plan.cost for plan, _ in parts if plan.cost is not None]
    cost, unchecked = sum(costs), sum(plan.unchecked for plan, _ in parts)
    if not costs or (not done and cost < 5e-4):
        return []
    effect = _note("longer", seconds=cost)
    details = {"done": done or [_note("slower")], "unchecked": unchecked}
    notes = [_note("done", **details, effect=effect)]
    if cost > 0.25 * unchecked:
        notes.append(_note("expensive", share=cost / unchecked))
    if changed:
        notes.append(DETOURS_STRAIGHT)
    return notes
