"""Jobs that leave nothing open: which arm does what, in which order; and the order of the file as one of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from dualarm_cli.geometry.arrays import IntArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import ANY, Job, StopKey, Task
from dualarm_cli.orders.model.buffer_numbers import served_pairing, used_buffers
from dualarm_cli.orders.paired.problem import IDLE


def file_order(job: Job) -> Job | None:
    """Returns a job in the order of its file; None where that is given, or tears apart what is done in a row.

    Jobs with paths or seams have it among the orders of their sections.

    Args:
        job: arms may be open; they are then searched for.
    """
    if job.order == "given" or job.in_sections:
        return None
    found = replace(job, order="given")
    # Searches for arms keep what is done in a row.
    if found.is_decided and not all(_in_a_row(found, row) for row in job.sequences):
        return None
    return found


def stage_by_stage(job: Job) -> Job:
    """Returns a job as paired arms do it: each makes its next stop as soon as what comes before it is over.

    Raises:
        InfeasibleError: in the order that is given arms wait for one another forever.
    """
    if job.is_decided and used_buffers(job):
        return replace(job, mode="paired", pairing=served_pairing(job))
    found = replace(job, mode="paired")
    if found.is_decided:
        found.stages()  # raises where there are none
    return found


def _in_a_row(job: Job, row: tuple[str, ...]) -> bool:
    """Returns whether one arm does tasks right after one another."""
    names = {
        name: [t.id for t in job.tasks if t.arm == name] for name in {t.arm for t in job.tasks}
    }
    return any(
        tuple(own[k : k + len(row)]) == tuple(row)
        for own in names.values()
        for k in range(len(own) - len(row) + 1)
    )


def own_rules(job: Job) -> Job:
    """Returns a job without the rules that are about tasks which are not its own: those are done before or after."""
    own = {task.id for task in job.tasks}
    tasks = (
        replace(task, after=tuple(name for name in task.after if name in own)) for task in job.tasks
    )
    rows = tuple(row for row in job.sequences if own.issuperset(row))
    return replace(job, tasks=tuple(tasks), sequences=rows)


def decided(job: Job, model: CellModel, slots: IntArray) -> Job:
    """Returns a job in which arms, order and pairing are as an order says.

    Args:
        job: as its file leaves it.
        model: its cell.
        slots: by stage and arm the number of the stop, IDLE for none, shape (n, arms).
    """
    stops = [(task, stop) for task in job.tasks for stop in task.stops]
    arms, doers = list(model.arms), dict[int, tuple[Task, str]]()
    pairing: list[tuple[StopKey, ...]] = []
    for row in slots.tolist():
        stage = []
        for arm, k in zip(arms, row, strict=True):
            if k == IDLE:
                continue
            task, stop = stops[k]
            doers.setdefault(id(task), (task, arm))
            stage.append((arm, task.id, stop.action))
        pairing.append(tuple(stage))
    ordered = tuple(_assigned(task, arm, arms) for task, arm in doers.values())
    return replace(job, tasks=ordered, order="given", pairing=tuple(pairing))


def _assigned(task: Task, arm: str, arms: Sequence[str]) -> Task:
    """Returns a task as an arm's, where any may do it; of a hand-over also who gives and who takes."""
    if task.arm != ANY:
        return task
    work = task.handover
    if work is not None:
        other = next(name for name in arms if name != arm)
        gives = task.stops[-1].action == "give"
        work = replace(work, giver=arm if gives else other, taker=other if gives else arm)
    return replace(task, arm=arm, handover=work)
