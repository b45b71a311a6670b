"""Tolerances of the verifier, all in one table."""

from __future__ import annotations

from dualarm_cli.model.joint_motion import SAME_TIME as SAME_TIME

POSITION_AGREEMENT = 1e-8
"""Difference of a knot's position from the integral of the knot before [rad]."""
VELOCITY_AGREEMENT = 1e-7
"""Difference of a knot's velocity from the integral of the knot before [rad/s]."""
DRIFT_TIME = 60.0
"""How long errors of knots are added up [s]; in two stretches that meet they may add up to twice what is allowed."""
POSITION_SLACK = 1e-9
"""How far a joint may be beyond its position limit by rounding [rad]."""
RATE_SLACK = 1e-9
"""Share by which a velocity or acceleration may exceed its limit by rounding."""
JUMP_SLACK = 1e-6
"""Share of the acceleration limit by which an acceleration may change beyond jerk times time: knots may be a
nanosecond apart, where a quotient of differences means nothing."""
RUN_SLACK = 10.0
"""How often that share may be used up within one run of knots."""
AT_REST = 1e-9
"""Speed [rad/s] and acceleration [rad/s²] that count as none."""
SAME_JOINTS = 1e-9
"""Difference of two postures that count as one [rad]."""
SAME_PLACE = 1e-9
"""Difference of two places that count as one [m]."""
EVENT_SPEED = 1e-6
"""How fast a joint may be while its arm is at a target that it may not pass [rad/s]."""
STANDS = 1e-6
"""How far a joint may move while its arm has to stand [rad]."""
POSE_DISTANCE = 1e-6
"""Distance of a tool from where it is commanded to be [m]."""
POSE_ANGLE = 1e-6
"""Angle of a tool from how it is commanded to be [rad]."""
LINE_DISTANCE = 1e-4
"""How far a tool may leave a straight line [m]."""
LINE_ANGLE = 1e-4
"""How far a tool may turn on a straight line [rad]."""
PATH_SPEED_SLACK = 5e-3
"""Share by which a tool may be faster along its path than asked, measured between instants."""
PATH_LATE = 1e-6
"""Time beyond what its speed and ramps allow that a path may take by rounding [s]."""
PATH_RAMP, PATH_RISE = 0.8, 0.4
"""Longest times to a path's speed and to its acceleration where the file leaves them open, at full speed [s]."""
CHAIN_DISTANCE = 1e-6
"""How far a tool may be from its seam, and a part from where it has to be [m]."""
CHAIN_ANGLE = 1e-6
"""How far a tool may be turned away on its seam, and a part from how it has to be [rad]."""
SEAM_SPEED_SLACK = 1e-3
"""Share by which the speed along a seam may be off."""
TORQUE_SLACK = 1e-3
"""Share by which a torque may exceed its limit between the instants that the planner looks at."""
CLEARANCE_SLACK = 1e-6
"""By how much a distance may fall short of the required clearance [m]."""
BELT_SPEED = 1e-3
"""How far a tool's velocity may be from that of the conveyor that it is to move with [m/s]."""
CONTACT_SLACK = 5e-4
"""How far a carried part may reach into what it lies on, on the lines at both ends of its way [m]."""
TOOL_SPEED_SLACK = 1e-4
"""Share by which a measured tool speed may exceed its cap."""
SAME_STATED = 1e-9
"""Tolerance of stated limits (as a share) and poses [m, or cosine] against the job's."""
DRIVEN_SPAN = 0.02
"""Share of the plan that a log may lack at either end."""
DRIVEN_RATE_SLACK = 0.05
"""Share by which velocities and accelerations of a motion as it was driven may exceed their limits: they are
those of an interpolation."""
