"""How far a part reaches into something where it is picked or placed, whatever arm holds it."""

from __future__ import annotations

from collections.abc import Sequence

import coal
import numpy as np
import pinocchio as pin

from dualarm_cli.collision.quick_test import OVERLAP
from dualarm_cli.collision.solids import WORLD, shape_solid
from dualarm_cli.model.cell import Cell
from dualarm_cli.model.shape import Shape

STEPS = 9
"""Places along a line that are looked at, its end included."""


def part_reaches(
    cell: Cell, part: str, shapes: Sequence[Shape], T_world_tool: pin.SE3, line: float
) -> tuple[float, str]:
    """Returns how far a part reaches into an obstacle at most [m], and which one; none where it is at most OVERLAP.

    At a target and along the line on which it is carried there.

    Args:
        cell: with parts and obstacles.
        part: name of the part, or of a tool's body.
        shapes: its solids in the frame of the arm's own tool centre point.
        T_world_tool: that at the target.
        line: length of the line, which runs against the tool's z axis [m].
    """
    allowed = {frozenset(pair) for pair in cell.allowed_contacts}
    things = [
        shape_solid(thing.name, WORLD, pin.SE3.Identity(), thing.shape)
        for thing in cell.obstacles
        if frozenset((part, thing.name)) not in allowed
    ]
    deepest, into = OVERLAP, ""
    places = [coal.Transform3s(x.pose.rotation, x.pose.translation) for x in things]
    asked, result = coal.CollisionRequest(), coal.CollisionResult()
    solids = [shape_solid(part, WORLD, pin.SE3.Identity(), shape) for shape in shapes]
    for back in np.linspace(0.0, line, STEPS if line > 0.0 else 1):
        T = T_world_tool * pin.SE3(np.eye(3), np.array([0.0, 0.0, -back]))
        for solid in solids:
            place = T * solid.pose
            here = coal.Transform3s(place.rotation, place.translation)
            for thing, there in zip(things, places, strict=True):
                # Whether they touch is told sooner than how far apart they are.
                result.clear()
                if not coal.collide(solid.geometry, here, thing.geometry, there, asked, result):
                    continue
                distance = coal.distance(
                    solid.geometry,
                    here,
                    thing.geometry,
                    there,
                    coal.DistanceRequest(),
                    coal.DistanceResult(),
                )
                if -distance > deepest:
                    deepest, into = -float(distance), thing.body
    return deepest, into
