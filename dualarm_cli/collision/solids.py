"""Solids of a cell for coal: links, tools, carried parts and obstacles, with their pairs.

The verifier uses this module too: it describes the cell and decides nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import lru_cache

import coal
import numpy as np
import pinocchio as pin

from dualarm_cli.geometry.products import norm
from dualarm_cli.model.cell import Cell, Held
from dualarm_cli.model.robot import Robot
from dualarm_cli.model.shape import Shape
from dualarm_cli.records import dataclass

WORLD = 0
"""Index of the fixed joint of the world."""
CAP_TOLERANCE = 1e-6
"""Largest distance of balls from the ends of a cylinder that form a capsule [m]."""


@dataclass(frozen=True)
class Solid:
    """Shape of a body, fixed to a joint."""

    body: str
    """Name of the link, tool (`left_tool`), carried part or obstacle."""
    joint: int
    """Index of the joint that moves it; WORLD for none."""
    pose: pin.SE3
    """Pose in the joint's frame."""
    geometry: coal.CollisionGeometry
    """Geometry for coal."""
    extent: float
    """Largest distance of its points from the joint's origin [m]; infinite for a half-space."""
    carrier: str = ""
    """Arm that carries it, for a part or changed tool."""
    tool: str = ""
    """Changed tool that it is, or that grips it; empty for none."""
    bolted: bool = False
    """Whether it is a changed tool.

    It may touch its arm's last links; unlike parts it may not lie on bodies.
    """
    lying: str = ""
    """Name of a waiting or lying part for messages; empty otherwise."""

    @property
    def label(self) -> str:
        """Name for users, which distinguishes equal parts of both arms."""
        if self.lying:
            return self.lying
        return f"{self.carrier} {self.body}" if self.carrier and not self.bolted else self.body

    def is_held(self, held: Held) -> bool:
        """Check whether it is present with a given load of its carrier."""
        return self.tool == held.tool and (self.bolted or self.body == held.part)


@dataclass(frozen=True)
class Pair:
    """Two solids with a required distance."""

    first: int
    """Index of the first solid."""
    second: int
    """Index of the second solid."""
    required: float
    """Required distance [m]."""


def tool_body(arm: str, tool: str) -> str:
    """Name the body of a changed tool."""
    return f"{arm}_{tool}"


def link_solids(model: pin.Model, robot: Robot) -> list[Solid]:
    """Build the collision shapes of all links.

    A cylinder between two balls becomes a capsule.

    Args:
        model: model of the robot's URDF.
        robot: robot, whose URDF has primitive shapes only.
    """
    solids = [*_primitive_solids(robot.urdf, tuple(model.names))]
    for name, shapes in robot.meshes.items():
        link = model.frames[model.getFrameId(name, pin.FrameType.BODY)]
        solids += [shape_solid(name, link.parentJoint, link.placement, shape) for shape in shapes]
    return solids


@lru_cache(maxsize=2)
def _primitive_solids(urdf: str, joints: tuple[str, ...]) -> tuple[Solid, ...]:
    """Build the primitive shapes of a URDF's links, which a plan needs some twenty times.

    Args:
        urdf: the URDF.
        joints: names of its model's joints, the universe first.
    """
    model = pin.buildModelFromXML(urdf)
    numbers = [joints.index(name) for name in model.names]
    geometry_model = pin.buildGeomFromUrdfString(model, urdf, pin.GeometryType.COLLISION)
    by_link: dict[int, list[pin.GeometryObject]] = {}
    for entry in geometry_model.geometryObjects:
        by_link.setdefault(entry.parentFrame, []).append(entry)
    solids = []
    for frame, entries in by_link.items():
        name = model.frames[frame].name
        for entry in _with_capsules(entries):
            joint = numbers[entry.parentJoint]
            solids.append(_solid(name, joint, entry.placement, entry.geometry))
    return tuple(solids)


def _with_capsules(entries: Sequence[pin.GeometryObject]) -> list[pin.GeometryObject]:
    """Merge each cylinder with balls at both ends into one capsule."""
    merged = list(entries)
    for rod in [e for e in entries if isinstance(e.geometry, coal.Cylinder)]:
        half = np.array([0.0, 0.0, rod.geometry.halfLength])
        caps = []
        for end in (rod.placement.act(half), rod.placement.act(-half)):
            caps += [
                e
                for e in merged
                if isinstance(e.geometry, coal.Sphere)
                and abs(e.geometry.radius - rod.geometry.radius) < CAP_TOLERANCE
                and norm(e.placement.translation - end) < CAP_TOLERANCE
            ][:1]
        if len(caps) == 2:
            names = {rod.name, *(cap.name for cap in caps)}
            merged = [e for e in merged if e.name not in names]
            # The balls are up to the tolerance off the ends.
            form = coal.Capsule(rod.geometry.radius + CAP_TOLERANCE, 2.0 * rod.geometry.halfLength)
            merged.append(
                pin.GeometryObject(rod.name, rod.parentJoint, rod.parentFrame, rod.placement, form)
            )
    return merged


