"""PlanSettings: choices on the command line that affect a plan."""

from __future__ import annotations

from dataclasses import asdict, replace
from numbers import Integral
from typing import Any, Literal, get_args

from dualarm_cli.errors import UsageError
from dualarm_cli.records import dataclass

Effort = Literal["quick", "normal", "thorough"]
"""Search effort of methods and lower bound."""
Blend = Literal["lines", "none"]
"""Name of a blending law."""
Timing = Literal["ruckig", "toppra", "trapezoid"]
"""Name of a timing solver."""
MAX_SEED = 2**32 - 1
"""Largest random seed."""


def check_seed(seed: int) -> None:
    """Refuse an unusable random seed.

    Raises:
        UsageError: no integer, or one outside the range.
    """
    if not (isinstance(seed, Integral) and 0 <= seed <= MAX_SEED):
        raise UsageError(f"seed {seed!r}: must be an integer from 0 to {MAX_SEED}")


def check_effort(effort: str) -> None:
    """Refuse an unknown effort.

    Raises:
        UsageError: with the allowed ones.
    """
    if effort not in get_args(Effort):
        raise UsageError(f"effort {effort!r}: choose one of {', '.join(get_args(Effort))}")


def check_count(name: str, value: int | None) -> None:
    """Refuse an unusable maximum number; None is no maximum.

    Raises:
        UsageError: no integer, or one below 1.
    """
    if value is not None and not (isinstance(value, Integral) and value >= 1):
        raise UsageError(f"{name} {value!r}: must be an integer from 1")


@dataclass(frozen=True)
class PlanSettings:
    """Solver names and search settings of one plan."""

    platform: str = "sequence"
    """Method that chooses platform angles and, in whole-sequence methods, postures."""
    redundancy: str = "arm_angle"
    """Redundancy solver."""
    timing: str = "ruckig"
    """Timing solver."""
    effort: str = "normal"
    """Search effort of methods and lower bound: quick, normal or thorough."""
    blend: str = "lines"
    """Blending law: `lines` passes outer ends of approaches and retracts, `none` stops."""
    follower: str | None = None
    """Path follower; None for the task file's."""
    seam_solver: str | None = None
    """Seam solver; None for the task file's."""
    seed: int = 0
    """Random seed."""
    time_limit: float | None = None
    """Time limit of the search for orders [s]; None for no limit.

    A plan that it ends depends on the machine.
    """
    named: frozenset[str] = frozenset()
    """Settings that the user chose; others may be replaced to suit a robot."""

    def naming(self, **chosen: str | None) -> PlanSettings:
        """Replace settings by those that the user chose; None leaves them."""
        requested = {name: value for name, value in chosen.items() if value is not None}
        values: dict[str, Any] = {**requested, "named": self.named | requested.keys()}
        return replace(self, **values)

    def as_dict(self) -> dict[str, Any]:
        """Return the settings as they are recorded in a schedule."""
        return {name: value for name, value in asdict(self).items() if name != "named"}
