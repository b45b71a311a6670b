"""Decided jobs: arms, order and pairing given by search or file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from dualarm_cli.geometry.arrays import IntArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import ANY, Job, StopKey, Task
from dualarm_cli.orders.model.buffer_numbers import served_pairing, used_buffers
from dualarm_cli.orders.paired.problem import IDLE


def file_order(job: Job) -> Job | None:
    """Build a job with the order of its file.

    None if that order is given anyway, or if it separates the tasks of a sequence. Jobs with paths or seams have it
    among the orders of their sections.

    Args:
        job: a job; open arms stay open for the search.
    """
    if job.order == "given" or job.in_sections:
        return None
    fixed = replace(job, order="given")
    # A search for arms keeps sequences by itself.
    if fixed.is_decided and not all(_in_a_row(fixed, row) for row in job.sequences):
        return None
    return fixed


def by_one_arm(job: Job) -> list[Job]:
    """Build jobs, in file order, whose open tasks are all done by one arm.

    There are none for hand-overs between any arms, changed tools, paths and seams.

    Args:
        job: a job with open arms.
    """
    arms = [arm.name for arm in job.cell.robot.arms]
    if all(task.arm != ANY for task in job.tasks) or job.in_sections or job.cell.tool_changes:
        return []
    if any(task.arm == ANY and task.handover is not None for task in job.tasks):
        return []
    tasks = [tuple(_assigned(task, arm, arms) for task in job.tasks) for arm in arms]
    jobs = [replace(job, order="given", tasks=assigned) for assigned in tasks]
    return [fixed for fixed in jobs if all(_in_a_row(fixed, row) for row in job.sequences)]


def stage_by_stage(job: Job) -> Job:
    """Convert a job to synchronous stages, each stop as early as possible.

    Raises:
        InfeasibleError: the given order ends in a deadlock.
    """
    if job.is_decided and used_buffers(job):
        return replace(job, mode="paired", pairing=served_pairing(job))
    paired = replace(job, mode="paired")
    if paired.is_decided:
        paired.stages()  # raises if there are none
    return paired


def _in_a_row(job: Job, row: tuple[str, ...]) -> bool:
    """Test whether one arm does tasks directly one after the other."""
    names = {
        name: [t.id for t in job.tasks if t.arm == name] for name in {t.arm for t in job.tasks}
    }
    return any(
        tuple(sequence[k : k + len(row)]) == tuple(row)
        for sequence in names.values()
        for k in range(len(sequence) - len(row) + 1)
    )


def own_rules(job: Job) -> Job:
    """Remove the rules that refer to tasks of other sections."""
    ids = {task.id for task in job.tasks}
    tasks = (
        replace(task, after=tuple(name for name in task.after if name in ids)) for task in job.tasks
    )
    rows = tuple(row for row in job.sequences if ids.issuperset(row))
    return replace(job, tasks=tuple(tasks), sequences=rows)


def decided(job: Job, model: CellModel, slots: IntArray) -> Job:
    """Build a job with the arms, order and pairing of an order of stages.

    Args:
        job: the open job.
        model: its cell.
        slots: number of each stop by stage and arm, IDLE for none, shape (n, arms).
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
    """Assign a task to an arm, if any arm may do it.

    Giver and taker of a hand-over are set.
    """
    if task.arm != ANY:
        return task
    handover = task.handover
    if handover is not None:
        other_arm = next(name for name in arms if name != arm)
        gives = task.stops[-1].action == "give"
        handover = replace(
            handover, giver=arm if gives else other_arm, taker=other_arm if gives else arm
        )
    return replace(task, arm=arm, handover=handover)
