"""Rooms: space of parts that wait or lie, for the quick collision test.

With a free yaw the planner does not know yet how a part will be turned: its room covers all yaws that the stop allows.
The motion decides the yaw; the verifier uses the actual one.
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
"""Orders of symmetry about the tool's z axis that are tested."""
SAME = 1e-9
"""Largest distance of equal shapes after a turn [m]."""
ANY_TURN = 1.0
"""Yaw that only maps shapes that are round about z onto themselves [rad]."""


@dataclass(frozen=True)
class PartRoom:
    """Space that a part takes up at one stop."""

    task: Task
    """Task that carries the part."""
    stop: Stop
    """Pick or place."""
    shapes: tuple[Shape, ...]
    """Solids over all yaws, in the world."""

    @property
    def key(self) -> RoomKey:
        """Key: task and action."""
        return self.task.id, self.stop.action

    def solids(self, cell: Cell) -> list[Solid]:
        """Return its solids in the frame of the robot's root link."""
        part, label = self.task.part, lying_label(self.task)
        solids = [shape_solid(part, WORLD, cell.base.inverse(), shape) for shape in self.shapes]
        return [replace(solid, lying=label) for solid in solids]


def rooms_of(job: Job, *, moving: bool = False) -> tuple[PartRoom, ...]:
    """List the rooms of all picks and places of parts with shapes and known poses.

    Args:
        job: with its cell.
        moving: whether to list those on conveyors, where the job meets them, or those that stand still.
    """
    rooms = []
    for task, stop in (*((t, s) for t in job.tasks for s in t.stops), *job.lying):
        shapes = held_part(job.cell, task)
        if not shapes or stop.action not in ("pick", "place") or stop.moves is not moving:
            continue
        if isinstance(stop.target, PoseTarget):
            rooms.append(PartRoom(task, stop, _over_turns(stop.target, shapes)))
    return tuple(rooms)


def held_part(cell: Cell, task: Task) -> tuple[Shape, ...]:
    """Return the solids of a task's part in the frame of the carrying fixed tool."""
    able = (arm.name for arm in cell.robot.arms if task.tool in cell.tool_names(arm.name))
    arm = next(filter(task.allows, able), "")
    return cell.held_shapes(arm, Held(task.tool, task.part))[1] if arm else ()


def pinned(target: PoseTarget, shapes: Sequence[Shape]) -> PoseTarget:
    """Replace a free yaw by the symmetry of the part."""
    same = (
        n for n in SYMMETRIES if all(_is_same(shape, _turned(shape, TURN / n)) for shape in shapes)
    )
    return replace(target, free_yaw=False, symmetry=next(same))


def _over_turns(target: PoseTarget, shapes: Sequence[Shape]) -> tuple[Shape, ...]:
    """Return the solids of a part over all yaws of its target, in the world."""
    solids: list[Shape] = []
    for shape in shapes:
        if target.free_yaw:
            solids.append(shape if _is_same(shape, _turned(shape, ANY_TURN)) else _round(shape))
            continue
        copies: list[Shape] = []
        for k in range(target.symmetry):
            copy = _turned(shape, TURN * k / target.symmetry)
            if not any(_is_same(copy, previous) for previous in copies):
                copies.append(copy)
        solids += copies
    return tuple(replace(shape, pose=target.pose * shape.pose) for shape in solids)


def _turned(shape: Shape, yaw: float) -> Shape:
    turn = pin.SE3(pin.utils.rotate("z", yaw), np.zeros(3))
    return replace(shape, pose=turn * shape.pose)


def _is_same(shape: Shape, other_shape: Shape) -> bool:
    """Check whether two shapes of one kind and size fill the same space."""
    points, others = _points(shape)[0], _points(other_shape)[0]
    distances = np.abs(points[:, None] - others[None]).max(axis=2)
    return bool((distances.min(axis=1) <= SAME).all())


def _points(shape: Shape) -> tuple[FloatArray, float]:
    """Compute points (n, 3) and a radius [m] whose balls' convex hull contains the shape."""
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
    """Compute the cylinder about the tool's z axis that contains a shape at any yaw."""
    points, radius = _points(shape)
    wide = float(np.hypot(points[:, 0], points[:, 1]).max()) + radius
    low, high = float(points[:, 2].min()) - radius, float(points[:, 2].max()) + radius
    middle = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.5 * (low + high)]))
    return Shape("cylinder", (wide, high - low), middle)
