"""Robot: arms, a platform that may carry them, joint limits and named postures.

Positions of joints that turn are in rad, of joints that slide in m; rates likewise. Where only rad is named, it is m
for those that slide.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field
from functools import cached_property
from typing import Literal
from xml.etree import ElementTree

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, readonly
from dualarm_cli.geometry.elementary import cube
from dualarm_cli.model.place import NOWHERE, Place
from dualarm_cli.model.rest_to_rest import RestToRest
from dualarm_cli.model.shape import Shape
from dualarm_cli.records import dataclass

ArmKind = Literal["srs", "spherical_wrist", "parallel_axes", "general"]


def sliding_joints(urdf: str) -> frozenset[str]:
    """Returns the names of a URDF's joints that slide."""
    joints = ElementTree.fromstring(urdf).iter("joint")
    return frozenset(j.get("name", "") for j in joints if j.get("type") == "prismatic")


def rate_source(acceleration: str, jerk: str) -> str:
    """Name the sources of an acceleration and a jerk limit: `urdf`, or `urdf, jerk assumed`."""
    return acceleration if jerk == acceleration else f"{acceleration}, jerk {jerk}"


@dataclass(frozen=True)
class JointLimits:
    """What each joint may do; infinite where nothing is demanded."""

    joints: tuple[str, ...]
    """Names of the n joints."""
    lower: FloatArray
    """Lowest position [rad], shape (n,)."""
    upper: FloatArray
    """Highest position [rad], shape (n,)."""
    velocity: FloatArray
    """Largest speed [rad/s], shape (n,)."""
    acceleration: FloatArray
    """Largest acceleration [rad/s²], shape (n,)."""
    jerk: FloatArray
    """Largest jerk [rad/s³], infinite where the robot file sets none, shape (n,)."""
    source: tuple[str, ...]
    """Sources of acceleration and jerk, as `rate_source` says them: datasheet, assumed, …"""

    def __post_init__(self) -> None:
        """Freezes the arrays and refuses limits that no motion could meet.

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
        """Return the columns of the joints whose acceleration or jerk limit is assumed."""
        parts = [source.partition(", jerk ") for source in self.source]
        sources = [(jerk or both) if rate == "jerk" else both for both, _, jerk in parts]
        return [k for k, source in enumerate(sources) if source == "assumed"]

    def scaled(self, speed: float) -> JointLimits:
        """Returns limits under which every motion takes 1/speed times as long along the same path.

        Args:
            speed: fraction of full speed, above 0.
        """
        return JointLimits(
            self.joints,
            self.lower,
            self.upper,
            self.velocity * speed,
            self.acceleration * np.square(speed),
            self.jerk * cube(speed),
            self.source,
        )

    @cached_property
    def law(self) -> RestToRest:
        """Least times of the joints from rest to rest, computed once."""
        return RestToRest(self.velocity, self.acceleration, self.jerk)

    def select(self, joints: Sequence[str]) -> JointLimits:
        """Returns the limits of the named joints, in the order of the names."""
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
class Arm:
    """One serial arm and the flange that carries its tool."""

    name: str
    """left or right."""
    joints: tuple[str, ...]
    """Its joints from base to flange."""
    flange: str
    """Link of the URDF to which the tool is bolted."""
    kind: ArmKind
    """How its inverse kinematics is solved; `dualarm check` compares it with the URDF."""
    place: Place = field(default=NOWHERE, compare=False)
    """Where its kind is written."""


@dataclass(frozen=True)
class Robot:
    """One or two arms, on a platform or not, as one tree of joints."""

    name: str
    """What people call it."""
    urdf: str
    """Complete URDF text: every moving joint with its limits, primitive geometry only."""
    platform: tuple[str, ...]
    """Joints that carry both arms: none, one or two."""
    arms: tuple[Arm, ...]
    """One or two arms, left before right."""
    limits: JointLimits
    """Limits of all moving joints, in the URDF's order."""
    postures: Mapping[str, FloatArray] = field(default_factory=dict)
    """Named postures [rad], each of shape (n,) over `joints`; home is always there."""
    allowed_contacts: tuple[tuple[str, str], ...] = ()
    """Pairs of links whose shapes may touch: the shapes are wider than the links."""
    meshes: Mapping[str, tuple[Shape, ...]] = field(default_factory=dict)
    """Collision meshes by their links, in the links' frames; they are not in the URDF text."""

    def __post_init__(self) -> None:
        """Adds the home posture, where there is none, and freezes all.

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

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of all moving joints, in the URDF's order."""
        return self.limits.joints

    @cached_property
    def sliding(self) -> frozenset[str]:
        """Names of the joints that slide."""
        return sliding_joints(self.urdf).intersection(self.joints)

    @property
    def without_closed_form(self) -> tuple[str, ...]:
        """Names of the arms that are not said to be spherical-revolute-spherical."""
        return tuple(arm.name for arm in self.arms if arm.kind != "srs")

    def arm(self, name: str) -> Arm:
        """Returns the arm of that name (KeyError where there is none)."""
        for arm in self.arms:
            if arm.name == name:
                return arm
        raise KeyError(name)

    def columns(self, joints: Sequence[str]) -> list[int]:
        """Returns the columns of the named joints within `joints`."""
        return [self.joints.index(name) for name in joints]
