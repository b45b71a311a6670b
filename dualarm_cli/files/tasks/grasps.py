"""Grasps of tasks: from poses of a part to the tool's targets."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import replace
from itertools import permutations
from typing import TYPE_CHECKING

from dualarm_cli.files.cells.grasps import repeated
from dualarm_cli.files.cells.schema_cell import FreeSection, GraspSection
from dualarm_cli.files.source.text_source import quote, suggest
from dualarm_cli.model.job import ANY, PoseTarget, Stop, Task
from dualarm_cli.model.part_flow import Grasp, kind_of_part, part_as_held

if TYPE_CHECKING:
    from dualarm_cli.files.source.yaml_source import Loc
    from dualarm_cli.files.tasks.schema_tasks import TaskSection
    from dualarm_cli.files.tasks.task_reader import TaskReader
    from dualarm_cli.model.cell import Cell


def grasped(reader: TaskReader, section: TaskSection, loc: Loc, task: Task) -> list[Task]:
    """Build a task with each grasp that it may use; unchanged for a part without grasps.

    Args:
        reader: of the file; errors are noted there.
        section: the task as the file has it.
        loc: where it stands.
        task: the task with targets as the file has them.
    """
    grasps = reader.cell.grasps.get(task.part, {})
    if not grasps:
        if section.grasp is not None:
            part = (
                f"part {quote(task.part)} has no grasps"
                if task.part
                else "the task carries no part"
            )
            reader.note((*loc, "grasp"), f"{part}; name them in the cell file, or remove 'grasp'")
        return _leaning(reader, section, loc, task)
    refuse_leaning(reader, section, loc, "its part has grasps; give it to them in the cell file")
    allowed = allowed_grasps(reader, loc, task.part, section.grasp)
    if allowed is None or not are_posed(reader, section, loc):
        return [task]
    return [_by_grasp(reader, section, loc, task, grasp) for grasp in allowed]


def open_grasps(choices: Sequence[Task]) -> Task:
    """Build an open task from the task with each of its grasps."""
    arm = choices[0].arm if len({task.arm for task in choices}) == 1 else ANY
    return replace(choices[0], arm=arm, grasps=tuple(choices[1:] and choices))


def fitting(
    reader: TaskReader, loc: Loc, choices: Sequence[tuple[Task, ...]]
) -> list[tuple[Task, ...]]:
    """Select the grasps whose widths the tools open to, each with the arms of such tools.

    All of them after noting that there is none.

    Args:
        reader: of the file; errors are noted there.
        loc: where the task stands.
        choices: the task with each of its grasps; both shares of a hand-over.
    """
    cell, fits, misfits = reader.cell, list[tuple[Task, ...]](), list[str]()
    for shares in choices:
        orders = [o for o in permutations(reader.arms, len(shares)) if shares[0].allows(o[0])]
        good = []
        for order in orders:
            pairs = [
                (arm, task, cell.width(task.part)) for arm, task in zip(order, shares, strict=True)
            ]
            texts = [_misfit(cell, *pair) for pair in pairs]
            misfits += [text for text in texts if text and text not in misfits]
            good += [] if any(texts) else [order]
        if len(good) == len(orders):
            fits.append(shares)
        elif good:
            fits.append(tuple(_by_arm(task, good[0], k) for k, task in enumerate(shares)))
    if fits or not choices:
        return fits
    message = (
        "; ".join(misfits)
        + ": allow another grasp, arm or tool, or correct 'width' or 'opening' in the cell file"
    )
    reader.note(loc, message)
    return list(choices)


def _misfit(cell: Cell, arm: str, task: Task, width: float) -> str:
    """Say why an arm's tool does not suit a width [m]; empty if it does."""
    if cell.opens_to(arm, task.tool, width):
        return ""
    least, most = cell.opening(arm, task.tool)
    grasp = f" in grasp {quote(task.grasp.of)}" if task.grasp is not None else ""
    tool = f"tool {quote(task.tool)} of the {arm} arm" if task.tool else f"the {arm} tool"
    return (
        f"part {quote(kind_of_part(task.part))} is {1e3 * width:g} mm wide{grasp}, but {tool} opens from "
        f"{1e3 * least:g} to {1e3 * most:g} mm"
    )


def _by_arm(task: Task, order: Sequence[str], share: int) -> Task:
    """Assign a task to its arm, given those of all its shares in order."""
    work = task.handover and replace(task.handover, giver=order[0], taker=order[1])
    return replace(task, arm=order[share], handover=work)


def allowed_grasps(
    reader: TaskReader, loc: Loc, part: str, names: list[str] | None
) -> list[Grasp] | None:
    """List the named grasps of a part, with their turns.

    None after noting an error.

    Args:
        reader: of the file; errors are noted there.
        loc: mapping with the key `grasp`.
        part: a part with grasps.
        names: names in the file; None for all grasps.
    """
    chosen: dict[str, list[Grasp]] = {}
    for grasp in reader.cell.grasps[part].values():
        chosen.setdefault(grasp.of, []).append(grasp)
    names = list(chosen) if names is None else names
    if not _are_known(reader, loc, names, chosen):
        return None
    return [grasp for name in names for grasp in chosen[name]]


