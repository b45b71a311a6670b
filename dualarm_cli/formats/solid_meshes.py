"""Triangle meshes of a cell's solids."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from typing import Any

import numpy as np

from dualarm_cli.exporting.cell_urdf import GROUND
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.elementary import TURN
from dualarm_cli.page.scene import DrawnHulls

AROUND, RINGS = 24, 6
"""Corners around a round solid, and rings of a hemisphere."""

Mesh = tuple[FloatArray, np.ndarray]


def solid_mesh(solid: Mapping[str, Any], hulls: DrawnHulls) -> Mesh:
    """Triangulate a solid in its own frame.

    Returns corners (m, 3) [m] and outward-facing triangles (k, 3). Corners of round solids lie on the surface; between
    them a triangle is at most 1 % of the radius inside.

    Args:
        solid: row of the page's data.
        hulls: of meshes.
    """
    size, kind = solid["size"], solid["kind"]
    if solid["hull"] is not None:
        return hull_mesh(hulls, solid["hull"])
    if kind == "box":
        return _box(np.array(size) / 2.0, 0.0)
    if kind == "half_space":
        side, thickness = GROUND
        return _box(np.array([side, side, thickness]) / 2.0, -thickness / 2.0)
    radius, half = size[0], (0.0 if kind == "sphere" else size[1] / 2.0)
    if kind == "cylinder":
        return _revolved([(0.0, -half), (radius, -half), (radius, half), (0.0, half)])
    angles = np.linspace(-np.pi / 2.0, 0.0, RINGS + 1)
    low = [(radius * np.cos(a), radius * np.sin(a) - half) for a in angles]
    high = [(r, -z) for r, z in reversed(low if half else low[:-1])]
    return _revolved([*low, *high])


def hull_mesh(hulls: DrawnHulls, number: int) -> Mesh:
    """Return the corners (m, 3) [m] and triangles (k, 3) of a hull."""
    row = hulls.rows[number]
    corners = np.frombuffer(base64.b64decode(row["corners"]), "<f4").reshape(-1, 3)
    triangles = np.frombuffer(base64.b64decode(row["triangles"]), "<u4").reshape(-1, 3)
    return corners.astype(np.float64), triangles


def _box(half: FloatArray, up: float) -> Mesh:
    """Triangulate a box, given half its sides and the height of its centre."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = [(a, b, c) for a, b, c, _ in quads] + [(a, c, d) for a, _, c, d in quads]
    return signs * half + [0.0, 0.0, up], np.array(triangles, dtype=np.uint32)


def _revolved(outline: list[tuple[float, float]]) -> Mesh:
    """Triangulate the solid of revolution of an outline about z.

    The outline has radii and heights, from bottom to top.
    """
    angle = np.arange(AROUND) * (TURN / AROUND)
    corners = [[r * np.cos(a), r * np.sin(a), z] for r, z in outline for a in angle]
    triangles = []
    for ring in range(len(outline) - 1):
        for k in range(AROUND):
            a, b = ring * AROUND + k, ring * AROUND + (k + 1) % AROUND
            c, d = a + AROUND, b + AROUND
            # A ring of radius zero is a point, whose triangles would have no area.
            if outline[ring][0] > 1e-12:
                triangles.append((a, b, d))
            if outline[ring + 1][0] > 1e-12:
                triangles.append((a, d, c))
    return np.array(corners), np.array(triangles, dtype=np.uint32)
