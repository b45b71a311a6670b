"""Buffers of a job as numbers, and whether the stages of a decided job keep them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.job import Job, Stop, StopKey, Task
from dualarm_cli.orders.model.stop_nodes import StopNodes
from dualarm_cli.orders.paired.alignment import any_alignment
from dualarm_cli.orders.paired.problem import IDLE
from dualarm_cli.orders.rules.stores import Stores

HELPS = (
    "what helps: order: optimise, mode: free (there arms wait for parts and room), a larger capacity, other numbers at "
    "the start (initial), or another order in the file"
)
"""What is said where an order that is given does not keep a buffer."""
HELPS_FREE = (
    "what helps: order: optimise, a larger capacity, more or fewer parts at the start (initial), or another order in "
    "the file"
)
"""The same where arms wait for parts and room anyway."""


def used_buffers(job: Job) -> list[str]:
    """Returns the names of the buffers that any stop uses, in the file's order."""
    used = {stop.buffer for task in job.tasks for stop in task.stops}
    return [name for name in job.buffers if name in used]


def job_stores(job: Job) -> Stores | None:
    """Returns a job's buffers as numbers, stops those of all tasks one after the other; None where none is used."""
    names = used_buffers(job)
    if not names:
        return None
    stops = [stop for task in job.tasks for stop in task.stops]
    change = np.zeros((len(stops) + 1, len(names)), dtype=np.int64)
    for k, stop in enumerate(stops):
        if stop.buffer:
            change[k, names.index(stop.buffer)] = stop.stored
    return Stores(
        change,
        np.array([job.buffers[name].capacity for name in names]),
        np.array([job.buffers[name].initial for name in names]),
    )


def stop_lasts(
    tasks: Sequence[Task],
    arms: Sequence[str],
    nodes: Mapping[tuple[str, int, int], StopNodes],
    f: int,
) -> FloatArray:
    """Returns how long before a stop is over its tool is there, and its dwell is over [s], shape (s, 2).

    Lines are taken to last half of what is not dwell each, at the least of all postures seen from an angle.

    Args:
        tasks: whose stops.
        arms: names of the arms.
        nodes: postures by arm, task and number of the stop.
        f: number of the platform angle.
    """
    rows = []
    for t, task in enumerate(tasks):
        for s, stop in enumerate(task.stops):
            own = [nodes[arm, t, s] for arm in arms if task.allows(arm)]
            work = min(float(one.work[one.angle == f].min(initial=np.inf)) for one in own)
            dwell = stop.dwell.total
            line = 0.5 * max(0.0, work - dwell) if np.isfinite(work) else 0.0
            rows.append((line + dwell, line))
    return np.array(rows).reshape(-1, 2)


def check_stage_levels(job: Job) -> None:
    """Raises InfeasibleError where a stage of a decided job takes a part that is not there, or has no room for one.

    Within a stage either arm may be the first at its target.
    """
    levels = {name: job.buffers[name].initial for name in used_buffers(job)}
    for number, work in enumerate(job.stages(), start=1):
        for name, level in levels.items():
            own = [(task, stop) for task, stop in work.values() if stop.buffer == name]
            puts = sum(stop.stored > 0 for _, stop in own)
            takes = len(own) - puts
            capacity = job.buffers[name].capacity
            if takes > level or (puts and level + puts > capacity):
                raise InfeasibleError(f"{_fault(number, name, own, level, capacity)}\n{HELPS}")
            levels[name] = level + puts - takes


def _fault(
    number: int, name: str, own: Sequence[tuple[Task, Stop]], level: int, capacity: int
) -> str:
    """Returns what is wrong with one buffer in a stage."""
    puts = [task.id for task, stop in own if stop.stored > 0]
    takes = [task.id for task, stop in own if stop.stored < 0]
    parts = []
    if puts:
        parts.append(f"{_names(puts)} {'put' if len(puts) > 1 else 'puts'} {len(puts)} in")
    if takes:
        parts.append(f"{_names(takes)} {'take' if len(takes) > 1 else 'takes'} {len(takes)} out")
    both = ", and either arm may be the first there" if puts and takes else ""
    return (
        f"{own[0][1].place}: buffer '{name}' holds {level} of at most {capacity} parts before stage {number}, in which "
        f"{' while '.join(parts)}{both}"
    )


