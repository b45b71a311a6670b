"""Mesh files: only inside the folder of what names them, there, and not absurd."""

from __future__ import annotations

import os
import re
import struct
from pathlib import Path

import numpy as np

from dualarm_cli.errors import InputError
from dualarm_cli.loading.projects import BadReferenceError, Project
from dualarm_cli.loading.text_source import quote, read_bytes
from dualarm_cli.loading.urdf import Urdf
from dualarm_cli.loading.urdf_shapes import mesh_elements
from dualarm_cli.loading.urdf_tree import UrdfFindings

MESH_SUFFIXES = (".stl", ".obj", ".ply", ".dae")
"""Kinds of mesh files."""
MAX_MESH_BYTES = 50_000_000
"""Largest mesh file [bytes]."""
_STL_HEADER, _STL_TRIANGLE = 84, 50
_STL_ROWS = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_NOT_FINITE = re.compile(rb"(?<![\w.])[+-]?(?:nan|inf|infinity)(?![\w.])", re.IGNORECASE)
"""A number in a text file that is none; coal would crash on it."""


def check_mesh_file(path: Path, reference: str) -> None:
    """Makes sure that a mesh file is one, as far as its size and header tell.

    Args:
        path: the file.
        reference: what the user calls it.

    Raises:
        BadReferenceError: unreadable, too large, of an unknown kind, or cut off.
    """
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise BadReferenceError(
            f"{quote(reference)} is no mesh file; allowed: {', '.join(MESH_SUFFIXES)}"
        )
    try:
        data = read_bytes(path, reference, MAX_MESH_BYTES)
    except InputError as error:
        raise BadReferenceError(f"{quote(reference)} {error.diagnostics[0].message}") from None
    if not data:
        raise BadReferenceError(f"{quote(reference)} is empty")
    if path.suffix.lower() == ".stl" and not data.lstrip().startswith(b"solid"):
        count = (
            struct.unpack_from("<I", data, _STL_HEADER - 4)[0] if len(data) >= _STL_HEADER else 0
        )
        if count == 0 or len(data) < _STL_HEADER + _STL_TRIANGLE * count:
            raise BadReferenceError(
                f"{quote(reference)} is not a whole STL file: "
                f"{count} triangles in {len(data)} bytes"
            )
        triangles = np.frombuffer(data, _STL_ROWS, count=count, offset=_STL_HEADER)
        finite = bool(np.isfinite(triangles["corners"]).all())
    else:
        finite = _NOT_FINITE.search(data) is None
    if not finite:
        raise BadReferenceError(f"{quote(reference)} has a corner that is not finite")


def check_urdf_meshes(urdf: Urdf, robot_folder: Path, urdf_folder: Path) -> None:
    """Makes sure that every mesh of a URDF lies in the robot's folder.

    Args:
        urdf: a checked URDF.
        robot_folder: folder of the robot file.
        urdf_folder: folder of the URDF, which mesh paths are relative to.

    Raises:
        InputError: a mesh is elsewhere, missing or no mesh.
    """
    findings = UrdfFindings(urdf.source)
    folder = Project(Path(os.path.realpath(robot_folder)))
    for mesh in mesh_elements(urdf.root):
        reference = mesh.get("filename")
        try:
            path = folder.follow(reference, urdf_folder / "urdf")
            check_mesh_file(path, reference)
        except BadReferenceError as error:
            findings.add(mesh, f"mesh: {error}")
    findings.raise_if_any()
