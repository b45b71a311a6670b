"""How far two tools are apart while one takes a part from the other: whatever the arms do, that is the same."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin

from dualarm_cli.collision.solids import WORLD, Solid, shape_solid
from dualarm_cli.model.cell import Cell
from dualarm_cli.model.handover import Handover


def grip_margin(cell: Cell, work: Handover) -> float:
    """Returns the distance of the two tools at the grip less what is required [m]; infinite where nothing is.

    Args:
        cell: with both tools.
        work: the hand-over.
    """
    names = frozenset((f"{work.giver}_tool", f"{work.taker}_tool"))
    if any(frozenset(pair) == names for pair in cell.allowed_contacts):
        return np.inf
    special = {frozenset(pair): least for *pair, least in cell.clearances}
    giving = _solids(cell, work.giver, pin.SE3.Identity())
    taking = _solids(cell, work.taker, work.grip)
    least = min((_distance(one, other) for one in giving for other in taking), default=np.inf)
    return least - special.get(names, cell.clearance)


def _solids(cell: Cell, arm: str, T_giver_tcp: pin.SE3) -> list[Solid]:
    """Returns a tool's solids in the frame of the giving tool's centre point."""
    tool = cell.tools[arm]
    flange = T_giver_tcp * tool.tcp.inverse()
    return [shape_solid(f"{arm}_tool", WORLD, flange, shape) for shape in tool.shapes]


def _distance(one: Solid, other: Solid) -> float:
    places = [coal.Transform3s(s.pose.rotation, s.pose.translation) for s in (one, other)]
    result = coal.DistanceResult()
    request = coal.DistanceRequest()
    coal.distance(one.geometry, places[0], other.geometry, places[1], request, result)
    return float(result.min_distance)
