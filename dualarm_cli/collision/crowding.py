"""Stops at which a tool or its part comes too near to a part that waits or lies, whatever the arms do."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import coal
import numpy as np
import pinocchio as pin

from dualarm_cli.collision.clearance import SLACK
from dualarm_cli.collision.lying import STEPS
from dualarm_cli.collision.quick_test import OVERLAP
from dualarm_cli.collision.rooms import PartRoom, rooms_of
from dualarm_cli.collision.solids import WORLD, Solid, shape_solid
from dualarm_cli.model.cell import Held
from dualarm_cli.model.job import TAKES, Job, PoseTarget, Stop, Task
from dualarm_cli.model.lying import SAME_SPOT, may_touch
from dualarm_cli.records import dataclass

YAWS = 24
"""Turns about the tool's z axis that are tried where any will do: 15 degrees apart."""


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
    worst: Crowded | None = None
    solids = [shape_solid("", WORLD, pin.SE3.Identity(), shape) for shape in room.shapes]
    for arm in filter(task.allows, [arm.name for arm in job.cell.robot.arms]):
        own = list(_carried(job, task, stop, arm, room))
        for yaw in _yaws(stop):
            least = _least(own, stop, yaw, solids)
            if least is None or least[1] >= least[2]:
                return None
            if worst is None or least[1] - least[2] > worst.distance - worst.needed:
                worst = Crowded(task, stop, room, *least)
    return worst


def _yaws(stop: Stop) -> list[float]:
    assert isinstance(stop.target, PoseTarget)  # asked for those only
    turns = YAWS if stop.target.free_yaw else stop.target.symmetry
    return [2.0 * np.pi * k / turns for k in range(turns)]


def _carried(
    job: Job, task: Task, stop: Stop, arm: str, room: PartRoom
) -> Iterator[tuple[Solid, float, float]]:
    """Yield solids of tools and part in the own tool centre point's frame, with line and needed distance [m]."""
    cell, part = job.cell, room.task.part
    allowed = {frozenset(pair) for pair in cell.allowed_contacts}
    special = {frozenset(names): least for *names, least in cell.clearances}
    of_tool, of_part = cell.held_shapes(arm, Held(task.tool, task.part))
    line = stop.retract if stop.action in TAKES else stop.approach
    both = max(stop.approach, stop.retract)
    own, here = cell.tools[arm], pin.SE3.Identity()
    rows = [
        (f"{arm}_tool", own.tcp.inverse(), own.shapes, both),
        (f"{arm}_{task.tool}", here, of_tool, both),
        (task.part, here, of_part, line),
    ]
    for body, holder, shapes, length in rows:
        names = frozenset((body, part))
        if names in allowed:
            continue
        needed = special.get(names, cell.clearance) + SLACK
        if body == task.part and may_touch(task, room.task):
            needed = -OVERLAP
        for shape in shapes:
            yield shape_solid(body, WORLD, holder, shape), length, needed


def _least(
    own: Sequence[tuple[Solid, float, float]], stop: Stop, yaw: float, room: Sequence[Solid]
) -> tuple[str, float, float] | None:
    """Return the body that lacks most on the lines of a stop, its distance and what is needed [m]; None where far."""
    assert isinstance(stop.target, PoseTarget)  # asked for those only
    turned = stop.target.pose * pin.SE3(pin.utils.rotate("z", yaw), np.zeros(3))
    found: tuple[str, float, float] | None = None
    for solid, line, needed in own:
        for other in room:
            for back in np.linspace(0.0, line, STEPS if line > 0.0 else 1):
                place = turned * pin.SE3(np.eye(3), np.array([0.0, 0.0, -back])) * solid.pose
                distance = _distance(solid, place, other, needed)
                if found is None or distance - needed < found[1] - found[2]:
                    found = solid.body, distance, needed
    return found


def _distance(solid: Solid, place: pin.SE3, other: Solid, needed: float) -> float:
    """Return how far two solids are apart [m]; where balls show more than is needed, that."""
    forms = solid.geometry, other.geometry
    middles = [
        np.asarray(pose.act(np.asarray(form.aabb_center).ravel()))
        for form, pose in zip(forms, (place, other.pose), strict=True)
    ]
    apart = float(np.sqrt(np.square(middles[0] - middles[1]).sum()))
    apart -= forms[0].aabb_radius + forms[1].aabb_radius
    if apart > max(needed, 0.0):
        return apart
    here, there = (
        coal.Transform3s(pose.rotation, pose.translation) for pose in (place, other.pose)
    )
    result, request = coal.DistanceResult(), coal.DistanceRequest()
    coal.distance(forms[0], here, forms[1], there, request, result)
    return float(result.min_distance)
