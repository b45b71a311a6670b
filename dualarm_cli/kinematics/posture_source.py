"""Interface of arms: forward kinematics, postures of poses and limits, whatever the family.

Come here for the methods of arms that other code uses, or to add a family: derive from `PostureSource`, or from
`ClosedArm` if six axes have closed forms.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import cached_property
from typing import ClassVar

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray, readonly
from dualarm_cli.geometry.elementary import TURN
from dualarm_cli.kinematics.srs import srs_limits
from dualarm_cli.records import dataclass

LARGEST_STEP = 0.7
"""Largest joint step between two samples; a larger one is a jump [rad]."""
PROVEN_MISS = 1e-6
"""Distance [m] or angle [rad] up to which a miss may be rounding."""


@dataclass(frozen=True)
class ReachedPostures:
    """Postures within limits that reach some of m poses."""

    pose: IntArray
    """Index of the pose that each posture reaches, ascending, shape (k,)."""
    q: FloatArray
    """Joints [rad], the turns nearest to the middle of the limits, shape (k, n)."""
    branch: IntArray
    """Branches of the postures, shape (k,)."""
    miss: FloatArray
    """Miss of each pose: distance [m] and angle [rad], shape (m, 2).

    It is 0 if the pose is reached.
    """


ToolPose = tuple[FloatArray, FloatArray, FloatArray]
"""Rotation (3, 3), position (3,) [m] and line's direction outward (3,) of a flange."""


Enclosure = tuple[IntArray, FloatArray, FloatArray]
"""Branches (n,), lowest and highest joints (n, joints) [rad] of boxes."""


@dataclass(frozen=True)
class Posture:
    """Posture of an arm, with branch and arm angle."""

    q: FloatArray
    """Joints [rad], shape (n,)."""
    branch: int
    """Branch of the inverse kinematics; of no effect without an arm angle."""
    psi: float
    """Arm angle [rad]; of no effect on arms without one."""


class LimitedJoints:
    """Joints with position limits, revolute or sliding."""

    lower: FloatArray
    """Lowest joint positions [rad], shape (n,), -inf allowed."""
    upper: FloatArray
    """Highest joint positions [rad], shape (n,), inf allowed."""
    slides: tuple[int, ...] = ()
    """Numbers of the joints that slide, from 0."""

    @cached_property
    def middle(self) -> FloatArray:
        """Middle of each joint's range [rad], 0 without limits, shape (n,)."""
        bounded = np.isfinite(self.lower) & np.isfinite(self.upper)
        low, high = np.where(bounded, self.lower, 0.0), np.where(bounded, self.upper, 0.0)
        return readonly(0.5 * (low + high))

    def within_limits(self, q: FloatArray) -> BoolArray:
        """Return whether all joints (..., n) are within their limits, shape (...)."""
        return srs_limits.within_limits(q, self.lower, self.upper)

    def nearest_turns(self, q: FloatArray, reference: FloatArray) -> FloatArray:
        """Add whole turns: the nearest to a reference among those within limits.

        A joint that no turn brings within its limits keeps its value, and so does one that slides.

        Args:
            q: joints [rad], shape (..., n).
            reference: joints to be near to [rad], broadcast against q.
        """
        turned = srs_limits.nearest_turns(q, reference, self.lower, self.upper)
        for k in self.slides:
            turned[..., k] = q[..., k]
        return turned

    def less_turns(self, moved: FloatArray) -> FloatArray:
        """Subtract whole turns from differences (..., n) [rad] of joints that turn."""
        turns = TURN * np.rint(moved / TURN)
        for k in self.slides:
            turns[..., k] = 0.0
        less: FloatArray = moved - turns
        return less


