"""Budget of a job, and its comparison with a plan."""

from __future__ import annotations

from typing import Literal

from dualarm_cli.model.place import NOWHERE, Place
from dualarm_cli.records import dataclass

CycleKind = Literal["nominal", "95%", "worst"]
"""Cycle time of a plan whose dwells vary that a budget is for."""


@dataclass(frozen=True)
class Budget:
    """Required cycle time, clearance and skew of every plan of a job."""

    cycle_time: float | None = None
    """Largest cycle time [s]; None for any."""
    clearance: float | None = None
    """Least distance of bodies that may not touch [m]; None for the cell's own."""
    cycle_time_place: Place = NOWHERE
    """Place of the cycle time in its file."""
    clearance_place: Place = NOWHERE
    """Place of the clearance in its file."""
    skew: float | None = None
    """Required tolerated delay of either arm [s], or None."""
    skew_place: Place = NOWHERE
    """Place of the skew in its file."""
    cycle_kind: CycleKind = "nominal"
    """Cycle time that is compared."""


@dataclass(frozen=True)
class Kept:
    """Line of a budget compared with the measured value."""

    name: str
    """Name of the figure: cycle_time, clearance or skew."""
    allowed: float
    """Largest cycle time [s], or least clearance [m] or skew [s]."""
    measured: float | None
    """Measured value of the plan; None if it was not proven."""
    kept: bool
    """Whether the plan satisfies the line."""
    file: str
    """File of the line."""
    line: int
    """Line number, from 1."""
    column: int
    """Column number, from 1."""
    cycle_kind: str = "nominal"
    """Cycle time that is compared."""

    def __str__(self) -> str:
        """Format measured and allowed value, and the place of a missed line."""
        verdict = "kept" if self.kept else f"MISSED ({self.file}:{self.line}:{self.column})"
        return f"{self.figures}: {verdict}"

    @property
    def figures(self) -> str:
        """Measured and allowed value, in words."""
        if self.name == "cycle_time":
            measured = "not known" if self.measured is None else f"{self.measured:.3f} s"
            kind = "" if self.cycle_kind == "nominal" else f" ({self.cycle_kind})"
            return f"cycle time{kind} {measured}, at most {self.allowed:g} s"
        unit = "mm" if self.name == "clearance" else "ms"
        measured = "not proven" if self.measured is None else f"{self.measured * 1e3:.1f} {unit}"
        return f"{self.name} {measured}, at least {self.allowed * 1e3:g} {unit}"
