"""Asynchronous plans in epochs, with the platform at a different position in each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dualarm_cli.effort import EFFORTS
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.job import Job, Task
from dualarm_cli.model.lying import lying_throughout
from dualarm_cli.motion.builder import Motion, MotionBuilder
from dualarm_cli.orders.asynchronous.epochs import (
    EpochOrder,
    EpochProblem,
    EpochSearch,
)
from dualarm_cli.orders.decided_jobs import own_rules
from dualarm_cli.orders.model.buffer_numbers import with_levels_after
from dualarm_cli.orders.model.order_model import OrderModel
from dualarm_cli.orders.model.tool_changes import cell_after, changes_of, with_changes
from dualarm_cli.orders.watch import Watch
from dualarm_cli.planning.asynchronous.free_plan import FreePlanner
from dualarm_cli.records import dataclass

HERE = "(where the platform stood before)"
"""Name of the posture in which an epoch starts."""


@dataclass(frozen=True)
class FreeEpochs:
    """Epochs of a plan: platform angles and tasks."""

    job: Job
    """The job with arms and order."""
    epochs: tuple[tuple[FloatArray, tuple[Task, ...]], ...]
    """Platform angle, shape (k,), and ordered tasks of each epoch."""
    total: float
    """Cycle time estimated by the search for orders [s]."""


def epoch_orders(
    order: OrderModel, effort: str, seed: int, watch: Watch, most: int
) -> list[FreeEpochs]:
    """Search for orders with at least two epochs, best first.

    Args:
        order: the job's tasks.
        effort: one of EFFORTS.
        seed: of all randomness.
        watch: may end the search.
        most: maximum number of results.
    """
    if len(order.angles) < 2 or len(order.job.tasks) < 2:
        return []
    watch.report("choosing platform angles for the tasks")
    is_reachable = order.reached().any(axis=(0, 1))
    problems = {int(f): order.problem(int(f)) for f in np.flatnonzero(is_reachable)}
    turn = order.clock.platform_times(order.angles[:, None] - order.angles[None])
    how, n = EFFORTS[effort].epochs, len(order.job.tasks)
    fewer = min(1.0, how.tasks / n)
    how = replace(how, sets=max(2, round(how.sets * fewer)), moves=max(4, round(how.moves * fewer)))
    search = EpochSearch(EpochProblem(problems, np.asarray(turn), seed), how, watch.stop)
    return [_decided(order, epochs) for epochs in search.best(most)]


def _decided(order: OrderModel, best: EpochOrder) -> FreeEpochs:
    """Convert numbered angles, tasks and arms to epochs."""
    epochs: list[tuple[FloatArray, tuple[Task, ...]]] = []
    for epoch, rows in zip(best.epochs, best.rows, strict=True):
        epoch_tasks = [
            replace(order.job.tasks[t], arm=name)
            for name, row in zip(order.model.arms, rows, strict=True)
            for t in row
        ]
        epochs.append((order.angles[epoch.angle], tuple(epoch_tasks)))
    tasks = tuple(task for _, epoch_tasks in epochs for task in epoch_tasks)
    decided = replace(order.job, tasks=tasks, order="given", pairing=None)
    # Tools are changed while the platform stands where the next task is done, at the end where the last ones are.
    before, end = changes_of(decided)
    epochs = [
        (angle, tuple(item for task in epoch_tasks for item in (*before[task.id], task)))
        for angle, epoch_tasks in epochs
    ]
    epochs[-1] = (epochs[-1][0], (*epochs[-1][1], *end))
    return FreeEpochs(with_changes(decided), tuple(epochs), best.total)


def plan_epochs(planner: FreePlanner, plan: FreeEpochs) -> Motion:
    """Plan the motion epoch by epoch, each from the end of the previous one.

    Raises:
        InfeasibleError: an epoch that has no plan.
    """
    job = plan.job
    cell, record = job.cell, MotionBuilder()
    here: FloatArray | None = None
    done: list[Task] = []
    for k, (angle, tasks) in enumerate(plan.epochs):
        epoch_job = own_rules(
            replace(job, tasks=_later(tasks, record.clock), returns=False, sequences=())
        )
        lying = lying_throughout(job, done, tasks)
        epoch_job = with_levels_after(replace(epoch_job, cell=cell, lying=lying), done)
        done += tasks
        if here is not None:
            epoch_job = replace(epoch_job, begin=here, start=HERE)
        end = None
        if job.returns and k == len(plan.epochs) - 1 and record.pieces:
            end = record.begin
        model = replace(planner.problem.model, cell=epoch_job.cell)
        problem = replace(planner.problem, job=epoch_job, model=model)
        motion = replace(planner, problem=problem, end=end).plan(angle)
        record.append(motion)
        here = np.asarray(motion.trajectory.position[-1])
        cell = cell_after(cell, tasks)
    return record.build(job.cell.robot)


def _later(tasks: Sequence[Task], clock: float) -> tuple[Task, ...]:
    """Shift the time windows of tasks to start from an instant [s]."""
    return tuple(
        replace(
            task,
            not_before=max(0.0, task.not_before - clock),
            not_after=task.not_after - clock,
        )
        for task in tasks
    )
