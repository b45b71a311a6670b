"""What `--redundancy NAME` means: a solver of stops, a follower of paths, or both."""

from __future__ import annotations

from dataclasses import replace

from dualarm_cli.errors import UnknownSolverError
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.path_following import PATH_SOLVERS
from dualarm_cli.redundancy import REDUNDANCY_SOLVERS


def with_redundancy(settings: PlanSettings, name: str | None) -> PlanSettings:
    """Returns settings with what a name sets; the rest stays.

    Args:
        settings: what they are changed from.
        name: a member of either family, or None.

    Raises:
        UnknownSolverError: neither family has it.
    """
    if name is None:
        return settings
    stops, paths = name in REDUNDANCY_SOLVERS.names, name in PATH_SOLVERS.names
    if not stops and not paths:
        known = [*dict.fromkeys([*REDUNDANCY_SOLVERS.names, *PATH_SOLVERS.names])]
        raise UnknownSolverError("--redundancy", name, known)
    if stops:
        settings = settings.naming(redundancy=name)
    return replace(settings, follower=name) if paths else settings
