"""Mesh files: read by ourselves within limits, as convex hulls."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin

from dualarm_cli.errors import InputError
from dualarm_cli.files.robots.mesh_collada import dae_corners
from dualarm_cli.files.robots.mesh_formats import MeshError, obj_corners, ply_corners, stl_corners
from dualarm_cli.files.robots.packages import MeshFinder
from dualarm_cli.files.robots.urdf import Urdf, mesh_elements
from dualarm_cli.files.robots.urdf_tree import Element, UrdfFindings
from dualarm_cli.files.source.projects import BadReferenceError
from dualarm_cli.files.source.text_source import quote, read_bytes
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.shape import Hull, Shape
from dualarm_cli.records import dataclass

MESH_SUFFIXES = (".stl", ".obj", ".ply", ".dae")
"""Kinds of mesh files."""
MAX_MESH_BYTES = 50_000_000
"""Largest mesh file [bytes]."""
MAX_CORNERS = 300_000
"""Most different corners of a mesh: their hull takes some four seconds."""
MAX_COORDINATE = 1000.0
"""Farthest that a corner may be from the origin along an axis [m]."""
_MAX_STATED = 3_000_000
"""Most corners of a mesh, each as often as faces have it."""


def read_hull(path: Path, reference: str, scale: FloatArray) -> Hull:
    """Returns the convex hull of a mesh file. A unit that a COLLADA file states is not applied.

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
    """Returns the convex hull of a URDF's mesh file, and the unit that the file states [m], which is applied.

    So do RViz and Gazebo; MoveIt's collision checks do not. A scale on top of a unit can mean either.

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
            f"{quote(reference)} states a unit of {unit:g} m, and the URDF scales it by {factors}: tools differ in "
            'what that means. Take the scale away, or write <unit meter="1"/> in the file'
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
    """Returns the corners of a mesh file, and the unit that it states [m], 1 where it states none."""
    suffix = path.suffix.lower()
    if suffix not in MESH_SUFFIXES:
        raise BadReferenceError(
            f"{quote(reference)} is not a mesh file; allowed: {', '.join(MESH_SUFFIXES)}"
        )
    try:
        data = read_bytes(path, reference, MAX_MESH_BYTES)
    except InputError as error:
        raise BadReferenceError(f"{quote(reference)} {error.diagnostics[0].message}") from None
    try:
        if not data.strip():
            raise MeshError("is empty")
        corners, unit = _parsed(data, suffix)
        if len(corners) > _MAX_STATED:
            raise MeshError(f"has {len(corners)} corners; at most {_MAX_STATED} are read")
    except MeshError as error:
        raise BadReferenceError(f"{quote(reference)} {error}") from None
    return corners, unit


def _parsed(data: bytes, suffix: str) -> tuple[FloatArray, float]:
    if suffix == ".dae":
        return dae_corners(data, _MAX_STATED)
    read = {".stl": stl_corners, ".obj": obj_corners, ".ply": ply_corners}[suffix]
    return read(data), 1.0


def convex_hull(corners: FloatArray) -> Hull:
    """Returns the convex hull of corners (n, 3) [m], by Qhull.

    Raises:
        MeshError: a corner that is not finite or far away, too many of them, or no volume.
    """
    from scipy.spatial import ConvexHull, QhullError

    corners = np.unique(corners, axis=0)
    finite = np.isfinite(corners).all(axis=1)
    if not finite.all():
        raise MeshError("has a corner that is not finite; export it again")
    far = np.abs(corners).max(initial=0.0)
    if far > MAX_COORDINATE:
        raise MeshError(
            f"has a corner at {far:g} m; at most {MAX_COORDINATE / 1e3:g} km from the origin is allowed; "
            "check its unit and the scale"
        )
    if len(corners) > MAX_CORNERS:
        raise MeshError(
            f"has {len(corners)} different corners; at most {MAX_CORNERS} are allowed; simplify it"
        )
    try:
        found = ConvexHull(corners)
    except (QhullError, ValueError):
        raise MeshError(
            "has no volume: its corners lie in a plane or closer together than rounding"
        ) from None
    used = found.vertices
    number = np.full(len(corners), -1)
    number[used] = np.arange(len(used))
    triangles = number[found.simplices]
    first, second, third = (corners[used][triangles[:, k]] for k in range(3))
    inward = (
        np.einsum("ij,ij->i", np.cross(second - first, third - first), found.equations[:, :3]) < 0.0
    )
    triangles[inward] = triangles[inward][:, ::-1]
    return Hull(corners[used], triangles)


@dataclass(frozen=True)
class LinkMeshes:
    """The meshes that a URDF gives to collision."""

    shapes: dict[str, tuple[Shape, ...]]
    """Their hulls by link, in the links' frames."""
    units: dict[str, float]
    """The unit that a COLLADA file states [m] by its name in the URDF, where it is not the metre."""

    @property
    def notes(self) -> list[str]:
        """Notes on units."""
        if not self.units:
            return []
        files = ", ".join(f"{name} ({unit:g} m)" for name, unit in self.units.items())
        return [
            f"units that COLLADA files state are applied, as RViz does and MoveIt's collision checks do not: {files}"
        ]


def link_meshes(urdf: Urdf, finder: MeshFinder) -> LinkMeshes:
    """Returns the meshes that a URDF gives to collision.

    Meshes that are only looked at are not read: they may be missing.

    Args:
        urdf: a checked URDF.
        finder: finds its mesh files.

    Raises:
        InputError: a mesh is elsewhere, missing or damaged.
    """
    findings = UrdfFindings(urdf.source)
    shapes: dict[str, tuple[Shape, ...]] = {}
    units: dict[str, float] = {}
    for name, link in urdf.links.items():
        for solid in link.all("collision"):
            mesh = next(mesh_elements(solid), None)
            if mesh is None:
                continue
            reference = mesh.get("filename")
            try:
                hull, unit = link_hull(finder.find(reference), reference, mesh_scale(mesh))
            except BadReferenceError as error:
                findings.add(mesh, f"mesh: {error}")
                continue
            shapes[name] = (*shapes.get(name, ()), Shape("mesh", (), _pose(solid), hull))
            if unit != 1.0:
                units[reference] = unit
    findings.raise_if_any()
    return LinkMeshes(shapes, units)


def mesh_scale(mesh: Element) -> FloatArray:
    """Returns what a mesh element multiplies coordinates along x, y and z with, shape (3,)."""
    return _vector(mesh, "scale", 1.0)


def _pose(solid: Element) -> pin.SE3:
    """Returns where a shape is in its link."""
    origin = solid.find("origin")
    if origin is None:
        return pin.SE3.Identity()
    rpy = _vector(origin, "rpy", 0.0)
    return pin.SE3(pin.rpy.rpyToMatrix(rpy), _vector(origin, "xyz", 0.0))


def _vector(element: Element, attribute: str, default: float) -> FloatArray:
    words = element.get(attribute).split()
    return np.array([float(word) for word in words]) if words else np.full(3, default)
