"""The order of a job's file as one of its orders: what is found must not be slower than what the file says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.model.job import ANY, Job
from dualarm_cli.planning.buffer_numbers import served_pairing, used_buffers
from dualarm_cli.planning.order_model import OrderModel

NEAR = 0.06
"""The file's order is planned where the search's estimate of it is above that of the best order, or above the best plan
where keeping clear made that slower, by at most this share: plans differ by less from their estimates."""


def file_order(order: OrderModel) -> Job | None:
    """Returns a job in the order of its file; None where that is given, breaks rules, or leaves open who gives to whom.

    Tasks of any arm are done by the one of those that reach them that has fewer stops until then. Paired arms make each
    stop as soon as what comes before it is over.

    Args:
        order: the job's tasks as each arm may do them.
    """
    job, arms = order.job, list(order.model.arms)
    if job.order == "given":
        return None
    reached = np.asarray(order.reached().any(axis=2))
    rows = {name: row for row in job.sequences for name in row}
    stops, doer = dict.fromkeys(arms, 0), dict[str, str]()
    tasks = []
    for t, task in enumerate(job.tasks):
        if task.arm == ANY:
            if task.handover is not None:
                return None
            able = [a for a, name in enumerate(arms) if reached[a, t]]
            if not able:
                return None
            fewest = arms[min(able, key=lambda a: (stops[arms[a]], a))]
            task = replace(
                task, arm=next((doer[n] for n in rows.get(task.id, ()) if n in doer), fewest)
            )
        doer[task.id] = task.arm
        stops[task.arm] += len(task.stops)
        tasks.append(task)
    found = replace(job, tasks=tuple(tasks), order="given")
    if not all(_in_a_row(found, row) for row in job.sequences):
        return None
    if job.mode == "free":
        return found
    try:
        return stage_by_stage(found)
    except InfeasibleError:
        return None


def stage_by_stage(job: Job) -> Job:
    """Returns a job as paired arms do it: each makes its next stop as soon as what comes before it is over.

    Raises:
        InfeasibleError: in the order that is given arms wait for one another for ever.
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
