"""Budget of a job against its plan; a plan beyond it is still a plan."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dualarm_cli.model.budget import Kept
from dualarm_cli.model.job import Job
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.model.verification import StageClearance
from dualarm_cli.verification.as_done import job_as_done
from dualarm_cli.verification.clearance_checks import check_clearance
from dualarm_cli.verification.tolerances import TOL


def judge_budget(schedule: Schedule, job: Job) -> tuple[Kept, ...]:
    """Returns the lines of a job's budget, compared with a schedule; nothing where it has none.

    Args:
        schedule: with its verification; without clearances in it clearance and skew count as missed.
        job: what it was planned for.
    """
    budget, lines = job.budget, list[Kept]()
    if budget is None:
        return ()
    if budget.cycle_time is not None:
        time, place = schedule.duration, budget.cycle_time_place
        kept = bool(time <= budget.cycle_time + TOL.same_time)
        lines.append(
            Kept("cycle_time", budget.cycle_time, time, kept, place.file, place.line, place.column)
        )
    if budget.clearance is not None:
        least, place = least_clearance(schedule, job), budget.clearance_place
        kept = least is not None and least >= budget.clearance - TOL.clearance_slack
        lines.append(
            Kept("clearance", budget.clearance, least, kept, place.file, place.line, place.column)
        )
    if budget.skew is not None:
        found = schedule.verification.delays if schedule.verification is not None else ()
        clear, place = min((one.clear for one in found), default=None), budget.skew_place
        kept = clear is not None and clear >= budget.skew
        lines.append(Kept("skew", budget.skew, clear, kept, place.file, place.line, place.column))
    return tuple(lines)


def least_clearance(schedule: Schedule, job: Job) -> float | None:
    """Returns the least distance of any two bodies that must keep apart [m], proven; None where none was proven.

    The stages of a verification have the pairs that are nearest to what is required of them. Where all pairs have to
    keep the same distance these are the nearest ones of all; where some have one of their own it is proven once more.
    """
    stages = schedule.verification.clearances if schedule.verification is not None else ()
    if stages and job.cell.clearances:
        with np.errstate(all="ignore"):
            stages = _alike(schedule, job)
    # What may lie on something has no clearance to speak of.
    found = [stage.clearance for stage in stages if stage.required >= 0.0]
    return min(found, default=None)


def _alike(schedule: Schedule, job: Job) -> tuple[StageClearance, ...]:
    """Returns the least clearances where the same is required of all pairs."""
    done = job_as_done(schedule, job)
    cell = replace(done.cell, clearances=())
    return check_clearance(schedule, replace(done, cell=cell))[1]
