"""The URDF that an import writes: the robot's tree, hulls of its meshes, nothing that only other tools read."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from dualarm_cli.files.robots.mesh_writer import stl_bytes
from dualarm_cli.files.robots.urdf import Urdf, mesh_elements
from dualarm_cli.files.robots.urdf_tree import Element
from dualarm_cli.files.robots.urdf_writer import urdf_text
from dualarm_cli.model.shape import Hull, Shape

ROUNDED = 5e-5
"""How far a written angle may be from a multiple of a quarter turn to be taken for it [rad]: 1.5708 is."""
_KEPT = ("origin", "parent", "child", "axis", "limit", "mimic")


@dataclass(frozen=True)
class Described:
    """A robot description and its mesh files."""

    text: str
    """Of the URDF."""
    meshes: Mapping[str, bytes]
    """STL files by path."""
    reasons: tuple[str, ...]
    """What was changed, and why."""


def described(
    urdf: Urdf,
    meshes: Mapping[str, Sequence[Shape]],
    parts: Mapping[str, Sequence[Sequence[Hull]]],
) -> Described:
    """Returns the description of a robot as it is imported.

    Args:
        urdf: as it was read.
        meshes: its collision meshes by link.
        parts: convex parts of some links' meshes, by link and mesh; other meshes become their hulls.
    """
    files: dict[str, bytes] = {}
    elements = []
    for name, link in urdf.links.items():
        clean = Element("link", {"name": name})
        clean.children = [c for c in link.children if c.tag == "inertial"]
        hulls = iter(parts.get(name) or [[s.hull] for s in meshes.get(name, ()) if s.hull])
        for solid in link.all("collision"):
            if next(mesh_elements(solid), None) is None:
                clean.children.append(
                    Element("collision", solid.attributes, children=solid.children)
                )
                continue
            kept = [c for c in solid.children if c.tag == "origin"]
            for hull in next(hulls):
                path = f"meshes/{_safe(name)}_{len(files)}.stl"
                files[path] = stl_bytes(hull)
                mesh = Element("mesh", {"filename": path})
                geometry = Element("geometry", {}, children=[mesh])
                clean.children.append(Element("collision", {}, children=[*kept, geometry]))
        elements.append(clean)
    rounded = 0
    for name, joint in urdf.joints.items():
        clean = Element("joint", {"name": name, "type": joint.get("type")})
        for child in joint.children:
            if child.tag not in _KEPT:
                continue
            attributes = dict(child.attributes)
            if child.tag == "origin" and "rpy" in attributes:
                attributes["rpy"], turned = _exact(attributes["rpy"])
                rounded += turned
            clean.children.append(Element(child.tag, attributes))
        elements.append(clean)
    reasons = []
    if files:
        count = sum(map(len, meshes.values()))
        reasons.append(f"{count} collision meshes: convex hulls in meshes/")
    for name, divided in parts.items():
        reasons.append(f"{name}: {sum(map(len, divided))} convex parts")
    if rounded:
        reasons.append(f"{rounded} rounded angles of the URDF (such as 1.5708) are written in full")
    return Described(urdf_text(urdf.root.name or "robot", elements), files, tuple(reasons))


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


def _safe(name: str) -> str:
    return "".join(c if c.isalnum() else "_" for c in name)
