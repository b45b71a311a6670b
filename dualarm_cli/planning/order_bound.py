"""A lower bound where arms or order are open, or arms have clocks of their own: what the slower arm needs at least."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.minimum_time.bound import LowerBound, lower_bound
from dualarm_cli.model.job import Job, Task
from dualarm_cli.planning.sequence_problem import sequence_problem
from dualarm_cli.planning.tool_changes import stand_tasks

SHARED = (
    "lower bound: holds for every plan of these tasks, whichever arm does what in whatever order: no task takes less "
    "than by itself, with the platform angle, postures and yaws that suit it best, and the slower arm does at least "
    "its share; transfers between tasks count nothing, of tool changes the fewest visits to stands"
)
"""What the bound over all orders assumes."""
OWN_CLOCKS = (
    "lower bound: holds for every plan in this order in which each arm goes by its own clock: the slower arm's stops, "
    "as if the platform served it alone"
)
"""What the bound of arms with clocks of their own assumes."""
DWELLS_ONLY = "lower bound: of the tasks beyond the first {most} only dwells count"
"""What is said where there are too many tasks to bound each."""
MOST_TASKS = 60
"""So many tasks are bounded one by one."""


def shared_bound(model: CellModel, job: Job, effort: str) -> LowerBound:
    """Returns a bound over all orders and assignments.

    The least T so that tasks, shared out in fractions, take no arm longer than T: a linear programme.

    Args:
        model: the job's cell, with closed forms.
        job: what is to be done.
        effort: as of `lower_bound`.
    """
    times = np.full((len(model.arms), len(job.tasks)), np.inf)
    for t, task in enumerate(job.tasks):
        for a, name in enumerate(model.arms):
            if not task.allows(name):
                continue
            times[a, t] = sum(stop.dwell.total for stop in task.stops)
            if t < MOST_TASKS:
                own = replace(task, arm=name, after=())
                alone = replace(job, tasks=(own,), start="free", returns=False, pairing=None)
                found = lower_bound(sequence_problem(model, alone), effort).value
                times[a, t] = max(times[a, t], found or 0.0)
    more = (DWELLS_ONLY.format(most=MOST_TASKS),) if len(job.tasks) > MOST_TASKS else ()
    visits = np.zeros(len(model.arms))
    for a, name in enumerate(model.arms):
        for stand in least_visits(job, name):
            alone = replace(job, tasks=(stand,), start="free", returns=False, pairing=None)
            visits[a] += lower_bound(sequence_problem(model, alone), effort).value or 0.0
    return LowerBound(_least_makespan(times, visits), (SHARED, *more))


def least_visits(job: Job, arm: str) -> list[Task]:
    """Returns the visits to stands that an arm makes at least, whatever the order, for tasks that only it may do.

    Every tool of theirs is taken once, that of the start again where it has to be on in the end; before each of these
    what was on is left.

    Args:
        job: what is to be done.
        arm: which arm.
    """
    start = job.cell.start_tool(arm)
    wanted = {task.tool for task in job.tasks if task.arm == arm} - {start}
    if not wanted:
        return []
    again = {start} if job.returns else set()
    takes = sorted((wanted | again) - {""})
    # In a cycle what is taken is left once as well; else one of them stays on, or may.
    leaves = takes if job.returns else [start] if start else []
    stands = {
        (task.tool, task.stops[0].action): task for task in stand_tasks(job.cell) if task.arm == arm
    }
    return [stands[tool, "take_tool"] for tool in takes] + [
        stands[tool, "leave_tool"] for tool in leaves
    ]


def own_clocks_bound(model: CellModel, job: Job, effort: str) -> LowerBound:
    """Returns a bound for arms that go through their stops by their own clocks; arguments as of `shared_bound`."""
    value = 0.0
    for name in model.arms:
        tasks = tuple(task for task in job.tasks if task.arm == name)
        if tasks:
            alone = replace(job, tasks=tasks, pairing=None)
            found = lower_bound(sequence_problem(model, alone), effort).value
            value = max(value, found or 0.0)
    return LowerBound(value, (OWN_CLOCKS,))


def _least_makespan(times: FloatArray, besides: FloatArray) -> float:
    """Returns the least T of tasks shared out in fractions.

    Args:
        times: of every task on every arm [s], infinite where an arm cannot, shape (arms, n).
        besides: what every arm does besides [s], shape (arms,).
    """
    from scipy.optimize import linprog

    arms, n = times.shape
    can = np.isfinite(times)
    if not can.any(axis=0).all():
        return np.inf
    cost = np.append(np.zeros(arms * n), 1.0)
    load = np.zeros((arms, arms * n + 1))
    share = np.zeros((n, arms * n + 1))
    for a in range(arms):
        load[a, a * n : (a + 1) * n] = np.where(can[a], times[a], 0.0)
        load[a, -1] = -1.0
        share[np.arange(n), a * n + np.arange(n)] = 1.0
    spans = [(0.0, 1.0 if one else 0.0) for one in can.ravel()] + [(0.0, None)]
    found = linprog(cost, load, -besides, share, np.ones(n), spans, method="highs")
    return float(found.fun) if found.success else 0.0
