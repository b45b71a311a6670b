"""Tool changes of cell files: from their section to the data model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Annotated

import numpy as np
import pinocchio as pin
from pydantic import Field, model_validator

from dualarm_cli.files.cells.cell_frames import frame_pose
from dualarm_cli.files.cells.cells import AddedToCell, CellReader, KindCell
from dualarm_cli.files.cells.schema_cell import CellFile, ToolSection
from dualarm_cli.files.source.diagnostics import Findings
from dualarm_cli.files.source.fields import (
    Duration,
    FramedPose,
    Name,
    Section,
    StraightLine,
    refuse,
    to_se3,
)
from dualarm_cli.files.source.text_source import quote, suggest
from dualarm_cli.files.source.yaml_source import Document, Loc
from dualarm_cli.geometry.elementary import arctan2
from dualarm_cli.geometry.products import norm
from dualarm_cli.model.cell import ChangedTool, Held, Tool, ToolChanges
from dualarm_cli.model.place import Place

NO_TOOL = "none"
"""Name of no tool in files."""
PARALLEL = 1e-6
"""Largest angle between z axes of a tool and the arm's own [rad]."""
LEAST_STAND_DISTANCE = 1e-3
"""Least distance between stands [m]. The arm's position decides which tool is meant."""


class ChangedToolSection(ToolSection):
    """Tool that an arm takes from its stand and leaves there."""

    stand: FramedPose = Field(
        description="Pose of the arm's own tool frame (tools: tcp) while it "
        "takes or leaves the tool; xyz must be given."
    )

    @model_validator(mode="after")
    def _somewhere(self) -> ChangedToolSection:
        if self.stand.xyz is None:
            raise refuse("the stand has no position; give its xyz", "stand", "E202")
        return self


class ArmChangesSection(Section):
    """Tool changes of one arm: its tools, start tool, stand time and lines."""

    start: Name = Field(
        description="The tool mounted at the start, and with return: true at the end; none for no tool."
    )
    time: Duration = Field(
        default=0.0,
        description="How long the arm stands still at a stand [s], each time it takes a tool and each time it leaves "
        "one: a change from one tool to another is two of these.",
    )
    approach: StraightLine = Field(
        default=0.0, description="Straight approach to a stand along the own tool's z axis [m]."
    )
    retract: StraightLine = Field(
        default=0.0, description="Straight retract from a stand along the own tool's z axis [m]."
    )
    tools: Annotated[dict[Name, ChangedToolSection], Field(min_length=1)] = Field(
        description="The tools, by name."
    )


class ToolChangesSection(Section):
    """Tool changes of each arm."""

    left: ArmChangesSection | None = Field(default=None, description="Those of the left arm.")
    right: ArmChangesSection | None = Field(default=None, description="Those of the right arm.")


class ToolChangesFile(CellFile):
    """Schema of cell files with the section `tool_changes`."""

    tool_changes: ToolChangesSection = Field(
        default=ToolChangesSection.model_construct(),
        description="Tools that arms change by themselves, by arm.",
    )


def read_tool_changes(
    reader: CellReader, model: CellFile, tools: dict[str, Tool], frames: dict[str, pin.SE3]
) -> AddedToCell:
    """Create the tools that each arm changes, and report errors.

    Args:
        reader: of the cell file.
        model: its content.
        tools: permanent tool of each arm.
        frames: named frames in the world.
    """
    assert isinstance(model, ToolChangesFile)  # the registry of kinds guarantees it
    document, findings = reader.document, reader.findings
    changes = {}
    sections = {"left": model.tool_changes.left, "right": model.tool_changes.right}
    for arm, section in sections.items():
        if section is None:
            continue
        loc: Loc = ("tool_changes", arm)
        if arm not in tools:
            message = f"the robot has no {arm} arm; it has {', '.join(tools)}"
            findings.add(document, loc, message, key=True)
            continue
        changes[arm] = _of_arm(reader, section, loc, tools[arm], frames)
    _check_stands(document, changes, findings)
    _check_names(document, changes, list(model.parts), findings)
    if changes and model.limits.tool_speed is not None:
        message = (
            "a cap on the tools' speed does not go with tool_changes in this version: it is measured at the permanent "
            "tool, not at the changed ones; remove one of the two"
        )
        findings.add(document, ("limits", "tool_speed"), message, "E310")
    bodies: list[tuple[Loc, str]] = [
        (("tool_changes", arm, "tools", name), f"{arm}_{name}")
        for arm, arm_changes in changes.items()
        for name in arm_changes.tools
    ]
    return AddedToCell({"tool_changes": changes}, bodies)


