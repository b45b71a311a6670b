"""dualarm: how fast a dual-arm cell can run, and the joint schedule that runs it.

from dualarm_cli import load, plan

found = plan(load("tasks.yaml"))
print(found.cycle_time, found.verified)
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dualarm_cli.errors import (
        Diagnostic,
        DualArmError,
        InfeasibleError,
        InputError,
        MissingDependencyError,
        OutputError,
        UsageError,
    )
    from dualarm_cli.interface import Plan, compare, compare_solvers, load, plan, verify
    from dualarm_cli.model.job import Job
    from dualarm_cli.model.schedule import Event, JointSamples, Schedule
    from dualarm_cli.model.verification import Check, Verification

__version__ = "0.1.0"

__all__ = [
    "Check",
    "Diagnostic",
    "DualArmError",
    "Event",
    "InfeasibleError",
    "InputError",
    "Job",
    "JointSamples",
    "MissingDependencyError",
    "OutputError",
    "Plan",
    "Schedule",
    "UsageError",
    "Verification",
    "__version__",
    "compare",
    "compare_solvers",
    "load",
    "plan",
    "verify",
]

_ERRORS = (
    "Diagnostic",
    "DualArmError",
    "InfeasibleError",
    "InputError",
    "MissingDependencyError",
    "OutputError",
)
_HOMES = {
    **dict.fromkeys((*_ERRORS, "UsageError"), "dualarm_cli.errors"),
    **dict.fromkeys(
        ("Plan", "compare", "compare_solvers", "load", "plan", "verify"), "dualarm_cli.interface"
    ),
    "Job": "dualarm_cli.model.job",
    **dict.fromkeys(("Event", "JointSamples", "Schedule"), "dualarm_cli.model.schedule"),
    **dict.fromkeys(("Check", "Verification"), "dualarm_cli.model.verification"),
}
"""Where public names are: they are loaded as they are used, since the libraries behind them take their time."""


def __getattr__(name: str) -> Any:
    """Returns a public name.

    Raises:
        AttributeError: there is no such name.
    """
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'dualarm_cli' has no attribute {name!r}")


def __dir__() -> list[str]:
    """Returns the public names."""
    return sorted(__all__)
