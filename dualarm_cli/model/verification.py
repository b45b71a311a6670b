"""Verification: checks of a schedule, with measured and allowed values."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Literal

from dualarm_cli.records import dataclass

Verdict = Literal["passed", "failed", "not checked"]
COLLISIONS, SHAPES = "collisions", "shapes"
"""Names of the checks of clearance and of missing shapes.

The check of shapes is present only if bodies have none.
"""
_OPEN = {COLLISIONS: "collisions were not checked", SHAPES: "collisions could not be fully checked"}
"""Consequence of an omitted check; the first one covers both."""


@dataclass(frozen=True)
class Check:
    """Checked property of a schedule."""

    name: str
    """Stable name, such as `velocity` or `tool_at_events`."""
    verdict: Verdict
    """Verdict; the reason for `not checked` is in `detail`."""
    measured: float | None
    """Worst value, in `unit`, or None."""
    allowed: float | None
    """Allowed value, in `unit`, or None."""
    unit: str
    """Unit of both values; empty for counts and ratios."""
    detail: str
    """Place of the worst value (joint, task, time), or reason for no check."""


@dataclass(frozen=True)
class StageClearance:
    """Least clearance of one stage, proven over its whole motion."""

    stage: int
    """Index of the stage, from 0."""
    clearance: float
    """Lower bound of the distance of these bodies [m]; negative if they overlap."""
    margin: float
    """Lower bound of clearance minus required clearance, over all pairs [m]."""
    required: float
    """Required clearance of the pair [m]."""
    bodies: tuple[str, str]
    """Pair of bodies with the least margin."""
    time: float
    """Time of the least margin [s]."""
    near: bool = False
    """Whether both are near links, whose distance few joints of one arm decide."""


def counted(clearances: Iterable[StageClearance]) -> list[StageClearance]:
    """Select the clearances that a cell can change; near links count if nothing else does.

    They also count where they miss the required clearance.
    """
    stages = list(clearances)
    return [stage for stage in stages if not stage.near or stage.margin < 0.0] or stages


def nearest(clearances: Iterable[StageClearance]) -> StageClearance | None:
    """Find the least margin of all clearances that count (`counted`), or None."""
    return min(counted(clearances), key=lambda stage: stage.margin, default=None)


LONGEST_DELAY = 0.5
"""Longest delay that is examined without a requirement [s]."""


@dataclass(frozen=True)
class ArmDelay:
    """Tolerated delays of one arm."""

    arm: str
    """Delayed arm."""
    clear: float
    """Proven bound up to which delays keep clearance [s]."""
    lacking: float | None
    """Delay without clearance [s]; None if none was found."""
    bodies: tuple[str, str] | None
    """Pair of bodies that come too close then."""
    time: float | None
    """Time of the plan at which that happens [s]."""

    def __str__(self) -> str:
        """Describe the delays in a phrase, rounded to the safe side."""
        clear = f"{self.arm} arm clear up to {math.floor(self.clear * 1e4) / 10.0:g} ms late"
        if self.lacking is None or self.bodies is None:
            return clear if self.clear >= LONGEST_DELAY else f"{clear} (more is not proven)"
        lacking = math.ceil(self.lacking * 1e4) / 10.0
        return f"{clear} (not {lacking:g} ms: {' and '.join(self.bodies)} at {self.time:.3f} s)"


@dataclass(frozen=True)
class Verification:
    """Result of verifying a schedule."""

    checks: tuple[Check, ...]
    """All checks, in a fixed order."""
    clearances: tuple[StageClearance, ...] = ()
    """Clearance of every stage, if checked; two where near links are nearest."""
    delays: tuple[ArmDelay, ...] = ()
    """Tolerated delays of each of two arms, if checked."""

    @property
    def passed(self) -> bool:
        """Whether no check failed and at least one passed."""
        verdicts = [check.verdict for check in self.checks]
        return "failed" not in verdicts and "passed" in verdicts

    @property
    def caveats(self) -> tuple[str, ...]:
        """Sentences on collision checks that were omitted or incomplete."""
        unchecked = {c.name: c.detail for c in self.checks if c.verdict == "not checked"}
        return tuple(f"{_OPEN[name]}: {unchecked[name]}" for name in _OPEN if name in unchecked)[:1]

    @property
    def verdict(self) -> str:
        """Verdict in a phrase, with the names of failed checks."""
        failed = ", ".join(check.name for check in self.failures) or "nothing could be checked"
        return "verified" if self.passed else f"verification FAILED: {failed}"

    def __repr__(self) -> str:
        """Describe the result in a line."""
        return f"<Verification of {len(self.checks)} checks: {self.verdict}>"

    @property
    def failures(self) -> tuple[Check, ...]:
        """Failed checks."""
        return tuple(check for check in self.checks if check.verdict == "failed")


def exceptions(caveats: Sequence[str]) -> str:
    """Format caveats as `, except that …` for the end of a sentence."""
    return f", except that {'; '.join(caveats)}" if caveats else ""
