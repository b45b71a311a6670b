"""Care of tasks and of the parts that they hold: limits of speed, acceleration and tilt."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from dualarm_cli.files.cells.cells import read_care
from dualarm_cli.files.cells.schema_cell import CareSection
from dualarm_cli.files.source.text_source import quote
from dualarm_cli.files.tasks.task_rules import NOT_AVAILABLE
from dualarm_cli.geometry.elementary import arctan2
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.model.job import PoseTarget, Task
from dualarm_cli.model.part_flow import NO_CARE, TILT_SPARE, Care, kind_of_part, part_as_held

if TYPE_CHECKING:
    from dualarm_cli.files.source.yaml_source import Loc
    from dualarm_cli.files.tasks.schema_tasks import TaskSection
    from dualarm_cli.files.tasks.task_reader import TaskReader
    from dualarm_cli.model.cell import Cell

KEYS = tuple(CareSection.model_fields)
"""Keys of care, in files and as fields of `Care`."""
VERTICAL = 1e-6
"""Largest sine of the angle between a vertical axis and the vertical."""


def with_care(
    reader: TaskReader, sections: Mapping[int, TaskSection]
) -> tuple[Cell, tuple[Task, ...]]:
    """Read the tasks of each arm with their care; note limits that they cannot keep.

    Parts of a kind that stay upright differently get names of their own in the cell.

    Args:
        reader: of the file; errors are noted there.
        sections: its valid tasks by their index.
    """
    tasks = reader.tasks(sections)
    cell = reader.cell
    indices = {section.id: index for index, section in sections.items()}
    for index, section in sections.items():
        shares = [task for task in tasks if task.id == section.id]
        given = [key for key in KEYS if getattr(section, key) is not None]
        holding = cell.care.get(kind_of_part(shares[0].part), NO_CARE) if shares else NO_CARE
        for key, message, code in _faults(section, shares, cell, given, holding):
            loc: Loc = ("tasks", index, key) if key in given else ("tasks", index, "part")
            named = (
                loc[-1]
                if key in given
                else f"while_holding of part {quote(kind_of_part(shares[0].part))}"
            )
            reader.note(loc, f"{named}: {message}", code)

    given_parts: dict[str, str] = {}
    upright: dict[str, list[object]] = {}

    def careful(task: Task) -> Task:
        nonlocal cell
        care = read_care(sections[indices[task.id]])
        holding, part = cell.care.get(kind_of_part(task.part), NO_CARE), task.part
        if task.stops and task.stops[0].action == "take" and task.grasp is None:
            part = part_as_held(given_parts[task.id], task.id)
        elif part:
            tilt = min(care.tilt, holding.tilt)
            kept = None if tilt == np.inf else (tilt, np.round(task.upright or (), 9).tolist())
            attitudes = upright.setdefault(part, [kept])
            if kept not in attitudes:
                attitudes.append(kept)
                cell = cell.with_held_part(part, f"{len(attitudes)}", pin.SE3.Identity())
            if (k := attitudes.index(kept)) > 0:
                part = part_as_held(part, f"{k + 1}")
        given_parts[task.id] = part
        grasps = tuple(map(careful, task.grasps))
        return replace(task, care=care, holding=holding, part=part, grasps=grasps)

    careful_tasks = tuple(map(careful, tasks))
    return cell, careful_tasks


def _faults(
    section: TaskSection, shares: Sequence[Task], cell: Cell, given: Sequence[str], holding: Care
) -> Iterator[tuple[str, str, str]]:
    """Find limits that a task cannot have: key, message and code."""
    picked = section.pick is not None and section.place is not None
    if not picked and section.move is None:
        return
    slowing = [key for key in KEYS if key in given or getattr(holding, key) < getattr(NO_CARE, key)]
    care = read_care(section).stricter(holding)
    if "tool_speed" in slowing and cell.tool_changes:
        message = "it is measured at the permanent tool, and this cell has tool_changes; remove it"
        yield "tool_speed", message, NOT_AVAILABLE
    belts = [stop.belt.conveyor for task in shares for stop in task.stops if stop.belt is not None]
    for belt in belts:
        if belt.speed >= care.tool_speed:
            yield (
                "tool_speed",
                f"{care.tool_speed * 1e3:.4g} mm/s, but the tool follows conveyor {quote(belt.name)}, which moves at "
                f"{belt.speed * 1e3:.4g} mm/s; raise it above that, or slow the conveyor",
                "E300",
            )
            break
    if "tilt" not in slowing:
        return
    if not picked:
        yield "tilt", "a bare move holds no part that could tilt; remove it", "E300"
        return
    choices = [choice for task in shares for choice in (task, *task.grasps)]
    faults = (message for choice in choices for message in _tilted(choice, care.tilt))
    yield from (("tilt", message, "E300") for message in islice(faults, 1))


def _tilted(task: Task, tilt: float) -> Iterator[str]:
    """Describe the stops at which a part has no attitude, or leans too much."""
    for stop in task.stops:
        target = stop.target
        if not isinstance(target, PoseTarget):
            yield f"joint positions at the {stop.action} give the part no attitude; give xyz, with rpy or quat"
            return
        turns = target.free_yaw or target.symmetry > 1
        if turns and norm(target.pose.rotation[:2, 2]) > VERTICAL:
            yield (
                f"at the {stop.action} the part may turn about the tool's z axis, which is not vertical there; "
                "remove 'free' or 'symmetry', or tilt"
            )
            return
    if task.upright is None:
        return
    for stop in task.stops:
        assert isinstance(stop.target, PoseTarget)  # others are noted above
        up = product(stop.target.pose.rotation, np.array(task.upright))
        angle = float(np.degrees(arctan2(norm(up[:2]), up[2])))
        if angle > (most := float(np.degrees(tilt - TILT_SPARE))):
            yield (
                f"at the {stop.action} the part leans {angle:.1f} deg from its attitude at the pick, and at a target "
                f"{most:.1f} deg are allowed; turn the target, or raise tilt"
            )
            return
