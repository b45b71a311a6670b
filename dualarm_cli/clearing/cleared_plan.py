"""A collision-free plan, what it came from, and notes on its clearance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field

from dualarm_cli.clearing.repairs import Clearing, TimedPlan
from dualarm_cli.motion.transfers import Known
from dualarm_cli.postures.holding import Holding
from dualarm_cli.records import dataclass
from dualarm_cli.stages.method import Decided, MethodProblem
from dualarm_cli.timing import TimingSolver

DEAR = 0.25
"""Share of the cycle time; where avoiding collisions costs more, a note says so."""
SHOWN = 5e-4
"""Costs that are shown as more than nothing [s]."""


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
    known: Known = field(default_factory=Known, compare=False, repr=False)
    """What was timed for it."""
    rivals: tuple[TimedPlan, ...] = field(default=(), compare=False, repr=False)
    """Other collision-free plans of the method that take longer with all stops, but perhaps not in motion."""
    stopping: TimedPlan | None = field(default=None, compare=False, repr=False)
    """The plan with all stops that it was blended from; None where it is that."""

    def clearing(self, problem: MethodProblem, timing: TimingSolver) -> Clearing | None:
        """Returns what other plans of the same problem are tested with; None where nothing has to be collision-free."""
        if self.holding is None:
            return None
        return Clearing(problem.model, problem.job, self.holding, timing, problem.seed, self.known)

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


def _detours(arm: str, stages: list[int]) -> str:
    """Returns how a note tells of an arm's detours, by their stages."""
    if len(stages) == 1:
        return f"{arm} makes a detour in stage {stages[0]}"
    return f"{arm} makes {len(stages)} detours (stages {', '.join(map(str, stages))})"


def clearance_notes(parts: Sequence[tuple[ClearedPlan, int]]) -> list[str]:
    """Returns what was done for clearance, and what it cost against the plan where nothing could touch.

    Args:
        parts: the plans of a job's sections that had to be collision-free, each with the number of its first stage.
    """
    done, detours = [], dict[str, list[int]]()
    for found, first in parts:
        for k, stage in enumerate(found.cleared.plans, first):
            done += [f"{arm} waits {wait:.2f} s in stage {k}" for arm, wait in stage.waits.items()]
            for arm in stage.detours:
                detours.setdefault(arm, []).append(k)
    changed = bool(done or detours)
    done += [_detours(arm, stages) for arm, stages in detours.items()]
    if any(found.replanned for found, _ in parts):
        done.insert(0, "other postures or platform angles were chosen")
    costs = [found.cost for found, _ in parts if found.cost is not None]
    cost, unchecked = sum(costs), sum(found.unchecked for found, _ in parts)
    if not costs or (not done and abs(cost) < SHOWN):
        return []
    if not done:
        done.append("a slower, collision-free plan was chosen")
    what = f"this costs {cost:.3f} s"
    if cost < 0.0:
        what = f"it is {-cost:.3f} s shorter: the method does not always find the fastest plan"
    notes = [
        f"clearance: {', '.join(done)}; with stops at all lines' ends, compared with the plan without collision "
        f"checking ({unchecked:.3f} s), {what}"
    ]
    if cost > DEAR * unchecked:
        notes.append(
            f"clearance costs {cost / unchecked:.0%} of the cycle time: other methods (`dualarm compare "
            "solvers`) or another cell layout may be faster"
        )
    if changed:
        notes.append(
            "sensitivity: transfers that wait or are curved to avoid collisions count as straight ones, and their "
            "extra time as constant"
        )
    return notes
