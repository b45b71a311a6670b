"""Composition of two robots of one arm each into one robot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin

from dualarm_cli.files.robots.urdf import read_urdf
from dualarm_cli.files.robots.urdf_writer import write_pair
from dualarm_cli.files.source.text_source import TextSource
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.robot import Arm, JointLimits, Robot


def why_not_a_pair_member(robot: Robot) -> str | None:
    """Explain why a robot cannot be part of a pair, or return None."""
    if len(robot.arms) != 1:
        return (
            f"{robot.name} has {len(robot.arms)} arms; each robot of a pair must have exactly one"
        )
    if robot.platform:
        return f"{robot.name} has a platform; robots of a pair must not have one"
    return None


def compose_pair(left: Robot, left_base: pin.SE3, right: Robot, right_base: pin.SE3) -> Robot:
    """Compose one robot with arms left and right, names prefixed by `left_` or `right_`.

    A posture that only one robot has leaves the other at home.

    Args:
        left: robot of one arm that becomes the left one.
        left_base: pose of its root link in the cell.
        right: robot of one arm that becomes the right one.
        right_base: pose of its root link in the cell.
    """
    robots = {"left": left, "right": right}
    bases = {"left": left_base, "right": right_base}
    members = {}
    for side, robot in robots.items():
        urdf = read_urdf(TextSource(robot.name, robot.urdf, ""))
        members[side] = (urdf.root, urdf.root_link, bases[side])
    arms = tuple(
        Arm(
            side,
            tuple(f"{side}_{j}" for j in r.arms[0].joints),
            f"{side}_{r.arms[0].flange}",
            r.arms[0].kind,
            r.arms[0].place,
        )
        for side, r in robots.items()
    )
    names = [*left.postures, *(name for name in right.postures if name not in left.postures)]
    postures = {
        name: np.concatenate([_posture(r, name) for r in robots.values()]) for name in names
    }
    title = f"{left.name} and {right.name}"
    contacts = tuple(
        (f"{side}_{link_a}", f"{side}_{link_b}")
        for side, robot in robots.items()
        for link_a, link_b in robot.allowed_contacts
    )
    meshes = {
        f"{side}_{link}": shapes
        for side, robot in robots.items()
        for link, shapes in robot.meshes.items()
    }
    visuals = tuple(
        replace(mesh, link=f"{side}_{mesh.link}")
        for side, robot in robots.items()
        for mesh in robot.visuals
    )
    limits = _joined_limits(robots)
    return Robot(title, write_pair(members), (), arms, limits, postures, contacts, meshes, visuals)


def _posture(robot: Robot, name: str) -> FloatArray:
    return robot.postures.get(name, robot.postures["home"])


def _joined_limits(robots: dict[str, Robot]) -> JointLimits:
    parts = [robot.limits for robot in robots.values()]
    return JointLimits(
        tuple(f"{side}_{joint}" for side, robot in robots.items() for joint in robot.joints),
        np.concatenate([p.lower for p in parts]),
        np.concatenate([p.upper for p in parts]),
        np.concatenate([p.velocity for p in parts]),
        np.concatenate([p.acceleration for p in parts]),
        np.concatenate([p.jerk for p in parts]),
        tuple(source for p in parts for source in p.source),
    )
