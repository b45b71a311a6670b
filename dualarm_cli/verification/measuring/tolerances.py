"""Tolerances of the verifier, all in one table."""

from __future__ import annotations

from dualarm_cli.model.motion.trajectory import SAME_TIME
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class Tolerances:
    """Largest deviations that pass a check."""

    same_time: float = SAME_TIME
    """Difference of two times that count as one [s]."""
    position_agreement: float = 1e-8
    """Difference of a knot's position from the integral of the knot before [rad]."""
    velocity_agreement: float = 1e-7
    """Difference of a knot's velocity from the integral of the knot before [rad/s]."""
    drift_time: float = 60.0
    """Interval over which errors of knots are summed [s].

    Over two adjacent intervals twice the sum is allowed.
    """
    position_slack: float = 1e-9
    """Excess over a position limit by rounding [rad]."""
    rate_slack: float = 1e-9
    """Relative excess of a velocity or acceleration over its limit by rounding."""
    jump_slack: float = 1e-6
    """Change of acceleration beyond jerk times time, as a fraction of the limit.

    Knots may be a nanosecond apart, where a quotient of differences means nothing.
    """
    run_slack: float = 10.0
    """Sum of changes within one run of knots, in multiples of `jump_slack`."""
    at_rest: float = 1e-9
    """Speed [rad/s] and acceleration [rad/s²] that count as zero."""
    same_joints: float = 1e-9
    """Difference of two postures that count as one [rad]."""
    same_place: float = 1e-9
    """Difference of two places that count as one [m]."""
    event_speed: float = 1e-6
    """Joint speed at a target at which the arm has to stand [rad/s]."""
    stands: float = 1e-6
    """Joint movement while an arm has to stand [rad]."""
    pose_distance: float = 1e-6
    """Distance of a tool from its commanded pose [m]."""
    pose_angle: float = 1e-6
    """Angle of a tool from its commanded pose [rad]."""
    line_distance: float = 1e-4
    """Distance of a tool from its straight line [m]."""
    line_angle: float = 1e-4
    """Rotation of a tool on a straight line [rad]."""
    path_speed_slack: float = 5e-3
    """Relative excess of a tool's speed along its path, measured between instants."""
    path_late: float = 1e-6
    """Excess of a path's duration over the one by its speed and ramps [s]."""
    path_ramp: float = 0.8
    """Longest time to a path's full speed if the file leaves it open [s]."""
    path_rise: float = 0.4
    """Longest time to a path's full acceleration if the file leaves it open [s]."""
    chain_distance: float = 1e-6
    """Distance of a tool from its seam, and of a part from its place [m]."""
    chain_angle: float = 1e-6
    """Angle of a tool from its seam frame, and of a part from its pose [rad]."""
    seam_speed_slack: float = 1e-3
    """Relative error of the speed along a seam."""
    torque_slack: float = 1e-3
    """Relative excess of a torque over its limit between the planner's instants."""
    clearance_slack: float = 1e-6
    """Shortfall of a distance below the required clearance [m]."""
    belt_speed: float = 1e-3
    """Velocity of a tool relative to the conveyor that it moves with [m/s]."""
    contact_slack: float = 5e-4
    """Penetration of a carried part and its support, on lines of pick and place [m]."""
    tool_speed_slack: float = 1e-4
    """Relative excess of a measured tool speed over its cap."""
    same_stated: float = 1e-9
    """Tolerance of stated limits (relative) and poses [m, or cosine] against the job's."""
    recorded_span: float = 0.02
    """Fraction of the plan that a log may lack at either end."""
    recorded_rate_slack: float = 0.05
    """Relative excess of velocities and accelerations of a recorded, interpolated motion."""


TOL = Tolerances()
