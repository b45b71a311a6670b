"""Finding and Verification: what was checked, what was measured, what is allowed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

from dualarm_cli.records import dataclass

Verdict = Literal["passed", "failed", "not checked"]
COLLISIONS, SHAPES = "collisions", "shapes"
"""Names of the checks of clearance, and that moving bodies have shapes: the latter only where some have none."""
_OPEN = {COLLISIONS: "collisions were not checked", SHAPES: "collisions could not be fully checked"}
"""Consequence of a check that was not made; that of the first one covers both."""


@dataclass(frozen=True)
class Check:
    """One property of a schedule, judged."""

    name: str
    """Stable name, such as `velocity` or `tool_at_events`."""
    verdict: Verdict
    """Whether it holds; `not checked` always says why in `detail`."""
    measured: float | None
    """Worst value found, in `unit`; None where there is nothing to measure."""
    allowed: float | None
    """What it may be, in `unit`."""
    unit: str
    """Unit of both; empty for counts and ratios."""
    detail: str
    """Where the worst value is (joint, task, time), or why nothing was checked."""


@dataclass(frozen=True)
class StageClearance:
    """The least clearance of one stage, proven over its whole motion."""

    stage: int
    """Number of the stage, from 0."""
    clearance: float
    """No distance of these bodies is smaller [m]; negative where they overlap."""
    margin: float
    """Clearance less what is required; no pair of bodies has less [m]."""
    required: float
    """What is required of the pair [m]."""
    bodies: tuple[str, str]
    """The two bodies that come nearest to what is required of them."""
    time: float
    """When [s]."""


LONGEST_DELAY = 0.5
"""Longest delay examined where no job requires more [s]."""


@dataclass(frozen=True)
class ArmDelay:
    """Delays of one arm that the motion's clearance tolerates."""

    arm: str
    """The late arm."""
    clear: float
    """No delay up to it lacks clearance [s], proven; the longest one that was looked at where none does."""
    lacking: float | None
    """A delay that lacks clearance [s]; None where none was found."""
    bodies: tuple[str, str] | None
    """The two bodies that come too near then."""
    time: float | None
    """Time of the plan at which that happens [s]."""

    def __str__(self) -> str:
        """Returns the delays in a phrase, rounded to the safe side."""
        clear = f"{self.arm} arm clear up to {math.floor(self.clear * 1e4) / 10.0:g} ms late"
        if self.lacking is None or self.bodies is None:
            return clear if self.clear >= LONGEST_DELAY else f"{clear} (more is not proven)"
        lacking = math.ceil(self.lacking * 1e4) / 10.0
        return f"{clear} (not {lacking:g} ms: {' and '.join(self.bodies)} at {self.time:.3f} s)"


@dataclass(frozen=True)
class Verification:
    """The judgement of a whole schedule."""

    checks: tuple[Check, ...]
    """Every check, in a fixed order."""
    clearances: tuple[StageClearance, ...] = ()
    """Of every stage, where they were checked."""
    delays: tuple[ArmDelay, ...] = ()
    """Delays of each of two arms, where clearances were checked."""

    @property
    def passed(self) -> bool:
        """Whether nothing failed and something was checked."""
        verdicts = [check.verdict for check in self.checks]
        return "failed" not in verdicts and "passed" in verdicts

    @property
    def caveats(self) -> tuple[str, ...]:
        """Sentences on what a pass leaves open: collisions that were not, or not fully, checked."""
        unchecked = {c.name: c.detail for c in self.checks if c.verdict == "not checked"}
        return tuple(f"{_OPEN[name]}: {unchecked[name]}" for name in _OPEN if name in unchecked)[:1]

    @property
    def failures(self) -> tuple[Check, ...]:
        """The checks that failed."""
        return tuple(check for check in self.checks if check.verdict == "failed")


def exceptions(caveats: Sequence[str]) -> str:
    """Return `, except that …` for the end of a sentence, or nothing."""
    return f", except that {'; '.join(caveats)}" if caveats else ""
