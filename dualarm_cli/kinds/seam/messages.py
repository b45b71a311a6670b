"""Message of seams: methods that there are not, times that are too long, bounds, and where they fail."""

from __future__ import annotations

from dualarm_cli.errors import Diagnostic, did_you_mean
from dualarm_cli.kinds.seam.closed_chain import SEAM_SOLVERS, NoSeam
from dualarm_cli.model.job import Job
from dualarm_cli.model.joint_motion import SAME_TIME
from dualarm_cli.model.seam import SeamWork
from dualarm_cli.refusals import Refusal

LONGEST = 1800.0
"""Longest time of a seam that is planned [s]."""


def seam_faults(job: Job) -> list[Diagnostic]:
    """Find unknown methods of seams, too short entries and too long seams."""
    findings = []
    for task in (section[0] for section in job.sections()):
        work = task.seam
        if work is None:
            continue
        where = (work.place.file, work.place.line, work.place.column, "E300")
        if work.method is not None and work.method not in SEAM_SOLVERS.names:
            known = ", ".join(SEAM_SOLVERS.names)
            hint = did_you_mean(work.method, SEAM_SOLVERS.names)
            message = f"method: no method '{work.method}' works seams{hint}; known: {known}"
            findings.append(Diagnostic(*where, message))
        entry = work.entry_duration
        if entry is not None and entry / job.speed < work.dwell_start - SAME_TIME:
            message = (
                f"entry: the dwell of {work.dwell_start:g} s does not fit into {entry / job.speed:g} s, the entry's "
                "duration; raise or remove the duration, or shorten the dwell"
            )
            about = {"task": task.id, "value": entry / job.speed, "allowed": work.dwell_start}
            findings.append(Diagnostic(*where, message, about=about))
        least = seam_bound(work, job.speed)
        if least > LONGEST:
            message = (
                f"the seam takes {least:.4g} s; at most {LONGEST:g} s are planned: raise the speed"
            )
            about = {"task": task.id, "value": least, "allowed": LONGEST}
            findings.append(Diagnostic(*where, message, about=about))
    return findings


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


def where_it_fails(work: SeamWork, found: NoSeam) -> Refusal:
    """Returns why no joints were found, with the first place that fails."""
    length = work.length * 1e3
    more = {"mm": found.share * length, "length_mm": length, "cause": found.reason}
    what = "seam_has_no_joints" if found.share >= 1.0 else "seam_fails_at"
    return Refusal(what, remedy=_helps(work), more=more)


def _helps(work: SeamWork) -> tuple[str, ...]:
    """Returns what a file may change where no joints are found: each freedom that it does not give yet."""
    freedoms = {
        "hold_free": work.hold.stands or work.hold.given,
        "spin": not work.tool.free_spin,
        "lean": work.tool.tilt == 0.0,
    }
    return "shorten", "move_curve", *(name for name, left in freedoms.items() if left)


def seam_refusal(task: str, work: SeamWork, cause: Refusal) -> Refusal:
    """Returns why a task's seam cannot be worked, with who works it on whose part."""
    carrier = [] if work.master is None else [Refusal("part_in", arm=work.master)]
    more = {"carrier": carrier, "cause": cause}
    return Refusal("seam_not_worked", work.place, task, work.slave, more=more)
