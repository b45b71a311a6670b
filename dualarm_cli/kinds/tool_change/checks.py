"""Check that every task has its tool mounted, from events at tool stands."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import field

from dualarm_cli.geometry.products import norm
from dualarm_cli.model.dwell import Dwell
from dualarm_cli.model.job import Action, Job, PoseTarget, Stop, Task
from dualarm_cli.model.schedule import Event, Schedule
from dualarm_cli.model.verification import Check
from dualarm_cli.records import dataclass
from dualarm_cli.verification.as_done import is_change
from dualarm_cli.verification.kind_checks import KindChecks
from dualarm_cli.verification.measuring.criteria import NO_TASKS, Criterion, judge, not_checked

NAME = "tool_changes"
CRITERIA = {
    NAME: Criterion(
        "",
        "Tasks with another tool on than theirs, and changes that are impossible or needless.",
        "the cell has no tools to change",
    )
}


def tool_at(event: Event, job: Job) -> str:
    """Find the tool whose stand is nearest to an event.

    The check of targets judges the distance.
    """
    tools = job.cell.tool_changes[event.arm].tools
    position = event.pose.translation
    return min(tools, key=lambda name: float(norm(tools[name].stand.translation - position)))


def change_tasks(schedule: Schedule, job: Job) -> list[tuple[float, Task]]:
    """Create tasks from the tool changes of a schedule, with their times [s].

    The checks of targets, lines and dwells use them.

    Args:
        schedule: the schedule.
        job: its job, whose cell has tools and stands.
    """
    names = {task.id for task in job.tasks}
    tasks: dict[str, tuple[float, Task]] = {}
    for event in sorted(schedule.events, key=lambda event: event.time):
        if not is_change(event, job) or event.task in names or event.task in tasks:
            continue
        changes, tool = job.cell.tool_changes[event.arm], tool_at(event, job)
        action: Action = "take_tool" if event.action == "take_tool" else "leave_tool"
        stop = Stop(
            action,
            PoseTarget(changes.tools[tool].stand),
            changes.approach,
            changes.retract,
            Dwell(gripper=changes.time),
            changes.place,
        )
        tasks[event.task] = event.time, Task(event.task, event.arm, (stop,), tool=tool)
    return list(tasks.values())


def check_tool_changes(schedule: Schedule, job: Job | None) -> Check:
    """Check that tasks have their tools, and that changes are possible and needed.

    A tool is taken by an arm without a tool, and left at its own stand, never within a task. A cycle ends with the tool
    of its start. Every visit to a stand has a unique name.

    Args:
        schedule: the schedule.
        job: as read from its file; None without a task file.
    """
    if job is None:
        return not_checked(NAME, NO_TASKS)
    if not job.cell.tool_changes:
        return not_checked(NAME)
    faults: list[str] = []
    for arm in job.cell.tool_changes:
        events = sorted((e for e in schedule.events if e.arm == arm), key=lambda e: e.time)
        faults += _Hand(arm, job).faults_of(events)
    # No other check finds repeated names: targets, lines and dwells are matched by name.
    named = Counter(event.task for event in schedule.events if is_change(event, job))
    faults += [
        f"{task} is the name of {count} visits to stands"
        for task, count in named.items()
        if count > 1
    ]
    detail = faults[0] if faults else "every task with its tool mounted"
    return judge(NAME, len(faults), 0, detail)


@dataclass
class _Hand:
    """Tools of one arm, followed through its events."""

    arm: str
    job: Job
    faults: list[str] = field(default_factory=list)

    def faults_of(self, events: Sequence[Event]) -> list[str]:
        """List the faults in the order of the events."""
        start = self.job.cell.start_tool(self.arm)
        tasks = {task.id: task for task in self.job.tasks}
        on, open_task = start, ""
        # Tool of the last task, while a change is in progress.
        before: str | None = None
        for event in events:
            if is_change(event, self.job):
                if event.task in tasks:
                    self._note(f"{event.task} is the id of a task, {event.action} bears it too")
                if open_task:
                    self._note(f"{event.task} is done within {open_task}")
                first = before is None
                before = on if before is None else before
                on = self._changed(event, on, first=first)
                continue
            task = tasks.get(event.task)
            if task is None:
                continue  # the check of the order finds unknown tasks
            if task.tool != on:
                done, due = (f"tool {name}" if name else "no tool" for name in (on, task.tool))
                self._note(f"{event.task} {event.action} has {done} mounted; it needs {due}")
            if before is not None and before == on:
                self._note(f"{before or 'no tool'} was already mounted before {event.task}")
            before = None
            open_task = event.task if event.action != task.stops[-1].action else ""
        closes = self.job.returns and on == start
        if before is not None and (not closes or before == on):
            self._note(f"tools are changed after the last task, to {on or 'none'}, for nothing")
        if self.job.returns and on != start:
            self._note(f"{on or 'no tool'} is mounted at the end, {start or 'none'} at the start")
        return self.faults

    def _changed(self, event: Event, on: str, *, first: bool) -> str:
        """Return the mounted tool after one was taken or left; `first` after a task."""
        tool = tool_at(event, self.job)
        if event.action == "leave_tool":
            if not on:
                self._note(f"{event.task}: {tool} is left, but no tool is mounted")
            elif on != tool:
                self._note(f"{event.task}: {on} is left at the stand of {tool}")
            elif not first:
                self._note(f"{event.task}: {tool} is left without having been used for a task")
            return ""
        if on:
            self._note(f"{event.task}: {tool} is taken while {on} is mounted")
        return tool

    def _note(self, fault: str) -> None:
        self.faults.append(f"{self.arm} arm: {fault}")


CHECKS = KindChecks(
    {"order": lambda case: [check_tool_changes(case.schedule, case.job)]},
    CRITERIA,
    added=change_tasks,
)
