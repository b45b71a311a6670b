"""The URDF that an import writes: the robot's tree, hulls of its meshes, nothing that only other tools read."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dualarm_cli.files.robots.urdf import MOVING_TYPES, Urdf, mesh_elements
from dualarm_cli.files.robots.urdf_tree import Element
from dualarm_cli.files.robots.urdf_writer import urdf_text
from dualarm_cli.model.shape import Shape
from dualarm_cli.robot_import.joint_limits import StatedLimits
from dualarm_cli.robot_import.structure import Structure

ROUNDED = 5e-5
"""How far a written angle may be from a multiple of a quarter turn to be taken for it [rad]: 1.5708 is."""
ASSUMED_SPEED = math.radians(90.0)
"""Top speed of a joint whose URDF has none [rad/s]."""
_KEPT = ("origin", "parent", "child", "axis", "limit", "mimic")


@dataclass(frozen=True)
class Described:
    """A robot description and its mesh files."""

    text: str
    """Of the URDF."""
    meshes: Mapping[str, bytes]
    """STL files by path."""
    assumed: frozenset[str]
    """Joints whose velocity limit is assumed."""
    reasons: tuple[str, ...]
    """What was changed, and why."""


def described(
    urdf: Urdf,
    meshes: Mapping[str, Sequence[Shape]],
    structure: Structure,
    limits: Mapping[str, StatedLimits],
) -> Described:
    """Returns the description of a robot as it is imported.

    Args:
        urdf: as it was read.
        meshes: its collision meshes by link.
        structure: its arms and platform.
        limits: of other files, by joint; velocities take the place of the URDF's where they are lower.
    """
    used = {joint for arm in structure.arms.values() for joint in arm.joints} | set(
        structure.platform
    )
    files: dict[str, bytes] = {}
    parts = []
    for name, link in urdf.links.items():
        clean = Element("link", {"name": name})
        clean.children = [c for c in link.children if c.tag == "inertial"]
        hulls = iter(meshes.get(name, ()))
        for solid in link.all("collision"):
            if next(mesh_elements(solid), None) is None:
                clean.children.append(
                    Element("collision", solid.attributes, children=solid.children)
                )
                continue
            shape = next(hulls)
            path = f"meshes/{_safe(name)}_{len(files)}.stl"
            files[path] = _stl(shape)
            mesh = Element("mesh", {"filename": path})
            kept = [c for c in solid.children if c.tag == "origin"]
            geometry = Element("geometry", {}, children=[mesh])
            clean.children.append(Element("collision", {}, children=[*kept, geometry]))
        parts.append(clean)
    rounded = 0
    slow: set[str] = set()
    for name, joint in urdf.joints.items():
        clean = Element("joint", {"name": name, "type": joint.get("type")})
        for child in joint.children:
            if child.tag not in _KEPT:
                continue
            attributes = dict(child.attributes)
            if child.tag == "origin" and "rpy" in attributes:
                attributes["rpy"], turned = _exact(attributes["rpy"])
                rounded += turned
            if child.tag == "limit" and name in used:
                _set_speed(name, attributes, limits, slow)
            clean.children.append(Element(child.tag, attributes))
        if name in used and joint.find("limit") is None and joint.get("type") in MOVING_TYPES:
            attributes = {}
            _set_speed(name, attributes, limits, slow)
            clean.children.append(Element("limit", attributes))
        parts.append(clean)
    reasons = []
    if files:
        reasons.append(f"{len(files)} collision meshes: convex hulls in meshes/")
    if rounded:
        reasons.append(f"{rounded} rounded angles of the URDF (such as 1.5708) are written in full")
    if slow:
        reasons.append(
            f"velocity limits assumed (90 deg/s), as the URDF has none: {', '.join(sorted(slow))}"
        )
    return Described(
        urdf_text(urdf.root.name or "robot", parts), files, frozenset(slow), tuple(reasons)
    )


def _set_speed(
    name: str, attributes: dict[str, str], limits: Mapping[str, StatedLimits], assumed: set[str]
) -> None:
    """Sets the velocity limit of a joint: the lower one of URDF and other file, an assumed one where there is none."""
    try:
        own = float(attributes.get("velocity", "0"))
    except ValueError:
        return  # the reader of robot files reports it
    other = limits[name].velocity if name in limits else None
    if other is not None and (own <= 0.0 or other < own):
        attributes["velocity"] = repr(other)
    elif own <= 0.0:
        attributes["velocity"] = repr(ASSUMED_SPEED)
        assumed.add(name)


def _exact(rpy: str) -> tuple[str, int]:
    """Returns angles with those near a multiple of a quarter turn made exact, and how many were."""
    found, count = [], 0
    for word in rpy.split():
        value = float(word)
        quarter = round(value / (0.5 * math.pi)) * 0.5 * math.pi
        near = 0.0 < abs(value - quarter) < ROUNDED
        found.append(repr(quarter) if near else word)
        count += near and abs(value - quarter) > 1e-12
    return " ".join(found), count


def _stl(shape: Shape) -> bytes:
    """Returns a hull as a binary STL file."""
    assert shape.hull is not None  # a mesh has one
    faces = shape.hull.corners[shape.hull.triangles]
    normals = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    rows = np.zeros(len(faces), dtype=[("vectors", "<f4", (12,)), ("more", "<u2")])
    rows["vectors"] = np.concatenate([normals, faces.reshape(-1, 9)], axis=1)
    return bytes(80) + struct.pack("<I", len(faces)) + rows.tobytes()


def _safe(name: str) -> str:
    return "".join(c if c.isalnum() else "_" for c in name)
