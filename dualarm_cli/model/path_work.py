"""Path work: paths that one tool or both follow together, with speed and tolerances."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, replace

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.curves.tool_path import ToolPath
from dualarm_cli.model.place import NOWHERE, Place
from dualarm_cli.records import dataclass

SAME_SHARE = 1e-9
"""Largest difference of equal path fractions."""


@dataclass(frozen=True)
class PathWork:
    """Paths that one tool or both follow together, with speed and tolerances."""

    paths: Mapping[str, ToolPath]
    """Paths by arm; both tools have the same progress at every time."""
    speed: float
    """Largest speed along the longer path [m/s]."""
    acceleration: float | None = None
    """Largest acceleration along that path [m/s²]; None lets the planner choose."""
    jerk: float | None = None
    """Largest jerk along that path [m/s³]; None lets the planner choose."""
    redundancy: str | None = None
    """Name of the path follower; None for the default one."""
    posture: str | None = None
    """Posture next to which the motion begins; None lets the planner choose."""
    slower: bool = False
    """Whether the speed may be reduced to keep joint limits."""
    tolerance: float = 1e-4
    """Largest position error of the tools [m]; divided by TURN_LENGTH, of rotation [rad]."""
    critical_points: Mapping[str, FloatArray] = field(default_factory=dict)
    """Attraction point of the elbow's virtual spring, by arm [m], shape (3,).

    In the frame of the last platform joint.
    """
    stiffness: float = 10.0
    """Stiffness K of the virtual springs, [Choi2020] Eq. 9."""
    torque: bool = False
    """Whether joint torques are kept within the limits of the URDF."""
    blend: float = 0.0
    """Largest distance from corners that are rounded [m], for one tool.

    With 0 the tool stops at corners.
    """
    place: Place = NOWHERE
    """Place of the path in its file."""
    sharp: Mapping[str, ToolPath] = field(default_factory=dict)
    """Paths before their corners were rounded, by arm; empty if none were."""

    @property
    def length(self) -> float:
        """Length of the longest path [m]."""
        return max(path.length for path in self.paths.values())

    def rounded(self) -> PathWork:
        """Round the corners, as far as the file allows it."""
        if not self.blend or self.sharp:
            return self
        paths = {arm: path.rounded(self.blend) for arm, path in self.paths.items()}
        return replace(self, paths=paths, sharp=self.paths)

    def stopping(self) -> PathWork:
        """Restore the corners at which the tools stop."""
        return replace(self, paths=self.sharp, sharp={}) if self.sharp else self

    def corners(self) -> tuple[float, ...]:
        """List the path fractions at which the tools must stop, without 0 and 1."""
        corners: list[float] = []
        for progress in sorted(
            c / path.length for path in self.paths.values() for c in path.corners
        ):
            # Corners of both tools that differ by rounding are one.
            if not corners or progress - corners[-1] > SAME_SHARE:
                corners.append(progress)
        return tuple(corners)
