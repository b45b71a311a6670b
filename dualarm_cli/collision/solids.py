"""The solids of a cell for coal: links, tools, carried parts and obstacles, and which of them must keep apart.

It says what is there and judges nothing, as readers and the data model do.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import coal
import numpy as np
import pinocchio as pin

from dualarm_cli.geometry.products import norm
from dualarm_cli.model.cell import Cell, Held
from dualarm_cli.model.robot import Robot
from dualarm_cli.model.shape import Hull, Shape
from dualarm_cli.records import dataclass

WORLD = 0
"""Number of the joint that never moves."""
CAP_TOLERANCE = 1e-6
"""How far two balls may be off the ends of a cylinder that they make a capsule of [m]."""


@dataclass(frozen=True)
class Solid:
    """One shape of a body."""

    body: str
    """Name of the link, tool (`left_tool`), carried part or obstacle that it belongs to."""
    joint: int
    """Number of the joint whose frame it moves with; WORLD for what stands still."""
    pose: pin.SE3
    """In that frame."""
    geometry: coal.CollisionGeometry
    """Its form."""
    extent: float
    """Greatest distance of its points from the joint's origin [m]; infinite for a half-space."""
    carrier: str = ""
    """The arm that carries it, of a part or a changed tool."""
    tool: str = ""
    """The changed tool that it is, or, of a part, that grips it; empty for none."""
    bolted: bool = False
    """Whether it is a changed tool: it may touch its arm's last links, and parts may lie on things, tools not."""
    lying: str = ""
    """Name for messages, of a part that waits or lies; empty for all else."""

    @property
    def label(self) -> str:
        """What a person calls it: both arms may carry the same kind of part."""
        if self.lying:
            return self.lying
        return f"{self.carrier} {self.body}" if self.carrier and not self.bolted else self.body

    def is_held(self, held: Held) -> bool:
        """Returns whether it is there while its carrier holds something."""
        return self.tool == held.tool and (self.bolted or self.body == held.part)


@dataclass(frozen=True)
class Pair:
    """Two solids that must keep apart."""

    first: int
    """Number of the one."""
    second: int
    """Number of the other."""
    required: float
    """Least distance between them [m]."""


def tool_body(arm: str, tool: str) -> str:
    """Returns what the body of a changed tool is called."""
    return f"{arm}_{tool}"


def link_solids(model: pin.Model, robot: Robot) -> list[Solid]:
    """Returns the collision shapes of all links; a cylinder between two balls as the capsule that it is.

    Args:
        model: of the robot's URDF.
        robot: its URDF has primitive shapes only.
    """
    found = pin.buildGeomFromUrdfString(model, robot.urdf, pin.GeometryType.COLLISION)
    by_link: dict[int, list[pin.GeometryObject]] = {}
    for entry in found.geometryObjects:
        by_link.setdefault(entry.parentFrame, []).append(entry)
    solids = []
    for frame, entries in by_link.items():
        name = model.frames[frame].name
        for entry in _with_capsules(entries):
            solids.append(_solid(name, entry.parentJoint, entry.placement, entry.geometry))
    for name, shapes in robot.meshes.items():
        link = model.frames[model.getFrameId(name, pin.FrameType.BODY)]
        solids += [shape_solid(name, link.parentJoint, link.placement, shape) for shape in shapes]
    return solids


def _with_capsules(entries: Sequence[pin.GeometryObject]) -> list[pin.GeometryObject]:
    """Returns one link's shapes, each cylinder with balls at both ends as one capsule."""
    left = list(entries)
    for rod in [e for e in entries if isinstance(e.geometry, coal.Cylinder)]:
        half = np.array([0.0, 0.0, rod.geometry.halfLength])
        caps = []
        for end in (rod.placement.act(half), rod.placement.act(-half)):
            caps += [
                e
                for e in left
                if isinstance(e.geometry, coal.Sphere)
                and abs(e.geometry.radius - rod.geometry.radius) < CAP_TOLERANCE
                and norm(e.placement.translation - end) < CAP_TOLERANCE
            ][:1]
        if len(caps) == 2:
            names = {rod.name, *(cap.name for cap in caps)}
            left = [e for e in left if e.name not in names]
            # The balls are up to the tolerance off the ends.
            form = coal.Capsule(rod.geometry.radius + CAP_TOLERANCE, 2.0 * rod.geometry.halfLength)
            left.append(
                pin.GeometryObject(rod.name, rod.parentJoint, rod.parentFrame, rod.placement, form)
            )
    return left


def shape_solid(body: str, joint: int, T_joint_holder: pin.SE3, shape: Shape) -> Solid:
    """Returns a solid of a cell file.

    Args:
        body: what it belongs to.
        joint: the joint that it moves with.
        T_joint_holder: the frame that the shape is posed in, in the joint's frame.
        shape: of the data model.
    """
    return _solid(body, joint, T_joint_holder * shape.pose, _geometry(shape))


def _geometry(shape: Shape) -> coal.CollisionGeometry:
    if shape.kind == "box":
        return coal.Box(*shape.size)
    if shape.kind == "sphere":
        return coal.Sphere(shape.size[0])
    if shape.kind == "cylinder":
        return coal.Cylinder(*shape.size)
    if shape.kind == "capsule":
        return coal.Capsule(*shape.size)
    if shape.hull is not None:
        return _convex(shape.hull)
    return coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)


