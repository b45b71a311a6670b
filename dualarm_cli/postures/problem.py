"""Problem and solution of a redundancy solver: one arm at one stop."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, readonly
from dualarm_cli.kinematics.posture_source import Posture, PostureSource
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal

Place = Literal["approach", "target", "retract"]
"""Where on a stop an arm is: where its approach starts, at its target, or where its retract ends."""


@dataclass(frozen=True)
class PostureSettings:
    """Numbers of the choice of postures at stops."""

    line_samples: int = 7
    """Samples of a line while postures are compared."""
    sure: float = 0.99
    """Share of a line's least time that its estimate, taken at a few instants, does not fall below."""
    travel_weight: float = 1e-3
    """Cost of a transfer's travel [s/rad]: of equals, the one that moves least."""
    scan_yaws: int = 8
    """Yaws that are scanned where any will do."""
    first_scanned: int = 12
    """Platform angles, nearest first, that are scanned together at first; then twice as many, and so on."""
    tried_angles: int = 24
    """Reachable angles, nearest first, at which the whole stage is tried."""
    clear_scan_step: float = float(np.radians(10.0))
    """Spacing of the platform angles scanned for what a posture touches [rad]."""
    proof_steps: tuple[float, float] = (float(np.radians(6.0)), float(np.radians(0.5)))
    """Coarse and fine spacing of the platform positions examined in proofs of reach [rad]."""
    proof_poses: int = 64
    """Poses whose bends such a proof examines first."""
    target_arm_angles: int = 48
    """Arm angles tried at each target: 7.5 degrees apart."""
    rough_arm_angles: int = 24
    """Arm angles for a rough estimate of a time: 15 degrees apart."""
    kept_targets: int = 48
    """Target postures, quickest transfer first, whose lines are examined."""
    tested_targets: int = 192
    """Target postures whose clearance is tested together, quickest first, until `kept_targets` are clear."""

    swings: tuple[float, ...] = (0.0, -0.2, 0.2, -0.5, 0.5)
    """Changes of the arm angle along a line that are tried [rad]."""
    far: float = 0.4
    """Difference of arm angle or yaw from which refinement may lead elsewhere [rad]."""
    looked_at_first: int = 4
    """Postures of each problem, by what no motion can beat, whose lines are timed first."""
    near: float = 1.02
    """Factor on the best first time up to which other lines are timed."""
    all_ways: int = 2
    """Rounds in which all ways of a problem are refined."""
    first_width: float = 0.25
    """Half-width of the first round of refinement [rad]."""
    dense_samples: int = 33
    """Samples of a line at which the posture that is taken must keep its limits."""
    end_samples: int = 3
    """Samples of a line where only its end matters."""
    starts: int = 2
    """Ways of a stop that are refined; what becomes of the best of them is taken."""

    general_dense_samples: int = 65
    """Samples of the lines of arms without closed forms at which the posture that is taken must keep its limits."""
    general_batch: int = 32
    """Postures of these arms, quickest transfer first, whose lines are followed together."""
    general_starts: int = 3
    """Ways of these arms that are refined, best first, of as many branches as there are."""
    general_drifts: tuple[float, ...] = (0.0, -0.3, 0.3)
    """Drifts along lines that are tried first for these arms [rad]."""
    general_width: float = 0.3
    """Half-width of the first round of these arms' refinement [rad]."""
    general_shrink: float = 0.55
    """Ratio of a round's half-width to that of the round before."""
    general_rounds: int = 6
    """Rounds of these arms' refinement."""
    along_self_motion: tuple[float, ...] = (0.0, -1.0, -0.4, 0.4, 1.0)
    """Variations along the self-motion in a round, as shares of the half-width."""
    to_sides: tuple[float, ...] = (0.0, -1.0, 1.0)
    """Variations of yaw and drifts in a round, as shares of the half-width."""


POSTURES = PostureSettings()


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
