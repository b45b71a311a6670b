"""What `--redundancy NAME` means: a solver of stops, a follower of paths, both, or a seam solver."""

from __future__ import annotations

from dataclasses import replace

from dualarm_cli.closed_chain import SEAM_SOLVERS
from dualarm_cli.errors import UnknownSolverError
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.path_following import PATH_SOLVERS
from dualarm_cli.redundancy import REDUNDANCY_SOLVERS


def with_redundancy(settings: PlanSettings, name: str | None) -> PlanSettings:
    """Returns settings with what a name sets; the rest stays.

    Args:
        settings: what they are changed from.
        name: a member of one of the families, or None.

    Raises:
        UnknownSolverError: no family has it.
    """
    if name is None:
        return settings
    stops, paths = name in REDUNDANCY_SOLVERS.names, name in PATH_SOLVERS.names
    if name in SEAM_SOLVERS.names:
        return replace(settings, seam_solver=name)
    if not stops and not paths:
        families = (REDUNDANCY_SOLVERS, PATH_SOLVERS, SEAM_SOLVERS)
        known = [*dict.fromkeys(member for family in families for member in family.names)]
        raise UnknownSolverError("--redundancy", name, known)
    if stops:
        settings = settings.naming(redundancy=name)
    return replace(settings, follower=name) if paths else settings
