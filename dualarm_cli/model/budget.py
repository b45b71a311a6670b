"""Budget: what a job's plan must keep beyond what makes it a plan, and whether it did."""

from __future__ import annotations

from dualarm_cli.model.place import NOWHERE, Place
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class Budget:
    """Figures that somebody wants of every plan of a job."""

    cycle_time: float | None = None
    """Longest cycle time [s]; None for any."""
    clearance: float | None = None
    """Least distance of any two bodies that must keep apart [m]; None for what the cell demands."""
    cycle_time_place: Place = NOWHERE
    """Where the cycle time is written."""
    clearance_place: Place = NOWHERE
    """Where the clearance is written."""
    skew: float | None = None
    """Required tolerated delay of either arm [s], or None."""
    skew_place: Place = NOWHERE
    """Place of the skew in its file."""


@dataclass(frozen=True)
class Kept:
    """One line of a budget, compared with what was measured."""

    name: str
    """cycle_time, clearance or skew."""
    allowed: float
    """Most of a cycle time [s], least of a clearance [m] or skew [s]."""
    measured: float | None
    """What the plan has; None where it was not proven."""
    kept: bool
    """Whether the plan is within it."""
    file: str
    """Where it is written."""
    line: int
    """Line from 1."""
    column: int
    """Column from 1."""

    def __str__(self) -> str:
        """Return a sentence: measured, allowed, and the place of a line that is missed."""
        verdict = "kept" if self.kept else f"MISSED ({self.file}:{self.line}:{self.column})"
        return f"{self.figures}: {verdict}"

    @property
    def figures(self) -> str:
        """Measured and allowed value, in words."""
        if self.name == "cycle_time":
            measured = "not known" if self.measured is None else f"{self.measured:.3f} s"
            return f"cycle time {measured}, at most {self.allowed:g} s"
        unit = "mm" if self.name == "clearance" else "ms"
        measured = "not proven" if self.measured is None else f"{self.measured * 1e3:.1f} {unit}"
        return f"{self.name} {measured}, at least {self.allowed * 1e3:g} {unit}"
