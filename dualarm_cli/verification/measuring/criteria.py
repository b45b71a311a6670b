"""Criteria of the verifier: the measure and unit of each check."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dualarm_cli.kinds import of_kinds
from dualarm_cli.model.verification import COLLISIONS, SHAPES, Check
from dualarm_cli.records import dataclass

NO_TASKS = "no task file was given (--tasks)"
"""Reason of checks that need the job."""
NO_STAGES, NO_EVENTS = "the schedule lists none", "the schedule lists no events"
NO_LINES = "the schedule lists no approach or retract of an event"
NO_DWELLS = "no event has a dwell in which the tool stands"
UNPROVEN = "clearance is not proven"
SHARE, NO_LIMIT = "share of the limit", "no joint has such a limit"


@dataclass(frozen=True)
class Criterion:
    """Measure of one check: a value above the allowed one fails."""

    unit: str
    """Unit of the measure, empty for counts; of joints that slide m in place of rad."""
    measure: str
    """Measured value in a phrase."""
    unchecked: str = ""
    """Reason why the check is not made, the usual one if there are several.

    Empty if it is always made.
    """


CRITERIA: Mapping[str, Mapping[str, Criterion]] = {
    "Motion": {
        "finite": Criterion("", "Numbers of the motion that are not finite."),
        "time": Criterion("s", "Start of a joint group's time, or its largest step backwards."),
        "everything else": Criterion(
            "",
            "All further checks.",
            "a number is not finite, or time does not start at 0 or runs backwards",
        ),
        "position_agreement": Criterion(
            "rad", "Difference of a position from the integral of earlier knots."
        ),
        "velocity_agreement": Criterion(
            "rad/s", "Difference of a velocity from the integral of earlier knots."
        ),
        "position": Criterion(
            "rad", "Position of a joint beyond its limits.", "the schedule states no such limit"
        ),
        "velocity": Criterion(SHARE, "Largest velocity of a joint.", NO_LIMIT),
        "acceleration": Criterion(SHARE, "Largest acceleration of a joint.", NO_LIMIT),
        "jerk": Criterion(SHARE, "Largest jerk of a joint.", NO_LIMIT),
        "torque": Criterion(
            SHARE,
            "Largest torque of a joint, with tools and carried parts.",
            "masses or efforts are unknown",
        ),
        "rated_torque": Criterion(
            SHARE,
            "Largest effective (RMS) torque of a joint; listed for joints with a rated effort.",
        ),
        "rest": Criterion("rad/s, rad/s²", "Velocity or acceleration at start and end."),
        "platform_still": Criterion(
            "rad, rad/s", "Motion of the platform in lines and dwells.", "the robot has no platform"
        ),
    },
    "Tools": {
        "events_at_knots": Criterion("s", "Distance of an event from the nearest knot.", NO_EVENTS),
        "tool_position_at_events": Criterion(
            "m", "Distance of the tool from its event's pose.", NO_EVENTS
        ),
        "tool_angle_at_events": Criterion(
            "rad", "Angle of the tool from its event's pose.", NO_EVENTS
        ),
        "tool_still_in_dwells": Criterion(
            "m", "Distance from the event's pose in its dwell.", NO_DWELLS
        ),
        "tool_steady_in_dwells": Criterion(
            "rad", "Angle from the event's pose in its dwell.", NO_DWELLS
        ),
        "lines_straight": Criterion("m", "Distance of the tool from its straight line.", NO_LINES),
        "lines_steady": Criterion("rad", "Turn of the tool on its straight line.", NO_LINES),
        "line_lengths": Criterion("m", "Difference of a line from its task's length.", NO_LINES),
        "lines_at_events": Criterion("s", "Time between a line and its event.", NO_LINES),
        "tool_speed": Criterion("m/s", "Largest speed of a tool in the world.", "no cap is set"),
        "events_at_targets": Criterion(
            "m, rad",
            "Distance or angle of an event from its task's target, within its freedoms.",
            "no event is one of the job's",
        ),
        "stands_at_events": Criterion(
            "rad/s, m/s",
            "Velocity at a target that may not be passed in motion.",
            "no target is one at which an arm has to stand",
        ),
    },
    "Order and time": {
        "arms": Criterion(
            "", "Events, segments and stages of an arm or tool that the robot lacks."
        ),
        "stages": Criterion("s", "Gap or overlap of stages.", NO_STAGES),
        "segments": Criterion("s", "Gap or overlap of an arm's segments.", NO_STAGES),
        "segment_kinds": Criterion("", "Segments that the motion contradicts.", NO_STAGES),
        "lower_bound": Criterion(
            "s", "Excess of the stated bound over the duration.", "none is stated"
        ),
        "order": Criterion(
            "", "Targets missing, repeated, or in an order or by an arm that is not allowed."
        ),
        "precedence": Criterion(
            "s", "Overlap of a task with one before it.", "no task has `after`"
        ),
        "windows": Criterion(
            "s", "Time outside a task's window.", "no task has not_before or not_after"
        ),
        "pairing": Criterion(
            "s", "Time between both arms' starts of a stage.", "the arms run asynchronously"
        ),
        "dwells": Criterion("s", "Time by which a dwell is too short."),
        "signals": Criterion(
            "", "Events with another signal than their task's; listed for jobs with signals."
        ),
        "grasps": Criterion(
            "",
            "Picks and places by another grasp than allowed, stated or used before, or with another width; listed for "
            "parts with grasps or widths.",
        ),
        "care": Criterion(
            "share of the limit",
            "Largest rate of a joint or tool in a task or while a part is held; listed for jobs with such limits.",
            "no such task or part is in the schedule",
        ),
        "tilt": Criterion(
            "share of the limit",
            "Largest angle by which a held part leans from its attitude at the pick; listed for jobs with `tilt`.",
            "no such part is in the schedule",
        ),
        "start_posture": Criterion(
            "rad", "Distance from the start posture.", "start: free leaves it to the planner"
        ),
        "return": Criterion("rad", "Distance of the end from the start.", "return: false"),
    },
    "Clearance": {
        COLLISIONS: Criterion(
            "m",
            "Largest lack of clearance of two bodies; below 0 for none.",
            "not requested; `dualarm verify PLAN --tasks FILE` proves it",
        ),
        SHAPES: Criterion("", "Links and tools without a shape, if any.", "some have no shape"),
        "skew": Criterion(
            "s",
            "Delay of either arm proven to be clear, which has to reach the allowed one; listed for jobs with `skew`.",
            "delays need two arms whose links have shapes",
        ),
    },
    "Files and budget": {
        "robot": Criterion("", "Differences of the file's robot from its URDF, or from the job's."),
        "duration": Criterion("s", "Difference of the stated duration from the motion's."),
        "files": Criterion("", "Files of the plan that have changed since it was written."),
        "budget_cycle_time": Criterion("s", "Cycle time."),
        "budget_clearance": Criterion(
            "m", "Least clearance, which has to reach the allowed one.", UNPROVEN
        ),
        "budget_skew": Criterion(
            "s",
            "Delay of either arm proven to be clear, which has to reach the allowed one.",
            UNPROVEN,
        ),
    },
    "Recorded motion": {
        "joints": Criterion("", "Joints that the log lacks.", "they count as following the plan"),
        "time_span": Criterion("s", "Time of the plan that the log lacks at either end."),
        "delay": Criterion(
            "s", "Delay of a joint behind the plan.", "no joint moves enough to measure it"
        ),
        "tracking_error": Criterion("rad", "Error of a turning joint without its delay."),
        "tracking_distance": Criterion("m", "Error of a sliding joint without its delay."),
        "tool_at_events": Criterion(
            "m", "Distance of a tool from its event's pose.", "the plan lists no events"
        ),
    },
}
"""Criteria of the verifier by heading and name of the check.

