"""PlanSettings: everything that a plan can be asked for on the command line."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class PlanSettings:
    """Solver names and tunables of one plan."""

    platform: str | None = None
    """Platform solver; None compares every one that fits, before postures are refined, and plans with the fastest."""
    redundancy: str = "arm_angle"
    """Redundancy solver."""
    timing: str = "ruckig"
    """Timing solver."""
    seed: int = 0
    """Seed of all randomness; the present solvers use none."""

    def as_dict(self) -> dict[str, Any]:
        """Returns the settings as they are recorded in a schedule."""
        return asdict(self)
