"""Buffers of a job as numbers, and whether the stages of a decided job keep them."""

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
    nodes: Mapping[tuple[str, int, int], Nodes],
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
            work = min(float(one.work[one.angle_index == f].min(initial=np.inf)) for one in own)
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
                raise InfeasibleError(_fault(number, name, own, level, capacity))
            levels[name] = level + puts - takes


def _fault(
    number: int, name: str, own: Sequence[tuple[Task, Stop]], level: int, capacity: int
) -> Refusal:
    """Returns what is wrong with one buffer in a stage."""
    puts = [task.id for task, stop in own if stop.stored > 0]
    takes = [task.id for task, stop in own if stop.stored < 0]
    more = {
        "buffer": name,
        "stage": number,
        "causes": [
            Refusal(what, more={"names": names})
            for what, names in (("puts", puts), ("takes", takes))
            if names
        ],
        "either": [Refusal("either_first")] if puts and takes else [],
    }
    task, stop = own[0]
    return Refusal("buffer_in_stage", stop.place, task.id, "", level, capacity, more=more)


def served_pairing(job: Job) -> tuple[tuple[StopKey, ...], ...]:
    """Returns the stages of a decided job in which each arm makes its next stop as soon as buffers and `after` let it.

    Both arms make the stops of a hand-over in one stage.

    Raises:
        InfeasibleError: in the order that is given arms wait for parts, for room or for one another forever.
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
        raise InfeasibleError(_waiting_forever(job, stores.after(found.slots).tolist(), waiting))
    return tuple(
        tuple((stops[k][0].arm, stops[k][0].id, stops[k][1].action) for k in row if k != IDLE)
        for row in found.slots.tolist()
    )


def _waiting_forever(
    job: Job, levels: Sequence[int], waiting: Sequence[tuple[Task, Stop]]
) -> Refusal:
    """Returns what arms wait for where an order that is given gets no farther."""
    holds = dict(zip(used_buffers(job), levels, strict=True))
    causes = []
    for task, stop in waiting:
        what = "waits_for_arm" if stop.action in ("give", "take") else "waits_for_tasks"
        level = capacity = None
        if stop.buffer:
            what = "waits_for_room" if stop.stored > 0 else "waits_for_part"
            level, capacity = holds[stop.buffer], job.buffers[stop.buffer].capacity
        more = {"action": stop.action, "buffer": stop.buffer}
        causes.append(Refusal(what, None, task.id, task.arm, level, capacity, more=more))
    first, stop = waiting[0]
    return Refusal("arms_wait_forever", stop.place, first.id, more={"causes": causes})


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
            more = {"buffer": name}
            found = stops[-1].place, done[-1].id, "", level, buffer.capacity
            raise InfeasibleError(Refusal("buffer_at_border", *found, more=more))
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
