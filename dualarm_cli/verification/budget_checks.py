"""Budget of a job against its plan; a plan beyond it is still a plan."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dualarm_cli.model.budget import Kept
from dualarm_cli.model.job import Job
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.model.verification import StageClearance, counted
from dualarm_cli.verification.as_done import job_as_done
from dualarm_cli.verification.clearance_checks import check_clearance
from dualarm_cli.verification.measuring.tolerances import TOL
from dualarm_cli.verification.varied_cycle import varied_cycle


def judge_budget(schedule: Schedule, job: Job) -> tuple[Kept, ...]:
    """Compare a schedule with its job's budget, item by item.

    Args:
        schedule: with its verification; without proven clearances, clearance and skew count as missed.
        job: the job that it was planned for.

    Returns:
        Items of the budget; empty without a budget.
    """
    budget, lines = job.budget, list[Kept]()
    if budget is None:
        return ()
    if budget.cycle_time is not None:
        time, place, kind = schedule.duration, budget.cycle_time_place, budget.cycle_kind
        if kind != "nominal" and (varied := varied_cycle(schedule, job)) is not None:
            time = varied.at(kind)
        kept = bool(time <= budget.cycle_time + TOL.same_time)
        lines.append(Kept("cycle_time", budget.cycle_time, time, kept, *place.order, kind))
    if budget.clearance is not None:
        least, place = least_clearance(schedule, job), budget.clearance_place
        kept = least is not None and least >= budget.clearance - TOL.clearance_slack
        lines.append(
            Kept("clearance", budget.clearance, least, kept, place.file, place.line, place.column)
        )
    if budget.skew is not None:
        arm_delays = schedule.verification.delays if schedule.verification is not None else ()
        clear, place = min((delay.clear for delay in arm_delays), default=None), budget.skew_place
        kept = clear is not None and clear >= budget.skew
        lines.append(Kept("skew", budget.skew, clear, kept, place.file, place.line, place.column))
    return tuple(lines)


def least_clearance(schedule: Schedule, job: Job) -> float | None:
    """Return the least proven clearance of all pairs that count (`counted`) [m], or None.

    A verification lists the pairs with the least margins. If pairs require different clearances, the least distance
    may be another pair's, and the proof is repeated with the same requirement for all.
    """
    stages = schedule.verification.clearances if schedule.verification is not None else ()
    if stages and job.cell.clearances:
        with np.errstate(all="ignore"):
            stages = _uniform_clearances(schedule, job)
    # Parts that may lie on something have no clearance.
    apart = counted(stage for stage in stages if stage.required >= 0.0)
    return min((stage.clearance for stage in apart), default=None)


def _uniform_clearances(schedule: Schedule, job: Job) -> tuple[StageClearance, ...]:
    """Prove the least distances, with no clearance required of any pair."""
    done = job_as_done(schedule, job)
    cell = replace(done.cell, clearance=0.0, clearances=())
    return check_clearance(schedule, replace(done, cell=cell))[1]
