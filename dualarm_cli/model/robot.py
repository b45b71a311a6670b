"""Robot: arms, a platform that may carry them, joint limits and named postures.

Positions of revolute joints are in rad, of prismatic joints in m; rates likewise. Where only rad is named, it is m
for prismatic joints.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from functools import cached_property
from typing import Literal
from xml.etree import ElementTree

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, readonly
from dualarm_cli.geometry.elementary import cube
from dualarm_cli.model.motion.rest_to_rest import RestToRest
from dualarm_cli.model.place import NOWHERE, Place
from dualarm_cli.model.shape import Shape, VisualMesh
from dualarm_cli.records import dataclass

ArmKind = Literal["srs", "spherical_wrist", "parallel_axes", "general"]


def sliding_joints(urdf: str) -> frozenset[str]:
    """List the names of a URDF's prismatic joints."""
    joints = ElementTree.fromstring(urdf).iter("joint")
    return frozenset(j.get("name", "") for j in joints if j.get("type") == "prismatic")


def rate_source(acceleration: str, jerk: str) -> str:
    """Name the sources of an acceleration and a jerk limit: `urdf`, or `urdf, jerk assumed`."""
    return acceleration if jerk == acceleration else f"{acceleration}, jerk {jerk}"


@dataclass(frozen=True)
class JointLimits:
    """Limits of each joint; infinite where none is required."""

    joints: tuple[str, ...]
    """Names of the n joints."""
    lower: FloatArray
    """Lower position limits [rad], shape (n,)."""
    upper: FloatArray
    """Upper position limits [rad], shape (n,)."""
    velocity: FloatArray
    """Velocity limits [rad/s], shape (n,)."""
    acceleration: FloatArray
    """Acceleration limits [rad/s²], shape (n,)."""
    jerk: FloatArray
    """Jerk limits [rad/s³], infinite if the robot file has none, shape (n,)."""
    source: tuple[str, ...]
    """Sources of acceleration and jerk limits, as `rate_source` formats them."""

    def __post_init__(self) -> None:
        """Freeze the arrays and refuse limits that no motion could satisfy.

        Raises:
            ValueError: wrong shape, NaN, lower above upper, or a rate that is not positive.
        """
        n = len(self.joints)
        for name in ("lower", "upper", "velocity", "acceleration", "jerk"):
            values = readonly(getattr(self, name))
            object.__setattr__(self, name, values)
            if values.shape != (n,) or np.isnan(values).any():
                raise ValueError(f"{name} limits must be {n} numbers, not {values}")
            if name not in ("lower", "upper") and (values <= 0).any():
                raise ValueError(f"{name} limits must be positive, not {values.min()}")
        if (self.lower > self.upper).any():
            raise ValueError("a lower position limit is above its upper one")

    def assumed(self, rate: Literal["acceleration", "jerk"]) -> list[int]:
        """List the columns of joints whose acceleration or jerk limit is assumed."""
        parts = [source.partition(", jerk ") for source in self.source]
        sources = [(jerk or both) if rate == "jerk" else both for both, _, jerk in parts]
        return [k for k, source in enumerate(sources) if source == "assumed"]

    def scaled(
        self, speed: float | FloatArray, acceleration: float | FloatArray = 1.0
    ) -> JointLimits:
        """Scale the limits: motions along the same path take 1/speed times as long.

        Args:
            speed: fraction of full speed, above 0; of all joints, or of each (n,).
            acceleration: fraction of the accelerations at that speed, likewise.
        """
        return JointLimits(
            self.joints,
            self.lower,
            self.upper,
            self.velocity * speed,
            self.acceleration * np.square(speed) * acceleration,
            self.jerk * cube(speed),
            self.source,
        )

    def stricter(self, limits: JointLimits) -> JointLimits:
        """Take the lower rates of two limits of the same joints."""
        names = ("velocity", "acceleration", "jerk")
        rates = {name: np.minimum(getattr(self, name), getattr(limits, name)) for name in names}
        return replace(self, **rates)

    @cached_property
    def law(self) -> RestToRest:
        """Timing law of the joints from rest to rest."""
        return RestToRest(self.velocity, self.acceleration, self.jerk)

    def select(self, joints: Sequence[str]) -> JointLimits:
        """Select the limits of the named joints, in that order."""
        index = [self.joints.index(name) for name in joints]
        return JointLimits(
            tuple(joints),
            self.lower[index],
            self.upper[index],
            self.velocity[index],
            self.acceleration[index],
            self.jerk[index],
            tuple(self.source[i] for i in index),
        )


@dataclass(frozen=True)
class JointTorques:
    """Torque limits of each joint, and torques that its links do not explain.

    Of prismatic joints forces in N in place of torques in N m, and masses in kg in place of inertias in kg m².
    """

    effort: FloatArray
    """Largest torques [N m], 0 where unknown, shape (n,)."""
    rated: FloatArray
    """Largest effective (RMS) torques over a cycle [N m], infinite where unknown, shape (n,)."""
    coulomb: FloatArray
    """Coulomb friction [N m], shape (n,)."""
    viscous: FloatArray
    """Viscous friction [N m s/rad], shape (n,)."""
    rotor: FloatArray
    """Inertia of the rotor at the joint [kg m²], shape (n,)."""
    spring: FloatArray
    """Torque of springs and counterweights at position 0 [N m], shape (n,)."""
    stiffness: FloatArray
    """Change of that torque by position [N m/rad], shape (n,)."""

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for name in ("effort", "rated", "coulomb", "viscous", "rotor", "spring", "stiffness"):
            object.__setattr__(self, name, readonly(getattr(self, name)))

    @classmethod
    def of_effort(cls, effort: FloatArray) -> JointTorques:
        """Build joint torques from efforts [N m], shape (n,); nothing else is known."""
        zero = np.zeros(len(effort))
        return cls(effort, np.full(len(effort), np.inf), zero, zero, zero, zero, zero)


