"""Shell completion of solvers, robots, jobs, error codes, kinds of files and YAML files.

Come here if a name is missing in completion. `families` lists the registries of all methods and imports them on the
first call. Nothing here may print or raise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any


def _begun(names: Iterable[str], incomplete: str) -> list[str]:
    return [name for name in names if name.startswith(incomplete)]


def _yaml_files(incomplete: str) -> list[str]:
    """List matching YAML files and folders, as the user writes them."""
    folder = incomplete.rpartition("/")[0]
    start = f"{folder}/" if "/" in incomplete else ""
    try:
        entries = sorted(Path(start or ".").iterdir())
    except OSError:
        return []
    paths = [
        f"{start}{entry.name}{'/' * entry.is_dir()}"
        for entry in entries
        if entry.is_dir() or entry.suffix in (".yaml", ".yml")
    ]
    hidden = incomplete[len(start) :].startswith(".")
    return [
        path
        for path in _begun(paths, incomplete)
        if hidden or not path[len(start) :].startswith(".")
    ]


def complete_job(incomplete: str) -> list[str]:
    """List bundled jobs and YAML files."""
    from dualarm_cli.files.source.bundled import bundled_tasks

    return [*_begun(bundled_tasks(), incomplete), *_yaml_files(incomplete)]


def complete_robot(incomplete: str) -> list[str]:
    """List bundled robots and YAML files."""
    from dualarm_cli.files.source.bundled import bundled_robots

    return [*_begun(bundled_robots(), incomplete), *_yaml_files(incomplete)]


def complete_solver(*names: str) -> Callable[[str], list[str]]:
    """Create a completion function for solver names.

    Args:
        names: of their families, such as timing.
    """

    def complete(incomplete: str) -> list[str]:
        named = [family for family in families() if family.family in names]
        return _begun(
            dict.fromkeys(solver.name for family in named for solver in family), incomplete
        )

    return complete


def complete_code(incomplete: str) -> list[str]:
    """List error codes."""
    from dualarm_cli.explanations import explanations

    return _begun(explanations(), incomplete)


def complete_kind(incomplete: str) -> list[str]:
    """List kinds of files that have a schema."""
    from dualarm_cli.schemas import KINDS

    return _begun(KINDS, incomplete)


def families() -> list[Any]:
    """List the registries of all families of methods."""
    from dualarm_cli.calibration import CALIBRATION_SOLVERS
    from dualarm_cli.kinds import planning
    from dualarm_cli.model.blending import BLENDINGS
    from dualarm_cli.platform_angle import PLATFORM_SOLVERS
    from dualarm_cli.postures import REDUNDANCY_SOLVERS
    from dualarm_cli.stages.methods import METHODS
    from dualarm_cli.timing import TIMING_SOLVERS

    return [
        METHODS,
        PLATFORM_SOLVERS,
        REDUNDANCY_SOLVERS,
        *(solvers for _, solvers in planning.families()),
        TIMING_SOLVERS,
        BLENDINGS,
        CALIBRATION_SOLVERS,
    ]
