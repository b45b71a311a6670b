"""What `--redundancy NAME` means: a solver of stops, a follower of paths, both, or a seam solver."""

from __future__ import annotations

from dataclasses import replace

from dualarm_cli.errors import (
    Diagnostic,
    InputError,
    UnknownSolverError,
    UnsupportedError,
    did_you_mean,
)
from dualarm_cli.kinds.path.following import PATH_SOLVERS
from dualarm_cli.kinds.seam.closed_chain import SEAM_SOLVERS
from dualarm_cli.kinematics.dynamics import Dynamics
from dualarm_cli.model.job import Job
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.postures import REDUNDANCY_SOLVERS

LONGEST = 1800.0
"""Longest time of a path that is planned [s]."""


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


def check_followers(job: Job, asked: str | None) -> None:
    """Raises where a path asks for what there is not: a method, or torque limits.

    Args:
        job: with paths.
        asked: the method that the command line names, or None.

    Raises:
        UnknownSolverError: the command line names it.
        UnsupportedError: the command line names one, and there are no paths.
        InputError: the task file does, at its place.
    """
    if asked is not None:
        PATH_SOLVERS[asked]
        if not job.has_paths and asked not in REDUNDANCY_SOLVERS.names:
            raise UnsupportedError(
                f"--redundancy {asked} follows paths, and the tasks have none; seams are worked by "
                f"{', '.join(SEAM_SOLVERS.names)}"
            )
    found = {
        task.path.place: task.path.redundancy
        for task in job.tasks
        if task.path is not None and task.path.redundancy not in (None, *PATH_SOLVERS.names)
    }
    findings = [
        Diagnostic(
            place.file,
            place.line,
            place.column,
            "E300",
            f"redundancy: no method '{name}' follows paths{did_you_mean(str(name), PATH_SOLVERS.names)}; known: "
            f"{', '.join(PATH_SOLVERS.names)}",
        )
        for place, name in found.items()
    ]
    asks = {task.path.place for task in job.tasks if task.path is not None and task.path.torque}
    if asks and (unknown := Dynamics(job.cell).unknown):
        findings += [
            Diagnostic(
                place.file,
                place.line,
                place.column,
                "E300",
                "torque: limited needs a torque limit (effort) and masses in the URDF; missing for "
                f"{', '.join(unknown)}",
            )
            for place in asks
        ]
    for task in job.tasks:
        if task.path is None:
            continue
        place, length = task.path.place, task.path.length
        least = length / (task.path.speed * job.speed)
        if least > LONGEST:
            message = (
                f"{length * 1e3:.4g} mm at {task.path.speed * job.speed * 1e3:.4g} mm/s take {least:.4g} s; at most "
                f"{LONGEST:g} s are planned: raise the speed"
            )
            findings.append(Diagnostic(place.file, place.line, place.column, "E300", message))
    if findings:
        raise InputError(list(dict.fromkeys(findings)))
