"""Tool changes, put between the tasks of a decided job: two stops more wherever the next task asks for another tool."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from dualarm_cli.geometry.arrays import IntArray
from dualarm_cli.model.cell import Cell
from dualarm_cli.model.job import Action, Dwell, Job, PoseTarget, Stop, StopKey, Task
from dualarm_cli.orders.paired.problem import IDLE


def with_changes(job: Job) -> Job:
    """Returns a decided job in which every arm changes its tool where it has to; the job itself where none has to.

    Before a task with another tool than the one that is on, the arm leaves that at its stand and takes the other one.
    In a cycle the tool of the start is on again at its end. Where the job says what is paired with what, changes have
    stages of their own, the other arm idle.

    Args:
        job: which arm does what in which order.
    """
    if not job.cell.tool_changes or not job.is_decided or any(t.is_change for t in job.tasks):
        return job
    before, end = changes_of(job)
    tasks = [one for task in job.tasks for one in (*before[task.id], task)]
    if len(tasks) + len(end) == len(job.tasks):
        return job
    pairing = None if job.pairing is None else _with_stages(job, job.pairing, before, end)
    return replace(job, tasks=(*tasks, *end), pairing=pairing)


def changes_of(job: Job) -> tuple[dict[str, tuple[Task, ...]], tuple[Task, ...]]:
    """Returns what a decided job's arms do at stands before each task, by its id, and at the end."""
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
    """Returns a cell in which those tools are on from the start that are after some tasks, changes among them."""
    changes = dict(cell.tool_changes)
    for task in tasks:
        if task.arm in changes:
            on = "" if task.stops[-1].action == "leave_tool" else task.tool
            changes[task.arm] = replace(changes[task.arm], start=on)
    return replace(cell, tool_changes=changes)


def change_tasks(cell: Cell, arm: str, on: str, wanted: str, task: str) -> tuple[Task, ...]:
    """Returns how an arm comes from one tool to another: it leaves the one and takes the other, where there is one.

    Args:
        cell: has the tools and their stands.
        arm: that changes.
        on: the tool that is on; empty for none.
        wanted: the tool that shall be; empty for none.
        task: id of the task that it is wanted for; empty for the end of the cycle.
    """
    if on == wanted:
        return ()
    what = task or f"{arm} arm, at the end"
    leaving = (stand_task(cell, arm, on, "leave_tool", f"leave {on} ({what})"),) if on else ()
    if not wanted:
        return leaving
    return (*leaving, stand_task(cell, arm, wanted, "take_tool", f"take {wanted} ({what})"))


def stand_task(cell: Cell, arm: str, tool: str, action: Action, name: str) -> Task:
    """Returns an arm's stop at the stand of a tool, as a task of its own."""
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
    """Returns the stops at which each arm may leave each of its tools, and take it, as tasks."""
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
    """Returns what a task is called in any order: its id, of a visit to a stand what it is for whatever comes next."""
    if not task.is_change:
        return task.id
    return _stand_name(task.arm, task.tool, task.stops[0].action)


def paired_as(job: Job, slots: IntArray) -> Job:
    """Returns a decided job whose stops are made in some stages, each arm's in the job's order.

    Args:
        job: with its tool changes.
        slots: any stop's number where an arm makes one, IDLE where it has none, shape (n, arms).
    """
    rows = [iter(job.stops_of(arm.name)) for arm in job.cell.robot.arms]
    pairing = []
    for row in slots.tolist():
        made = [next(own) for own, k in zip(rows, row, strict=True) if k != IDLE]
        pairing.append(tuple((task.arm, task.id, stop.action) for task, stop in made))
    return replace(job, pairing=tuple(pairing))


def _with_stages(
    job: Job,
    pairing: Sequence[tuple[StopKey, ...]],
    before: dict[str, tuple[Task, ...]],
    end: tuple[Task, ...],
) -> tuple[tuple[StopKey, ...], ...]:
    """Returns a pairing with a stage for every change."""
    first = {task.id: task.stops[0].action for task in job.tasks}
    found: list[tuple[StopKey, ...]] = []
    for stage in pairing:
        for _, task, action in stage:
            if first[task] == action:
                found += [_stage(change) for change in before[task]]
        found.append(stage)
    return (*found, *(_stage(change) for change in end))


def _stage(change: Task) -> tuple[StopKey, ...]:
    return ((change.arm, change.id, change.stops[0].action),)