def _names(ids: Sequence[str]) -> str:
    return " and ".join(f"'{name}'" for name in ids)


def served_pairing(job: Job) -> tuple[tuple[StopKey, ...], ...]:
    """Returns the stages of a decided job in which each arm makes its next stop as soon as buffers and `after` let it.

    Both arms make the stops of a hand-over in one stage.

    Raises:
        InfeasibleError: in the order that is given arms wait for parts, for room or for one another for ever.
    """
    stores = job_stores(job)
    assert stores is not None  # callers have looked
    stops = [(task, stop) for task in job.tasks for stop in task.stops]
    number = {(task.id, stop.action): k for k, (task, stop) in enumerate(stops)}
    index = {task.id: t for t, task in enumerate(job.tasks)}
    queues = [
        [number[task.id, stop.action] for task, stop in job.stops_of(arm.name)]
        for arm in job.cell.robot.arms
    ]
    found = any_alignment(
        stores,
        [[number[task.id, stop.action] for stop in task.stops] for task in job.tasks],
        [(index[name], t) for t, task in enumerate(job.tasks) for name in task.after],
        queues,
        [
            (number[task.id, "give"], number[task.id, "take"])
            for task in job.tasks
            if task.stops[-1].action == "give"
        ],
    )
    if not found.is_whole:
        waiting = [
            stops[queue[k]] for queue, k in zip(queues, found.at, strict=True) if k < len(queue)
        ]
        raise InfeasibleError(_waiting_for_ever(job, stores.after(found.slots).tolist(), waiting))
    return tuple(
        tuple((stops[k][0].arm, stops[k][0].id, stops[k][1].action) for k in row if k != IDLE)
        for row in found.slots.tolist()
    )


def _waiting_for_ever(job: Job, levels: Sequence[int], waiting: Sequence[tuple[Task, Stop]]) -> str:
    """Returns what arms wait for where an order that is given gets no farther."""
    holds = dict(zip(used_buffers(job), levels, strict=True))
    parts = []
    for task, stop in waiting:
        what = "for tasks that come later"
        if stop.action in ("give", "take"):
            what = "for the other arm"
        if stop.buffer:
            what = f"for {'room in' if stop.stored > 0 else 'a part in'} buffer '{stop.buffer}'"
            what += f" ({holds[stop.buffer]} of at most {job.buffers[stop.buffer].capacity})"
        parts.append(f"'{task.id}' waits {what} ({stop.action})")
    return (
        f"{waiting[0][1].place}: in the order that is given arms wait for ever, however one lets the other go first: "
        f"{' and '.join(parts)}\n{HELPS_FREE}"
    )


def begun(job: Job, done: Sequence[Task]) -> Job:
    """Returns a job whose buffers hold at the start what they hold after some tasks of it.

    Raises:
        InfeasibleError: one holds fewer parts then than none, or more than it has room for, in whatever order.
    """
    changed = {}
    for name, buffer in job.buffers.items():
        stops = [stop for task in done for stop in task.stops if stop.buffer == name]
        level = buffer.initial + sum(stop.stored for stop in stops)
        if not 0 <= level <= buffer.capacity:
            raise InfeasibleError(
                f"{stops[-1].place}: buffer '{name}' holds {level} parts after '{done[-1].id}', where it has to hold 0 "
                f"to {buffer.capacity}: what comes before a path or coordinate task is over when that begins; what "
                "helps is another order of the tasks, or other numbers (capacity, initial)"
            )
        changed[name] = replace(buffer, initial=level)
    return replace(job, buffers=changed)


def keeps_borders(job: Job) -> bool:
    """Returns whether every buffer holds no less than nothing, and no more than it has room for, after each section."""
    done: list[Task] = []
    for section in job.sections():
        done += section
        try:
            begun(job, done)
        except InfeasibleError:
            return False
    return True