def _convex(hull: Hull) -> coal.Convex:
    corners, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    corners.extend(list(hull.corners))
    triangles.extend([coal.Triangle(*corner) for corner in hull.triangles.tolist()])
    return coal.Convex(corners, triangles)


def _solid(body: str, joint: int, pose: pin.SE3, geometry: coal.CollisionGeometry) -> Solid:
    if isinstance(geometry, coal.Halfspace):
        return Solid(body, joint, pose, geometry, np.inf)
    geometry.computeLocalAABB()
    center, radius = np.asarray(geometry.aabb_center).ravel(), float(geometry.aabb_radius)
    return Solid(body, joint, pose, geometry, float(norm(pose.act(center))) + radius)


def cell_solids(cell: Cell, model: pin.Model, carried: Sequence[tuple[str, str]]) -> list[Solid]:
    """Returns all solids of a cell, as the robot's root link sees them.

    Args:
        cell: of the data model.
        model: of its robot's URDF.
        carried: arm and name of everything that an arm ever holds, see `Held.name`.
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
        # A tool is there once, whatever is in it.
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
"""A tool whose centre point is farther than that from the flange has a body [m]."""


def tools_without_shape(cell: Cell) -> list[str]:
    """Return the tools that reach out and have no shape, those that an arm changes included."""
    tools = {tool_body(arm, "tool"): tool for arm, tool in cell.tools.items()}
    for arm, changes in cell.tool_changes.items():
        tools |= {tool_body(arm, name): changed.tool for name, changed in changes.tools.items()}
    return [
        name
        for name, tool in tools.items()
        if not tool.shapes and float(np.abs(tool.tcp.translation).max()) > TOOL_REACH
    ]


def bodies_without_shape(cell: Cell) -> list[str]:
    """Return the arms none of whose moving links has a shape, and the tools without one."""
    model = pin.buildModelFromXML(cell.robot.urdf)
    shaped = {model.names[solid.joint] for solid in link_solids(model, cell.robot)}
    found = [
        f"the {arm.name} arm's links" for arm in cell.robot.arms if shaped.isdisjoint(arm.joints)
    ]
    return [*found, *tools_without_shape(cell)]


def solid_distance(
    one: Solid, here: coal.Transform3s, other: Solid, there: coal.Transform3s
) -> float:
    """Measure how far two solids are apart at two places, by coal [m]; negative: how deep they overlap."""
    result, request = coal.DistanceResult(), coal.DistanceRequest()
    coal.distance(one.geometry, here, other.geometry, there, request, result)
    return float(result.min_distance)


def geometry_model(solids: Sequence[Solid], pairs: Iterable[tuple[int, int]]) -> pin.GeometryModel:
    """Returns solids as pinocchio's geometry, named by their numbers, with some pairs of them in the order given.

    Args:
        solids: of a cell.
        pairs: numbers of two solids each, none of them twice: pinocchio keeps one.
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
    """Returns every pair of solids that must keep apart.

    Left out are solids that never move against each other, those of neighbouring links (joined by one joint; a tool
    counts as the link that carries it, changed or not, a part does not), and the pairs of bodies that the robot's or
    the cell's file names as allowed contacts.

    Args:
        model: of the robot's URDF.
        solids: of the cell.
        cell: with its clearances and allowed contacts.
    """
    allowed = {frozenset(pair) for pair in (*cell.robot.allowed_contacts, *cell.allowed_contacts)}
    special = {frozenset(names): distance for *names, distance in cell.clearances}
    before = [_links_before(model, joint) for joint in range(model.njoints)]
    pairs = []
    for i, one in enumerate(solids):
        for j in range(i + 1, len(solids)):
            other = solids[j]
            bodies = frozenset((one.body, other.body))
            neighbours = one.body in before[other.joint] or other.body in before[one.joint]
            if any(solid.carrier and not solid.bolted for solid in (one, other)):
                neighbours = False
            if one.joint == other.joint or neighbours or bodies in allowed:
                continue
            pairs.append(Pair(i, j, special.get(bodies, cell.clearance)))
    return pairs


def pairs_with_lying(solids: Sequence[Solid], lying: Sequence[int], cell: Cell) -> list[Pair]:
    """List the pairs of what moves and parts that lie, these second, that must keep apart.

    Args:
        solids: of the cell.
        lying: numbers of those of parts that wait or lie.
        cell: with its clearances and allowed contacts.
    """
    allowed = {frozenset(pair) for pair in (*cell.robot.allowed_contacts, *cell.allowed_contacts)}
    special = {frozenset(names): distance for *names, distance in cell.clearances}
    pairs = []
    for i, one in enumerate(solids):
        for j in lying if one.joint != WORLD and not one.lying else ():
            bodies = frozenset((one.body, solids[j].body))
            if bodies not in allowed:
                pairs.append(Pair(i, j, special.get(bodies, cell.clearance)))
    return pairs


def _links_before(model: pin.Model, joint: int) -> set[str]:
    """Returns the links that a joint hangs on: its parent link, and those that this one is fixed to towards the root.

    Links that are fixed to them elsewhere, such as the other robot's base, are no neighbours.
    """
    found: set[str] = set()
    if joint == WORLD:
        return found
    frame = model.frames[model.getFrameId(model.names[joint], pin.FrameType.JOINT)].parentFrame
    while model.frames[frame].parentJoint == model.parents[joint]:
        if model.frames[frame].type == pin.FrameType.BODY:
            found.add(model.frames[frame].name)
        if frame == model.frames[frame].parentFrame:
            break
        frame = model.frames[frame].parentFrame
    return found
