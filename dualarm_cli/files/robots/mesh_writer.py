"""Hulls as binary STL files."""

from __future__ import annotations

import struct

import numpy as np

from dualarm_cli.geometry.products import norm
from dualarm_cli.model.shape import Hull


def stl_bytes(hull: Hull) -> bytes:
    """Returns a hull as a binary STL file."""
    faces = hull.corners[hull.triangles]
    normals = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    normals /= np.maximum(norm(normals, axis=1, keepdims=True), 1e-300)
    rows = np.zeros(len(faces), dtype=[("vectors", "<f4", (12,)), ("more", "<u2")])
    rows["vectors"] = np.concatenate([normals, faces.reshape(-1, 9)], axis=1)
    return bytes(80) + struct.pack("<I", len(faces)) + rows.tobytes()
