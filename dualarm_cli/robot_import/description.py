"""The URDF that an import writes: the robot's tree, hulls of its meshes, nothing that only other tools read."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from decimal import Decimal

from dualarm_cli.files.robots.mesh_writer import stl_bytes
from dualarm_cli.files.robots.urdf import Urdf, mesh_elements
from dualarm_cli.files.robots.urdf_tree import Element
from dualarm_cli.files.robots.urdf_writer import urdf_text
from dualarm_cli.model.shape import Hull, Shape
from dualarm_cli.records import dataclass
from dualarm_cli.robot_import.names import count_of

NOISE, COARSE, UNITS = 1e-9, 1e-4, 5
"""A written angle within NOISE of a multiple of a quarter turn is that one [rad]; so is one within UNITS of its last
decimal, at most COARSE: 1.5708, 3.14159, and 1.570795, which is half of 3.14159."""
ROUNDED = 1e-3
"""Coarsest last decimal of an angle that is a multiple of a quarter turn where it rounds to it [rad]: 1.571, 3.142."""
_KEPT = ("origin", "parent", "child", "axis", "limit", "safety_controller", "mimic")


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
        count = sum(len(hulls) for name, hulls in meshes.items() if name not in parts)
        if count:
            whole = count_of(count, "collision mesh", "collision meshes")
            reasons.append(f"{whole}: taken as convex hulls, in meshes/")
    for name, divided in parts.items():
        reasons.append(f"{name}: {count_of(sum(map(len, divided)), 'convex part')}, in meshes/")
    if rounded:
        angles = count_of(rounded, "rounded angle")
        reasons.append(f"{angles} of the URDF (such as 1.5708) made exact")
    return Described(urdf_text(urdf.root.name or "robot", elements), files, tuple(reasons))


def _exact(rpy: str) -> tuple[str, int]:
    """Returns angles with rounded multiples of a quarter turn made exact, and how many were.

    Small angles stay as they are: a calibration measured them.
    """
    found, count = [], 0
    for word in rpy.split():
        value = float(word)
        quarter = round(value / (0.5 * math.pi)) * 0.5 * math.pi
        exponent = Decimal(word).normalize().as_tuple().exponent
        last = 10.0**exponent if isinstance(exponent, int) and 10.0**exponent <= ROUNDED else 0.0
        slack = min(UNITS * last, COARSE) if last <= COARSE else 0.5 * last
        near = quarter != 0.0 and abs(value - quarter) < max(NOISE, slack)
        found.append(repr(quarter) if near else word)
        count += near and abs(value - quarter) > 1e-12
    return " ".join(found), count


def _safe(name: str) -> str:
    return "".join(c if c.isalnum() else "_" for c in name)
