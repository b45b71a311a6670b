"""Tools that arms change by themselves: from a cell file's section to the data model."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import combinations
from typing import Annotated

import numpy as np
import pinocchio as pin
from pydantic import Field, model_validator

from dualarm_cli.files.cells.cell_frames import frame_pose
from dualarm_cli.files.cells.cells import AddedToCell, CellReader, KindCell
from dualarm_cli.files.cells.schema_cell import CellFile, ShapeSection, ToolSection
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
from dualarm_cli.model.shape import Shape

NO_TOOL = "none"
"""What files call it that no tool is on."""
PARALLEL = 1e-6
"""How far a tool's z axis may lean from that of the arm's own tool [rad]."""
APART = 1e-3
"""Stands are at least so far apart [m]: where the arm is decides which tool is meant."""

ShapeReader = Callable[[ShapeSection, Loc, dict[str, pin.SE3]], Shape | None]


class ChangedToolSection(ToolSection):
    """A tool that an arm takes from its stand and leaves there."""

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
    """The tools that one arm changes by itself."""

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
    """The tools that each arm changes."""

    left: ArmChangesSection | None = Field(default=None, description="Those of the left arm.")
    right: ArmChangesSection | None = Field(default=None, description="Those of the right arm.")


class ToolChangesFile(CellFile):
    """A cell file that may have tools that arms change."""

    tool_changes: ToolChangesSection = Field(
        default=ToolChangesSection.model_construct(),
        description="Tools that arms change by themselves, by arm.",
    )


def read_tool_changes(
    reader: CellReader, model: CellFile, tools: dict[str, Tool], frames: dict[str, pin.SE3]
) -> AddedToCell:
    """Returns the tools that each arm changes, after noting what is wrong with them.

    Args:
        reader: of the cell file.
        model: its content.
        tools: what is always on each arm.
        frames: named frames in the world.
    """
    assert isinstance(model, ToolChangesFile)  # as the list of kinds has it
    document, findings = reader.document, reader.findings
    found = {}
    sections = {"left": model.tool_changes.left, "right": model.tool_changes.right}
    for arm, section in sections.items():
        if section is None:
            continue
        loc: Loc = ("tool_changes", arm)
        if arm not in tools:
            message = f"the robot has no {arm} arm; it has {', '.join(tools)}"
            findings.add(document, loc, message, key=True)
            continue
        found[arm] = _of_arm(reader, section, loc, tools[arm], frames)
    _check_stands(document, found, findings)
    _check_names(document, found, list(model.parts), findings)
    if found and model.limits.tool_speed is not None:
        message = (
            "a cap on the tools' speed does not go with tool_changes in this version: it is measured at the permanent "
            "tool, not at the changed ones; remove one of the two"
        )
        findings.add(document, ("limits", "tool_speed"), message, "E310")
    bodies: list[tuple[Loc, str]] = [
        (("tool_changes", arm, "tools", name), f"{arm}_{name}")
        for arm, own in found.items()
        for name in own.tools
    ]
    return AddedToCell({"tool_changes": found}, bodies)


def _of_arm(
    reader: CellReader,
    section: ArmChangesSection,
    loc: Loc,
    own: Tool,
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
        shapes = [reader.shape(s, (*place, "shapes", k), {}) for k, s in enumerate(entry.shapes)]
        tool = Tool(to_se3(entry.tcp), entry.mass, tuple(s for s in shapes if s))
        _check_axis(document, place, name, tool, own, findings)
        stand = _stand(document, entry, place, frames, findings)
        tools[name] = ChangedTool(tool, stand)
    known = [*tools, NO_TOOL]
    if section.start not in known:
        message = f"there is no tool {quote(section.start)}{suggest(section.start, known, 'tools')}"
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
    document: Document, place: Loc, name: str, tool: Tool, own: Tool, findings: Findings
) -> None:
    """Notes a tool whose z axis is not that of the arm's own: lines run along both."""
    z = own.tcp.actInv(tool.tcp).rotation[:, 2]
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
    """Notes stands that are at the same place."""
    stands = [
        (arm, name, one.stand.translation)
        for arm, own in changes.items()
        for name, one in own.tools.items()
    ]
    for (arm, name, here), (_, other, there) in combinations(stands, 2):
        if float(norm(here - there)) < APART:
            message = f"the stands of {quote(name)} and {quote(other)} are at the same place"
            findings.add(document, ("tool_changes", arm, "tools", name, "stand"), message)


def _check_names(
    document: Document,
    changes: Mapping[str, ToolChanges],
    parts: Sequence[str],
    findings: Findings,
) -> None:
    """Notes tools whose names could be taken for a part's, or for a tool with a part in it."""
    for arm, own in changes.items():
        others = {Held("", part).name for part in parts}
        for name in own.tools:
            mine = {Held(name, part).name for part in ("", *parts)}
            mine.add(Held(name, docking=True).name)
            if mine & others:
                message = f"{quote(name)} is also the name of a part or of another tool; choose another name"
                findings.add(document, ("tool_changes", arm, "tools", name), message, key=True)
            others |= mine


CELL_READING = KindCell(ToolChangesFile, read_tool_changes)
