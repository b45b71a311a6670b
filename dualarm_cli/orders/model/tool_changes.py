"""Tool changes between the tasks of a decided job: two further stops per change."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from dualarm_cli.geometry.arrays import IntArray
from dualarm_cli.model.cell import Cell
from dualarm_cli.model.dwell import Dwell
from dualarm_cli.model.job import Action, Job, PoseTarget, Stop, StopKey, Task
from dualarm_cli.orders.paired.problem import IDLE


def with_changes(job: Job) -> Job:
    """Insert all required tool changes into a decided job.

    Before a task with another tool the arm leaves its tool at the stand and takes the required one. In a cycle the tool
    of the start is taken again at the end. In a job with given pairing each change is a stage of its own, with the
    other arm idle. Without changes the job itself is returned.

    Args:
        job: a decided job.
    """
    if not job.cell.tool_changes or not job.is_decided or any(t.is_change for t in job.tasks):
        return job
    before, end = changes_of(job)
    tasks = [inserted for task in job.tasks for inserted in (*before[task.id], task)]
    if len(tasks) + len(end) == len(job.tasks):
        return job
    pairing = None if job.pairing is None else _with_stages(job, job.pairing, before, end)
    return replace(job, tasks=(*tasks, *end), pairing=pairing)


def changes_of(job: Job) -> tuple[dict[str, tuple[Task, ...]], tuple[Task, ...]]:
    """List the tool changes before each task, by its id, and at the end."""
    on = {arm.name: job.cell.start_tool(arm.name) for arm in job.cell.robot.arms}
    before: dict[str, tuple[Task, ...]] = {}
    for task in job.tasks:
        before[task.id] = change_tasks(job.cell, task.arm, on[task.arm], task.tool, task.id)
        on[task.arm] = task.tool
    end = tuple(
        change
        for arm, tool in on.items()
        if job.returns
        for change in change_tasks(job.cell, arm, tool, job.cell.start_tool(arm), "")
    )
    return before, end


def cell_after(cell: Cell, tasks: Sequence[Task]) -> Cell:
    """Update a cell's start tools to those after tasks and tool changes."""
    changes = dict(cell.tool_changes)
    for task in tasks:
        if task.arm in changes:
            on = "" if task.stops[-1].action == "leave_tool" else task.tool
            changes[task.arm] = replace(changes[task.arm], start=on)
    return replace(cell, tool_changes=changes)


def change_tasks(cell: Cell, arm: str, current: str, required: str, task: str) -> tuple[Task, ...]:
    """List the stops of a tool change: leave old, take new.

    Args:
        cell: cell with tools and stands.
        arm: name of the arm.
        current: current tool; empty for none.
        required: required tool; empty for none.
        task: id of the task that requires it; empty for the end of the cycle.
    """
    if current == required:
        return ()
    purpose = task or f"{arm} arm, at the end"
    leaving = (
        (stand_task(cell, arm, current, "leave_tool", f"leave {current} ({purpose})"),)
        if current
        else ()
    )
    if not required:
        return leaving
    return (*leaving, stand_task(cell, arm, required, "take_tool", f"take {required} ({purpose})"))


def stand_task(cell: Cell, arm: str, tool: str, action: Action, name: str) -> Task:
    """Build a task of one stop at the stand of a tool."""
    changes = cell.tool_changes[arm]
    stop = Stop(
        action,
        PoseTarget(changes.tools[tool].stand),
        changes.approach,
        changes.retract,
        Dwell(gripper=changes.time),
        changes.place,
    )
    return Task(name, arm, (stop,), place=changes.place, tool=tool)


def stand_tasks(cell: Cell) -> tuple[Task, ...]:
    """List all tasks at stands: each arm leaves and takes its tools."""
    actions: tuple[Action, ...] = ("leave_tool", "take_tool")
    return tuple(
        stand_task(cell, arm, tool, action, _stand_name(arm, tool, action))
        for arm, changes in cell.tool_changes.items()
        for tool in changes.tools
        for action in actions
    )


def _stand_name(arm: str, tool: str, action: str) -> str:
    return f"{action.split('_')[0]} {tool} ({arm} arm)"


def stop_name(task: Task) -> str:
    """Build a task's name in any order.

    It is the task's id, or tool and arm of a visit to a stand.
    """
    if not task.is_change:
        return task.id
    return _stand_name(task.arm, task.tool, task.stops[0].action)


def paired_as(job: Job, slots: IntArray) -> Job:
    """Pair a decided job's stops into stages, in order on each arm.

    Args:
        job: decided job with its tool changes.
        slots: any number for a stop of an arm, IDLE for none, shape (n, arms).
    """
    rows = [iter(job.stops_of(arm.name)) for arm in job.cell.robot.arms]
    pairing = []
    for row in slots.tolist():
        stops = [next(remaining) for remaining, k in zip(rows, row, strict=True) if k != IDLE]
        pairing.append(tuple((task.arm, task.id, stop.action) for task, stop in stops))
    return replace(job, pairing=tuple(pairing))


def _with_stages(
    job: Job,
    pairing: Sequence[tuple[StopKey, ...]],
    before: dict[str, tuple[Task, ...]],
    end: tuple[Task, ...],
) -> tuple[tuple[StopKey, ...], ...]:
    """Insert a stage for every change into a pairing."""
    first = {task.id: task.stops[0].action for task in job.tasks}
    stages: list[tuple[StopKey, ...]] = []
    for stage in pairing:
        for _, task, action in stage:
            if first[task] == action:
                stages += [_stage(change) for change in before[task]]
        stages.append(stage)
    return (*stages, *(_stage(change) for change in end))


def _stage(change: Task) -> tuple[StopKey, ...]:
    return ((change.arm, change.id, change.stops[0].action),)