Kinds of work bring their own.
"""


def criterion(name: str) -> Criterion:
    """Look up the criterion of a check.

    Raises:
        KeyError: no table has the check.
    """
    tables = CRITERIA.values()
    built_in = next((table[name] for table in tables if name in table), None)
    return built_in or {k: c for kind in of_kinds("checks") for k, c in kind.criteria.items()}[name]


def judge(name: str, measured: float, allowed: float, where: str, *, slides: bool = False) -> Check:
    """Judge a measured value, which passes up to the allowed one; a NaN fails.

    A value that passes is rounded to 1e-12 of its unit: the last digits of pinocchio's sines are the processor's.

    Args:
        name: of the check.
        measured: in the unit of its criterion.
        allowed: in the same unit.
        where: place of the worst value.
        slides: whether the value is of a sliding joint, in m in place of rad.
    """
    passed = bool(measured <= allowed)
    value = float(measured) if np.isfinite(measured) else None
    if passed and value is not None:
        value = round(value, 12) + 0.0
    unit = criterion(name).unit
    unit = unit.replace("rad", "m") if slides else unit
    return Check(name, "passed" if passed else "failed", value, float(allowed), unit, where)


def not_checked(name: str, why: str = "") -> Check:
    """State that a check is not made, with its criterion's reason by default."""
    usual = criterion(name).unchecked
    return Check(name, "not checked", None, None, "", why or usual)
