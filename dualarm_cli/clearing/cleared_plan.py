"""A collision-free plan, what it came from, and notes on its clearance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field
from functools import partial

from dualarm_cli.clearing.repairs import Clearing, TimedPlan
from dualarm_cli.motion.transfers import MotionCache
from dualarm_cli.notes import Note
from dualarm_cli.postures.holding import Holding
from dualarm_cli.records import dataclass
from dualarm_cli.stages.method import Decided, MethodProblem
from dualarm_cli.timing import TimingSolver

SENTENCES: Mapping[str, str] = {
    "done": "clearance: {done:*, }; with stops at all lines' ends, compared with the plan without collision "
    "checking ({unchecked:.3f} s), {effect}",
    "replanned": "other postures or platform angles were chosen",
    "slower": "a slower, collision-free plan was chosen",
    "waits": "{arm} waits {seconds:.2f} s in stage {stage}",
    "detour": "{arm} makes a detour in stage {stages:*}",
    "detours": "{arm} makes {stages:#|#} detours (stages {stages:*, })",
    "longer": "this costs {seconds:.3f} s",
    "shorter": "it is {seconds:.3f} s shorter: the method does not always find the fastest plan",
    "dear": "clearance costs {share:.0%} of the cycle time: other methods (`dualarm compare solvers`) or another "
    "cell layout may be faster",
}
"""Notes on clearance, by key."""
_note = partial(Note.of, SENTENCES, "clearance")
DETOURS_STRAIGHT = Note(
    "sensitivity: transfers that wait or are curved to avoid collisions count as straight ones, and their extra time "
    "as constant",
    "sensitivity",
)
"""Note on assumed limits."""


@dataclass(frozen=True)
class ClearedPlan:
    """A method's plan, repaired and timed."""

    decided: Decided
    """What it came from."""
    cleared: TimedPlan
    """The plan that is collision-free."""
    unchecked: float
    """Duration of the method's plan where nothing has to be collision-free [s]."""
    replanned: bool
    """Whether other postures or platform angles were needed."""
    holding: Holding | None = field(compare=False, repr=False)
    """What had to be collision-free; None where nothing had to."""
    cache: MotionCache = field(default_factory=MotionCache, compare=False, repr=False)
    """What was timed for it."""
    rivals: tuple[TimedPlan, ...] = field(default=(), compare=False, repr=False)
    """Other collision-free plans of the method that take longer with all stops, but perhaps not in motion."""
    stopping: TimedPlan | None = field(default=None, compare=False, repr=False)
    """The plan with all stops that it was blended from; None where it is that."""

    def clearing(self, problem: MethodProblem, timing: TimingSolver) -> Clearing | None:
        """Returns what other plans of the same problem are tested with; None where nothing has to be collision-free."""
        if self.holding is None:
            return None
        cache, settings = self.cache, problem.settings.clearing
        given = problem.model, problem.job, self.holding, timing, problem.seed, cache
        return Clearing(*given, settings=settings)

    @property
    def cost(self) -> float | None:
        """How much longer the plan, with all stops, is than the unchecked one [s].

        None where nothing had to be collision-free.
        """
        if self.holding is None:
            return None
        return self.cleared.duration + (self.cleared.motion.gain or 0.0) - self.unchecked

    def costs_more_than(self, fraction: float) -> bool:
        """Return whether stages are blocked, or clearance lengthens the plan by more than a fraction."""
        return bool(self.cleared.blocked) or (self.cost or 0.0) > fraction * self.unchecked


def clearance_notes(parts: Sequence[tuple[ClearedPlan, int]]) -> list[Note]:
    """List notes on what was done for clearance, and its cost against the plan where nothing could touch.

    Args:
        parts: the plans of a job's sections that had to be collision-free, each with the number of its first stage.
    """
    changed, detours = list[Note](), dict[str, list[int]]()
    for found, first in parts:
        for k, stage in enumerate(found.cleared.plans, first):
            for arm, wait in stage.waits.items():
                changed.append(_note("waits", arm=arm, seconds=wait, stage=k))
            for arm in stage.detours:
                detours.setdefault(arm, []).append(k)
    for arm, stages in detours.items():
        key = "detour" if len(stages) == 1 else "detours"
        changed.append(_note(key, arm=arm, stages=stages))
    replanned = any(found.replanned for found, _ in parts)
    done = [_note("replanned"), *changed] if replanned else changed
    costs = [found.cost for found, _ in parts if found.cost is not None]
    cost, unchecked = sum(costs), sum(found.unchecked for found, _ in parts)
    if not costs or (not done and abs(cost) < 5e-4):
        return []
    effect = _note("shorter" if cost < 0.0 else "longer", seconds=abs(cost))
    more = {"done": done or [_note("slower")], "unchecked": unchecked}
    notes = [_note("done", **more, effect=effect)]
    if cost > 0.25 * unchecked:
        notes.append(_note("dear", share=cost / unchecked))
    if changed:
        notes.append(DETOURS_STRAIGHT)
    return notes
