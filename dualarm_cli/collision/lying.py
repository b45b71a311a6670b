"""Unavoidable contacts of parts with obstacles, each other, and tools that transfer them."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import replace

import coal
import numpy as np
import pinocchio as pin

from dualarm_cli.collision.quick_test import OVERLAP
from dualarm_cli.collision.solids import WORLD, Solid, shape_solid, solid_distance, tool_body
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.elementary import TURN
from dualarm_cli.geometry.products import norm
from dualarm_cli.model.cell import Cell, Held
from dualarm_cli.model.job import LYING, TAKES, PoseTarget, Stop, Task
from dualarm_cli.model.lines import Line
from dualarm_cli.model.part_flow import Handover
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class TooNear:
    """Two bodies without clearance."""

    where: str
    """Place of the contact, in words."""
    bodies: tuple[str, str]
    """Names of the bodies."""
    margin: float
    """Distance minus required distance [m]; negative."""


def too_near(
    cell: Cell, work: Handover, part: str, taken: str, approach: pin.SE3, retract: pin.SE3
) -> list[TooNear]:
    """List the tools and part that lack clearance in a hand-over.

    Checked are both tools at the grip, at the start of the taker's approach, and at the end of the giver's retract. At
    the latter two also the part and the tool that does not hold it, which may touch only in between.

    Args:
        cell: with tools and parts.
        work: the hand-over.
        part: part as held by the giving tool; empty for nothing.
        taken: part as held by the taking tool.
        approach: displacement of the taking tool to the start of its approach.
        retract: displacement of the giving tool to the end of its retract.
    """
    at_giver, back = pin.SE3.Identity(), work.grip * approach
    giving, taking = f"{work.giver}_tool", f"{work.taker}_tool"
    gives, retracted = (
        _tool(cell, work.giver, at_giver),
        _tool(cell, work.giver, retract),
    )
    takes, arriving = _tool(cell, work.taker, work.grip), _tool(cell, work.taker, back)
    held = [shape_solid(part, WORLD, at_giver, shape) for shape in cell.parts[part]] if part else []
    begins = f"where the {work.taker} arm's approach begins"
    ends = f"where the {work.giver} arm's retract ends"
    pairs = [
        ("at the grip", giving, gives, taking, takes),
        (begins, giving, gives, taking, arriving),
        (begins, part, held, taking, arriving),
        (ends, giving, retracted, taking, takes),
        (ends, giving, retracted, taken, held),
    ]
    contacts = []
    for where, body, solids, other_body, other_solids in pairs:
        margin = _margin(cell, body, solids, other_body, other_solids)
        if margin < 0.0:
            contacts.append(TooNear(where, (body, other_body), margin))
    return contacts


def _tool(cell: Cell, arm: str, T_giver_tcp: pin.SE3) -> list[Solid]:
    """Return a tool's solids in the frame of the giving tool centre point."""
    tool = cell.tools[arm]
    flange = T_giver_tcp * tool.tcp.inverse()
    return [shape_solid(f"{arm}_tool", WORLD, flange, shape) for shape in tool.shapes]


def _margin(
    cell: Cell, body: str, solids: Sequence[Solid], other_body: str, other_solids: Sequence[Solid]
) -> float:
    """Compute distance minus required distance of two bodies [m].

    Infinite if they may touch.
    """
    least = required(cell, body, other_body)
    if least is None:
        return np.inf
    return min((_distance(a, b) for a in solids for b in other_solids), default=np.inf) - least


def _distance(solid: Solid, other_solid: Solid) -> float:
    places = [coal.Transform3s(s.pose.rotation, s.pose.translation) for s in (solid, other_solid)]
    return solid_distance(solid, places[0], other_solid, places[1])


STEPS = 9
"""Number of checked positions along a line, its end included."""
YAW_STEPS = 24
"""Number of yaws that are tried if yaw is free: 15 degrees apart."""


def stop_yaws(stop: Stop) -> FloatArray:
    """Return the yaws that are tried at a stop [rad], shape (y,)."""
    if not isinstance(stop.target, PoseTarget):
        return np.zeros(1)
    turns = YAW_STEPS if stop.target.free_yaw else stop.target.symmetry
    return np.arange(turns, dtype=np.float64) * (TURN / turns)


def turned_poses(stop: Stop) -> Iterator[pin.SE3]:
    """Iterate over the poses of the fixed tool at a stop, for each yaw.

    Joint targets have none.
    """
    if isinstance(stop.target, PoseTarget):
        for yaw in stop_yaws(stop).tolist():
            yield stop.target.pose * pin.SE3(pin.utils.rotate("z", yaw), np.zeros(3))


@dataclass(frozen=True)
class HeldBody:
    """Tool or part of an arm at a stop."""

    name: str
    """Name of a part or changed tool in its task; else of the fixed tool's body."""
    body: str
    """Name of its body in collision checks."""
    solids: tuple[Solid, ...]
    """Solids in the frame of the fixed tool centre point."""
    lines: tuple[Line, ...]
    """Its lines, of each direction the longest."""
    rests: bool
    """Whether it may touch obstacles: lying parts, and tools at their stands."""

    @property
    def longest(self) -> float:
        """Length of its longest line [m]."""
        return max(length for length, _ in self.lines)

    @property
    def radius(self) -> float:
        """Upper bound on its distance from the tool's z axis at the target [m]."""
        boxes = [(solid.pose, solid.geometry.aabb_local) for solid in self.solids]
        corners = [
            pose.act(np.array(corner))[:2]
            for pose, box in boxes
            for corner in itertools.product(
                *zip(np.ravel(box.min_), np.ravel(box.max_), strict=True)
            )
        ]
        aside = [
            length * np.hypot(*line.vector[:2]) for length, line in self.lines if not line.fixed
        ]
        return float(norm(np.array(corners), axis=1).max()) + max(aside, default=0.0)


