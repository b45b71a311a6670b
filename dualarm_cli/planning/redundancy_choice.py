"""Meaning of `--redundancy NAME`: a solver of stops, a follower of paths, or a seam solver."""

from __future__ import annotations

from dataclasses import replace

from dualarm_cli.errors import UnknownSolverError, UnsupportedError
from dualarm_cli.kinds.path.following import PATH_SOLVERS
from dualarm_cli.kinds.planning import families
from dualarm_cli.kinds.seam.closed_chain import SEAM_SOLVERS
from dualarm_cli.model.job import Job
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.postures import REDUNDANCY_SOLVERS


def with_redundancy(settings: PlanSettings, name: str | None) -> PlanSettings:
    """Apply a redundancy solver's name to the settings.

    Args:
        settings: settings to change.
        name: a member of one of the families, or None.

    Raises:
        UnknownSolverError: no family has it.
    """
    if name is None:
        return settings
    stops, others = name in REDUNDANCY_SOLVERS.names, families()
    of_kinds = {kind.setting: name for kind, solvers in others if name in solvers.names}
    if not stops and not of_kinds:
        names = [
            *REDUNDANCY_SOLVERS.names,
            *(solver for _, solvers in others for solver in solvers.names),
        ]
        raise UnknownSolverError("redundancy", name, list(dict.fromkeys(names)))
    if stops:
        settings = settings.naming(redundancy=name)
    return replace(settings, **of_kinds)  # type: ignore[arg-type]


def check_follower(job: Job, requested: str | None) -> None:
    """Refuse an unknown or unused path follower on the command line.

    Args:
        job: job with paths or seams.
        requested: the method that the command line names, or None.

    Raises:
        UnknownSolverError: there is none of that name.
        UnsupportedError: there are no paths.
    """
    if requested is not None:
        PATH_SOLVERS[requested]
        if not job.has_paths and requested not in REDUNDANCY_SOLVERS.names:
            raise UnsupportedError(
                f"redundancy {requested} follows paths, and the tasks have none; seams are worked by "
                f"{', '.join(SEAM_SOLVERS.names)}"
            )
