"""What is said of seams: methods that there are not, times that are too long, bounds, and where they fail."""

from __future__ import annotations

from dualarm_cli.errors import Diagnostic, InputError, did_you_mean
from dualarm_cli.kinds.seam.closed_chain import SEAM_SOLVERS, NoSeam
from dualarm_cli.model.job import Job
from dualarm_cli.model.seam import SeamWork

LONGEST = 1800.0
"""Longest time of a seam that is planned [s]."""


def check_seams(job: Job) -> None:
    """Raises where a seam asks for what there is not.

    Raises:
        InputError: an unknown method, or a seam that takes too long, at its place.
    """
    findings = []
    for work in (section[0].seam for section in job.sections()):
        if work is None:
            continue
        where = (work.place.file, work.place.line, work.place.column, "E300")
        if work.method is not None and work.method not in SEAM_SOLVERS.names:
            known = ", ".join(SEAM_SOLVERS.names)
            hint = did_you_mean(work.method, SEAM_SOLVERS.names)
            message = f"method: no method '{work.method}' works seams{hint}; known: {known}"
            findings.append(Diagnostic(*where, message))
        least = seam_bound(work, job.speed)
        if least > LONGEST:
            message = (
                f"the seam takes {least:.4g} s; at most {LONGEST:g} s are planned: raise the speed"
            )
            findings.append(Diagnostic(*where, message))
    if findings:
        raise InputError(findings)


def seam_bound(work: SeamWork, pace: float) -> float:
    """Returns what no plan of a seam can beat [s]: its length at the speed that is asked for, and its dwells.

    Args:
        work: the seam.
        pace: the job's share of full speed.
    """
    dwells = work.dwell_start + work.dwell_end
    if work.duration is not None:
        return work.duration / pace + dwells
    assert work.speed is not None
    return work.length / (work.speed * pace) + dwells


def where_it_fails(work: SeamWork, found: NoSeam) -> str:
    """Returns why no joints were found, with the first place that fails."""
    length = work.length * 1e3
    if found.share >= 1.0:
        return f"{found.reason}; {_helps(work)}"
    from_here = f"{found.share * length:.1f} mm along the seam of {length:.1f} mm"
    return f"fails {from_here}: {found.reason}; {_helps(work)}"


def _helps(work: SeamWork) -> str:
    """Returns what a file may change where no joints are found: each freedom that it does not give yet."""
    ways = ["shorten the curve or divide it", "move it on the part ('part', 'curve')"]
    if work.hold.stands or work.hold.given:
        ways.append("let the part move ('hold: free')")
    if not work.tool.free_spin:
        ways.append("let the tool spin ('free: spin')")
    if work.tool.tilt == 0.0:
        ways.append("let it lean ('tilt')")
    return f"{', '.join(ways[:-1])}, or {ways[-1]}"


def workers(work: SeamWork) -> str:
    """Returns who works a seam, on whose part."""
    return work.slave if work.master is None else f"{work.slave} on the part in {work.master}"