def held_bodies(cell: Cell, arm: str, task: Task, stop: Stop) -> list[HeldBody]:
    """List the bodies with shapes of an arm at a stop.

    They are its fixed tool, a changed tool, and its part.

    Args:
        cell: with tools and parts.
        arm: arm that makes the stop.
        task: task of the stop.
        stop: the stop.
    """
    fixed_tool = cell.tools[arm]
    both: tuple[Line, ...] = stop.lines
    of_tool, of_part = cell.held_shapes(arm, Held(task.tool, task.part))
    line = both[1:] if stop.action in TAKES else both[:1]
    if both[0][1] == both[1][1]:
        both = (max(both, key=lambda line: line[0]),)
    fixed_body, changed, identity = (
        tool_body(arm, "tool"),
        tool_body(arm, task.tool),
        pin.SE3.Identity(),
    )
    at_stand = task.is_change
    rows = [
        (fixed_body, fixed_body, fixed_tool.tcp.inverse(), fixed_tool.shapes, both, False),
        (task.tool, changed, identity, of_tool, line if at_stand else both, at_stand),
        (task.part, task.part, identity, of_part, line, stop.action in LYING),
    ]
    return [
        HeldBody(name, body, tuple(shape_solid(body, WORLD, T, x) for x in shapes), lines, rests)
        for name, body, T, shapes, lines, rests in rows
        if shapes
    ]


def required(cell: Cell, body: str, other_body: str) -> float | None:
    """Return the required distance of two bodies [m]; None if they may touch."""
    names = frozenset((body, other_body))
    if any(frozenset(pair) == names for pair in cell.allowed_contacts):
        return None
    special = {frozenset(pair): least for *pair, least in cell.clearances}
    return special.get(names, cell.clearance)


def reaches(cell: Cell, held_body: HeldBody, stop: Stop) -> Iterator[tuple[float, str]]:
    """Yield a body's largest violation [m] and its obstacle, at each yaw.

    Target and line are checked. Without a violation above OVERLAP, OVERLAP and an empty name are returned. A body that
    may rest on obstacles only must not penetrate them.

    Args:
        cell: with obstacles.
        held_body: the body.
        stop: the stop.
    """
    things = _obstacles(cell, held_body)
    if held_body.rests:
        things = [(solid, 0.0) for solid, _ in things]
    for T_world_tool in turned_poses(stop):
        yield undercut(held_body, T_world_tool, things, OVERLAP)


def misses_at_ends(cell: Cell, held_body: HeldBody, stop: Stop) -> Iterator[tuple[float, str]]:
    """Yield what a resting body lacks of clearance where its line ends [m].

    At each yaw, with the obstacle. Beyond its line it must not touch anything. As for `reaches`, OVERLAP and an empty
    name mean none.

    Args:
        cell: with obstacles.
        held_body: the body, which has one line.
        stop: the stop.
    """
    things = _obstacles(cell, held_body)
    [(length, line)] = held_body.lines
    there = replace(held_body, lines=((0.0, line),))
    for T_world_tool in turned_poses(stop):
        end = T_world_tool * line.back(T_world_tool.rotation, length)
        yield undercut(there, end, things, OVERLAP)


def _obstacles(cell: Cell, held_body: HeldBody) -> list[tuple[Solid, float]]:
    """List the obstacles that a body must not touch, each with its required distance [m]."""
    return [
        (shape_solid(thing.name, WORLD, pin.SE3.Identity(), thing.shape), needed)
        for thing in cell.obstacles
        if (needed := required(cell, held_body.body, thing.name)) is not None
    ]


def undercut(
    held_body: HeldBody,
    T_world_tool: pin.SE3,
    things: Sequence[tuple[Solid, float]],
    least: float = 0.0,
) -> tuple[float, str]:
    """Measure the largest violation of clearance from solids, at a target and on its line [m].

    Args:
        held_body: the body.
        T_world_tool: the fixed tool centre point at the target.
        things: solids in the world, each with its required distance [m].
        least: violation below which nothing is reported [m].

    Returns:
        Violation and the solid's body; `least` and an empty name without one.
    """
    largest, violated = least, ""
    places = [coal.Transform3s(x.pose.rotation, x.pose.translation) for x, _ in things]
    request, result = coal.CollisionRequest(), coal.CollisionResult()
    moved = [
        line.back(T_world_tool.rotation, back)
        for length, line in held_body.lines
        for back in np.linspace(0.0, length, STEPS if length > 0.0 else 1).tolist()
    ]
    for shift in moved:
        T = T_world_tool * shift
        for solid in held_body.solids:
            place = T * solid.pose
            transform = coal.Transform3s(place.rotation, place.translation)
            for (thing, needed), thing_transform in zip(things, places, strict=True):
                # A contact test is faster than computing the distance.
                result.clear()
                request.security_margin = max(needed, 0.0)
                if not coal.collide(
                    solid.geometry, transform, thing.geometry, thing_transform, request, result
                ):
                    continue
                lacks = needed - solid_distance(solid, transform, thing, thing_transform)
                if lacks > largest:
                    largest, violated = lacks, thing.body
    return largest, violated