def shape_solid(body: str, joint: int, T_joint_holder: pin.SE3, shape: Shape) -> Solid:
    """Build a solid from a shape of a cell file.

    Args:
        body: name of its body.
        joint: index of the joint that moves it.
        T_joint_holder: pose of the shape's holding frame in the joint's frame.
        shape: shape of the data model.
    """
    return _solid(body, joint, T_joint_holder * shape.pose, shape.geometry)


def _solid(body: str, joint: int, pose: pin.SE3, geometry: coal.CollisionGeometry) -> Solid:
    if isinstance(geometry, coal.Halfspace):
        return Solid(body, joint, pose, geometry, np.inf)
    geometry.computeLocalAABB()
    center, radius = np.asarray(geometry.aabb_center).ravel(), float(geometry.aabb_radius)
    return Solid(body, joint, pose, geometry, float(norm(pose.act(center))) + radius)


def cell_solids(cell: Cell, model: pin.Model, carried: Sequence[tuple[str, str]]) -> list[Solid]:
    """Build all solids of a cell, in the frame of the robot's root link.

    Args:
        cell: cell of the data model.
        model: model of its robot's URDF.
        carried: arm and name of every object that an arm may hold, see `Held.name`.
    """
    solids = link_solids(model, cell.robot)
    flanges = {
        arm.name: model.frames[model.getFrameId(arm.flange, pin.FrameType.BODY)]
        for arm in cell.robot.arms
    }
    for arm, tool in cell.tools.items():
        joint, pose = flanges[arm].parentJoint, flanges[arm].placement
        solids += [shape_solid(f"{arm}_tool", joint, pose, shape) for shape in tool.shapes]
    names = {arm.name: cell.all_held(arm.name) for arm in cell.robot.arms}
    things = dict.fromkeys((arm, replace(names[arm][name], docking=False)) for arm, name in carried)
    tools = set[tuple[str, str]]()
    for arm, held in things:
        joint, pose = flanges[arm].parentJoint, flanges[arm].placement * cell.tools[arm].tcp
        of_tool, of_part = cell.held_shapes(arm, held)
        # A tool has one set of solids, with any part in it.
        for shape in of_tool if (arm, held.tool) not in tools else ():
            solid = shape_solid(tool_body(arm, held.tool), joint, pose, shape)
            solids.append(replace(solid, carrier=arm, tool=held.tool, bolted=True))
        tools.add((arm, held.tool))
        solids += [
            replace(shape_solid(held.part, joint, pose, shape), carrier=arm, tool=held.tool)
            for shape in of_part
        ]
    T_root_world = cell.base.inverse()
    for obstacle in cell.obstacles:
        solids.append(shape_solid(obstacle.name, WORLD, T_root_world, obstacle.shape))
    return solids


TOOL_REACH = 1e-3
"""Distance of a tool centre point from the flange that requires a shape [m]."""


def shaped_hands(robot: Robot) -> list[str]:
    """List the arms whose own hand has shapes."""
    shaped = {solid.body for solid in link_solids(pin.buildModelFromXML(robot.urdf), robot)}
    return [arm for arm, links in robot.hands.items() if not shaped.isdisjoint(links)]


def tools_without_shape(cell: Cell) -> list[str]:
    """List the tools that reach out but have no shape, changed tools included.

    The shapes of an arm's hand are those of its tool.
    """
    hands = shaped_hands(cell.robot)
    tools = {tool_body(arm, "tool"): tool for arm, tool in cell.tools.items() if arm not in hands}
    for arm, changes in cell.tool_changes.items():
        tools |= {tool_body(arm, name): changed.tool for name, changed in changes.tools.items()}
    return [
        name
        for name, tool in tools.items()
        if not tool.shapes and float(np.abs(tool.tcp.translation).max()) > TOOL_REACH
    ]


def bodies_without_shape(cell: Cell) -> list[str]:
    """List the arms without shapes of moving links, and the tools without shapes."""
    model = pin.buildModelFromXML(cell.robot.urdf)
    shaped = {model.names[solid.joint] for solid in link_solids(model, cell.robot)}
    arms = [
        f"the {arm.name} arm's links" for arm in cell.robot.arms if shaped.isdisjoint(arm.joints)
    ]
    return [*arms, *tools_without_shape(cell)]


FAILED = -1e3
"""Distance below which coal has found none [m]."""


