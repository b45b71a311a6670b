"""Messages about seams: notes, methods that there are not, times that are too long, bounds, and where they fail."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

from dualarm_cli.errors import Diagnostic, did_you_mean
from dualarm_cli.kinds.seam.closed_chain import SEAM_SOLVERS, NoSeam
from dualarm_cli.kinds.seam.motion import TimedSeam
from dualarm_cli.model.job import Job
from dualarm_cli.model.joint_motion import SAME_TIME
from dualarm_cli.model.seam import SeamWork
from dualarm_cli.notes import Note
from dualarm_cli.refusals import Refusal

LONGEST = 1800.0
"""Longest time of a seam that is planned [s]."""

NOTES: Mapping[str, str] = {
    "slow": "{task}: worked at {mm:.4g} mm/s, because of {capped:the limit of the tools' speed|limits}, instead of "
    "{asked:.4g} mm/s",
    "long": "{task}: takes {duration:.3f} s, because of {capped:the limit of the tools' speed|limits}, instead of "
    "{asked:.3f} s",
    "pace": "{task}: at {pace:.0%} of full speed seams are slower as well: {asked:.4g} mm/s for {mm:.4g}",
    "no_shapes": "{task}: {bodies:* and } without shapes: they are not checked for collisions",
    "touches": "{task}: {tool} may touch {bodies:*, } while it works, but must not penetrate it",
}
"""Notes on plans with seams, by key."""
SLOWED = 1.001
"""Factor by which a seam has to be slower than the file asks for a note."""


def seam_notes(job: Job, task: str, work: SeamWork, seam: TimedSeam) -> list[str]:
    """List notes on how a task's seam is worked."""
    note, notes = partial(Note.of, NOTES, "seams", task=task), list[str]()
    # What decides is not looked for: the file's own acceleration is one of the limits.
    speed, duration = seam.speed(work.length), seam.trajectory.duration
    if work.speed is not None and speed * SLOWED < work.speed * job.speed:
        asked = work.speed * job.speed * 1e3
        notes.append(note("slow", mm=speed * 1e3, asked=asked, capped=seam.capped))
    if work.duration is not None and duration > SLOWED * work.duration / job.speed:
        asked = work.duration / job.speed
        notes.append(note("long", duration=duration, asked=asked, capped=seam.capped))
    if work.speed is not None and job.speed < 1.0:
        asked = work.speed * job.speed * 1e3
        notes.append(note("pace", pace=job.speed, asked=asked, mm=work.speed * 1e3))
    bodies = [f"{arm}_tool" for arm in work.arms if not job.cell.tools[arm].shapes]
    if bodies:
        notes.append(note("no_shapes", bodies=bodies))
    tool = f"{work.slave}_tool"
    if work.touches and tool not in bodies:
        notes.append(note("touches", tool=tool, bodies=work.touches))
    return notes


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
