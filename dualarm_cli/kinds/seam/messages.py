"""Messages about seams: notes, faults of the job, the lower bound, and refusals."""

from __future__ import annotations

from functools import partial

from dualarm_cli.errors import Diagnostic, did_you_mean
from dualarm_cli.kinds.seam.closed_chain import SEAM_SOLVERS, NoSeam
from dualarm_cli.kinds.seam.motion import TimedSeam
from dualarm_cli.model.job import Job
from dualarm_cli.model.motion.trajectory import SAME_TIME
from dualarm_cli.model.process_work import SeamWork
from dualarm_cli.notes import NoteTable
from dualarm_cli.refusals import Refusal

LONGEST = 1800.0
"""Longest duration of a seam that is planned [s]."""

_note = NoteTable(
    "seams",
    slow="{task}: worked at {mm:.4g} mm/s, because of {capped:the limit of the tools' speed|limits}, instead of "
    "{requested:.4g} mm/s",
    long="{task}: takes {duration:.3f} s, because of {capped:the limit of the tools' speed|limits}, instead of "
    "{requested:.3f} s",
    pace="{task}: at {pace:.0%} of full speed seams are slower as well: {requested:.4g} mm/s for {mm:.4g}",
    no_shapes="{task}: {bodies:* and } without shapes: they are not checked for collisions",
    touches="{task}: {tool} may touch {bodies:*, } while it works, but must not penetrate it",
)
"""Notes on plans with seams."""
SLOWED = 1.001
"""Ratio of required to actual speed above which a note is given."""


def seam_notes(job: Job, task: str, work: SeamWork, seam: TimedSeam) -> list[str]:
    """List notes on how a task's seam is worked."""
    note = partial(_note, task=task)
    notes: list[str] = []
    # The deciding limit is not searched: the file's own acceleration is one of them.
    speed, duration = seam.speed(work.length), seam.trajectory.duration
    if work.speed is not None and speed * SLOWED < work.speed * job.speed:
        requested = work.speed * job.speed * 1e3
        notes.append(note("slow", mm=speed * 1e3, requested=requested, capped=seam.capped))
    if work.duration is not None and duration > SLOWED * work.duration / job.speed:
        requested = work.duration / job.speed
        notes.append(note("long", duration=duration, requested=requested, capped=seam.capped))
    if work.speed is not None and job.speed < 1.0:
        requested = work.speed * job.speed * 1e3
        notes.append(note("pace", pace=job.speed, requested=requested, mm=work.speed * 1e3))
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
        speed = job.under(task.care).speed
        place = (work.place.file, work.place.line, work.place.column, "E300")
        if work.method is not None and work.method not in SEAM_SOLVERS.names:
            names = ", ".join(SEAM_SOLVERS.names)
            hint = did_you_mean(work.method, SEAM_SOLVERS.names)
            message = f"method: no method '{work.method}' works seams{hint}; known: {names}"
            findings.append(Diagnostic(*place, message))
        entry = work.entry_duration
        if entry is not None and entry / speed < work.dwell_start - SAME_TIME:
            message = (
                f"entry: the dwell of {work.dwell_start:g} s does not fit into {entry / speed:g} s, the entry's "
                "duration; raise or remove the duration, or shorten the dwell"
            )
            about = {"task": task.id, "value": entry / speed, "allowed": work.dwell_start}
            findings.append(Diagnostic(*place, message, about=about))
        least = seam_bound(work, speed)
        if least > LONGEST:
            message = (
                f"the seam takes {least:.4g} s; at most {LONGEST:g} s are planned: raise the speed"
            )
            about = {"task": task.id, "value": least, "allowed": LONGEST}
            findings.append(Diagnostic(*place, message, about=about))
    return findings


def seam_bound(work: SeamWork, pace: float) -> float:
    """Compute the lower bound on a seam's duration [s].

    It is the length at the requested speed, plus the dwells.

    Args:
        work: the seam.
        pace: the job's fraction of full speed.
    """
    dwells = work.dwell_start + work.dwell_end
    if work.duration is not None:
        return work.duration / pace + dwells
    assert work.speed is not None
    return work.length / (work.speed * pace) + dwells


def where_it_fails(work: SeamWork, failure: NoSeam) -> Refusal:
    """Explain why no joints were found, with the first place that fails."""
    length = work.length * 1e3
    details = {"mm": failure.share * length, "length_mm": length, "cause": failure.reason}
    key = "seam_has_no_joints" if failure.share >= 1.0 else "seam_fails_at"
    return Refusal(key, remedy=_helps(work), data=details)


def _helps(work: SeamWork) -> tuple[str, ...]:
    """List remedies for missing joints: each freedom that the file does not give yet."""
    freedoms = {
        "hold_free": work.hold.stands or work.hold.given,
        "spin": not work.tool.free_spin,
        "lean": work.tool.tilt == 0.0,
    }
    return "shorten", "move_curve", *(name for name, is_open in freedoms.items() if is_open)


def seam_refusal(task: str, work: SeamWork, cause: Refusal) -> Refusal:
    """Create the refusal of a task's seam, with the arms."""
    carrier = [] if work.master is None else [Refusal("part_in", arm=work.master)]
    data = {"carrier": carrier, "cause": cause}
    return Refusal("seam_not_worked", work.place, task, work.slave, data=data)
