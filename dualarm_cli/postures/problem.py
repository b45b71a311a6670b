"""Problem and solution of a redundancy solver: one arm at one stop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import field
from typing import Literal

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, readonly
from dualarm_cli.kinematics.posture_source import Posture, PostureSource
from dualarm_cli.model.lines import LineDirections
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal

Place = Literal["approach", "target", "retract"]
"""Place on a stop: start of the approach, target or end of the retract."""


@dataclass(frozen=True)
class PostureSettings:
    """Settings of the choice of postures at stops."""

    line_samples: int = 7
    """Samples of a line while postures are compared."""
    bound_factor: float = 0.99
    """Safety factor on the lower bound of a line's time, because times are estimated."""
    travel_weight: float = 1e-3
    """Cost of a transfer's travel [s/rad], which breaks ties."""
    scan_yaws: int = 8
    """Number of yaws that are scanned if yaw is free."""
    first_scanned: int = 12
    """Platform angles scanned in the first block, nearest first; blocks double."""
    max_angles: int = 24
    """Maximum number of reachable angles at which the stage is solved, nearest first."""
    clear_scan_step: float = float(np.radians(10.0))
    """Spacing of platform angles in explanations of collisions [rad]."""
    proof_steps: tuple[float, float] = (float(np.radians(6.0)), float(np.radians(0.5)))
    """Coarse and fine spacing of platform positions in proofs of reach [rad]."""
    proof_poses: int = 64
    """Poses whose bends a proof of reach examines first."""
    target_arm_angles: int = 48
    """Number of arm angles at each target: 7.5 degrees apart."""
    rough_arm_angles: int = 24
    """Number of arm angles for a rough estimate of a time: 15 degrees apart."""
    max_targets: int = 48
    """Maximum number of target postures whose lines are examined, quickest first."""
    tested_targets: int = 192
    """Block of target postures whose clearance is tested, until `max_targets` are clear."""

    swings: tuple[float, ...] = (0.0, -0.2, 0.2, -0.5, 0.5)
    """Candidate changes of the arm angle along a line [rad]."""
    far_angle: float = 0.4
    """Difference of arm angle or yaw between distinct optima [rad]."""
    first_timed: int = 4
    """Postures of each problem whose lines are timed first, by lower bound."""
    timing_factor: float = 1.02
    """Factor on the best time up to which other lines are timed."""
    joint_rounds: int = 2
    """Rounds in which all candidates of a problem are refined."""
    first_width: float = 0.25
    """Half-width of the first round of refinement [rad]."""
    dense_samples: int = 33
    """Samples of a line at which the chosen posture must be feasible."""
    end_samples: int = 3
    """Samples of a line if only its end matters."""
    starts: int = 2
    """Number of candidates of a stop that are refined."""

    general_dense_samples: int = 65
    """Samples of a general arm's line at which the chosen posture must be feasible."""
    general_batch: int = 32
    """Block of a general arm's postures whose lines are followed, quickest first."""
    general_starts: int = 3
    """Number of a general arm's candidates that are refined, of distinct branches."""
    general_drifts: tuple[float, ...] = (0.0, -0.3, 0.3)
    """Initial drifts along a general arm's lines [rad]."""
    general_width: float = 0.3
    """Half-width of the first round of a general arm's refinement [rad]."""
    general_shrink: float = 0.55
    """Ratio of a round's half-width to the previous one."""
    general_rounds: int = 6
    """Number of rounds of a general arm's refinement."""
    along_self_motion: tuple[float, ...] = (0.0, -1.0, -0.4, 0.4, 1.0)
    """Variations along the self-motion in a round, as fractions of the half-width."""
    to_sides: tuple[float, ...] = (0.0, -1.0, 1.0)
    """Variations of yaw and drifts in a round, as fractions of the half-width."""


POSTURES = PostureSettings()


@dataclass(frozen=True)
class StopProblem:
    """Next stop of one arm while the platform stands: transfer, approach, retract.

    All poses are in the arm's base frame. The tool frame's z axis points out of the tool.
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
    """Joint configurations of the targets [rad], shape (m, n); None for pose targets."""
    yaw: FloatArray
    """Allowed yaws [rad], shape (y,)."""
    free_yaw: bool
    """Flag of a free yaw; `yaw` has samples of it."""
    approach: float
    """Length of the straight approach [m]."""
    retract: float
    """Length of the straight retract [m]."""
    start: FloatArray
    """Joints of the arm before the transfer [rad], shape (n,)."""
    waiting: float
    """Minimum time of the transfer, because the platform moves [s]."""
    joint_times: Callable[[FloatArray], FloatArray]
    """Closed-form rest-to-rest time of each joint [s] for joint displacements [rad], both (..., n)."""
    line_time: Callable[[FloatArray, FloatArray], FloatArray]
    """Estimated times [s], (k,), of lines q (k, s, n) [rad] over lengths (s,) [m]."""
    refine: bool = True
    """Flag of a posture that is refined between the grid's arm angles."""
    is_free: Callable[[FloatArray, Place], BoolArray] | None = None
    """Collision test (k,) of joints (k, n) [rad] at a place; None for no test."""
    directions: FloatArray = field(default_factory=lambda: LineDirections().vectors)
    """Directions outward, in the tool's frame, then the base frame, (2, 2, 3)."""

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for name in (
            "R_base_tool",
            "p_base_tool",
            "R_tool_flange",
            "p_tool_flange",
            "yaw",
            "start",
            "directions",
        ):
            object.__setattr__(self, name, readonly(getattr(self, name)))

    def transfer_time(self, displacement: FloatArray) -> FloatArray:
        """Compute the time of the slowest joint [s], (...), for displacements (..., n) [rad]."""
        slowest: FloatArray = self.joint_times(displacement).max(axis=-1)
        return slowest


@dataclass(frozen=True)
class StopPosture:
    """Posture of a stop: one branch, with arm angles at target and ends of lines.

    A general arm has no arm angle. Its lines are followed from the posture at the target, and its arm angles are
    distances along the self-motion from there (`FlangeLines`), 0 without a redundant joint.
    """

    target: int
    """Number of the chosen nominal target."""
    yaw: float
    """Chosen yaw [rad]."""
    branch: int
    """Branch of the inverse kinematics, the same on the whole stop."""
    psi_target: float
    """Arm angle at the target [rad]."""
    psi_approach: float
    """Arm angle at the start of the approach [rad], linear along the line."""
    psi_retract: float
    """Arm angle at the end of the retract [rad], linear along the line."""
    q_approach: FloatArray
    """Joints at the start of the approach [rad], shape (n,)."""
    q_target: FloatArray
    """Joints at the target [rad], shape (n,)."""
    q_retract: FloatArray
    """Joints at the end of the retract [rad], shape (n,)."""
    cost: float
    """Time of transfer, approach and retract [s], lines as estimated."""

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for name in ("q_approach", "q_target", "q_retract"):
            object.__setattr__(self, name, readonly(getattr(self, name)))

    @property
    def at_target(self) -> Posture:
        """Posture at the target."""
        return Posture(self.q_target, self.branch, self.psi_target)


@dataclass(frozen=True)
class NoPosture:
    """Infeasible stop at one platform position."""

    reason: Refusal
    """Fault of the stop, as part of a refusal."""
