"""Composition of two robots of one arm each into one robot."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np
import pinocchio as pin

from dualarm_cli.files.robots.urdf import read_urdf
from dualarm_cli.files.robots.urdf_writer import PairMember, write_pair
from dualarm_cli.files.source.text_source import TextSource
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.robot import Arm, JointLimits, JointTorques, Robot
from dualarm_cli.records import field_values

_TAKEN = ("world", "world_to_left", "world_to_right", "left_tool", "right_tool")
"""Names of links, joints and bodies that every pair has."""


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
    """Compose one robot with arms left and right, its names unique.

    Moving joints keep their names if the two robots share none, as controllers of both expect. All other names get
    their side's prefix, `left_` or `right_`, unless they have it. A posture that only one robot has leaves the other
    at home.

    Args:
        left: robot of one arm that becomes the left one.
        left_base: pose of its root link in the cell.
        right: robot of one arm that becomes the right one.
        right_base: pose of its root link in the cell.
    """
    robots = {"left": left, "right": right}
    urdfs = {side: read_urdf(TextSource(r.name, r.urdf, "")) for side, r in robots.items()}
    distinct = set(left.joints).isdisjoint(right.joints)
    kept = {*left.joints, *right.joints} if distinct else set[str]()
    links = _unique({side: urdf.links for side, urdf in urdfs.items()})
    joints = _unique({side: urdf.joints for side, urdf in urdfs.items()}, kept)
    members = {
        side: PairMember(urdf, base, links[side], joints[side])
        for (side, urdf), base in zip(urdfs.items(), (left_base, right_base), strict=True)
    }
    arms = tuple(
        Arm(
            side,
            tuple(joints[side][joint] for joint in r.arms[0].joints),
            links[side][r.arms[0].flange],
            r.arms[0].kind,
            r.arms[0].place,
            links[side].get(r.arms[0].hand, ""),
        )
        for side, r in robots.items()
    )
    names = [*left.postures, *(name for name in right.postures if name not in left.postures)]
    postures = {
        name: np.concatenate([_posture(r, name) for r in robots.values()]) for name in names
    }
    title = f"{left.name} and {right.name}"
    contacts = tuple(
        (links[side][link_a], links[side][link_b])
        for side, robot in robots.items()
        for link_a, link_b in robot.allowed_contacts
    )
    meshes = {
        links[side][link]: shapes
        for side, robot in robots.items()
        for link, shapes in robot.meshes.items()
    }
    visuals = tuple(
        replace(mesh, link=links[side][mesh.link])
        for side, robot in robots.items()
        for mesh in robot.visuals
    )
    limits = _joined_limits(robots, joints)
    text, torques = write_pair(members), _joined_torques(left.torques, right.torques)
    return Robot(title, text, (), arms, limits, postures, contacts, meshes, visuals, torques)


def _unique(
    names: Mapping[str, Collection[str]], kept: Collection[str] = ()
) -> dict[str, dict[str, str]]:
    """Map the names of both robots to unique ones.

    Every name gets a prefix if fewer prefixes are ambiguous, for example if a robot has both `tip` and `left_tip`.

    Args:
        names: names of links or joints.
        kept: names that need no prefix.
    """
    for exempt in (True, False):
        unique = {
            side: {
                name: name
                if exempt and (name in kept or name.startswith(f"{side}_"))
                else f"{side}_{name}"
                for name in members
            }
            for side, members in names.items()
        }
        values = [*_TAKEN, *unique["left"].values(), *unique["right"].values()]
        if len(set(values)) == len(values):
            break
    return unique


def _posture(robot: Robot, name: str) -> FloatArray:
    return robot.postures.get(name, robot.postures["home"])


def _joined_limits(
    robots: Mapping[str, Robot], joints: Mapping[str, Mapping[str, str]]
) -> JointLimits:
    parts = [robot.limits for robot in robots.values()]
    return JointLimits(
        tuple(joints[side][name] for side, robot in robots.items() for name in robot.joints),
        np.concatenate([p.lower for p in parts]),
        np.concatenate([p.upper for p in parts]),
        np.concatenate([p.velocity for p in parts]),
        np.concatenate([p.acceleration for p in parts]),
        np.concatenate([p.jerk for p in parts]),
        tuple(source for p in parts for source in p.source),
    )


def _joined_torques(left: JointTorques, right: JointTorques) -> JointTorques:
    pairs = ((getattr(left, name), getattr(right, name)) for name in field_values(left))
    return JointTorques(*(np.concatenate(pair) for pair in pairs))
