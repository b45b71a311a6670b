"""Decomposition of a mesh into convex parts by CoACD that contain its whole surface."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import numpy as np

from dualarm_cli.errors import MissingDependencyError, UsageError, did_you_mean
from dualarm_cli.files.robots.meshes import convex_hull, mesh_scale
from dualarm_cli.files.robots.packages import PackageFinder
from dualarm_cli.files.robots.urdf import Urdf, mesh_elements
from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.model.shape import Hull

CONCAVITY = 0.05
"""Concavity threshold of a part in CoACD's measure: 0.01 is fine, 1 is coarse."""
FACE_SHARE = 0.05
"""Maximum edge length of a face, as a fraction of the mesh's diagonal."""


def convex_parts(
    urdf: Urdf, finder: PackageFinder, units: Mapping[str, float], links: Collection[str]
) -> dict[str, list[list[Hull]]]:
    """Decompose the collision meshes of given links, in URDF order and mesh frames.

    Args:
        urdf: a checked URDF, whose meshes can be read.
        finder: finds its mesh files.
        units: of the mesh files by their names in the URDF [m]; the default is the metre.
        links: names of the links.

    Raises:
        MissingDependencyError: CoACD or trimesh is not installed.
        UsageError: a link does not exist or has no mesh.
    """
    parts: dict[str, list[list[Hull]]] = {}
    for name in links:
        if name not in urdf.links:
            hint = did_you_mean(name, list(urdf.links))
            raise UsageError(f"--convex-parts: the URDF has no link '{name}'{hint}")
        solids = urdf.links[name].all("collision")
        meshes = [mesh for mesh in (next(mesh_elements(s), None) for s in solids) if mesh]
        if not meshes:
            raise UsageError(f"--convex-parts: link '{name}' has no collision mesh")
        parts[name] = []
        for mesh in meshes:
            path = finder.mesh(mesh.get("filename"))
            scale = mesh_scale(mesh) * units.get(mesh.get("filename"), 1.0)
            parts[name].append(divided(*_triangles(path, scale)))
    return parts


def divided(corners: FloatArray, triangles: IntArray) -> list[Hull]:
    """Decompose a mesh into convex parts that contain every triangle completely.

    CoACD's parts may lack slivers of the mesh, so each triangle is added to the part from which it protrudes least.

    Args:
        corners: shape (n, 3) [m].
        triangles: numbers of their corners, shape (m, 3).

    Raises:
        MissingDependencyError: CoACD is not installed.
    """
    try:
        import coacd
    except ImportError:
        raise MissingDependencyError("coacd", "coacd") from None
    coacd.set_log_level("off")
    parts = coacd.run_coacd(coacd.Mesh(corners, triangles), threshold=CONCAVITY, seed=0)
    hulls = [convex_hull(np.asarray(part)) for part, _ in parts]
    of_faces = _sticking_out(hulls, corners)[:, triangles].max(axis=2).argmin(axis=0)
    faces = [corners[triangles[of_faces == k]].reshape(-1, 3) for k in range(len(hulls))]
    return [convex_hull(np.concatenate([h.corners, f])) for h, f in zip(hulls, faces, strict=True)]


def _sticking_out(hulls: Sequence[Hull], points: FloatArray) -> FloatArray:
    """Compute the protrusion of points from hulls along face normals, shape (hulls, points) [m]."""
    protrusion = np.empty((len(hulls), len(points)))
    for k, hull in enumerate(hulls):
        first, second, third = (hull.corners[hull.triangles[:, i]] for i in range(3))
        normals = np.cross(second - first, third - first)
        normals /= np.maximum(norm(normals, axis=1, keepdims=True), 1e-300)
        heights = np.einsum("ij,ij->i", normals, first)
        protrusion[k] = (product(points, normals.T) - heights).max(axis=1)
    return protrusion


def _triangles(path: Path, scale: FloatArray) -> tuple[FloatArray, IntArray]:
    """Read the corners [m] and triangles of a mesh file, with long triangles divided."""
    try:
        import trimesh
    except ImportError:
        raise MissingDependencyError("trimesh", "coacd") from None
    mesh = trimesh.load_mesh(path)
    corners, triangles = np.asarray(mesh.vertices) * scale, np.asarray(mesh.faces)
    longest = FACE_SHARE * float(norm(np.ptp(corners, axis=0)))
    corners, triangles = trimesh.remesh.subdivide_to_size(corners, triangles, longest)
    return np.asarray(corners), np.asarray(triangles)
