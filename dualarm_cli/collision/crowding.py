"""Stops at which a tool or its part comes too near to a part that waits or lies, whatever the arms do."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from dualarm_cli.collision.clearance import SLACK
from dualarm_cli.collision.lying import HeldBody, held_bodies, required, turned_poses, undercut
from dualarm_cli.collision.quick_test import OVERLAP
from dualarm_cli.collision.rooms import PartRoom, rooms_of
from dualarm_cli.collision.solids import WORLD, shape_solid
from dualarm_cli.model.cell import Cell
from dualarm_cli.model.job import Job, PoseTarget, Stop, Task
from dualarm_cli.model.lying import SAME_SPOT, may_touch
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class Crowded:
    """A stop that cannot be made while a part lies in a room."""

    task: Task
    """The task of the stop."""
    stop: Stop
    """A pick or a place."""
    room: PartRoom
    """Of another task's part."""
    body: str
    """What comes too near: a tool or the task's part."""
    distance: float
    """How far apart they are at best; negative: how deep they reach into one another [m]."""
    needed: float
    """How far apart they must be [m]."""


def crowded_stops(job: Job) -> list[Crowded]:
    """List the stops that come too near to a part at another stop, for every arm and turn that the job allows."""
    rooms = rooms_of(job)
    found = []
    for task in job.tasks if rooms else ():
        for stop in task.stops:
            if stop.action not in ("pick", "place") or stop.moves:
                continue
            near = [room for room in rooms if room.task.id != task.id]
            for room in near if isinstance(stop.target, PoseTarget) else ():
                if one := _crowded(job, task, stop, room):
                    found.append(one)
    return found


def is_same_spot(stop: Stop, room: PartRoom) -> bool:
    """Return whether a stop's tool is where that of a room's stop is."""
    poses = [one.target.pose for one in (stop, room.stop) if isinstance(one.target, PoseTarget)]
    return len(poses) == 2 and bool(
        np.abs(poses[0].translation - poses[1].translation).max() <= SAME_SPOT
    )


def _crowded(job: Job, task: Task, stop: Stop, room: PartRoom) -> Crowded | None:
    """Return what comes too near to a part in its room; None where some arm and turn avoid it."""
    if stop.action == "pick" and is_same_spot(stop, room):
        return None
    found: list[Crowded] = []
    solids = [shape_solid("", WORLD, pin.SE3.Identity(), shape) for shape in room.shapes]
    for arm in filter(task.allows, [arm.name for arm in job.cell.robot.arms]):
        needs = [
            (one, needed)
            for one in held_bodies(job.cell, arm, task, stop)
            if (needed := _needed(job.cell, one, task, room)) is not None
        ]
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


def _needed(cell: Cell, one: HeldBody, task: Task, room: PartRoom) -> float | None:
    """Return the distance that a body must keep from a part in its room [m]; None where they may touch."""
    least = required(cell, one.body, room.task.part)
    if least is None:
        return None
    return -OVERLAP if one.body == task.part and may_touch(task, room.task) else least + SLACK
