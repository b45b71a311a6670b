"""Targets on conveyors in task files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from pydantic import Field, model_validator

from dualarm_cli.files.source.diagnostics import Findings
from dualarm_cli.files.source.fields import Duration, Name, Size, refuse
from dualarm_cli.files.source.text_source import quote, suggest
from dualarm_cli.files.source.yaml_source import Document, Loc
from dualarm_cli.files.tasks.schema_tasks import TargetSection, TaskSection, TasksFile
from dualarm_cli.files.tasks.task_reader import KindReading, TaskReader
from dualarm_cli.files.tasks.task_rules import NOT_AVAILABLE, incompatible_kinds, incompatible_tasks
from dualarm_cli.model.job import Stop, Task
from dualarm_cli.model.part_flow import OnBelt


class ConveyorTarget(TargetSection):
    """Schema of targets: optional conveyor, time of passing and largest travel."""

    conveyor: Name | None = Field(
        default=None, description="Conveyor of the cell that the target moves with."
    )
    passes: Duration | None = Field(
        default=None,
        description="When the part on the conveyor passes this pose, after the start [s].",
    )
    within: Size | None = Field(
        default=None,
        description="Largest travel of the part beyond this pose until the tool meets it [m].",
    )

    @model_validator(mode="after")
    def _whole_conveyor(self) -> ConveyorTarget:
        given = [key for key in ("passes", "within") if getattr(self, key) is not None]
        if self.conveyor is None:
            if given:
                raise refuse(f"'{given[0]}' is of a target on a conveyor; add 'conveyor'", given[0])
            return self
        if self.by_joints is not None:
            raise refuse(
                f"'conveyor' does not go with '{self.by_joints}', which stands still; give xyz, with rpy or quat",
                "conveyor",
            )
        missing = [key for key in ("passes", "within") if key not in given]
        if missing:
            what = {
                "passes": "when the part passes this pose",
                "within": "how far beyond it it may be met",
            }
            raise refuse(f"'{missing[0]}' is missing: {what[missing[0]]}", "conveyor", code="E202")
        return self


def check_apart(
    document: Document,
    tasks: Mapping[int, TaskSection],
    model: TasksFile | None,
    findings: Findings,
) -> None:
    """Report targets on conveyors in a file with tasks that exclude conveyors."""
    others = incompatible_tasks("conveyor", model.tasks) if model is not None else []
    for index, task in tasks.items() if others else ():
        for action in ("pick", "place"):
            target = getattr(task, action)
            if isinstance(target, ConveyorTarget) and target.conveyor is not None:
                message = (
                    f"conveyors do not go with {incompatible_kinds('conveyor')} (task {quote(others[0].id)}) in this "
                    "version; plan them in files of their own"
                )
                loc = ("tasks", index, action, "conveyor")
                findings.add(document, loc, message, NOT_AVAILABLE)


def on_belt(reader: TaskReader, section: TargetSection, loc: Loc, stop: Stop) -> Stop:
    """Attach a target's conveyor to its stop.

    After an error is reported, the returned stop rests.
    """
    assert isinstance(section, ConveyorTarget)  # the registry of kinds guarantees it
    if section.conveyor is None or section.passes is None or section.within is None:
        return stop
    place, conveyors = (*loc, "conveyor"), reader.cell.conveyors
    if stop.action == "move":
        message = "a move goes to a target at rest; 'conveyor' goes with pick and place"
        reader.note(place, message)
        return stop
    if section.conveyor not in conveyors:
        names = list(conveyors)
        hint = suggest(section.conveyor, names, "it has") if names else "; it has none"
        reader.note(place, f"the cell has no conveyor {quote(section.conveyor)}{hint}")
        return stop
    conveyor = conveyors[section.conveyor]
    return replace(stop, belt=OnBelt(conveyor, section.passes, section.within, section.passes))


def check_windows(reader: TaskReader, section: TaskSection, loc: Loc, task: Task) -> Task:
    """Report a task window without overlap with its part's meeting time.

    Args:
        reader: of the file.
        section: the task as the file has it.
        loc: its location in the file.
        task: the task that was read.
    """
    for stop in task.stops:
        belt = stop.belt
        if belt is None:
            continue
        if task.not_before > belt.last:
            key, says = "not_before", f"not_before: {task.not_before:g} s is after"
        elif task.not_after < belt.passes:
            key, says = "not_after", f"not_after: {task.not_after:g} s is before"
        else:
            continue
        message = (
            f"{says} the part of the {stop.action} may be met on conveyor {quote(belt.conveyor.name)}, from "
            f"{belt.passes:g} s (passes) to {belt.last:.3f} s (within)"
        )
        reader.note((*loc, key), message)
    return task


READING = KindReading(
    target_keys=ConveyorTarget, check=check_apart, stop=on_belt, task=check_windows
)