def refuse_leaning(reader: TaskReader, section: TaskSection, loc: Loc, why: str) -> None:
    """Note tilts and areas of a task's targets.

    Args:
        reader: of the file; errors are noted there.
        section: the task as the file has it.
        loc: where it stands.
        why: reason and remedy.
    """
    for action in ("pick", "place"):
        free = getattr(getattr(section, action), "free", None)
        if free is not None and free.leans:
            key = "tilt" if free.tilt else "area"
            reader.note((*loc, action, "free", key), f"{key}: {why}")


def _leaning(reader: TaskReader, section: TaskSection, loc: Loc, task: Task) -> list[Task]:
    """Build a task with each pose of the tool that its targets allow.

    The tool holds the part alike at pick and place.
    """
    frees = {
        stop.action: getattr(section, stop.action).free or FreeSection() for stop in task.stops
    }
    leaning = [action for action, free in frees.items() if free.leans]
    if not leaning:
        return [task]
    free = frees[leaning[0]]
    if any((f.tilt, f.area) != (free.tilt, free.area) for f in frees.values()):
        message = "the tool holds the part alike at pick and place; give both the same 'tilt' and 'area', or remove it"
        reader.note((*loc, leaning[0], "free"), message)
        return [task]
    choices = [task]
    for grasp in repeated("", GraspSection.model_construct(free=free), 1):
        if grasp.name:
            grasp = replace(grasp, name=grasp.name.removeprefix("/"))
            part = part_as_held(task.part, grasp.name)
            if task.part in reader.cell.parts and part not in reader.cell.parts:
                reader.cell = reader.cell.with_held_part(task.part, grasp.name, grasp.pose)
            stops = tuple(
                replace(stop, target=PoseTarget(stop.target.pose * grasp.pose))
                for stop in task.stops
                if isinstance(stop.target, PoseTarget)
            )
            choices.append(replace(task, stops=stops, part=part, grasp=grasp))
    return choices


def _are_known(reader: TaskReader, loc: Loc, names: list[str], grasps: Collection[str]) -> bool:
    """Check that a part has all named grasps; note unknown and repeated ones."""
    good = True
    for k, name in enumerate(names):
        if name in grasps and name not in names[:k]:
            continue
        message = f"{quote(name)} is in the list already; remove it"
        if name not in grasps:
            hint = suggest(name, list(grasps), "grasps")
            message = f"the part has no grasp {quote(name)}{hint}"
        reader.note((*loc, "grasp", k), message)
        good = False
    return good


def are_posed(reader: TaskReader, section: TaskSection, loc: Loc) -> bool:
    """Check that pick and place are poses of a part with grasps; note joint positions."""
    good = True
    for action in ("pick", "place"):
        target = getattr(section, action)
        if target is not None and target.by_joints is not None:
            message = (
                "the part has grasps, so its targets are poses of the part, which joint positions do not give; "
                "give xyz, with rpy or quat"
            )
            reader.note((*loc, action, target.by_joints), message)
            good = False
    return good


def _by_grasp(reader: TaskReader, section: TaskSection, loc: Loc, task: Task, grasp: Grasp) -> Task:
    """Build a task with one grasp."""
    stops = tuple(stop_by_grasp(reader, section, loc, stop, grasp) for stop in task.stops)
    return replace(task, stops=stops, part=part_as_held(task.part, grasp.name), grasp=grasp)


def stop_by_grasp(
    reader: TaskReader, section: TaskSection, loc: Loc, stop: Stop, grasp: Grasp
) -> Stop:
    """Build the stop of a tool with a grasp: T_world_tool = T_world_part T_part_tool.

    Args:
        reader: of the file; errors are noted there.
        section: the task as the file has it.
        loc: where it stands.
        stop: with the pose of the part.
        grasp: of the part.
    """
    target = stop.target
    assert isinstance(target, PoseTarget)  # others are refused before
    key = "free" if target.free_yaw else "symmetry"
    if (target.free_yaw or target.symmetry > 1) and not grasp.is_on_axis:
        message = (
            f"it turns the part about its z axis, which is not the tool's in grasp {quote(grasp.name)}; "
            f"remove {quote(key)}, or that grasp from the task, or give the part `symmetry`"
        )
        reader.note((*loc, stop.action, key), message)
    target = PoseTarget(
        target.pose * grasp.pose,
        target.free_yaw or grasp.free_yaw,
        math.lcm(target.symmetry, grasp.symmetry),
    )
    stop = replace(stop, target=target)
    for key in ("approach", "retract"):
        line, stated = getattr(grasp, key), (section, getattr(section, stop.action))
        if line is not None and all(getattr(keys, key) is None for keys in stated):
            directions = replace(stop.directions, **{key: line[1]})
            stop = replace(stop, directions=directions, **{key: line[0]})
    return stop