@dataclass(frozen=True)
class Arm:
    """Serial arm with the flange that carries its tool."""

    name: str
    """Name: left or right."""
    joints: tuple[str, ...]
    """Joints from base to flange."""
    flange: str
    """Link of the URDF that carries the tool."""
    kind: ArmKind
    """Type of inverse kinematics; `dualarm check` compares it with the URDF."""
    place: Place = field(default=NOWHERE, compare=False)
    """Place of the kind in its file."""
    hand: str = ""
    """Link of a hand that its links' shapes and names need not show, or empty."""


@dataclass(frozen=True)
class Robot:
    """Robot with one or two arms, with or without a platform."""

    name: str
    """Name for users."""
    urdf: str
    """Complete URDF text: all moving joints with limits, primitive geometry only."""
    platform: tuple[str, ...]
    """Joints that carry both arms: none, one or two."""
    arms: tuple[Arm, ...]
    """Arms, left before right."""
    limits: JointLimits
    """Limits of all moving joints, in the URDF's order."""
    postures: Mapping[str, FloatArray] = field(default_factory=dict)
    """Named postures [rad], each of shape (n,) over `joints`; home is always included."""
    allowed_contacts: tuple[tuple[str, str], ...] = ()
    """Pairs of links whose shapes may touch, because shapes are larger than links."""
    meshes: Mapping[str, tuple[Shape, ...]] = field(default_factory=dict)
    """Collision meshes by link, in the links' frames; the URDF text has none."""
    visuals: tuple[VisualMesh, ...] = field(default=(), compare=False)
    """Meshes that show the links, if the file has any."""
    stated_torques: JointTorques | None = None
    """Torques that the robot file states; None for the efforts of the URDF alone."""

    def __post_init__(self) -> None:
        """Add a missing home posture and freeze all.

        Raises:
            ValueError: arms share a name or a joint, or a joint is not among the limits.
        """
        used = [*self.platform, *(joint for arm in self.arms for joint in arm.joints)]
        if len(set(used)) != len(used) or set(used) != set(self.joints):
            raise ValueError("every moving joint belongs to exactly one of platform and arms")
        if len({arm.name for arm in self.arms}) != len(self.arms):
            raise ValueError("two arms share a name")
        postures = {name: readonly(q) for name, q in self.postures.items()}
        postures.setdefault("home", readonly(np.zeros(len(self.joints))))
        object.__setattr__(self, "postures", postures)

    def __repr__(self) -> str:
        """Describe the robot in a line."""
        return f"<Robot {self.name}: {len(self.joints)} joints>"

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of all moving joints, in the URDF's order."""
        return self.limits.joints

    @cached_property
    def sliding(self) -> frozenset[str]:
        """Names of the prismatic joints."""
        return sliding_joints(self.urdf).intersection(self.joints)

    @cached_property
    def hands(self) -> Mapping[str, tuple[str, ...]]:
        """Links beyond the link that an arm's last joint moves, by arm: its own hand."""
        below: dict[str, list[str]] = {}
        ends: dict[str, str] = {}
        for joint in ElementTree.fromstring(self.urdf).findall("joint"):
            parent, child = (joint.find(end) for end in ("parent", "child"))
            assert parent is not None and child is not None  # the reader refuses such a file
            below.setdefault(parent.get("link", ""), []).append(child.get("link", ""))
            ends[joint.get("name", "")] = child.get("link", "")
        hands = {}
        for arm in self.arms:
            links = list(below.get(ends[arm.joints[-1]], ()))
            for link in links:
                links += below.get(link, ())
            hands[arm.name] = tuple(links) or ((arm.hand,) if arm.hand else ())
        return hands

    def torque_unit(self, joint: str) -> str:
        """Return the unit of a joint's torque, or of a sliding joint's force."""
        return "N" if joint in self.sliding else "N m"

    @cached_property
    def torques(self) -> JointTorques:
        """Torque limits of the joints and torques besides those of the links."""
        if self.stated_torques is not None:
            return self.stated_torques
        limits = {
            joint.get("name", ""): joint.find("limit")
            for joint in ElementTree.fromstring(self.urdf).iter("joint")
        }
        efforts = [
            0.0 if (limit := limits.get(name)) is None else abs(float(limit.get("effort", "0")))
            for name in self.joints
        ]
        return JointTorques.of_effort(np.array(efforts))

    @property
    def without_closed_form(self) -> tuple[str, ...]:
        """Names of the arms whose kind is not `srs`."""
        return tuple(arm.name for arm in self.arms if arm.kind != "srs")

    def arm(self, name: str) -> Arm:
        """Return the arm with a name (KeyError without one)."""
        for arm in self.arms:
            if arm.name == name:
                return arm
        raise KeyError(name)

    def columns(self, joints: Sequence[str]) -> list[int]:
        """Return the columns of the named joints within `joints`."""
        return [self.joints.index(name) for name in joints]
