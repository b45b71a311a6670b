"""The room that parts take where they wait before their pick or lie after their place, for the quick test.

At a stop whose yaw is open the planner does not know yet how a part will be turned: there it takes the room of all the
turns that the stop allows. The motion decides; the verifier takes the part as it is turned.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from dualarm_cli.collision.solids import WORLD, Solid, shape_solid
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.elementary import TURN
from dualarm_cli.model.cell import Cell, Held
from dualarm_cli.model.job import Job, PoseTarget, Stop, Task
from dualarm_cli.model.lying import lying_label
from dualarm_cli.model.shape import Shape
from dualarm_cli.records import dataclass

RoomKey = tuple[str, str]
"""Task and action of the stop at which a part lies."""
SYMMETRIES = (12, 8, 6, 5, 4, 3, 2, 1)
"""Orders of symmetry about the tool's z axis that are looked for in a part."""
SAME = 1e-9
"""Distance up to which turned shapes count as the same [m]."""
ANY_TURN = 1.0
"""A turn that maps only shapes that are round about its axis onto themselves [rad]."""


@dataclass(frozen=True)
class PartRoom:
    """Space that a part takes up at one stop."""

    task: Task
    """The task that carries it."""
    stop: Stop
    """The pick or place."""
    shapes: tuple[Shape, ...]
    """Its solids over all turns, in the world."""

    @property
    def key(self) -> RoomKey:
        """Task and action."""
        return self.task.id, self.stop.action

    def solids(self, cell: Cell) -> list[Solid]:
        """Return its solids as the robot's root link sees them."""
        part, label = self.task.part, lying_label(self.task)
        found = [shape_solid(part, WORLD, cell.base.inverse(), shape) for shape in self.shapes]
        return [replace(solid, lying=label) for solid in found]


def rooms_of(job: Job, *, moving: bool = False) -> tuple[PartRoom, ...]:
    """List the rooms of all picks and places of parts with shapes whose poses are known.

    Args:
        job: with its cell.
        moving: whether those on conveyors are asked for, where the job meets them, or those that stand.
    """
    found = []
    for task, stop in (*((t, s) for t in job.tasks for s in t.stops), *job.beside):
        shapes = held_part(job.cell, task)
        if not shapes or stop.action not in ("pick", "place") or stop.moves is not moving:
            continue
        if isinstance(stop.target, PoseTarget):
            found.append(PartRoom(task, stop, _over_turns(stop.target, shapes)))
    return tuple(found)


def held_part(cell: Cell, task: Task) -> tuple[Shape, ...]:
    """Return the solids of a task's part in the frame of the own tool centre point of the arm that carries it."""
    able = (arm.name for arm in cell.robot.arms if task.tool in cell.tool_names(arm.name))
    arm = next(filter(task.allows, able), "")
    return cell.held_shapes(arm, Held(task.tool, task.part))[1] if arm else ()


def pinned(target: PoseTarget, shapes: Sequence[Shape]) -> PoseTarget:
    """Return a target with an open yaw as one at the yaw of the file and those at which its part looks the same."""
    same = (
        n for n in SYMMETRIES if all(_is_same(shape, _turned(shape, TURN / n)) for shape in shapes)
    )
    return replace(target, free_yaw=False, symmetry=next(same))


def _over_turns(target: PoseTarget, shapes: Sequence[Shape]) -> tuple[Shape, ...]:
    """Return the solids of a part over all turns of its target, in the world."""
    found: list[Shape] = []
    for shape in shapes:
        if target.free_yaw:
            found.append(shape if _is_same(shape, _turned(shape, ANY_TURN)) else _round(shape))
            continue
        copies: list[Shape] = []
        for k in range(target.symmetry):
            copy = _turned(shape, TURN * k / target.symmetry)
            if not any(_is_same(copy, other) for other in copies):
                copies.append(copy)
        found += copies
    return tuple(replace(shape, pose=target.pose * shape.pose) for shape in found)


def _turned(shape: Shape, yaw: float) -> Shape:
    turn = pin.SE3(pin.utils.rotate("z", yaw), np.zeros(3))
    return replace(shape, pose=turn * shape.pose)


def _is_same(one: Shape, other: Shape) -> bool:
    """Return whether two shapes of one kind and size fill the same room."""
    points, others = _points(one)[0], _points(other)[0]
    apart = np.abs(points[:, None] - others[None]).max(axis=2)
    return bool((apart.min(axis=1) <= SAME).all())


def _points(shape: Shape) -> tuple[FloatArray, float]:
    """Return points (n, 3) and a radius [m]: the convex hull of balls about them contains the shape."""
    if shape.kind == "box":
        corners = np.array(np.meshgrid(*[(-1.0, 1.0)] * 3)).reshape(3, -1).T
        local, radius = corners * (0.5 * np.array(shape.size)), 0.0
    elif shape.hull is not None:
        local, radius = shape.hull.corners, 0.0
    else:
        half = 0.5 * shape.size[1] if len(shape.size) > 1 else 0.0
        local, radius = np.array([[0.0, 0.0, half], [0.0, 0.0, -half]]), shape.size[0]
    return np.array([shape.pose.act(point) for point in local]), radius


def _round(shape: Shape) -> Shape:
    """Return the cylinder about the tool's z axis that contains a shape however it is turned."""
    points, radius = _points(shape)
    wide = float(np.hypot(points[:, 0], points[:, 1]).max()) + radius
    low, high = float(points[:, 2].min()) - radius, float(points[:, 2].max()) + radius
    middle = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.5 * (low + high)]))
    return Shape("cylinder", (wide, high - low), middle)
