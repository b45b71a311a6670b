"""Writer of URDF text: with selected moving joints, of a pair of robots, or from elements."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np
import pinocchio as pin

from dualarm_cli.files.robots.urdf import Urdf, UrdfJoint, mesh_elements
from dualarm_cli.files.robots.urdf_tree import Element
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.records import dataclass

ESCAPES = str.maketrans(
    {
        "&": "&amp;",
        "<": "&lt;",
        ">": "&gt;",
        '"': "&quot;",
        "\n": "&#10;",
        "\r": "&#13;",
        "\t": "&#9;",
    }
)
"""Escapes of characters in attributes.

The standard library's function would load all modules that open web addresses.
"""
_LINK_PARTS = ("inertial", "visual", "collision")


def write_urdf(urdf: Urdf, joints: list[UrdfJoint], frozen: Mapping[str, float]) -> str:
    """Write a complete URDF in which exactly the given joints move.

    Continuous joints become revolute with wide limits, axes get unit length, every other joint is fixed.
    Capsules, which many readers do not support, become a cylinder and two spheres. Meshes, whose paths would be
    wrong, and extensions of other tools are omitted.

    Args:
        urdf: a checked URDF.
        joints: the joints that move.
        frozen: where other joints stand [rad or m]; at 0 where it does not say.
    """
    moving = {joint.name: joint for joint in joints}
    parts = [_clean_link(link) for link in urdf.links.values()]
    for joint in urdf.joints.values():
        parts.append(_clean_joint(joint, moving.get(joint.name), frozen.get(joint.name, 0.0)))
    return urdf_text(urdf.root.name or "robot", parts)


@dataclass(frozen=True)
class PairMember:
    """Robot of a pair, with its names in the pair."""

    urdf: Urdf
    """Clean URDF."""
    base: pin.SE3
    """Pose of its root link in the cell."""
    links: Mapping[str, str]
    """Names of its links in the pair, by their names in the URDF."""
    joints: Mapping[str, str]
    """Names of its joints in the pair, by their names in the URDF."""


def write_pair(members: Mapping[str, PairMember]) -> str:
    """Write one URDF with two robots on a `world` link.

    Args:
        members: robots by arm name.
    """
    parts = [Element("link", {"name": "world"})]
    for side, member in members.items():
        parts += [_renamed(element, member) for element in member.urdf.root.children]
        joint = Element("joint", {"name": f"world_to_{side}", "type": "fixed"})
        joint.children = [
            Element("origin", origin_words(member.base)),
            Element("parent", {"link": "world"}),
            Element("child", {"link": member.links[member.urdf.root_link]}),
        ]
        parts.append(joint)
    return urdf_text("_and_".join(member.urdf.root.name for member in members.values()), parts)


def _clean_link(link: Element) -> Element:
    parts = [
        clean
        for child in link.children
        if child.tag in _LINK_PARTS and next(mesh_elements(child), None) is None
        for clean in _without_capsule(_without_materials(child), link.name)
    ]
    return Element("link", {"name": link.name}, children=parts)


def _without_capsule(element: Element, link: str) -> list[Element]:
    """Replace a capsule by a cylinder and two spheres; keep other elements."""
    geometry = element.find("geometry")
    capsule = None if geometry is None else geometry.find("capsule")
    if capsule is None:
        return [element]
    origin = element.find("origin") or Element("origin", {})
    rpy = [float(word) for word in origin.get("rpy", "0 0 0").split()]
    xyz = [float(word) for word in origin.get("xyz", "0 0 0").split()]
    radius, length = (float(capsule.get(size)) for size in ("radius", "length"))
    along = pin.rpy.rpyToMatrix(*rpy)[:, 2] * length / 2.0
    solids = []
    for ending, shift, tag in (
        ("", 0.0, "cylinder"),
        ("_a", -1.0, "sphere"),
        ("_b", 1.0, "sphere"),
    ):
        sizes = {"radius": repr(radius)} | ({"length": repr(length)} if tag == "cylinder" else {})
        place = " ".join(repr(float(v) + 0.0) for v in np.array(xyz) + shift * along)
        words = {"xyz": place, "rpy": " ".join(repr(v) for v in rpy)}
        shape = Element("geometry", {}, children=[Element(tag, sizes)])
        name = f"{element.name or f'{link}_capsule'}{ending}"
        solids.append(
            Element(element.tag, {"name": name}, children=[Element("origin", words), shape])
        )
    return solids


def _without_materials(element: Element) -> Element:
    children = [_without_materials(c) for c in element.children if c.tag != "material"]
    return Element(element.tag, element.attributes, children=children)


def _clean_joint(joint: Element, moving: UrdfJoint | None, position: float) -> Element:
    kind = "fixed" if moving is None else "prismatic" if moving.slides else "revolute"
    clean = Element("joint", {"name": joint.name, "type": kind})
    kept = ("origin", "parent", "child")
    clean.children = [Element(c.tag, c.attributes) for c in joint.children if c.tag in kept]
    axis = joint.find("axis")
    vector = (
        [float(word) for word in axis.get("xyz").split()] if axis is not None else [1.0, 0.0, 0.0]
    )
    length = math.hypot(*vector)
    if moving is None:
        if position:
            _displace(clean, joint, np.array(vector) / length * position)
        return clean
    unit = " ".join(repr(v / length + 0.0) for v in vector)
    effort = joint.child_name("limit", "effort") or "0"
    limits = {"lower": moving.lower, "upper": moving.upper, "velocity": moving.velocity}
    attributes = {name: repr(value) for name, value in limits.items()} | {"effort": effort}
    clean.children += [Element("axis", {"xyz": unit}), Element("limit", attributes)]
    return clean


def _displace(clean: Element, joint: Element, displacement: FloatArray) -> None:
    """Move the origin of a fixed joint by a displacement from its zero.

    The joint is turned [rad] or slid [m] along its axis, shape (3,).
    """
    origin = clean.find("origin") or Element("origin", {})
    xyz, rpy = (
        np.array([float(word) for word in origin.get(key, "0 0 0").split()])
        for key in ("xyz", "rpy")
    )
    T = pin.SE3(pin.rpy.rpyToMatrix(rpy), xyz)
    if joint.get("type") == "prismatic":
        T = T * pin.SE3(np.eye(3), displacement)
    else:
        T = T * pin.SE3(pin.exp3(displacement), np.zeros(3))
    clean.children = [
        Element("origin", origin_words(T)),
        *(c for c in clean.children if c.tag != "origin"),
    ]


def origin_words(pose: pin.SE3) -> dict[str, str]:
    """Format a pose as the attributes of an `origin`."""
    parts = (("xyz", pose.translation), ("rpy", pin.rpy.matrixToRpy(pose.rotation)))
    return {key: " ".join(repr(float(v) + 0.0) for v in values) for key, values in parts}


def _renamed(element: Element, member: PairMember) -> Element:
    """Rename a link or joint and its references."""
    names = {"link": member.links, "joint": member.joints}.get(element.tag, {})
    attributes = {
        k: names[v] if names and k == "name" else v for k, v in element.attributes.items()
    }
    children = [
        Element(c.tag, {"link": member.links[c.get("link")]}) if c.tag in ("parent", "child") else c
        for c in element.children
    ]
    return Element(element.tag, attributes, children=children)


def urdf_text(name: str, parts: list[Element]) -> str:
    """Write a robot description.

    Args:
        name: what the robot is called.
        parts: its links and joints.
    """
    root = Element("robot", {"name": name}, children=parts)
    return '<?xml version="1.0"?>\n' + "\n".join(_lines(root, "")) + "\n"


def _lines(element: Element, indent: str) -> Iterable[str]:
    values = {key: value.translate(ESCAPES) for key, value in element.attributes.items()}
    attributes = "".join(f' {key}="{value}"' for key, value in values.items())
    if not element.children:
        yield f"{indent}<{element.tag}{attributes}/>"
        return
    yield f"{indent}<{element.tag}{attributes}>"
    for child in element.children:
        yield from _lines(child, indent + "  ")
    yield f"{indent}</{element.tag}>"
