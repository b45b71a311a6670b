"""What parts touch whatever the arms do: where they lie, and the tools that hand them over."""

from __future__ import annotations

from collections.abc import Sequence

import coal
import numpy as np
import pinocchio as pin

from dualarm_cli.collision.quick_test import OVERLAP
from dualarm_cli.collision.solids import WORLD, Solid, shape_solid
from dualarm_cli.model.cell import Cell
from dualarm_cli.model.handover import Handover, taken_part
from dualarm_cli.model.shape import Shape
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class TooNear:
    """Two bodies that lack clearance."""

    where: str
    """Where they do, in words."""
    bodies: tuple[str, str]
    """Their names."""
    margin: float
    """Distance less what is required [m]; negative."""


def too_near(
    cell: Cell, work: Handover, task: str, part: str, approach: float, retract: float
) -> list[TooNear]:
    """Returns which tools and part are too near to each other in a hand-over.

    Both tools at the grip, where the taker's approach begins, and where the giver's retract ends; at the latter two
    also the part and the tool that does not hold it, which may touch it only in between.

    Args:
        cell: with tools and parts.
        work: the hand-over.
        task: its task's id.
        part: what is handed over, as it is in the giving tool; empty for nothing.
        approach: length of the taker's approach [m].
        retract: length of the giver's retract [m].
    """
    here, back = pin.SE3.Identity(), work.grip * _drawn_back(approach)
    giving, taking = f"{work.giver}_tool", f"{work.taker}_tool"
    gives, gone = _tool(cell, work.giver, here), _tool(cell, work.giver, _drawn_back(retract))
    takes, comes = _tool(cell, work.taker, work.grip), _tool(cell, work.taker, back)
    held = [shape_solid(part, WORLD, here, shape) for shape in cell.parts[part]] if part else []
    begins = f"where the {work.taker} arm's approach begins"
    ends = f"where the {work.giver} arm's retract ends"
    pairs = [
        ("at the grip", giving, gives, taking, takes),
        (begins, giving, gives, taking, comes),
        (begins, part, held, taking, comes),
        (ends, giving, gone, taking, takes),
        (ends, giving, gone, taken_part(part, task), held),
    ]
    found = []
    for where, one, some, other, others in pairs:
        margin = _margin(cell, one, some, other, others)
        if margin < 0.0:
            found.append(TooNear(where, (one, other), margin))
    return found


def _drawn_back(length: float) -> pin.SE3:
    """Returns a tool drawn back along its z axis."""
    return pin.SE3(np.eye(3), np.array([0.0, 0.0, -length]))


def _tool(cell: Cell, arm: str, T_giver_tcp: pin.SE3) -> list[Solid]:
    """Returns a tool's solids in the frame of the giving tool's centre point."""
    tool = cell.tools[arm]
    flange = T_giver_tcp * tool.tcp.inverse()
    return [shape_solid(f"{arm}_tool", WORLD, flange, shape) for shape in tool.shapes]


def _margin(
    cell: Cell, one: str, some: Sequence[Solid], other: str, others: Sequence[Solid]
) -> float:
    """Returns the distance of two bodies less what is required [m]; infinite where they may touch."""
    names = frozenset((one, other))
    if any(frozenset(pair) == names for pair in cell.allowed_contacts):
        return np.inf
    special = {frozenset(pair): least for *pair, least in cell.clearances}
    least = min((_distance(a, b) for a in some for b in others), default=np.inf)
    return least - special.get(names, cell.clearance)


def _distance(one: Solid, other: Solid) -> float:
    places = [coal.Transform3s(s.pose.rotation, s.pose.translation) for s in (one, other)]
    result, request = coal.DistanceResult(), coal.DistanceRequest()
    coal.distance(one.geometry, places[0], other.geometry, places[1], request, result)
    return float(result.min_distance)


STEPS = 9
"""Places along a line that are looked at, its end included."""


def part_reaches(
    cell: Cell,
    part: str,
    shapes: Sequence[Shape],
    T_world_tool: pin.SE3,
    line: float,
    *,
    clear: bool = False,
) -> tuple[float, str]:
    """Returns how far a part reaches into an obstacle at most [m], and which one; none where it is at most OVERLAP.

    At a target and along the line on which it is carried there.

    Args:
        cell: with parts and obstacles.
        part: name of the part, or of a tool's body.
        shapes: its solids in the frame of the arm's own tool centre point.
        T_world_tool: that at the target.
        line: length of the line, which runs against the tool's z axis [m].
        clear: whether it has to keep the cell's clearance, of which it then is how much is missing.
    """
    special = {frozenset(pair): least for *pair, least in cell.clearances}
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
                # Whether they touch is quicker to compute than how far apart they are.
                result.clear()
                least = special.get(frozenset((part, thing.body)), cell.clearance) if clear else 0.0
                asked.security_margin = least
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
                if least - distance > deepest:
                    deepest, into = least - float(distance), thing.body
    return deepest, into
