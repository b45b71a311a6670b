"""Problem and solution of a redundancy solver: one arm at one stop."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, readonly
from dualarm_cli.kinematics.posture_source import Posture, PostureSource
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal

Place = Literal["approach", "target", "retract"]
"""Where on a stop an arm is: where its approach starts, at its target, or where its retract ends."""


@dataclass(frozen=True)
class StopProblem:
    """One arm's next stop while the platform stands: go there, approach, retract.

    All poses are in the arm's base frame. The tool frame's z axis points out of the tool; a line of length L
    runs from the target shifted by -L z to the target.
    """

    arm: PostureSource
    """The arm's kinematics and position limits."""
    R_base_tool: FloatArray
    """Rotation of the tool centre point at each nominal target, shape (m, 3, 3)."""
    p_base_tool: FloatArray
    """Position of the tool centre point at each nominal target [m], shape (m, 3)."""
    R_tool_flange: FloatArray
    """Rotation of the flange in the tool frame, shape (3, 3)."""
    p_tool_flange: FloatArray
    """Position of the flange in the tool frame [m], shape (3,)."""
    configurations: FloatArray | None
    """Joint configurations that are the targets themselves [rad], shape (m, n); None where any
    posture that reaches the target will do."""
    yaw: FloatArray
    """Turns about the tool's z axis that may be tried [rad], shape (y,)."""
    free_yaw: bool
    """Whether any turn between the tried ones will do as well."""
    approach: float
    """Length of the straight approach [m]."""
    retract: float
    """Length of the straight retract [m]."""
    start: FloatArray
    """Where the arm's joints are before [rad], shape (n,)."""
    waiting: float
    """Time that the transfer takes in any case, because the platform turns [s]."""
    joint_times: Callable[[FloatArray], FloatArray]
    """Closed-form rest-to-rest time of each joint [s] for joint displacements [rad], both (..., n)."""
    line_time: Callable[[FloatArray, FloatArray], FloatArray]
    """Estimated time [s], shape (k,), of k lines q (k, s, n) [rad] over their length (s,) [m]."""
    refine: bool = True
    """Whether the best posture is refined between the grid's arm angles; without, it is found faster."""
    clear: Callable[[FloatArray, Place], BoolArray] | None = None
    """Whether joints (k, n) [rad] at a place are clear of everything, shape (k,); None where nothing has to."""

    def __post_init__(self) -> None:
        """Freezes the arrays."""
        for name in (
            "R_base_tool",
            "p_base_tool",
            "R_tool_flange",
            "p_tool_flange",
            "yaw",
            "start",
        ):
            object.__setattr__(self, name, readonly(getattr(self, name)))

    def transfer_time(self, displacement: FloatArray) -> FloatArray:
        """Returns the time of the slowest joint [s], shape (...), for displacements (..., n) [rad]."""
        slowest: FloatArray = self.joint_times(displacement).max(axis=-1)
        return slowest


@dataclass(frozen=True)
class StopPosture:
    """How the arm makes the stop: one branch, an arm angle at each end of its lines.

    An arm without closed forms has no arm angle. Its posture at the target is what its lines are followed from, and
    the arm angles are ways along the self-motion from there (`LineFollowing`); without a spare joint all are 0.
    """

    target: int
    """Which nominal target was taken."""
    yaw: float
    """Turn about the tool's z axis that was taken [rad]."""
    branch: int
    """Branch of the inverse kinematics, the same on the whole stop."""
    psi_target: float
    """Arm angle at the target [rad]."""
    psi_approach: float
    """Arm angle where the approach starts [rad]; it varies linearly along the line."""
    psi_retract: float
    """Arm angle where the retract ends [rad]; it varies linearly along the line."""
    q_approach: FloatArray
    """Joints where the approach starts [rad], shape (n,)."""
    q_target: FloatArray
    """Joints at the target [rad], shape (n,)."""
    q_retract: FloatArray
    """Joints where the retract ends [rad], shape (n,)."""
    cost: float
    """Time of transfer, approach and retract, and of nothing else [s]: closed forms, the lines as estimated."""

    def __post_init__(self) -> None:
        """Freezes the arrays."""
        for name in ("q_approach", "q_target", "q_retract"):
            object.__setattr__(self, name, readonly(getattr(self, name)))

    @property
    def at_target(self) -> Posture:
        """Posture at the target."""
        return Posture(self.q_target, self.branch, self.psi_target)


@dataclass(frozen=True)
class NoPosture:
    """Why an arm cannot make a stop at this platform position."""

    reason: Refusal
    """Fault of the stop, as part of a refusal."""
