"""Seams: one arm holds a part, the other's tool works along a curve on it."""

from __future__ import annotations

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

RAMP = 1.2
"""Longest time of a ramp of a seam that may not be slower, where its file gives no acceleration, at full speed [s]."""
INTO = np.diag([1.0, -1.0, -1.0])
"""Rotation of a tool that points into the surface, in the curve's frame: z against z, x along the curve."""


@dataclass(frozen=True)
class SeamTool:
    """How the tool stands on a seam: P_j to T_G of [Qin2024], with the freedoms that the work leaves."""

    standoff: float = 0.0
    """Distance of the tool centre point from the seam, along the tool [m]."""
    work_angle: float = 0.0
    """Turn about the seam's tangent [rad]."""
    travel_angle: float = 0.0
    """Then about the frame's y [rad]: the tool leans forwards or backwards."""
    spin: float = 0.0
    """Then about the tool's own axis [rad]: at 0 its x axis is along the curve."""
    free_spin: bool = False
    """Whether the tool may turn about its own axis."""
    tilt: float = 0.0
    """By how much the tool's axis may lean away from where it should point [rad]."""

    @cached_property
    def R_curve_tool(self) -> FloatArray:
        """Rotation of the tool in the curve's frame as it should be, shape (3, 3)."""
        work = exp_rotation(np.array([self.work_angle, 0.0, 0.0]))
        travel = exp_rotation(np.array([0.0, self.travel_angle, 0.0]))
        spin = exp_rotation(np.array([0.0, 0.0, self.spin]))
        found: FloatArray = product(work, travel, INTO, spin)
        return found


@dataclass(frozen=True)
class Hold:
    """Where the part is while its seam is worked on."""

    way: ToolPath | None = None
    """What the part's frame follows in the world, at the same share as the tool follows the seam; or None."""
    pose: pin.SE3 | None = None
    """Where it stands still in the world; or None."""
    still: bool = False
    """With neither of them: whether it stands still where the planner likes, or may move as well."""

    @property
    def given(self) -> bool:
        """Whether the file gives the pose of the part."""
        return self.way is not None or self.pose is not None

    @property
    def stands(self) -> bool:
        """Whether the part stands still."""
        return self.still or self.pose is not None

    def at(self, share: FloatArray) -> Poses:
        """Returns the part's rotations (k, 3, 3) and positions (k, 3) [m] in the world at shares (k,) of the seam.

        Only where the file gives them.
        """
        if self.way is not None:
            return self.way.at(share * self.way.length)
        assert self.pose is not None
        k = len(share)
        return np.tile(self.pose.rotation, (k, 1, 1)), np.tile(self.pose.translation, (k, 1))


@dataclass(frozen=True, eq=False)
class SeamWork:
    """One seam on one part, and how it is to be worked.

    Each is only equal to itself: tasks of both arms share one, and curves hold arrays, which have no hash.
    """

    master: str | None
    """The arm that holds the part; None where it stands in the cell."""
    slave: str
    """The arm whose tool works."""
    part: pin.SE3
    """The part's frame in the master's flange; without a master in the world."""
    curve: MeasuredCurve
    """The seam in the part's frame."""
    tool: SeamTool
    """How the tool stands on it."""
    hold: Hold
    """Where the part is meanwhile."""
    speed: float | None
    """Speed of the tool along the seam, relative to the part [m/s]; None where the duration is given."""
    duration: float | None = None
    """Time for the seam, ramps included [s]; None where the speed is given."""
    acceleration: float | None = None
    """Largest acceleration along the seam [m/s²]; None leaves the ramps to the planner."""
    slower: bool = False
    """Whether the speed may be reduced where the joints' limits need it."""
    downhand: float | None = None
    """By how much the seam's surface may lean away from facing upwards [rad]; None where it does not matter."""
    entry_duration: float | None = None
    """Time for the way to the seam, approach and dwell included [s]; None for as quick as can be."""
    approach: float = 0.0
    """Length of the straight way to the seam along the tool [m]; 0 for none."""
    retract: float = 0.0
    """Length of the straight way from the seam along the tool [m]; 0 for none."""
    dwell_start: float = 0.0
    """How long the tool stands where the seam begins [s]."""
    dwell_end: float = 0.0
    """How long the tool stands where the seam ends [s]."""
    not_before: float = 0.0
    """When the seam begins at the earliest, from the start of the motion [s]."""
    touches: tuple[str, ...] = ()
    """Bodies that the slave's tool may touch, but not reach into, while it works: the part, as tool or obstacle."""
    posture: str | None = None
    """Name of the posture near which it begins; None leaves it to the planner."""
    method: str | None = None
    """Name of the seam solver; None for the default one."""
    place: Place = NOWHERE
    """Where it is written."""

    @property
    def arms(self) -> tuple[str, ...]:
        """The arms that work: the slave, then the master where there is one."""
        return (self.slave,) if self.master is None else (self.slave, self.master)

    @property
    def length(self) -> float:
        """Length of the seam [m]."""
        return self.curve.length

    def tool_frames(self, share: FloatArray) -> Poses:
        """Returns the tool's rotations (k, 3, 3) as they should be and the seam's points (k, 3) [m], in the part.

        The tool centre point is `standoff` from the point, back along the tool's z axis.
        """
        R, p = self.curve.at(share * self.curve.length)
        return product(R, self.tool.R_curve_tool), p


def longest_ramp(work: SeamWork, pace: float) -> float:
    """Returns the longest time in which a seam that may not be slower comes to its speed [s].

    RAMP, or twice what the file's acceleration takes: it rises and falls too.

    Args:
        work: with a speed.
        pace: the job's share of full speed.
    """
    longest = RAMP / pace
    if work.acceleration is not None and work.speed is not None:
        longest = max(longest, 2.0 * work.speed / (work.acceleration * pace))
    return longest