def solid_distance(
    solid_a: Solid, transform_a: coal.Transform3s, solid_b: Solid, transform_b: coal.Transform3s
) -> float:
    """Compute the distance of two solids at two places, by coal [m]; negative for overlap."""
    request, distance = coal.DistanceRequest(), FAILED
    bodies = (solid_a.geometry, transform_a), (solid_b.geometry, transform_b)
    # Where faces touch, coal may find nothing (-1.8e308) in one order of the bodies.
    for first, second in (bodies, bodies[::-1]):
        if distance <= FAILED:
            result = coal.DistanceResult()
            coal.distance(*first, *second, request, result)
            distance = float(result.min_distance)
    return distance


def are_near(model: pin.Model, first: Solid, second: Solid) -> bool:
    """Test whether two bodies are near links of the robot.

    Both are links, or fixed to links, with at most three joints between them: their distance depends on these joints
    alone, often stays constant through a plan, and would hide the clearance that a cell can change.
    """
    if WORLD in (first.joint, second.joint):
        links = {frame.name for frame in model.frames if frame.type == pin.FrameType.BODY}
        if not {first.body, second.body} <= links:
            return False
    joints = set(model.supports[first.joint]) ^ set(model.supports[second.joint])
    return len(joints) <= 3


def geometry_model(solids: Sequence[Solid], pairs: Iterable[tuple[int, int]]) -> pin.GeometryModel:
    """Build pinocchio's geometry model of solids and pairs, in the given order.

    Solids are named by their indices.

    Args:
        solids: solids of a cell.
        pairs: indices of two solids each, without duplicates, which pinocchio removes.
    """
    geometry = pin.GeometryModel()
    for number, solid in enumerate(solids):
        geometry.addGeometryObject(
            pin.GeometryObject(str(number), solid.joint, solid.pose, solid.geometry)
        )
    for first, second in pairs:
        geometry.addCollisionPair(pin.CollisionPair(first, second))
    return geometry


def pairs_that_must_keep_apart(model: pin.Model, solids: Sequence[Solid], cell: Cell) -> list[Pair]:
    """List the pairs of solids that must not collide.

    Omitted are solids without relative motion, those of neighbouring links, and allowed contacts of the robot's or the
    cell's file. Links are neighbours if one joint connects them. A tool, changed or not, counts as its link; a part
    does not.

    Args:
        model: model of the robot's URDF.
        solids: solids of the cell.
        cell: cell with its clearances and allowed contacts.
    """
    allowed = {frozenset(pair) for pair in (*cell.robot.allowed_contacts, *cell.allowed_contacts)}
    special = {frozenset(names): distance for *names, distance in cell.clearances}
    before = [_links_before(model, joint) for joint in range(model.njoints)]
    pairs = []
    for i, solid_a in enumerate(solids):
        for j in range(i + 1, len(solids)):
            solid_b = solids[j]
            bodies = frozenset((solid_a.body, solid_b.body))
            neighbours = (
                solid_a.body in before[solid_b.joint] or solid_b.body in before[solid_a.joint]
            )
            if any(solid.carrier and not solid.bolted for solid in (solid_a, solid_b)):
                neighbours = False
            if solid_a.joint == solid_b.joint or neighbours or bodies in allowed:
                continue
            pairs.append(Pair(i, j, special.get(bodies, cell.clearance)))
    return pairs


def pairs_with_lying(solids: Sequence[Solid], lying: Sequence[int], cell: Cell) -> list[Pair]:
    """List the pairs of moving solids and lying parts that must not collide.

    The lying part is second.

    Args:
        solids: solids of the cell.
        lying: indices of waiting or lying parts.
        cell: cell with its clearances and allowed contacts.
    """
    allowed = {frozenset(pair) for pair in (*cell.robot.allowed_contacts, *cell.allowed_contacts)}
    special = {frozenset(names): distance for *names, distance in cell.clearances}
    pairs = []
    for i, solid in enumerate(solids):
        for j in lying if solid.joint != WORLD and not solid.lying else ():
            bodies = frozenset((solid.body, solids[j].body))
            if bodies not in allowed:
                pairs.append(Pair(i, j, special.get(bodies, cell.clearance)))
    return pairs


def _links_before(model: pin.Model, joint: int) -> set[str]:
    """List the links that are rigidly connected to a joint's parent, towards the root.

    Links that are fixed to them elsewhere, such as the other robot's base, are not neighbours.
    """
    links: set[str] = set()
    if joint == WORLD:
        return links
    frame = model.frames[model.getFrameId(model.names[joint], pin.FrameType.JOINT)].parentFrame
    while model.frames[frame].parentJoint == model.parents[joint]:
        if model.frames[frame].type == pin.FrameType.BODY:
            links.add(model.frames[frame].name)
        if frame == model.frames[frame].parentFrame:
            break
        frame = model.frames[frame].parentFrame
    return links
