"""Plans of jobs with paths and seams in several orders of their sections; the quickest one is taken."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.planning.section_orders import section_orders
from dualarm_cli.planning.watch import Watch

ORDERS = {"quick": 2, "normal": 4, "thorough": 24}
"""So many orders of sections are planned."""


def quickest_of_sections(
    model: CellModel, job: Job, effort: str, watch: Watch, plan: Callable[[Job], Schedule]
) -> Schedule:
    """Returns the quickest plan of some orders of a job's sections; of the file's where it gives the order.

    Args:
        model: the job's cell.
        job: with paths or seams.
        effort: one of ORDERS.
        watch: is told how it goes, and may end the search.
        plan: plans the job with its sections in the order of its tasks.

    Raises:
        InfeasibleError: none of the orders has a plan; why the file's has none.
    """
    if job.order == "given":
        return plan(job)
    watch.begin()
    orders = section_orders(model, job, ORDERS[effort])
    if _has_open_runs(job):
        # Runs are ordered one by one, by estimates: at last what the file says is planned as it is.
        orders.append(replace(job, order="given"))
    best: Schedule | None = None
    failure: InfeasibleError | None = None
    longest, chosen, tried = 0.0, job, 0
    for number, one in enumerate(orders, start=1):
        if best is not None and watch.stop(longest):
            break
        begin = watch.elapsed()
        watch.tell(f"planning order {number} of {len(orders)} of what takes both arms")
        tried += 1
        try:
            found = plan(one)
        except InfeasibleError as error:
            failure = failure or error
            continue
        longest = max(longest, watch.elapsed() - begin)
        watch.found(found.duration)
        watch.keep(_with_order(found, one, orders[0], tried))
        if best is None or found.duration < best.duration:
            best, chosen = found, one
    if best is None:
        assert failure is not None  # there is at least the file's order
        raise failure
    return _with_order(best, chosen, orders[0], tried)


def _has_open_runs(job: Job) -> bool:
    """Returns whether there is an order to choose between paths and seams."""
    return any(
        not section[0].alone and len({task.id for task in section}) > 1
        for section in job.sections()
    )


def _with_order(schedule: Schedule, chosen: Job, given: Job, tried: int) -> Schedule:
    """Returns a schedule that says in which order the sections are, where there was a choice."""
    if tried < 2:
        return schedule
    rows = [
        "/".join(dict.fromkeys(task.id for task in section))
        if section[0].alone
        else f"{len({task.id for task in section})} others"
        for section in chosen.sections()
    ]
    whose = "the file's order of sections" if chosen == given else "sections in another order"
    if chosen.order == "given":
        whose = "the file's order of all tasks"
    note = f"order: of {tried} that were planned {whose} is the quickest: {', '.join(rows)}"
    return replace(schedule, notes=(*schedule.notes, note))
