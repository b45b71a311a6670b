"""dualarm: minimum cycle time of a dual-arm cell, and the joint schedule for it.

from dualarm_cli import load, plan

result = plan(load("tasks.yaml"))
print(result.cycle_time, result.verified)
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
        explain,
    )
    from dualarm_cli.explanations import Explanation
    from dualarm_cli.exporting.schedule_reader import read_schedule
    from dualarm_cli.interface import Plan, compare, compare_solvers, load, plan, verify
    from dualarm_cli.interface.exporting import Export, export
    from dualarm_cli.interface.many_plans import plan_many
    from dualarm_cli.interface.reaching import inverse_kinematics, reach
    from dualarm_cli.model.job import Job
    from dualarm_cli.model.schedule import Event, JointSamples, Schedule
    from dualarm_cli.model.verification import Check, Verification
    from dualarm_cli.report.comparisons import (
        PerturbationReport,
        ReachReport,
        ScheduleComparison,
        SolverComparison,
        StudyReport,
    )
    from dualarm_cli.report.document import Report
    from dualarm_cli.studies.perturbation import perturb
    from dualarm_cli.studies.sweep import sweep

__version__ = "0.1.0"

__all__ = [
    "Check",
    "Diagnostic",
    "DualArmError",
    "Event",
    "Explanation",
    "Export",
    "InfeasibleError",
    "InputError",
    "Job",
    "JointSamples",
    "MissingDependencyError",
    "OutputError",
    "PerturbationReport",
    "Plan",
    "ReachReport",
    "Report",
    "Schedule",
    "ScheduleComparison",
    "SolverComparison",
    "StudyReport",
    "UsageError",
    "Verification",
    "__version__",
    "compare",
    "compare_solvers",
    "explain",
    "export",
    "inverse_kinematics",
    "load",
    "perturb",
    "plan",
    "plan_many",
    "reach",
    "read_schedule",
    "sweep",
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
_DOCUMENTS = (
    "PerturbationReport",
    "ReachReport",
    "ScheduleComparison",
    "SolverComparison",
    "StudyReport",
)
_HOMES = {
    **dict.fromkeys((*_ERRORS, "UsageError", "explain"), "dualarm_cli.errors"),
    "Explanation": "dualarm_cli.explanations",
    **dict.fromkeys(("Export", "export"), "dualarm_cli.interface.exporting"),
    **dict.fromkeys(("inverse_kinematics", "reach"), "dualarm_cli.interface.reaching"),
    "plan_many": "dualarm_cli.interface.many_plans",
    "read_schedule": "dualarm_cli.exporting.schedule_reader",
    **dict.fromkeys(
        ("Plan", "compare", "compare_solvers", "load", "plan", "verify"), "dualarm_cli.interface"
    ),
    "Job": "dualarm_cli.model.job",
    **dict.fromkeys(("Event", "JointSamples", "Schedule"), "dualarm_cli.model.schedule"),
    **dict.fromkeys(("Check", "Verification"), "dualarm_cli.model.verification"),
    "Report": "dualarm_cli.report.document",
    **dict.fromkeys(_DOCUMENTS, "dualarm_cli.report.comparisons"),
    "perturb": "dualarm_cli.studies.perturbation",
    "sweep": "dualarm_cli.studies.sweep",
}
"""Modules of the public names, imported at first use because libraries load slowly."""


def __getattr__(name: str) -> Any:
    """Import the object of a public name.

    Raises:
        AttributeError: unknown name.
    """
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'dualarm_cli' has no attribute {name!r}")


def __dir__() -> list[str]:
    """List the public names."""
    return sorted(__all__)
