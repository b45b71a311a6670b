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
    """Returns the convex hull of a mesh file.

    Args:
        path: the file.
        reference: what the user calls it.
        scale: what coordinates along x, y and z are multiplied with to be metres, shape (3,).

    Raises:
        BadReferenceError: unreadable, of an unknown kind, damaged, too large, or without volume.
    """
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
        corners = _corners(data, suffix)
        if len(corners) > _MAX_STATED:
            raise MeshError(f"has {len(corners)} corners; at most {_MAX_STATED} are read")
        with np.errstate(over="ignore", invalid="ignore"):
            scaled = corners * scale
        return convex_hull(scaled)
    except MeshError as error:
        raise BadReferenceError(f"{quote(reference)} {error}") from None


def _corners(data: bytes, suffix: str) -> FloatArray:
    if suffix == ".stl":
        return stl_corners(data)
    if suffix == ".obj":
        return obj_corners(data)
    if suffix == ".ply":
        return ply_corners(data)
    return dae_corners(data, _MAX_STATED)


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


def link_meshes(urdf: Urdf, finder: MeshFinder) -> dict[str, tuple[Shape, ...]]:
    """Returns the meshes that a URDF gives to collision, by their links and in the links' frames.

    Meshes that are only looked at are not read: they may be missing.

    Args:
        urdf: a checked URDF.
        finder: finds its mesh files.

    Raises:
        InputError: a mesh is elsewhere, missing or damaged.
    """
    findings = UrdfFindings(urdf.source)
    shapes: dict[str, tuple[Shape, ...]] = {}
    for name, link in urdf.links.items():
        for solid in link.all("collision"):
            mesh = next(mesh_elements(solid), None)
            if mesh is None:
                continue
            reference = mesh.get("filename")
            try:
                hull = read_hull(finder.find(reference), reference, mesh_scale(mesh))
            except BadReferenceError as error:
                findings.add(mesh, f"mesh: {error}")
                continue
            shapes[name] = (*shapes.get(name, ()), Shape("mesh", (), _pose(solid), hull))
    findings.raise_if_any()
    return shapes


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
