"""Stops at which a tool or its part comes too near to a part that waits or lies, whatever the arms do."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from dualarm_cli.collision.clearance import SLACK
from dualarm_cli.collision.lying import HeldBody, held_bodies, required, turned_poses, undercut
from dualarm_cli.collision.quick_test import OVERLAP
from dualarm_cli.collision.rooms import PartRoom, rooms_of
from dualarm_cli.collision.solids import WORLD, Solid, shape_solid
from dualarm_cli.geometry.products import norm
from dualarm_cli.model.cell import Cell
from dualarm_cli.model.job import Job, PoseTarget, Stop, Task
from dualarm_cli.model.lying import SAME_SPOT, Visit, may_touch
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class Crowded:
    """A stop that cannot be made while a part lies in a room."""

    task: Task
    """The task of the stop."""
    stop: Stop
    """A pick or a place."""
    room: PartRoom
    """Room of another task's part."""
    body: str
    """Name of the body that comes too near: a tool or the task's part."""
    distance: float
    """Greatest distance that some arm and turn leave [m]; negative: depth of overlap."""
    needed: float
    """Required distance [m]."""


def crowded_stops(job: Job) -> list[Crowded]:
    """List the stops that come too near to a part at another stop, for every arm and turn that the job allows."""
    rooms = [
        (room, [shape_solid("", WORLD, pin.SE3.Identity(), shape) for shape in room.shapes])
        for room in rooms_of(job)
    ]
    found = []
    for task in job.tasks if rooms else ():
        for stop in task.stops:
            posed = isinstance(stop.target, PoseTarget) and not stop.moves
            if stop.action not in ("pick", "place") or not posed:
                continue
            held = [
                held_bodies(job.cell, arm.name, task, stop)
                for arm in job.cell.robot.arms
                if task.allows(arm.name)
            ]
            for room, solids in rooms:
                if room.task.id == task.id or (stop.action == "pick" and is_same_spot(stop, room)):
                    continue
                if one := _crowded(job.cell, held, (task, stop), room, solids):
                    found.append(one)
    return found


def is_same_spot(stop: Stop, room: PartRoom) -> bool:
    """Return whether a stop's tool is where that of a room's stop is."""
    poses = [one.target.pose for one in (stop, room.stop) if isinstance(one.target, PoseTarget)]
    return len(poses) == 2 and bool(
        np.abs(poses[0].translation - poses[1].translation).max() <= SAME_SPOT
    )


def _crowded(
    cell: Cell,
    held: Sequence[Sequence[HeldBody]],
    visit: Visit,
    room: PartRoom,
    solids: Sequence[Solid],
) -> Crowded | None:
    """Find a body that comes too near to a part in its room; None where some arm and turn avoid it.

    Args:
        cell: with clearances.
        held: what each arm that may make the stop has there.
        visit: the stop with its task.
        room: of the part.
        solids: of the room.
    """
    (task, stop), found = visit, list[Crowded]()
    for bodies in held:
        needs = [
            (one, needed)
            for one in bodies
            if (needed := _needed(cell, one, task, room)) is not None
        ]
        if _is_far(needs, stop, solids):
            return None
        for T_world_tool in turned_poses(stop):
            lacking = [
                (undercut(one, T_world_tool, [(solid, needed) for solid in solids])[0], one, needed)
                for one, needed in needs
            ]
            lacks, one, needed = max(lacking, key=lambda row: row[0], default=(0.0, None, 0.0))
            if one is None or lacks <= 0.0:
                return None
            found.append(Crowded(task, stop, room, one.body, needed - lacks, needed))
    return max(found, key=lambda one: one.distance - one.needed, default=None)


def _is_far(needs: Sequence[tuple[HeldBody, float]], stop: Stop, solids: Sequence[Solid]) -> bool:
    """Return whether balls show that bodies are far from solids at every turn of a stop."""
    assert isinstance(stop.target, PoseTarget)  # asked for those only
    tip = stop.target.pose.translation
    reach = [one.line + needed + max(x.extent for x in one.solids) for one, needed in needs]
    apart = [
        norm(solid.pose.act(solid.geometry.aabb_center) - tip) - solid.geometry.aabb_radius
        for solid in solids
    ]
    return bool(min(apart) > max(reach, default=0.0))


def _needed(cell: Cell, one: HeldBody, task: Task, room: PartRoom) -> float | None:
    """Return the distance that a body must keep from a part in its room [m]; None where they may touch."""
    least = required(cell, one.body, room.task.part)
    if least is None:
        return None
    return -OVERLAP if one.body == task.part and may_touch(task, room.task) else least + SLACK
