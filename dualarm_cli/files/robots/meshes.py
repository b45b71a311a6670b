"""Reader of mesh files as convex hulls, within limits.

COLLADA (DAE) files are read here: the corners of the geometry in their scene, and their length unit. Faces are not
read, because a hull needs none. The upward axis of the file is not applied: ROS tools ignore it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import field
from pathlib import Path
from typing import TypeVar

import numpy as np
import pinocchio as pin

from dualarm_cli.errors import InputError
from dualarm_cli.files.robots.mesh_formats import (
    MeshError,
    mesh_number,
    obj_corners,
    ply_corners,
    stl_corners,
)
from dualarm_cli.files.robots.notes import robot_note
from dualarm_cli.files.robots.packages import PackageFinder
from dualarm_cli.files.robots.urdf import Urdf, mesh_elements
from dualarm_cli.files.robots.urdf_tree import Element, UrdfFindings, parse_xml
from dualarm_cli.files.source.projects import BadReferenceError
from dualarm_cli.files.source.text_source import TextSource, quote, read_bytes
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.model.shape import Hull, Shape, VisualMesh
from dualarm_cli.notes import Note
from dualarm_cli.records import dataclass

MESH_SUFFIXES = (".stl", ".obj", ".ply", ".dae")
"""Suffixes of mesh files."""


@dataclass(frozen=True)
class MeshLimits:
    """Limits of mesh files, which bound the memory."""

    size: int = 50_000_000
    """Largest mesh file [bytes]."""
    corners: int = 300_000
    """Maximum number of distinct corners of a mesh: their hull takes some four seconds."""
    coordinate: float = 1000.0
    """Maximum absolute coordinate of a corner [m]."""
    stated: int = 3_000_000
    """Maximum number of corners of a mesh, with repetitions by faces."""
    nodes: int = 10_000
    """Maximum number of nodes in a scene; a node counts each time it is instantiated."""
    depth: int = 100
    """Maximum depth of nodes in a scene."""


MESH = MeshLimits()


def read_hull(path: Path, reference: str, scale: FloatArray) -> Hull:
    """Read the convex hull of a mesh file.

    The unit of a COLLADA file is not applied.

    Args:
        path: the file.
        reference: what the user calls it.
        scale: what coordinates along x, y and z are multiplied with to be metres, shape (3,).

    Raises:
        BadReferenceError: unreadable, of an unknown kind, damaged, too large, or without volume.
    """
    corners, _ = _corners(path, reference)
    return _scaled_hull(corners, reference, scale)


def link_hull(path: Path, reference: str, scale: FloatArray) -> tuple[Hull, float]:
    """Read the convex hull of a URDF's mesh file, and the file's unit [m].

    The unit is applied, as in RViz and Gazebo; MoveIt's collision checks do not apply it. A scale in addition to a unit
    is ambiguous.

    Args:
        path: the file.
        reference: what the user calls it.
        scale: of the URDF, shape (3,).

    Raises:
        BadReferenceError: unreadable, of an unknown kind, damaged, too large, without volume, or scaled twice.
    """
    corners, unit = _corners(path, reference)
    if unit != 1.0 and not np.allclose(np.abs(scale), 1.0):
        factors = " ".join(f"{factor:g}" for factor in scale)
        raise BadReferenceError(
            f"{quote(reference)} has a unit of {unit:g} m and a scale of {factors} in the URDF: tools combine them "
            'differently. Remove the scale, or write <unit meter="1"/> in the file'
        )
    return _scaled_hull(corners, reference, scale * unit), unit


def _scaled_hull(corners: FloatArray, reference: str, scale: FloatArray) -> Hull:
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            scaled = corners * scale
        return convex_hull(scaled)
    except MeshError as error:
        raise BadReferenceError(f"{quote(reference)} {error}") from None


def _corners(path: Path, reference: str) -> tuple[FloatArray, float]:
    """Read the corners of a mesh file, and its unit [m], by default 1."""
    suffix = path.suffix.lower()
    if suffix not in MESH_SUFFIXES:
        raise BadReferenceError(
            f"{quote(reference)} is not a mesh file; allowed: {', '.join(MESH_SUFFIXES)}"
        )
    try:
        data = read_bytes(path, reference, MESH.size)
    except InputError as error:
        raise BadReferenceError(f"{quote(reference)} {error.diagnostics[0].message}") from None
    try:
        if not data.strip():
            raise MeshError("is empty")
        corners, unit = _parsed(data, suffix)
        if len(corners) > MESH.stated:
            raise MeshError(f"has {len(corners)} corners; at most {MESH.stated} are read")
    except MeshError as error:
        raise BadReferenceError(f"{quote(reference)} {error}") from None
    return corners, unit


def _parsed(data: bytes, suffix: str) -> tuple[FloatArray, float]:
    if suffix == ".dae":
        return dae_corners(data, MESH.stated)
    read = {".stl": stl_corners, ".obj": obj_corners, ".ply": ply_corners}[suffix]
    return read(data), 1.0


def convex_hull(corners: FloatArray) -> Hull:
    """Compute the convex hull of corners (n, 3) [m], by Qhull.

    Raises:
        MeshError: a corner that is not finite or far away, too many of them, or no volume.
    """
    from scipy.spatial import ConvexHull, QhullError

    corners = np.unique(corners, axis=0)
    finite = np.isfinite(corners).all(axis=1)
    if not finite.all():
        raise MeshError("has a corner that is not finite; export it again")
    far = np.abs(corners).max(initial=0.0)
    if far > MESH.coordinate:
        raise MeshError(
            f"has a corner at {far:g} m; at most {MESH.coordinate / 1e3:g} km from the origin is allowed; "
            "check its unit and the scale"
        )
    if len(corners) > MESH.corners:
        raise MeshError(
            f"has {len(corners)} different corners; at most {MESH.corners} are allowed; simplify it"
        )
    try:
        hull = ConvexHull(corners)
    except (QhullError, ValueError):
        raise MeshError(
            "has no volume: its corners lie in a plane or closer together than rounding"
        ) from None
    used = hull.vertices
    number = np.full(len(corners), -1)
    number[used] = np.arange(len(used))
    triangles = number[hull.simplices]
    first, second, third = (corners[used][triangles[:, k]] for k in range(3))
    inward = (
        np.einsum("ij,ij->i", np.cross(second - first, third - first), hull.equations[:, :3]) < 0.0
    )
    triangles[inward] = triangles[inward][:, ::-1]
    return Hull(corners[used], triangles)


@dataclass(frozen=True)
class LinkMeshes:
    """Meshes of a URDF."""

    shapes: dict[str, tuple[Shape, ...]]
    """Hulls by link, in the link frames."""
    units: dict[str, float]
    """Length unit [m] of COLLADA files not in metres, by name in the URDF."""
    visuals: tuple[VisualMesh, ...] = ()
    """Meshes that show the links."""

    @property
    def notes(self) -> list[Note]:
        """Notes on units."""
        files = [f"{name} ({unit:g} m)" for name, unit in self.units.items()]
        return [robot_note("units", files=files)] if files else []


def link_meshes(urdf: Urdf, finder: PackageFinder) -> LinkMeshes:
    """Read the collision meshes of a URDF.

    Visual meshes are not read here: they may be missing.

    Args:
        urdf: a checked URDF.
        finder: finds its mesh files.

    Raises:
        InputError: a mesh is elsewhere, missing or damaged.
    """
    findings = UrdfFindings(urdf.source)
    shapes: dict[str, tuple[Shape, ...]] = {}
    units: dict[str, float] = {}
    unread: dict[str, list[Element]] = {}
    for name, link in urdf.links.items():
        for solid in link.all("collision"):
            mesh = next(mesh_elements(solid), None)
            if mesh is None:
                continue
            reference = mesh.get("filename")
            try:
                hull, unit = link_hull(finder.mesh(reference), reference, mesh_scale(mesh))
            except BadReferenceError as error:
                unread.setdefault(str(error), []).append(mesh)
                continue
            shapes[name] = (*shapes.get(name, ()), Shape("mesh", (), element_pose(solid), hull))
            if unit != 1.0:
                units[reference] = unit
    for message, (first, *others) in unread.items():
        count = f" ({len(others) + 1} meshes)" if others else ""
        findings.add(first, f"mesh: {message}{count}")
    findings.raise_if_any()
    return LinkMeshes(shapes, units)


def mesh_scale(mesh: Element) -> FloatArray:
    """Read the scale of a mesh element along x, y and z, shape (3,)."""
    return _vector(mesh, "scale", 1.0)


def element_pose(solid: Element) -> pin.SE3:
    """Read the pose of a shape in its link."""
    origin = solid.find("origin")
    if origin is None:
        return pin.SE3.Identity()
    rpy = _vector(origin, "rpy", 0.0)
    return pin.SE3(pin.rpy.rpyToMatrix(rpy), _vector(origin, "xyz", 0.0))


def _vector(element: Element, attribute: str, default: float) -> FloatArray:
    words = element.get(attribute).split()
    return np.array([float(word) for word in words]) if words else np.full(3, default)


_PRIMITIVES = ("triangles", "polylist", "polygons", "tristrips", "trifans")
_TRANSFORMS = {"matrix": 16, "translate": 3, "rotate": 4, "scale": 3}
"""Elements that move a node, with their number of values."""
_T = TypeVar("_T")


@dataclass
class _Scene:
    """Nodes and corners of a COLLADA scene while it is traversed."""

    nodes: dict[str, Element]
    """Nodes that may be instantiated, by id."""
    corners: dict[str, FloatArray]
    """Corners of each geometry, by id."""
    remaining: int
    """Number of corners that may still be added."""
    visited: int = 0
    """Number of nodes visited so far."""
    placed: list[FloatArray] = field(default_factory=list)
    """Transformed corners of the scene."""


def dae_corners(data: bytes, most: int) -> tuple[FloatArray, float]:
    """Read the corners in a COLLADA scene, shape (n, 3), and their unit [m].

    Args:
        data: the whole file.
        most: how many corners it may have, each as often as it is instantiated.

    Raises:
        MeshError: it is damaged, too large, or has what is not read: skinned meshes, files elsewhere.
    """
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise MeshError("is not UTF-8") from None
    try:
        root = parse_xml(TextSource("", text, ""))
    except InputError as error:
        fault = error.diagnostics[0]
        raise MeshError(f"line {fault.line}: {fault.message}") from None
    if root.tag != "COLLADA":
        raise MeshError(f"line {root.line}: root element must be <COLLADA>, not <{root.tag}>")
    geometries = {
        geometry.get("id"): _geometry_corners(geometry)
        for library in root.all("library_geometries")
        for geometry in library.all("geometry")
        if geometry.find("mesh") is not None
    }
    nodes = {
        element.get("id"): element
        for tag in ("library_nodes", "library_visual_scenes")
        for library in root.all(tag)
        for element in _below(library)
        if element.tag in ("node", "visual_scene")
    }
    scene = _Scene(nodes, geometries, most)
    shown = [
        instance for part in root.all("scene") for instance in part.all("instance_visual_scene")
    ]
    if len(shown) != 1:
        raise MeshError(f"must have one <instance_visual_scene>, not {len(shown)}")
    _show(_target(shown[0], nodes), np.eye(4), scene, 0)
    if not scene.placed:
        raise MeshError("shows no geometry with faces")
    return np.concatenate(scene.placed), _unit(root)


def _unit(root: Element) -> float:
    """Read the length unit of a file [m]; 1 if it has none."""
    asset = root.find("asset")
    element = asset.find("unit") if asset is not None else None
    if element is None:
        return 1.0
    where = f"line {element.line}: <unit>"
    unit = mesh_number(element.get("meter", "1").encode(), where)
    if unit <= 0.0:
        raise MeshError(f"{where} must be above 0 m, not {unit:g} m")
    return unit


def _below(element: Element) -> Iterator[Element]:
    for child in element.children:
        yield child
        yield from _below(child)


def _target(instance: Element, targets: Mapping[str, _T]) -> _T:
    """Look up the target of an instance's url."""
    url = instance.get("url")
    if not url.startswith("#") or url[1:] not in targets:
        raise MeshError(
            f"line {instance.line}: <{instance.tag}> names {quote(url)}, which is not in the file"
        )
    return targets[url[1:]]


