"""The nearest neighbour: what is done soonest comes next. Baselines for the search, with the search's own numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dualarm_cli.geometry.arrays import IntArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job
from dualarm_cli.orders.asynchronous.problem import SequencingProblem
from dualarm_cli.orders.decided_jobs import decided
from dualarm_cli.orders.model.order_model import OrderModel
from dualarm_cli.orders.model.stage_order_model import stage_problem
from dualarm_cli.orders.paired.orders import nearest_stages, never_touching
from dualarm_cli.orders.paired.problem import IDLE, StageProblem


def each_arms_nearest(job: Job) -> Job:
    """Returns a job of paired arms without rules of order, with arms and order decided by each arm's nearest neighbour.

    The arms choose in turn, each the stop that it alone is done with soonest after its last one, whatever the platform
    and the other arm do; where no platform angle serves both, their stops are made one after the other.
    """
    model = CellModel.from_cell(job.cell)
    problem = stage_problem(OrderModel.of(model, job))
    return decided(job, model, never_touching(problem, _in_turn(problem)))


def _in_turn(problem: StageProblem) -> IntArray:
    """Returns each arm's nearest neighbours as stages, shape (n, 2)."""
    stops = problem.stops
    soonest = [length[:, :stops].min(axis=(2, 3)) for length in problem.length]
    came, left = [stops, stops], dict(enumerate(problem.tasks))
    due: list[tuple[int, ...]] = [(), ()]
    rows = []
    while left or any(due):
        row = [IDLE, IDLE]
        for a in range(2):
            tasks = [t for t, own in left.items() if np.isfinite(soonest[a][came[a], own[0]])]
            if not due[a] and tasks:
                nearest = min(tasks, key=lambda t, a=a: soonest[a][came[a], left[t][0]])
                due[a] = left.pop(nearest)
            if due[a]:
                row[a], due[a] = due[a][0], due[a][1:]
                came[a] = row[a]
        assert row != [IDLE, IDLE]  # instances are drawn so that every task is reached
        rows.append(row)
    return np.array(rows, dtype=np.int64)


def nearest_neighbour(job: Job) -> Job:
    """Returns a job without rules of order with arms and order decided by the nearest neighbour.

    Of paired arms by the nearest stage: whichever stops and platform angle are over first, looked at together.
    """
    model = CellModel.from_cell(job.cell)
    order = OrderModel.of(model, job)
    if job.mode == "paired":
        stages = nearest_stages(stage_problem(order))
        assert stages is not None  # instances are drawn so that every task is reached
        return decided(job, model, stages)
    best: tuple[float, list[tuple[int, int]]] | None = None
    for f in np.flatnonzero(order.reached().any(axis=0).all(axis=0)).tolist():
        found = _by_own_clocks(order.problem(f))
        if found is not None and (best is None or found[0] < best[0]):
            best = found
    assert best is not None  # instances are drawn so that one angle serves all tasks
    names = list(model.arms)
    tasks = tuple(replace(job.tasks[t], arm=names[a]) for a, t in best[1])
    return replace(job, tasks=tasks, order="given")


def _by_own_clocks(problem: SequencingProblem) -> tuple[float, list[tuple[int, int]]] | None:
    """Returns when the last arm is back, and arms and tasks in order: whoever is free first takes the soonest done."""
    clock = [problem.turn[0]] * len(problem.arms)
    at = [arm.start for arm in problem.arms]
    left = set(range(problem.tasks))
    order: list[tuple[int, int]] = []
    idle: set[int] = set()
    while left:
        free = [a for a in range(len(clock)) if a not in idle]
        if not free:
            return None
        a = min(free, key=lambda a: clock[a])
        arm, tasks = problem.arms[a], np.array(sorted(left))
        whole = arm.law.duration(np.nan_to_num(arm.entry[tasks]) - at[a])
        whole = whole + arm.first[tasks] + arm.second[tasks]
        if not np.isfinite(whole).any():
            idle.add(a)
            continue
        k, way = np.unravel_index(int(whole.argmin()), whole.shape)
        task = int(tasks[k])
        clock[a] += float(whole[k, way])
        at[a] = arm.leaving[task, way]
        left.remove(task)
        order.append((a, task))
    return max(clock), order
