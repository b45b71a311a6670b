"""URDF of the whole cell: robot, tools, tool centre points, obstacles and collision hulls."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field

import pinocchio as pin

from dualarm_cli.files.robots.mesh_formats import stl_bytes
from dualarm_cli.files.robots.urdf import read_urdf
from dualarm_cli.files.robots.urdf_tree import Element
from dualarm_cli.files.robots.urdf_writer import origin_words, urdf_text
from dualarm_cli.files.source.text_source import TextSource
from dualarm_cli.model.cell import Cell
from dualarm_cli.model.shape import Shape
from dualarm_cli.records import dataclass

GROUND = (6.0, 0.01)
"""Side and thickness of the plate that replaces a half-space in a URDF [m]."""


@dataclass(frozen=True)
class CellUrdf:
    """URDF and its mesh files."""

    text: str
    """Text of the URDF."""
    meshes: Mapping[str, bytes] = field(default_factory=dict)
    """STL files by name, to be written next to the URDF."""


def cell_urdf(cell: Cell) -> CellUrdf:
    """Build the URDF of a cell, with the robot's moving joints in order.

    Tools are links fixed to the flanges, `left_tcp` and `right_tcp` stand for tool centre points, and obstacles are
    fixed to the robot's root link, whose pose in the cell is in `schedule.json`. Changed tools and carried parts come
    and go: they are left out. Tools have their masses.

    Args:
        cell: of the data model.
    """
    robot = cell.robot
    urdf = read_urdf(TextSource(robot.name, robot.urdf, ""))
    writer = _Writer()
    links = dict(urdf.links)
    for name, shapes in robot.meshes.items():
        links[name] = writer.with_shapes(links[name], shapes, pin.SE3.Identity())
    parts = [*links.values(), *urdf.joints.values()]
    taken = set(links) | set(urdf.joints)
    for arm, tool in cell.tools.items():
        flange = robot.arm(arm).flange
        body = Element("link", {"name": _free(f"{arm}_tool", taken)})
        body = writer.with_shapes(body, tool.shapes, pin.SE3.Identity())
        if tool.inertia.mass > 0.0:
            body.children.append(_inertial(tool.inertia))
        point = Element("link", {"name": _free(f"{arm}_tcp", taken)})
        parts += [body, _fixed(body.name, flange, pin.SE3.Identity(), taken)]
        parts += [point, _fixed(point.name, flange, tool.tcp, taken)]
    T_root_world = cell.base.inverse()
    for obstacle in cell.obstacles:
        body = Element("link", {"name": _free(obstacle.name, taken)})
        body = writer.with_shapes(body, (obstacle.shape,), T_root_world)
        parts += [body, _fixed(body.name, urdf.root_link, pin.SE3.Identity(), taken)]
    return CellUrdf(urdf_text(urdf.root.name or "robot", parts), writer.meshes)


class _Writer:
    """Writer of shapes as link elements, and of hulls as STL files."""

    def __init__(self) -> None:
        self.meshes: dict[str, bytes] = {}

    def with_shapes(self, link: Element, shapes: tuple[Shape, ...], holder: pin.SE3) -> Element:
        """Add solids to a link, as visual and collision elements.

        Args:
            link: without them.
            shapes: the solids.
            holder: the frame that they are posed in, in the link's frame.
        """
        added = []
        for shape in shapes:
            for tag in ("visual", "collision"):
                for pose, geometry in self._geometries(link.name, shape):
                    origin = Element("origin", origin_words(holder * shape.pose * pose))
                    children = [origin, Element("geometry", {}, children=[geometry])]
                    added.append(Element(tag, {}, children=children))
        return Element("link", link.attributes, children=[*link.children, *added])

    def _geometries(self, body: str, shape: Shape) -> list[tuple[pin.SE3, Element]]:
        """Convert a shape to URDF primitives with their poses in the shape's frame."""
        here = pin.SE3.Identity()
        if shape.kind == "box":
            return [(here, _box(*shape.size))]
        if shape.kind == "sphere":
            return [(here, Element("sphere", {"radius": repr(shape.size[0])}))]
        if shape.kind == "half_space":
            side, thickness = GROUND
            below = pin.SE3(here.rotation, here.rotation[:, 2] * -0.5 * thickness)
            return [(below, _box(side, side, thickness))]
        if shape.hull is not None:
            path = self._mesh(body, shape)
            return [(here, Element("mesh", {"filename": path}))]
        radius, length = (repr(size) for size in shape.size)
        rod = (here, Element("cylinder", {"radius": radius, "length": length}))
        if shape.kind == "cylinder":
            return [rod]
        ends = [
            (pin.SE3(here.rotation, here.rotation[:, 2] * sign * 0.5 * shape.size[1]), radius)
            for sign in (-1.0, 1.0)
        ]
        return [rod, *((pose, Element("sphere", {"radius": r})) for pose, r in ends)]

    def _mesh(self, body: str, shape: Shape) -> str:
        """Return the file name of a hull's mesh; a new mesh is added."""
        assert shape.hull is not None
        content = stl_bytes(shape.hull)
        for path, existing in self.meshes.items():
            if existing == content:
                return path
        safe = "".join(c if c.isalnum() else "_" for c in body)
        path = f"mesh_{safe}_{len(self.meshes)}.stl"
        self.meshes[path] = content
        return path


def _box(x: float, y: float, z: float) -> Element:
    return Element("box", {"size": f"{x!r} {y!r} {z!r}"})


def _inertial(inertia: pin.Inertia) -> Element:
    """Build the element of an inertia in its link's frame."""
    moments = inertia.inertia
    columns = (("x", 0), ("y", 1), ("z", 2))
    words = {
        f"i{first}{second}": repr(float(moments[row, column]))
        for first, row in columns
        for second, column in columns[row:]
    }
    center = pin.SE3(pin.SE3.Identity().rotation, inertia.lever)
    return Element(
        "inertial",
        {},
        children=[
            Element("origin", origin_words(center)),
            Element("mass", {"value": repr(float(inertia.mass))}),
            Element("inertia", words),
        ],
    )


def _fixed(child: str, parent: str, pose: pin.SE3, taken: set[str]) -> Element:
    """Build the joint that fixes a link to its parent."""
    joint = Element("joint", {"name": _free(f"{child}_mount", taken), "type": "fixed"})
    joint.children = [
        Element("origin", origin_words(pose)),
        Element("parent", {"link": parent}),
        Element("child", {"link": child}),
    ]
    return joint


def _free(name: str, taken: set[str]) -> str:
    """Reserve an unused name."""
    candidate, number = name, 2
    while candidate in taken:
        candidate, number = f"{name}_{number}", number + 1
    taken.add(candidate)
    return candidate
