"""Denavit-Hartenberg tables to the text of a URDF."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from dualarm_cli.errors import InputError
from dualarm_cli.files.robots.schema_robot import RobotFile, RowSection
from dualarm_cli.files.robots.urdf import Urdf, read_urdf
from dualarm_cli.files.robots.urdf_tree import Element
from dualarm_cli.files.robots.urdf_writer import urdf_text
from dualarm_cli.files.source.diagnostics import Findings
from dualarm_cli.files.source.fields import to_se3
from dualarm_cli.files.source.text_source import TextSource, quote
from dualarm_cli.files.source.yaml_source import Document
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.elementary import arctan2, cos, sin
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.geometry.rotations import rpy_angles

ROOT_LINK = "base_link"
"""Name of the link that nothing moves."""
Placement = tuple[FloatArray, FloatArray]
"""Translation (3,) [m] and rotation (3, 3) of a frame in the one before it."""


def read_tables(document: Document, model: RobotFile, findings: Findings) -> Urdf | None:
    """Returns the URDF that a robot file's tables describe, or None after noting what is wrong.

    Args:
        document: the robot file.
        model: its content, with tables.
        findings: where errors are noted.
    """
    if model.dh is None or not _check_links(document, model, findings):
        return None
    parts = [Element("link", {"name": ROOT_LINK})]
    for side, rows in model.dh.tables().items():
        arm = getattr(model.arms, side)
        base = to_se3(getattr(model.dh.bases, side))
        frames = placements(rows, model.dh.convention)
        R, p = np.array(base.rotation), np.array(base.translation)
        frames[0] = (p + product(R, frames[0][0]), product(R, frames[0][1]))
        parts += _arm(rows, frames, arm.flange)
    try:
        return read_urdf(TextSource(document.source.name, urdf_text("robot", parts), ""))
    except InputError as error:  # the text has no places of its own: the table stands for it
        for diagnostic in error.diagnostics:
            findings.add(document, ("dh",), diagnostic.message)
        return None


def placements(rows: Sequence[RowSection], convention: str) -> list[Placement]:
    """Returns the frame of each joint in the one before, and at last the flange in the last joint's.

    A joint's frame turns with it, about its z axis; at position 0 it stands as the table's theta says. So a
    standard row's Tz(d) Tx(a) Rx(alpha) comes after its joint and belongs to the next frame, a modified row's
    Rx(alpha) Tx(a) before it.

    Args:
        rows: the table.
        convention: `standard` ([Denavit1955]; [Qin2024] Eq. 1) or `modified` ([Craig1989]).
    """
    zero, turns = np.zeros(3), [_turn_z(row.theta) for row in rows]
    if convention == "modified":
        found = [
            (
                np.array([row.a, -sin(row.alpha) * row.d, cos(row.alpha) * row.d]),
                product(_turn_x(row.alpha), turn),
            )
            for row, turn in zip(rows, turns, strict=True)
        ]
        return [*found, (zero, np.eye(3))]
    turns.append(np.eye(3))
    after = [(np.array([row.a, 0.0, row.d]), _turn_x(row.alpha)) for row in rows]
    return [
        (p, product(R, turn))
        for (p, R), turn in zip([(zero, np.eye(3)), *after], turns, strict=True)
    ]


def _check_links(document: Document, model: RobotFile, findings: Findings) -> bool:
    """Returns whether every link has a name of its own, each table its arm and each arm its table."""
    before, tables = len(findings.diagnostics), model.dh.tables() if model.dh is not None else {}
    for name in model.platform:
        message = (
            f"{quote(name)}: DH parameters describe arms only; a robot with a platform needs a URDF"
        )
        findings.add(document, ("platform", model.platform.index(name)), message)
    seen = {ROOT_LINK: "the root link"}
    for side, rows in tables.items():
        if getattr(model.arms, side) is None:
            findings.add(document, ("dh", side), f"arms has no {side} arm for it", key=True)
            continue
        for k, row in enumerate(rows):
            if row.joint in seen:
                message = f"joint {quote(row.joint)} is also {seen[row.joint]}; rename it"
                findings.add(document, ("dh", side, k, "joint"), message, "E102")
            seen[row.joint] = seen[f"{row.joint}_link"] = f"at {side} row {k + 1}"
    for side in ("left", "right"):
        arm = getattr(model.arms, side)
        if arm is not None and side not in tables:
            findings.add(document, ("arms", side), f"dh has no {side} table for it", key=True)
        elif arm is not None and arm.flange in seen:
            message = f"flange {quote(arm.flange)} is also {seen[arm.flange]}; rename it"
            findings.add(document, ("arms", side, "flange"), message)
        if arm is not None:
            seen[arm.flange] = f"the {side} flange"
    return len(findings.diagnostics) == before


def _arm(rows: Sequence[RowSection], frames: list[Placement], flange: str) -> list[Element]:
    """Returns the links and joints of one arm."""
    parts, parent = [], ROOT_LINK
    for row, frame, following in zip(rows, frames, frames[1:], strict=False):
        name = f"{row.joint}_link"
        joint = _joint(row.joint, "revolute", parent, name, frame)
        limits = {"lower": row.lower, "upper": row.upper, "velocity": row.velocity}
        words = {key: repr(value) for key, value in (limits | {"effort": row.effort}).items()}
        joint.children += [Element("axis", {"xyz": "0 0 1"}), Element("limit", words)]
        link = Element("link", {"name": name})
        if row.radius is not None:
            for tag in ("visual", "collision"):
                link.children += _capsule(tag, name, row.radius, following[0])
        parts += [link, joint]
        parent = name
    last = _joint(f"{parent}_to_{flange}", "fixed", parent, flange, frames[-1])
    return [*parts, Element("link", {"name": flange}), last]


def _joint(name: str, kind: str, parent: str, child: str, frame: Placement) -> Element:
    joint = Element("joint", {"name": name, "type": kind})
    joint.children = [
        _origin(*frame),
        Element("parent", {"link": parent}),
        Element("child", {"link": child}),
    ]
    return joint


def _capsule(tag: str, link: str, radius: float, end: FloatArray) -> list[Element]:
    """Returns a capsule from the link's origin to a point, spelled as a cylinder and two balls."""
    length = float(norm(end))
    ball = Element("sphere", {"radius": repr(radius)})
    if length < 1e-9:
        return [_solid(tag, f"{link}_capsule", np.zeros(3), np.eye(3), ball)]
    x, y, z = end / length
    tilt = arctan2(math.hypot(x, y), z)
    R = product(_turn_z(arctan2(y, x)), _turn_y(tilt))
    middle = Element("cylinder", {"radius": repr(radius), "length": repr(length)})
    return [
        _solid(tag, f"{link}_capsule", end / 2.0, R, middle),
        _solid(tag, f"{link}_capsule_a", np.zeros(3), np.eye(3), ball),
        _solid(tag, f"{link}_capsule_b", end, np.eye(3), ball),
    ]


def _solid(tag: str, name: str, p: FloatArray, R: FloatArray, shape: Element) -> Element:
    geometry = Element("geometry", {}, children=[shape])
    return Element(tag, {"name": name}, children=[_origin(p, R), geometry])


def _origin(p: FloatArray, R: FloatArray) -> Element:
    words = [" ".join(repr(float(v) + 0.0) for v in values) for values in (p, rpy_angles(R))]
    return Element("origin", {"xyz": words[0], "rpy": words[1]})


def _turn_x(angle: float) -> FloatArray:
    c, s = cos(angle), sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def _turn_y(angle: float) -> FloatArray:
    c, s = cos(angle), sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def _turn_z(angle: float) -> FloatArray:
    c, s = cos(angle), sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
