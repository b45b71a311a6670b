"""Process work: tool paths in the cell, seams on a held part."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, replace
from functools import cached_property

import numpy as np
import pinocchio as pin

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.products import product
from dualarm_cli.geometry.rotations import exp_rotation
from dualarm_cli.model.curves.feature_curve import MeasuredCurve
from dualarm_cli.model.curves.tool_path import Poses, ToolPath
from dualarm_cli.model.place import NOWHERE, Place
from dualarm_cli.records import dataclass

SAME_SHARE = 1e-9
"""Largest difference of equal path fractions."""
RAMP = 1.2
"""Longest ramp of a seam without given acceleration, at full speed [s].

For seams whose speed may not be reduced.
"""
INTO = np.diag([1.0, -1.0, -1.0])
"""Rotation of a tool that points into the surface, in the curve's frame.

Its z axis is opposite to the curve's, x is along the curve.
"""


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


@dataclass(frozen=True)
class SeamTool:
    """Orientation of the tool on a seam: P_j to T_G of [Qin2024], with free rotations."""

    standoff: float = 0.0
    """Distance of the tool centre point from the seam, along the tool [m]."""
    work_angle: float = 0.0
    """Rotation about the seam's tangent [rad]."""
    travel_angle: float = 0.0
    """Rotation about the frame's y after that [rad]; the tool leans forwards or backwards."""
    spin: float = 0.0
    """Rotation about the tool's axis after that [rad]; 0 is x along the curve."""
    free_spin: bool = False
    """Whether the rotation about the tool's axis is free."""
    tilt: float = 0.0
    """Largest angle of the tool's axis from its nominal direction [rad]."""

    @cached_property
    def R_curve_tool(self) -> FloatArray:
        """Nominal rotation of the tool in the curve's frame, shape (3, 3)."""
        work = exp_rotation(np.array([self.work_angle, 0.0, 0.0]))
        travel = exp_rotation(np.array([0.0, self.travel_angle, 0.0]))
        spin = exp_rotation(np.array([0.0, 0.0, self.spin]))
        rotation: FloatArray = product(work, travel, INTO, spin)
        return rotation


@dataclass(frozen=True)
class Hold:
    """Pose or path of the part while its seam is worked."""

    part_path: ToolPath | None = None
    """Path of the part's frame in the world, or None.

    Part and tool have the same progress along their paths.
    """
    pose: pin.SE3 | None = None
    """Fixed pose of the part in the world, or None."""
    still: bool = False
    """Whether the part stands still, if neither path nor pose is given.

    The planner then chooses where.
    """

    @property
    def given(self) -> bool:
        """Whether the file gives the pose of the part."""
        return self.part_path is not None or self.pose is not None

    @property
    def stands(self) -> bool:
        """Whether the part stands still."""
        return self.still or self.pose is not None

    def at(self, share: FloatArray) -> Poses:
        """Return the part's poses in the world: rotations (k, 3, 3), positions (k, 3) [m].

        At fractions (k,) of the seam; only if the file gives them.
        """
        if self.part_path is not None:
            return self.part_path.at(share * self.part_path.length)
        assert self.pose is not None
        k = len(share)
        return np.tile(self.pose.rotation, (k, 1, 1)), np.tile(self.pose.translation, (k, 1))


@dataclass(frozen=True, eq=False)
class SeamWork:
    """Seam on a part, with the conditions under which it is worked.

    Compared by identity: tasks of both arms share an instance, and curves hold arrays, which cannot be hashed.
    """

    master: str | None
    """Arm that holds the part; None if it stands in the cell."""
    slave: str
    """Arm whose tool works."""
    part: pin.SE3
    """Part's frame in the master's flange, or in the world without a master."""
    curve: MeasuredCurve
    """Seam in the part's frame."""
    tool: SeamTool
    """Orientation of the tool on the seam."""
    hold: Hold
    """Pose or path of the part meanwhile."""
    speed: float | None
    """Speed of the tool relative to the part [m/s]; None with a given duration."""
    duration: float | None = None
    """Duration of the seam, ramps included [s]; None with a given speed."""
    acceleration: float | None = None
    """Largest acceleration along the seam [m/s²]; None lets the planner choose."""
    slower: bool = False
    """Whether the speed may be reduced to keep joint limits."""
    downhand: float | None = None
    """Largest angle of the seam's surface from facing upwards [rad], or None."""
    entry_duration: float | None = None
    """Time to reach the seam, approach and dwell included [s]; None for the shortest."""
    approach: float = 0.0
    """Length of the straight approach to the seam, along the tool [m]."""
    retract: float = 0.0
    """Length of the straight retract from the seam, along the tool [m]."""
    dwell_start: float = 0.0
    """Dwell at the start of the seam [s]."""
    dwell_end: float = 0.0
    """Dwell at the end of the seam [s]."""
    not_before: float = 0.0
    """Earliest start of the seam [s]."""
    touches: tuple[str, ...] = ()
    """Bodies that the slave's tool may touch but not penetrate while it works.

    Usually the part, as a tool or an obstacle.
    """
    posture: str | None = None
    """Posture next to which the seam begins; None lets the planner choose."""
    method: str | None = None
    """Name of the seam solver; None for the default one."""
    place: Place = NOWHERE
    """Place of the seam in its file."""

    @property
    def arms(self) -> tuple[str, ...]:
        """Arms that work: the slave, then the master if there is one."""
        return (self.slave,) if self.master is None else (self.slave, self.master)

    @property
    def length(self) -> float:
        """Length of the seam [m]."""
        return self.curve.length

    def tool_frames(self, share: FloatArray) -> Poses:
        """Return the tool's nominal rotations (k, 3, 3) and seam points (k, 3) [m].

        Both are in the part's frame.

        The tool centre point is `standoff` from the point, back along the tool's z axis.
        """
        R, p = self.curve.at(share * self.curve.length)
        return product(R, self.tool.R_curve_tool), p


def longest_ramp(work: SeamWork, pace: float) -> float:
    """Compute the longest ramp of a seam whose speed may not be reduced [s].

    RAMP, or twice the time at the file's acceleration, because jerk is limited.

    Args:
        work: with a speed.
        pace: the job's fraction of full speed.
    """
    longest = RAMP / pace
    if work.acceleration is not None and work.speed is not None:
        longest = max(longest, 2.0 * work.speed / (work.acceleration * pace))
    return longest
