"""Stops that lack clearance from a lying part in any posture."""

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
from dualarm_cli.model.lying import SAME_SPOT, Visit, may_touch, spot
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class Crowded:
    """Stop that is infeasible while a part lies in a room."""

    task: Task
    """Task of the stop."""
    stop: Stop
    """Stop: a pick or a place."""
    room: PartRoom
    """Room of another task's part."""
    body: str
    """Name of the body that lacks clearance: a tool or the task's part."""
    distance: float
    """Largest feasible distance over arms and yaws [m]; negative for overlap."""
    needed: float
    """Required distance [m]."""


def crowded_stops(job: Job) -> list[Crowded]:
    """List the stops that lack clearance from a lying part for all arms and yaws."""
    rooms = [
        (room, [shape_solid("", WORLD, pin.SE3.Identity(), shape) for shape in room.shapes])
        for room in rooms_of(job)
    ]
    crowded_list = []
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
                if room.task.id == task.id or (
                    stop.action == "pick" and is_same_spot((task, stop), room)
                ):
                    continue
                if crowded := _crowded(job.cell, held, (task, stop), room, solids):
                    crowded_list.append(crowded)
    return crowded_list


def is_same_spot(visit: Visit, room: PartRoom) -> bool:
    """Check whether a stop is where a room's part is, by positions of part or tool."""
    (task, stop), there = visit, room.stop.target
    if not isinstance(stop.target, PoseTarget) or not isinstance(there, PoseTarget):
        return False
    apart = np.abs(spot(task, stop.target) - spot(room.task, there)).max()
    return bool(apart <= SAME_SPOT)


def _crowded(
    cell: Cell,
    held: Sequence[Sequence[HeldBody]],
    visit: Visit,
    room: PartRoom,
    solids: Sequence[Solid],
) -> Crowded | None:
    """Find a body that lacks clearance from a part in its room, or None.

    It is None if some arm and yaw avoid the part.

    Args:
        cell: with clearances.
        held: bodies of each arm that may make the stop.
        visit: the stop with its task.
        room: room of the part.
        solids: solids of the room.
    """
    (task, stop), candidates = visit, list[Crowded]()
    for bodies in held:
        needs = [
            (body, needed)
            for body in bodies
            if (needed := _needed(cell, body, task, room)) is not None
        ]
        if _is_far(needs, stop, solids):
            return None
        for T_world_tool in turned_poses(stop):
            lacking = [
                (
                    undercut(body, T_world_tool, [(solid, needed) for solid in solids])[0],
                    body,
                    needed,
                )
                for body, needed in needs
            ]
            lacks, body, needed = max(lacking, key=lambda row: row[0], default=(0.0, None, 0.0))
            if body is None or lacks <= 0.0:
                return None
            candidates.append(Crowded(task, stop, room, body.body, needed - lacks, needed))
    return max(candidates, key=lambda stop: stop.distance - stop.needed, default=None)


def _is_far(needs: Sequence[tuple[HeldBody, float]], stop: Stop, solids: Sequence[Solid]) -> bool:
    """Check by bounding balls whether bodies are far from solids at every yaw."""
    assert isinstance(stop.target, PoseTarget)  # its caller passes only those
    tip = stop.target.pose.translation
    reach = [body.longest + needed + max(x.extent for x in body.solids) for body, needed in needs]
    distances = [
        norm(solid.pose.act(solid.geometry.aabb_center) - tip) - solid.geometry.aabb_radius
        for solid in solids
    ]
    return bool(min(distances) > max(reach, default=0.0))


def _needed(cell: Cell, held_body: HeldBody, task: Task, room: PartRoom) -> float | None:
    """Return the required distance of a body from a lying part [m].

    None if they may touch.
    """
    least = required(cell, held_body.body, room.task.part)
    if least is None:
        return None
    return -OVERLAP if held_body.body == task.part and may_touch(task, room.task) else least + SLACK