def _show(node: Element, T_scene_parent: FloatArray, scene: _Scene, depth: int) -> None:
    """Add the corners of a node's geometries and of its child nodes."""
    scene.visited += 1
    if scene.visited > MESH.nodes or depth > MESH.depth:
        raise MeshError(
            f"line {node.line}: more than {MESH.nodes} nodes, or deeper than {MESH.depth}"
        )
    T_scene_node = T_scene_parent
    for part in node.children:
        if part.tag in _TRANSFORMS:
            T_scene_node = product(T_scene_node, _transform(part))
    for part in node.children:
        if part.tag == "node":
            _show(part, T_scene_node, scene, depth + 1)
        elif part.tag == "instance_node":
            _show(_target(part, scene.nodes), T_scene_node, scene, depth + 1)
        elif part.tag == "instance_geometry":
            corners = _target(part, scene.corners)
            scene.remaining -= len(corners)
            if scene.remaining < 0:
                raise MeshError(
                    f"line {part.line}: more corners than the {MESH.stated} that are read"
                )
            scene.placed.append(product(corners, T_scene_node[:3, :3].T) + T_scene_node[:3, 3])
        elif part.tag in ("lookat", "skew", "instance_controller"):
            raise MeshError(
                f"line {part.line}: <{part.tag}> is not read; export the mesh as it stands, with its nodes' matrices"
            )


