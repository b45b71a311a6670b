"""Platform of a robot, and held joints of waists, lifts and rails."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from dualarm_cli.errors import UsageError
from dualarm_cli.files.robots.frozen_joints import nearest_to_zero, position_range
from dualarm_cli.files.robots.meshes import element_pose
from dualarm_cli.files.robots.urdf import MOVING_TYPES, Urdf
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.notes import Note, NoteTable, of_arm
from dualarm_cli.records import dataclass

_note = NoteTable(
    "carriers",
    platform="platform: {name}: turns and carries both arms",
    held="{name}: {moves} and carries both arms; held at {place}; --platform {name} lets it move between stages",
    rail="{name}: {moves} and carries the {arm}; held at {place}; the comments of robot.yaml say how to let it "
    "move",
)


@dataclass(frozen=True)
class HeldJoint:
    """Joint of a waist, lift or rail that is kept fixed, although it could move."""

    joint: str
    """Name of the joint."""
    position: float
    """Fixed position [rad or m]."""
    lower: float
    """Lowest position [rad or m]."""
    upper: float
    """Highest position [rad or m]."""
    slides: bool
    """Flag of a sliding joint."""
    arm: str = ""
    """Arm that this joint begins, as in `left arm`; empty if it carries both."""

    @property
    def place(self) -> str:
        """Fixed position with its unit, as files have it."""
        return self._with_unit(self.position)

    @property
    def span(self) -> str:
        """Range of positions with its unit, for comments of the robot file."""
        if not math.isfinite(self.upper - self.lower):
            return "without position limits"
        return self._with_unit(self.lower, self.upper)

    def _with_unit(self, *positions: float) -> str:
        """Format positions as `-45 to 90 deg`."""
        values = [1e3 * p if self.slides else math.degrees(p) for p in positions]
        return f"{' to '.join(f'{v:.6g}' for v in values)} {'mm' if self.slides else 'deg'}"

    @property
    def note(self) -> Note:
        """Decision to hold the joint."""
        data = {"name": self.joint, "arm": self.arm, "place": self.place}
        moves = "slides" if self.slides else "turns"
        return _note("rail" if self.arm else "held", moves=moves, **data)


def moving(urdf: Urdf) -> list[str]:
    """List the turning and sliding joints that mimic no other joint, in document order."""
    return [
        name
        for name, joint in urdf.joints.items()
        if joint.get("type") in MOVING_TYPES and joint.find("mimic") is None
    ]


def _slides(urdf: Urdf, joint: str) -> bool:
    return urdf.joints[joint].get("type") == "prismatic"


def find_platform(
    urdf: Urdf,
    carriers: Sequence[str],
    firsts: Mapping[str, str],
    requested: Sequence[str] | None,
) -> tuple[tuple[str, ...], tuple[HeldJoint, ...], list[Note]]:
    """Select the platform among joints that carry both arms, and hold the others.

    Of several turning joints it is the most nearly vertical one, and of equal ones that nearest to the arms.

    Args:
        urdf: a checked URDF.
        carriers: joints that carry both arms, root first.
        firsts: first joint of each arm, by side.
        requested: platform joints as named by the user, or None.

    Returns:
        Joints of the platform, held joints, and the decisions.
    """
    movable = moving(urdf)
    if requested is not None:
        for name in requested:
            if name not in carriers:
                carrier_names = ", ".join(carriers) or "none"
                raise UsageError(
                    f"--platform: '{name}' does not carry both arms; these do: {carrier_names}"
                )
        platform = tuple(n for n in carriers if n in requested)
    else:
        turning = [n for n in carriers if n in movable and not _slides(urdf, n)]
        turning.sort(key=lambda name: _verticality(urdf, name))
        platform = tuple(turning[-1:])
    sides = dict.fromkeys((n for n in carriers if n in movable and n not in platform), "")
    for side, first in firsts.items():
        chain = urdf.chain(urdf.joints[first].child_name("parent", "link"))
        before = [name for name in chain if name in movable and name not in platform][-1:]
        arm = of_arm(side, "arm", len(firsts))
        sides |= {name: arm for name in before if name not in sides and _slides(urdf, name)}
    held = []
    for name, side in sides.items():
        joint, slides = urdf.joints[name], _slides(urdf, name)
        held.append(HeldJoint(name, nearest_to_zero(joint), *position_range(joint), slides, side))
    reasons = [_note("platform", name=name) for name in platform if requested is None]
    return platform, tuple(held), [*reasons, *(joint.note for joint in held)]


def _verticality(urdf: Urdf, joint: str) -> float:
    """Compute the cosine between a joint's axis and the vertical, with all joints at zero."""
    words = urdf.joints[joint].child_name("axis", "xyz").split() or ["1", "0", "0"]
    axis = np.array([float(word) for word in words])
    carried = {element.child_name("child", "link"): element for element in urdf.joints.values()}
    link = urdf.joints[joint].child_name("child", "link")
    while link in carried:
        axis = product(element_pose(carried[link]).rotation, axis)
        link = carried[link].child_name("parent", "link")
    return round(abs(float(axis[2])) / float(norm(axis)), 3)


def common(chains: list[list[str]]) -> list[str]:
    """Find the joints with which all chains begin."""
    prefix = []
    for names in zip(*chains, strict=False):
        if len(set(names)) > 1:
            break
        prefix.append(names[0])
    return prefix
