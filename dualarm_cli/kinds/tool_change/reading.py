"""Tools of tasks, and targets in the frame of the arm's permanent tool."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pydantic import Field

from dualarm_cli.files.source.diagnostics import Findings
from dualarm_cli.files.source.fields import Name
from dualarm_cli.files.source.text_source import quote, suggest
from dualarm_cli.files.source.yaml_source import Document, Loc
from dualarm_cli.files.tasks.schema_tasks import DefaultsSection, TaskHead, TaskSection, TasksFile
from dualarm_cli.files.tasks.task_reader import KindReading, TaskReader
from dualarm_cli.files.tasks.task_rules import NOT_AVAILABLE
from dualarm_cli.kinds import of_kinds
from dualarm_cli.kinds.tool_change.cell_reading import NO_TOOL
from dualarm_cli.model.cell import Cell
from dualarm_cli.model.job import ANY, PoseTarget, Stop, Task
from dualarm_cli.model.lines import LineDirections

COAXIAL = 1e-6
"""Largest distance between the z axes of a tool and the arm's own [m].

It holds for targets that are free about z.
"""


class ToolTask(TaskHead):
    """Task that may name its tool."""

    tool: Name | None = Field(
        default=None,
        description="The tool for the task, one of the cell's tool_changes; none for no tool.",
    )


class ToolDefaults(DefaultsSection):
    """Defaults that may name the tool of tasks."""

    tool: Name | None = Field(default=None, description="The tool for all tasks; none for no tool.")


def check_tool_changes(
    document: Document, model: TasksFile, cell: Cell, findings: Findings
) -> None:
    """Report keys that cannot be combined with tool changes.

    Args:
        document: the task file.
        model: its content.
        cell: its cell.
        findings: receives the errors.
    """
    if not cell.tool_changes:
        if _default(model.defaults) is not None:
            message = "the cell has no tool_changes; remove 'tool'"
            findings.add(document, ("defaults", "tool"), message)
        return
    for index, task in enumerate(model.tasks):
        for kind in of_kinds("reading", "tool_change"):
            if getattr(task, kind.key) is not None:
                message = (
                    f"'{kind.key}' does not go with a cell that has tool_changes in this version; plan it with a cell "
                    "in which the tool is permanent (tools:)"
                )
                findings.add(document, ("tasks", index, kind.key), message, NOT_AVAILABLE)
        _check_name(document, index, task.id, cell, findings)
    if model.limits.tool_speed is not None:
        message = (
            "a cap on the tools' speed does not go with a cell that has tool_changes in this version: it is measured "
            "at the permanent tool; remove it"
        )
        findings.add(document, ("limits", "tool_speed"), message, NOT_AVAILABLE)


def _check_name(document: Document, index: int, name: str, cell: Cell, findings: Findings) -> None:
    """Report an id that could mean a visit to a stand."""
    for changes in cell.tool_changes.values():
        for tool in changes.tools:
            if name.startswith((f"take {tool} (", f"leave {tool} (")):
                message = f"{quote(name)} is the name of a visit to a stand; choose another id"
                findings.add(document, ("tasks", index, "id"), message)
                return


def with_tool(reader: TaskReader, section: TaskSection, loc: Loc, task: Task) -> Task:
    """Assign a task's tool, its arm, and targets in the permanent tool's frame.

    The arm is one that has the tool.

    Args:
        reader: of the file.
        section: the task as the file has it.
        loc: its location in the file.
        task: the task without a tool.
    """
    assert isinstance(section, ToolTask)  # the registry of kinds guarantees it
    arm, tool = _choose(reader, section, loc, task.arm)
    stops = [_in_own_frame(reader, stop, (*loc, stop.action), arm, tool) for stop in task.stops]
    grasp = task.grasp
    if grasp is not None and tool:
        capable = next(name for name in reader.arms if tool in reader.cell.tool_names(name))
        T_tool_own = reader.cell.T_own_tool(capable if arm == ANY else arm, tool).inverse()
        grasp = replace(grasp, pose=grasp.pose * T_tool_own)
    return replace(task, arm=arm, stops=tuple(stops), tool=tool, grasp=grasp)


def _default(defaults: DefaultsSection) -> str | None:
    """Return the tool of tasks that name none."""
    return defaults.tool if isinstance(defaults, ToolDefaults) else None


def _choose(reader: TaskReader, section: ToolTask, loc: Loc, arm: str) -> tuple[str, str]:
    """Choose arm (ANY for either) and tool (empty for none) of a task.

    Errors are reported.
    """
    cell, changes = reader.cell, reader.cell.tool_changes
    arms = reader.arms if arm == ANY else [arm]
    if not any(name in changes for name in arms):
        if section.tool not in (None, NO_TOOL):
            owner = "the cell has no tool_changes" if not changes else f"{arm} changes no tools"
            _note(reader, loc, section, f"{owner}; remove 'tool'")
        return arm, ""
    requested = section.tool if section.tool is not None else _default(reader.defaults)
    available = {tool for name in arms if name in changes for tool in changes[name].tools}
    if requested is None:
        message = (
            f"task {quote(section.id)} names no tool; give tool: or "
            f"defaults: {{tool: …}}, one of {', '.join([*sorted(available), NO_TOOL])}"
        )
        reader.note(loc, message, "E202")
        return arm, ""
    if requested == NO_TOOL:
        return arm, ""
    capable = [name for name in arms if requested in cell.tool_names(name)]
    if not capable:
        hint = suggest(requested, [*sorted(available), NO_TOOL], "tools")
        owner = "no arm has a" if arm == ANY else f"the {arm} arm has no"
        _note(reader, loc, section, f"{owner} tool {quote(requested)}{hint}")
        return arm, ""
    if len(capable) == len(arms) > 1:
        first, second = (cell.T_own_tool(name, requested) for name in capable)
        if not first.isApprox(second, COAXIAL):
            message = (
                f"tool {quote(requested)} is not the same on both arms (its tcp as the arm's own tcp has it), so its "
                "targets are not the same either: write arm: left or right"
            )
            _note(reader, loc, section, message)
    return (arm if len(capable) == len(arms) else capable[0]), requested


def _in_own_frame(reader: TaskReader, stop: Stop, loc: Loc, arm: str, tool: str) -> Stop:
    """Convert target and lines of a changed tool's centre point to the permanent tool's frame.

    T_world_own = T_world_target T_tool_own. Joint configurations stay.
    """
    target = stop.target
    if not tool:
        return stop
    capable = [name for name in reader.arms if tool in reader.cell.tool_names(name)]
    T_own_tool = reader.cell.T_own_tool(capable[0] if arm == ANY else arm, tool)
    approach, retract = stop.directions.approach, stop.directions.retract
    R = T_own_tool.rotation
    stop = replace(stop, directions=LineDirections(approach.in_frame(R), retract.in_frame(R)))
    if not isinstance(target, PoseTarget):
        return stop
    offset = float(np.hypot(*T_own_tool.translation[:2]))
    if offset > COAXIAL and (target.free_yaw or target.symmetry > 1):
        key = "free" if target.free_yaw else "symmetry"
        message = (
            f"turns about the z axis of tool {quote(tool)} are free here, but that axis is "
            f"{offset * 1e3:.3g} mm from the arm's own tool's (tool_changes: tcp); remove '{key}', or make the "
            "two coaxial"
        )
        reader.note((*loc, key), message)
    return replace(stop, target=replace(target, pose=target.pose * T_own_tool.inverse()))


def _note(reader: TaskReader, loc: Loc, section: ToolTask, message: str) -> None:
    place: Loc = (*loc, "tool") if section.tool is not None else ("defaults", "tool")
    reader.note(place, message)


READING = KindReading(
    task_keys=ToolTask,
    defaults_keys=ToolDefaults,
    check_cell=check_tool_changes,
    task=with_tool,
)