def _transform(element: Element) -> FloatArray:
    """Compute the matrix of one transform element of a node, shape (4, 4)."""
    values = _numbers(element)
    if len(values) != _TRANSFORMS[element.tag]:
        raise MeshError(
            f"line {element.line}: <{element.tag}> needs {_TRANSFORMS[element.tag]} numbers, not {len(values)}"
        )
    if element.tag == "matrix":
        return values.reshape(4, 4)
    T = np.eye(4)
    if element.tag == "translate":
        T[:3, 3] = values
    elif element.tag == "scale":
        T[:3, :3] = np.diag(values)
    elif (length := norm(values[:3])) > 0.0:
        T[:3, :3] = pin.AngleAxis(math.radians(values[3]), values[:3] / length).matrix()
    return T


def _geometry_corners(geometry: Element) -> FloatArray:
    """Read all corners of a geometry, shape (n, 3); none without faces."""
    (mesh, *_) = geometry.all("mesh")
    sources = {source.get("id"): source for source in mesh.all("source")}
    vertices, positions = mesh.find("vertices"), None
    for entry in vertices.all("input") if vertices is not None else ():
        if entry.get("semantic") == "POSITION":
            positions = sources.get(entry.get("source").removeprefix("#"))
    if vertices is None or positions is None:
        raise MeshError(f"line {mesh.line}: <mesh> has no <vertices> with positions")
    if not any(part.tag in _PRIMITIVES for part in mesh.children):
        # Lines only: there is no surface.
        return np.empty((0, 3))
    return _positions(positions)