class PostureSource(LimitedJoints, ABC):
    """Arm in its carrying frame: flange poses, and postures that reach them."""

    reach_step: ClassVar[float]
    """Spacing of the platform angles at which reach is examined [rad]."""

    has_arm_angle: ClassVar[bool] = False
    """Flag of families with closed forms over branches and an arm angle."""
    solves_by_search: ClassVar[bool] = False
    """Flag of families that search for postures.

    A search takes some thousand times as long as closed forms.
    """

    @property
    @abstractmethod
    def chain(self) -> tuple[FloatArray, BoolArray]:
        """Constant transforms from joint to joint, and flags of joints that slide.

        The transforms have shape (n + 1, 3, 4): rotation and position [m] of each joint at zero in the one before, and
        of the flange in the last one. The flags have shape (n,). Joints slide along their z axes or turn about them.
        """

    @property
    @abstractmethod
    def last_axis(self) -> tuple[FloatArray, FloatArray]:
        """Direction (3,) of the last joint's axis, and a point (3,) on it [m].

        Both are in the flange frame.
        """

    @abstractmethod
    def forward(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute flange rotations (..., 3, 3) and positions (..., 3) [m] of joints (..., n)."""

    @abstractmethod
    def postures(
        self, R: FloatArray, p: FloatArray, *, first_only: bool = False, thorough: bool = True
    ) -> ReachedPostures:
        """Solve for postures within limits that reach flange poses.

        Args:
            R: flange rotations in the carried frame, shape (m, 3, 3).
            p: flange positions [m], shape (m, 3).
            first_only: whether the search of a pose ends with its first solution.
            thorough: whether many solutions are computed, or few.
        """

    @abstractmethod
    def neighbour(self, posture: Posture, R: FloatArray, p: FloatArray) -> FloatArray | None:
        """Solve for joints (n,) [rad] near a posture that reach a pose, or None.

        None means that no such joints are within limits.

        Args:
            posture: at a pose near this one.
            R: flange rotation in the carried frame, shape (3, 3).
            p: flange position [m], shape (3,).
        """

    @abstractmethod
    def follow_line(
        self, posture: Posture, pose: ToolPose, length: float, psi_end: float, samples: int
    ) -> FloatArray:
        """Compute the joints (samples, n) [rad] along a straight line outward from a posture's target.

        Args:
            posture: at the target.
            pose: flange at the target, and direction of the line.
            length: length of the line [m].
            psi_end: arm angle at the outer end, or distance along the self-motion from the target [rad].
            samples: number of equidistant samples, at least 2.
        """

    @abstractmethod
    def follow_points(
        self, posture: Posture, R: FloatArray, p: FloatArray, drift: FloatArray, target: int
    ) -> tuple[FloatArray, bool]:
        """Compute joints (m, n) [rad] along flange poses, and whether they are feasible.

        Feasible joints are continuous and within limits.

        Args:
            posture: posture near the one at the target.
            R: flange rotation throughout, shape (3, 3).
            p: flange positions [m], shape (m, 3).
            drift: change of the arm angle, or distance along the self-motion, from the target [rad], shape (m,).
            target: number of the pose that is the target.
        """

    @abstractmethod
    def reached(self, R: FloatArray, p: FloatArray) -> tuple[BoolArray, FloatArray]:
        """Flag poses that a posture within limits reaches, and measure the others' miss.

        Args:
            R: flange rotations in the carried frame, shape (a, y, 3, 3).
            p: flange positions [m], shape (a, y, 3).

        Returns:
            Flags and misses [m], both (a, y), as `why_missed` reads them.
        """

    @abstractmethod
    def why_missed(self, miss: float) -> str:
        """Return the key of the refusal for a pose that `reached` or `signed_miss` misses [m]."""

    @abstractmethod
    def fixed_point(self, R: FloatArray, p: FloatArray) -> FloatArray:
        """Compute the point on the last link that flange poses fix [m], shape (..., 3)."""

    @property
    def lever(self) -> float:
        """Largest distance of points that `reach_miss` examines from `fixed_point` [m]."""
        return 0.0

    @abstractmethod
    def reach_miss(self, R: FloatArray, p: FloatArray) -> FloatArray:
        """Compute the proven least distance of `fixed_point` beyond reach [m], shape (...); 0 within.

        Args:
            R: flange rotations in the carried frame, shape (..., 3, 3).
            p: flange positions [m], shape (..., 3).
        """

    def signed_miss(self, R: FloatArray, p: FloatArray) -> FloatArray:
        """Compute the distance beyond reach [m], negative if too near the shoulder, (...)."""
        return self.reach_miss(R, p)

    def may_bend(
        self, R: FloatArray, p: FloatArray, moved: FloatArray, turned: FloatArray
    ) -> BoolArray:
        """Test whether joints may be within limits near poses (k,).

        The answer is yes if this family cannot prove the contrary.

        Args:
            R: flange rotations, shape (k, 3, 3).
            p: flange positions [m], shape (k, 3).
            moved: largest distance of `fixed_point` from there [m], shape (k,).
            turned: largest turn of the flange from there [rad], shape (k,).
        """
        return np.ones(len(p), dtype=np.bool_)

    def proven_miss(self, R: FloatArray, p: FloatArray) -> tuple[float, float] | None:
        """Compute the least miss of poses (y,), distance [m] and angle [rad], or None.

        None means that a pose may be reached; zeros, that the poses are in reach but limits leave no posture.
        """
        return None

    def enclosure(
        self, R: FloatArray, p: FloatArray, slack: float, free_last: bool
    ) -> Enclosure | None:
        """Compute boxes of joints about all postures of a pose within limits, or None.

        Args:
            R: flange rotation in the carried frame, shape (3, 3).
            p: flange position [m], shape (3,).
            slack: half-width of the boxes [rad].
            free_last: whether the last joint may be anywhere within its limits.
        """
        return None
