"""Contacts of parts that no motion avoids: with obstacles, each other, and tools that transfer them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import coal
import numpy as np
import pinocchio as pin

from dualarm_cli.collision.quick_test import OVERLAP
from dualarm_cli.collision.solids import WORLD, Solid, shape_solid, solid_distance, tool_body
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.elementary import TURN
from dualarm_cli.model.cell import Cell, Held
from dualarm_cli.model.handover import Handover, taken_part
from dualarm_cli.model.job import LYING, TAKES, PoseTarget, Stop, Task
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
    least = required(cell, one, other)
    if least is None:
        return np.inf
    return min((_distance(a, b) for a in some for b in others), default=np.inf) - least


def _distance(one: Solid, other: Solid) -> float:
    places = [coal.Transform3s(s.pose.rotation, s.pose.translation) for s in (one, other)]
    return solid_distance(one, places[0], other, places[1])


STEPS = 9
"""Places along a line that are looked at, its end included."""
YAW_STEPS = 24
"""Turns about the tool's z axis that are tried where any will do: 15 degrees apart."""


def stop_yaws(stop: Stop) -> FloatArray:
    """Return the turns about the tool's z axis that are tried at a stop [rad], shape (y,)."""
    if not isinstance(stop.target, PoseTarget):
        return np.zeros(1)
    turns = YAW_STEPS if stop.target.free_yaw else stop.target.symmetry
    return np.arange(turns, dtype=np.float64) * (TURN / turns)


def turned_poses(stop: Stop) -> Iterator[pin.SE3]:
    """Iterate over the poses of an arm's own tool at a stop, one for each turn that is tried; none without a pose."""
    if isinstance(stop.target, PoseTarget):
        for yaw in stop_yaws(stop).tolist():
            yield stop.target.pose * pin.SE3(pin.utils.rotate("z", yaw), np.zeros(3))


@dataclass(frozen=True)
class HeldBody:
    """A tool, or a part, that an arm has at a stop."""

    name: str
    """Name of a part or a changed tool in its task; of the arm's own tool that of its body."""
    body: str
    """Name of its solids."""
    solids: tuple[Solid, ...]
    """In the frame of the arm's own tool centre point."""
    line: float
    """Length of the longest line on which it is there [m]; lines run against the tool's z axis."""
    rests: bool
    """Whether it may touch obstacles, as parts that lie and tools at their stands do."""


def held_bodies(cell: Cell, arm: str, task: Task, stop: Stop) -> list[HeldBody]:
    """List the bodies with shapes that an arm has at a stop: its own tool, a changed one, and a part that may lie.

    Args:
        cell: with tools and parts.
        arm: that makes the stop.
        task: of the stop.
        stop: where.
    """
    own, both = cell.tools[arm], max(stop.approach, stop.retract)
    of_tool, of_part = cell.held_shapes(arm, Held(task.tool, task.part))
    line = stop.retract if stop.action in TAKES else stop.approach
    own_body, changed, here = tool_body(arm, "tool"), tool_body(arm, task.tool), pin.SE3.Identity()
    at_stand, lying = task.is_change, of_part if stop.action in LYING else ()
    rows = [
        (own_body, own_body, own.tcp.inverse(), own.shapes, both, False),
        (task.tool, changed, here, of_tool, line if at_stand else both, at_stand),
        (task.part, task.part, here, lying, line, True),
    ]
    return [
        HeldBody(name, body, tuple(shape_solid(body, WORLD, T, x) for x in shapes), length, rests)
        for name, body, T, shapes, length, rests in rows
        if shapes
    ]


def required(cell: Cell, one: str, other: str) -> float | None:
    """Return the distance that two bodies must keep [m]; None where they may touch."""
    names = frozenset((one, other))
    if any(frozenset(pair) == names for pair in cell.allowed_contacts):
        return None
    special = {frozenset(pair): least for *pair, least in cell.clearances}
    return special.get(names, cell.clearance)


def reaches(cell: Cell, one: HeldBody, stop: Stop) -> Iterator[tuple[float, str]]:
    """Iterate over the turns of a stop: what a body lacks of its distance to obstacles [m], and to which.

    At the target and on the line; at most OVERLAP, and no name, where nothing is too near. What may rest on obstacles
    must only not reach into them.

    Args:
        cell: with obstacles.
        one: the body.
        stop: where.
    """
    things = []
    for thing in cell.obstacles:
        needed = required(cell, one.body, thing.name)
        if needed is not None:
            solid = shape_solid(thing.name, WORLD, pin.SE3.Identity(), thing.shape)
            things.append((solid, 0.0 if one.rests else needed))
    for T_world_tool in turned_poses(stop):
        yield undercut(one, T_world_tool, things, OVERLAP)


def undercut(
    one: HeldBody, T_world_tool: pin.SE3, things: Sequence[tuple[Solid, float]], least: float = 0.0
) -> tuple[float, str]:
    """Measure what a body lacks most of the distance to some solids, at a target and on the line there [m].

    Args:
        one: the body.
        T_world_tool: the arm's own tool centre point at the target.
        things: solids in the world, each with the distance that is needed [m].
        least: what counts as nothing [m].

    Returns:
        What is lacking and the solid's body; `least` and no name where nothing is.
    """
    most, into = least, ""
    places = [coal.Transform3s(x.pose.rotation, x.pose.translation) for x, _ in things]
    asked, result = coal.CollisionRequest(), coal.CollisionResult()
    for back in np.linspace(0.0, one.line, STEPS if one.line > 0.0 else 1):
        T = T_world_tool * pin.SE3(np.eye(3), np.array([0.0, 0.0, -back]))
        for solid in one.solids:
            place = T * solid.pose
            here = coal.Transform3s(place.rotation, place.translation)
            for (thing, needed), there in zip(things, places, strict=True):
                # Whether they touch is quicker to compute than how far apart they are.
                result.clear()
                asked.security_margin = max(needed, 0.0)
                if not coal.collide(solid.geometry, here, thing.geometry, there, asked, result):
                    continue
                lacks = needed - solid_distance(solid, here, thing, there)
                if lacks > most:
                    most, into = lacks, thing.body
    return most, into
