"""Buffers of a job as numbers, and their levels in decided jobs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.job import Job, Stop, StopKey, Task
from dualarm_cli.orders.paired.alignment import any_alignment
from dualarm_cli.orders.paired.problem import IDLE
from dualarm_cli.orders.rules.stores import Stores
from dualarm_cli.refusals import Refusal
from dualarm_cli.stages.plans.candidates import Nodes


def used_buffers(job: Job) -> list[str]:
    """List the names of the used buffers, in the file's order."""
    used = {stop.buffer for task in job.tasks for stop in task.stops}
    return [name for name in job.buffers if name in used]


def job_stores(job: Job) -> Stores | None:
    """Build a job's buffers as numbers, stops task by task.

    None without buffers.
    """
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
    nodes: Mapping[tuple[str, int, int], Nodes],
    f: int,
) -> FloatArray:
    """Estimate arrival and dwell end before each stop's end [s], shape (s, 2).

    The two lines of a stop are assumed to take equal times, in the quickest posture at the angle.

    Args:
        tasks: tasks of the stops.
        arms: names of the arms.
        nodes: postures by arm, task and number of the stop.
        f: number of the platform angle.
    """
    rows = []
    for t, task in enumerate(tasks):
        for s, stop in enumerate(task.stops):
            arm_nodes = [nodes[arm, t, s] for arm in arms if task.allows(arm)]
            work = min(float(n.work[n.angle_index == f].min(initial=np.inf)) for n in arm_nodes)
            dwell = stop.dwell.total
            line = 0.5 * max(0.0, work - dwell) if np.isfinite(work) else 0.0
            rows.append((line + dwell, line))
    return np.array(rows).reshape(-1, 2)


def check_stage_levels(job: Job) -> None:
    """Raise InfeasibleError if a decided job's stage lacks a part or room.

    Within a stage either arm may be the first at its target.
    """
    levels = {name: job.buffers[name].initial for name in used_buffers(job)}
    for number, work in enumerate(job.stages(), start=1):
        for name, level in levels.items():
            uses = [(task, stop) for task, stop in work.values() if stop.buffer == name]
            puts = sum(stop.stored > 0 for _, stop in uses)
            takes = len(uses) - puts
            capacity = job.buffers[name].capacity
            if takes > level or (puts and level + puts > capacity):
                raise InfeasibleError(_fault(number, name, uses, level, capacity))
            levels[name] = level + puts - takes


def _fault(
    number: int, name: str, uses: Sequence[tuple[Task, Stop]], level: int, capacity: int
) -> Refusal:
    """Build the refusal of a stage that violates a buffer."""
    puts = [task.id for task, stop in uses if stop.stored > 0]
    takes = [task.id for task, stop in uses if stop.stored < 0]
    details = {
        "buffer": name,
        "stage": number,
        "causes": [
            Refusal(key, data={"names": names})
            for key, names in (("puts", puts), ("takes", takes))
            if names
        ],
        "either": [Refusal("either_first")] if puts and takes else [],
    }
    task, stop = uses[0]
    return Refusal("buffer_in_stage", stop.place, task.id, "", level, capacity, data=details)


def served_pairing(job: Job) -> tuple[tuple[StopKey, ...], ...]:
    """Pair a decided job's stops, each as early as its rules allow.

    The rules are buffers and `after`.

    Both arms make the stops of a hand-over in one stage.

    Raises:
        InfeasibleError: the given order ends in a deadlock.
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
    alignment = any_alignment(
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
    if not alignment.is_whole:
        waiting = [
            stops[queue[k]] for queue, k in zip(queues, alignment.at, strict=True) if k < len(queue)
        ]
        raise InfeasibleError(
            _waiting_forever(job, stores.after(alignment.slots).tolist(), waiting)
        )
    return tuple(
        tuple((stops[k][0].arm, stops[k][0].id, stops[k][1].action) for k in row if k != IDLE)
        for row in alignment.slots.tolist()
    )


def _waiting_forever(
    job: Job, levels: Sequence[int], waiting: Sequence[tuple[Task, Stop]]
) -> Refusal:
    """Build the refusal of an order that ends in a deadlock, with its causes."""
    parts = dict(zip(used_buffers(job), levels, strict=True))
    causes = []
    for task, stop in waiting:
        cause = "waits_for_arm" if stop.action in ("give", "take") else "waits_for_tasks"
        level = capacity = None
        if stop.buffer:
            cause = "waits_for_room" if stop.stored > 0 else "waits_for_part"
            level, capacity = parts[stop.buffer], job.buffers[stop.buffer].capacity
        details = {"action": stop.action, "buffer": stop.buffer}
        causes.append(Refusal(cause, None, task.id, task.arm, level, capacity, data=details))
    first, stop = waiting[0]
    return Refusal("arms_wait_forever", stop.place, first.id, data={"causes": causes})


def with_levels_after(job: Job, finished: Sequence[Task]) -> Job:
    """Set the initial levels of buffers to those after some tasks.

    Raises:
        InfeasibleError: a level is negative or above the capacity, whatever the order.
    """
    changed = {}
    for name, buffer in job.buffers.items():
        stops = [stop for task in finished for stop in task.stops if stop.buffer == name]
        level = buffer.initial + sum(stop.stored for stop in stops)
        if not 0 <= level <= buffer.capacity:
            details = {"buffer": name}
            place = stops[-1].place, finished[-1].id, "", level, buffer.capacity
            raise InfeasibleError(Refusal("buffer_at_border", *place, data=details))
        changed[name] = replace(buffer, initial=level)
    return replace(job, buffers=changed)


def keeps_borders(job: Job) -> bool:
    """Test whether all levels are feasible after each section."""
    finished: list[Task] = []
    for section in job.sections():
        finished += section
        try:
            with_levels_after(job, finished)
        except InfeasibleError:
            return False
    return True
