"""Work of a path task: paths that one tool or both follow together, and how."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, replace

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.curves.tool_path import ToolPath
from dualarm_cli.model.place import NOWHERE, Place
from dualarm_cli.records import dataclass

SAME_SHARE = 1e-9
"""Difference of two shares of a way that count as one."""


@dataclass(frozen=True)
class PathWork:
    """Paths that one tool or both follow together, and how."""

    paths: Mapping[str, ToolPath]
    """By arm. Both tools have gone the same share of their paths at every instant."""
    speed: float
    """Largest speed of the tool with the longer path along it [m/s]."""
    acceleration: float | None = None
    """Largest acceleration along that path [m/s²]; None leaves the ramps to the planner."""
    jerk: float | None = None
    """Largest jerk along that path [m/s³]; None leaves it to the planner."""
    redundancy: str | None = None
    """Name of the path follower; None for the default one."""
    posture: str | None = None
    """Name of the posture that the motion begins near; None leaves it to the planner."""
    slower: bool = False
    """Whether the speed may be reduced where the joints' limits need it."""
    tolerance: float = 1e-4
    """How far the tools may leave their paths [m], and turn away by tolerance over TURN_LENGTH [rad]."""
    critical_points: Mapping[str, FloatArray] = field(default_factory=dict)
    """By arm, where a virtual spring pulls the elbow, in the frame of the last platform joint [m], shape (3,)."""
    stiffness: float = 10.0
    """Of the virtual springs: K of [Choi2020] Eq. 9."""
    torque: bool = False
    """Whether the joints' torques are kept within the limits of the URDF."""
    blend: float = 0.0
    """How far a tool that does not stop at corners may leave them [m]; 0: it stops. For paths of one tool."""
    place: Place = NOWHERE
    """Where it is written."""
    sharp: Mapping[str, ToolPath] = field(default_factory=dict)
    """By arm, the paths before their corners were rounded; empty where none were."""

    @property
    def length(self) -> float:
        """Length of the longest path [m]."""
        return max(path.length for path in self.paths.values())

    def rounded(self) -> PathWork:
        """Returns the work with rounded corners, as far as the file allows it."""
        if not self.blend or self.sharp:
            return self
        paths = {arm: path.rounded(self.blend) for arm, path in self.paths.items()}
        return replace(self, paths=paths, sharp=self.paths)

    def stopping(self) -> PathWork:
        """Returns the work with its corners as they are written, at which the tools stop."""
        return replace(self, paths=self.sharp, sharp={}) if self.sharp else self

    def corners(self) -> tuple[float, ...]:
        """Returns the shares of the way at which the tools have to stop, without 0 and 1."""
        found: list[float] = []
        for share in sorted(c / path.length for path in self.paths.values() for c in path.corners):
            # What both tools' shares differ by rounding is one corner.
            if not found or share - found[-1] > SAME_SHARE:
                found.append(share)
        return tuple(found)
