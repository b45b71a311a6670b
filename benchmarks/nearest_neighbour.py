"""The nearest neighbour: what is done soonest comes next. A baseline for the search, with the search's own numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job
from dualarm_cli.planning.order_model import OrderModel
from dualarm_cli.planning.orders import decided
from dualarm_cli.planning.stage_order_model import stage_problem
from dualarm_cli.sequencing.problem import SequencingProblem
from dualarm_cli.sequencing.stage_problem import IDLE, StageProblem


def nearest_neighbour(job: Job) -> Job:
    """Returns a job without rules of order with arms and order decided by the nearest neighbour."""
    model = CellModel.from_cell(job.cell)
    order = OrderModel.of(model, job)
    if job.mode == "paired":
        return decided(job, model, nearest_stages(stage_problem(order)))
    best: tuple[float, list[tuple[int, int]]] | None = None
    for f in np.flatnonzero(order.reached().any(axis=0).all(axis=0)).tolist():
        found = _by_own_clocks(order.problem(f))
        if found is not None and (best is None or found[0] < best[0]):
            best = found
    assert best is not None  # instances are drawn so that one angle serves all tasks
    names = list(model.arms)
    tasks = tuple(replace(job.tasks[t], arm=names[a]) for a, t in best[1])
    return replace(job, tasks=tasks, order="given")


def nearest_stages(problem: StageProblem) -> IntArray:
    """Returns stages made one after the other, shape (n, arms); two arms.

    In each, one arm takes the stop that it has done soonest, and the other one the soonest done of those that are left
    and that it can make beside it; whichever arm chooses first, and at whichever platform angle, the stage that is over
    first is taken, and among equals that in which the arms need less together. An arm that has picked places next.
    """
    came, at = [problem.stops, problem.stops], 0
    due: list[tuple[int, ...]] = [(), ()]
    left = [tuple(own) for own in problem.tasks]
    rows: list[tuple[int, ...]] = []
    while left or any(due):
        options: list[tuple[float, float, int, tuple[int, ...]]] = []
        can = [_candidates(left, due[a]) for a in range(2)]
        for first in range(2):
            options += _stages(problem, came, at, can, first)
        _, _, at, row = min(options)
        for a, stop in enumerate(row):
            if stop == IDLE:
                continue
            came[a] = stop
            own = due[a] or next(one for one in left if one[0] == stop)
            left = [one for one in left if one[0] != stop]
            due[a] = own[1:]
        rows.append(row)
    return np.array(rows, dtype=np.int64)


def _candidates(left: list[tuple[int, ...]], due: tuple[int, ...]) -> IntArray:
    stops = [due[0]] if due else [own[0] for own in left]
    return np.array(stops, dtype=np.int64)


def _stages(
    problem: StageProblem, came: list[int], at: int, can: list[IntArray], first: int
) -> list[tuple[float, float, int, tuple[int, ...]]]:
    """Returns length, sum, angle and stops of the best stage at each angle, one arm choosing first."""
    other, found = 1 - first, []
    for g in range(len(problem.turn)):
        own = problem.length[first][came[first], can[first], at, g]
        if not np.isfinite(own).any():
            continue
        k = int(own.argmin())
        stop, one = int(can[first][k]), float(own[k])
        rest = can[other][can[other] != stop]
        lengths: FloatArray = np.array(problem.length[other][came[other], rest, at, g])
        if problem.apart is not None:
            pair = (stop, rest) if first == 0 else (rest, stop)
            lengths = lengths + problem.apart[(*pair, g)]
        row = [IDLE, IDLE]
        row[first] = stop
        if len(rest) and np.isfinite(lengths).any():
            m = int(lengths.argmin())
            row[other] = int(rest[m])
            # What is done side by side is worth more than what is done alone: by the stop.
            two = float(lengths[m])
            found.append((0.5 * max(one, two), one + two, g, tuple(row)))
        else:
            found.append((one, one, g, tuple(row)))
    return found


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
