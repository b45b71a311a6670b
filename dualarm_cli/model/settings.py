"""PlanSettings: everything that a plan can be asked for on the command line."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Any

from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class PlanSettings:
    """Solver names and tunables of one plan."""

    platform: str = "sequence"
    """Method that chooses platform angles (and, for the whole-sequence methods, postures)."""
    redundancy: str = "arm_angle"
    """Redundancy solver."""
    timing: str = "ruckig"
    """Timing solver."""
    effort: str = "normal"
    """quick, normal or thorough: how hard methods and the lower bound try."""
    blend: str = "lines"
    """Where tools do not stop: `lines`, at the outer ends of approaches and retracts, or `none`."""
    follower: str | None = None
    """Method that finds the joints on paths; None for what the task file says."""
    seam_solver: str | None = None
    """Method that works seams; None for what the task file says."""
    seed: int = 0
    """Seed of all randomness."""
    time_limit: float | None = None
    """How long orders are searched for at most [s]; a plan that it ends depends on the machine. None for no limit."""
    named: frozenset[str] = frozenset()
    """Which of these a person asked for: others may be replaced where they do not serve a robot."""

    def naming(self, **chosen: str | None) -> PlanSettings:
        """Returns the settings with what a person asked for; None where they did not."""
        asked = {name: value for name, value in chosen.items() if value is not None}
        values: dict[str, Any] = {**asked, "named": self.named | asked.keys()}
        return replace(self, **values)

    def as_dict(self) -> dict[str, Any]:
        """Returns the settings as they are recorded in a schedule."""
        return {name: value for name, value in asdict(self).items() if name != "named"}