def _positions(source: Element) -> FloatArray:
    """Read the points of a source, shape (n, 3)."""
    array, technique = source.find("float_array"), source.find("technique_common")
    accessor = technique.find("accessor") if technique is not None else None
    if array is None or accessor is None:
        raise MeshError(f"line {source.line}: <source> needs <float_array> and <accessor>")
    values = _numbers(array)
    count, stride, offset = (
        _whole(accessor, name, default)
        for name, default in (("count", ""), ("stride", "1"), ("offset", "0"))
    )
    if stride < 3 or count > len(values) or offset + count * stride > len(values):
        raise MeshError(
            f"line {accessor.line}: <accessor> needs {count} times {stride} numbers "
            f"from {offset} on, but its array has {len(values)}"
        )
    return values[offset : offset + count * stride].reshape(count, stride)[:, :3]


def _numbers(element: Element) -> FloatArray:
    where = f"line {element.line}: <{element.tag}>"
    return np.array(
        [mesh_number(word, where) for word in element.text.encode().split()], dtype=np.float64
    )


def _whole(element: Element, name: str, default: str) -> int:
    text = element.get(name, default)
    if not (text.isascii() and text.isdigit()) or len(text) > 9:
        raise MeshError(f"line {element.line}: {name} must be a whole number, not {quote(text)}")
    return int(text)