def _of_arm(
    reader: CellReader,
    section: ArmChangesSection,
    loc: Loc,
    permanent: Tool,
    frames: dict[str, pin.SE3],
) -> ToolChanges:
    document, findings = reader.document, reader.findings
    tools = {}
    for name, entry in section.tools.items():
        place: Loc = (*loc, "tools", name)
        if name == NO_TOOL:
            message = f"{quote(NO_TOOL)} means that no tool is mounted; choose another name"
            findings.add(document, place, message, key=True)
            continue
        tool = reader.tool(entry, place)
        _check_axis(document, place, name, tool, permanent, findings)
        stand = _stand(document, entry, place, frames, findings)
        tools[name] = ChangedTool(tool, stand)
    names = [*tools, NO_TOOL]
    if section.start not in names:
        message = f"there is no tool {quote(section.start)}{suggest(section.start, names, 'tools')}"
        findings.add(document, (*loc, "start"), message)
    start = "" if section.start == NO_TOOL else section.start
    line, column = document.place(loc)
    return ToolChanges(
        tools,
        start,
        section.time,
        section.approach,
        section.retract,
        Place(document.source.name, line, column),
    )


def _stand(
    document: Document,
    entry: ChangedToolSection,
    place: Loc,
    frames: dict[str, pin.SE3],
    findings: Findings,
) -> pin.SE3:
    T_world_frame = frame_pose(document, (*place, "stand", "in"), entry.stand.in_, frames, findings)
    if T_world_frame is None:
        return pin.SE3.Identity()
    T_world_own: pin.SE3 = T_world_frame * to_se3(entry.stand)
    return T_world_own


def _check_axis(
    document: Document, place: Loc, name: str, tool: Tool, permanent: Tool, findings: Findings
) -> None:
    """Report a tool whose z axis differs from the permanent tool's.

    Lines run along both.
    """
    z = permanent.tcp.actInv(tool.tcp).rotation[:, 2]
    lean = float(arctan2(np.hypot(z[0], z[1]), z[2]))
    if lean > PARALLEL:
        message = (
            f"the z axis of tool {quote(name)} leans by {np.degrees(lean):.4g} deg from that of the permanent tool "
            "(tools: tcp); lines run along both axes, so make the two parallel"
        )
        findings.add(document, (*place, "tcp"), message)


def _check_stands(
    document: Document, changes: Mapping[str, ToolChanges], findings: Findings
) -> None:
    """Report stands at the same place."""
    stands = [
        (arm, name, tool.stand.translation)
        for arm, arm_changes in changes.items()
        for name, tool in arm_changes.tools.items()
    ]
    for (arm, name, position_a), (_, other_name, position_b) in combinations(stands, 2):
        if float(norm(position_a - position_b)) < LEAST_STAND_DISTANCE:
            message = f"the stands of {quote(name)} and {quote(other_name)} are at the same place"
            findings.add(document, ("tool_changes", arm, "tools", name, "stand"), message)


def _check_names(
    document: Document,
    changes: Mapping[str, ToolChanges],
    parts: Sequence[str],
    findings: Findings,
) -> None:
    """Report tool names that are also names of parts or loaded tools."""
    for arm, arm_changes in changes.items():
        others = {Held("", part).name for part in parts}
        for name in arm_changes.tools:
            mine = {Held(name, part).name for part in ("", *parts)}
            mine.add(Held(name, docking=True).name)
            if mine & others:
                message = f"{quote(name)} is also the name of a part or of another tool; choose another name"
                findings.add(document, ("tool_changes", arm, "tools", name), message, key=True)
            others |= mine


CELL_READING = KindCell(ToolChangesFile, read_tool_changes)
