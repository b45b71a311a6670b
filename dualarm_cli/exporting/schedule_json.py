"""`schedule.json`: the schedule, lossless, in the order a person reads it."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import pinocchio as pin

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.model.schedule import Schedule, ScheduleRobot, Segment, Stage
from dualarm_cli.model.verification import Verification

FORMAT = "dualarm.schedule/1"


def to_json(schedule: Schedule, urdf: str, files: Mapping[str, str]) -> bytes:
    """Returns the schedule as JSON: the same bytes for the same schedule.

    Args:
        schedule: what to write.
        urdf: name of the URDF file beside it.
        files: SHA-256 of the other files of the set, by name.
    """
    trajectory = schedule.trajectory
    document: dict[str, Any] = {
        "format": FORMAT,
        "robot": _robot(schedule.robot, trajectory.joints, urdf),
        "duration": schedule.duration,
        "lower_bound": schedule.lower_bound,
        "grid_gap": schedule.grid_gap,
        "order_grid_gap": schedule.order_grid_gap,
        "clearance_cost": schedule.clearance_cost,
        "stages": [_stage(stage) for stage in schedule.stages],
        "segments": [_segment(segment) for segment in schedule.segments],
        "events": [
            {
                "time": event.time,
                "arm": event.arm,
                "task": event.task,
                "action": event.action,
                "frame": event.frame,
                **_pose(event.pose),
                "dwell": event.dwell,
                **({"velocity": list(event.velocity)} if event.moves else {}),
            }
            for event in schedule.events
        ],
        "trajectory": {
            "time": trajectory.time.tolist(),
            "position": trajectory.position.tolist(),
            "velocity": trajectory.velocity.tolist(),
            "acceleration": trajectory.acceleration.tolist(),
        },
        "provenance": asdict(schedule.provenance),
        "notes": list(schedule.notes),
        "files": dict(files),
        "verification": _verification(schedule.verification),
    }
    lines = []
    for key, value in document.items():
        text = json.dumps(value, allow_nan=False, ensure_ascii=False)
        if key in ("stages", "segments", "events") and value:
            rows = ",\n  ".join(
                json.dumps(row, allow_nan=False, ensure_ascii=False) for row in value
            )
            text = f"[\n  {rows}\n ]"
        lines.append(f" {json.dumps(key)}: {text}")
    # A file name that is no UTF-8 arrives as lone surrogates, which JSON can only escape.
    return ("{\n" + ",\n".join(lines) + "\n}\n").encode("utf-8", "backslashreplace")


def _robot(robot: ScheduleRobot, joints: tuple[str, ...], urdf: str) -> dict[str, Any]:
    return {
        "name": robot.name,
        "urdf": urdf,
        "joints": list(joints),
        "base": _pose(robot.base),
        "platform": list(robot.platform),
        "arms": {
            name: {"flange": arm.flange, "tcp": _pose(arm.tcp), "joints": list(arm.joints)}
            for name, arm in robot.arms.items()
        },
        "limits": _limits(robot.limits),
        "tool_speed": robot.tool_speed,
    }


def _limits(limits: JointLimits) -> dict[str, Any]:
    """Returns the limits by joint; null where nothing is demanded."""

    def number(values: FloatArray, k: int) -> float | None:
        return float(values[k]) if math.isfinite(values[k]) else None

    return {
        joint: {
            "lower": number(limits.lower, k),
            "upper": number(limits.upper, k),
            "velocity": number(limits.velocity, k),
            "acceleration": number(limits.acceleration, k),
            "jerk": number(limits.jerk, k),
            "source": limits.source[k],
        }
        for k, joint in enumerate(limits.joints)
    }


def _pose(pose: pin.SE3) -> dict[str, list[float]]:
    """Returns xyz [m] and the quaternion x, y, z, w with w not negative."""
    quaternion = pin.Quaternion(pose.rotation).coeffs()
    if quaternion[3] < 0:
        quaternion = -quaternion
    return {
        "xyz": [float(v) + 0.0 for v in pose.translation],
        "quat_xyzw": [float(v) + 0.0 for v in quaternion],
    }


def _stage(stage: Stage) -> dict[str, Any]:
    return asdict(stage) | {"tasks": list(stage.tasks)}


def _segment(segment: Segment) -> dict[str, Any]:
    row = asdict(segment)
    if segment.dwell is None:
        del row["dwell"]
    if not segment.reason:
        del row["reason"]
    return row


def _verification(verification: Verification | None) -> dict[str, Any] | None:
    if verification is None:
        return None
    return {
        "passed": verification.passed,
        "checks": [asdict(check) for check in verification.checks],
    }
