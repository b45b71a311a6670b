"""What `--redundancy NAME` means: a solver of stops, a follower of paths, or both."""

from __future__ import annotations

from dualarm_cli.errors import UnknownSolverError
from dualarm_cli.path_following import PATH_SOLVERS
from dualarm_cli.redundancy import REDUNDANCY_SOLVERS


def redundancy_settings(name: str | None) -> dict[str, str]:
    """Returns the settings that a name sets; what it does not name keeps its default.

    Args:
        name: a member of either family, or None.

    Raises:
        UnknownSolverError: neither family has it.
    """
    if name is None:
        return {}
    found = {}
    if name in REDUNDANCY_SOLVERS.names:
        found["redundancy"] = name
    if name in PATH_SOLVERS.names:
        found["follower"] = name
    if not found:
        known = [*dict.fromkeys([*REDUNDANCY_SOLVERS.names, *PATH_SOLVERS.names])]
        raise UnknownSolverError("--redundancy", name, known)
    return found
