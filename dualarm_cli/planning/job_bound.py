"""What no plan of a job can beat, by the bound that serves it."""

from __future__ import annotations

from dataclasses import replace

from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.minimum_time.bound import LowerBound, lower_bound
from dualarm_cli.model.job import Job, Task
from dualarm_cli.planning.order_bound import own_clocks_bound, shared_bound
from dualarm_cli.planning.seam_words import seam_bound
from dualarm_cli.planning.sequence_problem import bound_problem
from dualarm_cli.planning.tool_changes import with_changes

PATH_BOUND = (
    "lower bound: the sections between paths and seams each by itself, from wherever they like; these at full speed; "
    "the transfers to where they begin and from where they end count nothing"
)
"""What a bound with paths assumes."""
NO_BOUND = "lower bound: none for arms that are not spherical-revolute-spherical"
"""What is said where there is no bound."""
NO_CONVEYOR_BOUND = "lower bound: none for tasks with conveyors"
"""The same where parts move: the bound is of parts that stand, and those may be nearer when they are met."""


def job_bound(job: Job, effort: str) -> LowerBound:
    """Returns what no plan of a job can beat.

    Args:
        job: what is to be done.
        effort: quick, normal or thorough.
    """
    if job.has_conveyors:
        return LowerBound(None, (NO_CONVEYOR_BOUND,))
    general = bool(job.cell.robot.without_closed_form)
    job = with_changes(job)
    if general and not job.in_sections:
        return LowerBound(None, (NO_BOUND,))
    if not job.is_decided and not job.in_sections:
        return shared_bound(CellModel.from_cell(job.cell), job, effort)
    if job.mode == "free":
        return own_clocks_bound(CellModel.from_cell(job.cell), job, effort)
    if not job.in_sections:
        return lower_bound(bound_problem(CellModel.from_cell(job.cell), job), effort)
    value, assumptions = 0.0, dict[str, None]()
    for section in _bounded_sections(job):
        work, seam = section[0].path, section[0].seam
        if work is not None:
            value += work.length / (work.speed * job.speed)
        elif seam is not None:
            # It begins, its dwell over, no earlier than the file says.
            value = max(value, seam.not_before - seam.dwell_start) + seam_bound(seam, job.speed)
        elif not general:
            # Where a section starts is for the plan to choose, and what comes after it does not count.
            alone = replace(job, tasks=section, start="free", returns=False)
            model = CellModel.from_cell(job.cell)
            if alone.is_decided:
                bound = lower_bound(bound_problem(model, alone), effort)
            else:
                bound = shared_bound(model, alone, effort)
            value += bound.value if bound.value is not None else 0.0
            assumptions |= dict.fromkeys(bound.assumptions)
    return LowerBound(value, (*assumptions, PATH_BOUND))


def _bounded_sections(job: Job) -> list[tuple[Task, ...]]:
    """Returns sections that take at least as long together as each by itself, in whatever order they are done."""
    if job.order == "given":
        return job.sections()
    others = tuple(task for task in job.tasks if not task.alone)
    return [*(one for one in job.sections() if one[0].alone), *([others] if others else [])]
