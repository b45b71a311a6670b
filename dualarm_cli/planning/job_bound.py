"""What no plan of a job can beat, by the bound that serves it."""

from __future__ import annotations

from dataclasses import replace

from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.minimum_time.bound import LowerBound, lower_bound
from dualarm_cli.minimum_time.problem import SequenceProblem
from dualarm_cli.model.job import Job, Task
from dualarm_cli.planning.order_bound import own_clocks_bound, shared_bound
from dualarm_cli.planning.seam_words import seam_bound
from dualarm_cli.planning.sequence_problem import sequence_problem
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
        return _bound(CellModel.from_cell(job.cell), job, effort)
    value, assumptions = 0.0, dict[str, None]()
    for section in _bounded_sections(job):
        work, seam = section[0].path, section[0].seam
        if work is not None:
            value += work.length / (work.speed * job.speed)
        elif seam is not None:
            value = max(value, _opens(section)) + seam_bound(seam, job.speed)
        elif not general:
            # Where a section starts is for the plan to choose, and what comes after it does not count.
            alone = replace(job, tasks=section, start="free", returns=False)
            model = CellModel.from_cell(job.cell)
            bounded = _bound if alone.is_decided else shared_bound
            bound = bounded(model, alone, effort)
            value += bound.value if bound.value is not None else 0.0
            assumptions |= dict.fromkeys(bound.assumptions)
    return LowerBound(value, (*assumptions, PATH_BOUND))


def _bounded_sections(job: Job) -> list[tuple[Task, ...]]:
    """Returns sections that take at least as long together as each by itself, in whatever order they are done."""
    if job.order == "given":
        return job.sections()
    others = tuple(task for task in job.tasks if not task.alone)
    alone = sorted((one for one in job.sections() if one[0].alone), key=_opens)
    # Of works that each open at some time no order is over sooner than that in which they open.
    return [*([others] if others else []), *alone]


def _opens(section: tuple[Task, ...]) -> float:
    """Returns when a section may begin at the earliest [s]: a seam so that its dwell is over when the file says."""
    seam = section[0].seam
    return 0.0 if seam is None else max(0.0, seam.not_before - seam.dwell_start)


def _bound(model: CellModel, job: Job, effort: str) -> LowerBound:
    """Returns the bound of a decided job.

    It looks at each arm by itself. In a hand-over what the other arm does comes before or after one's own lines and
    dwell: at least what its stop takes by itself from wherever it likes.
    """
    problem = sequence_problem(model, job)
    arms = [list(arm.stops) for arm in problem.arms]
    for k in problem.together.tolist():
        least = [_least_work(problem, a, k, effort) for a in range(len(arms))]
        for a, stops in enumerate(arms):
            stop = stops[k]
            if stop is not None:
                stops[k] = replace(stop, dwell=stop.dwell + sum(least) - least[a])
    whole = tuple(
        replace(arm, stops=tuple(stops)) for arm, stops in zip(problem.arms, arms, strict=True)
    )
    return lower_bound(replace(problem, arms=whole, handing=()), effort)


def _least_work(problem: SequenceProblem, a: int, k: int, effort: str) -> float:
    """Returns what lines and dwell of one arm's stop take at least [s]."""
    stop = problem.arms[a].stops[k]
    if stop is None:
        return 0.0
    arms = tuple(
        replace(arm, stops=(stop if i == a else None,)) for i, arm in enumerate(problem.arms)
    )
    alone = replace(problem, arms=arms, free_start=True, returns=False, handing=())
    return max(stop.dwell, lower_bound(alone, effort).value or 0.0)
