"""Writer of `schedule.json`: the schedule without loss, in readable order."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict
from typing import Any

import pinocchio as pin

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.model.motion.joint_motion import anchors
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.model.schedule import Event, Schedule, Segment, Stage
from dualarm_cli.model.verification import Verification
from dualarm_cli.records import field_values

FORMAT = "dualarm.schedule/2"
BLOCK = 4096
"""Number of knots written at once."""


def to_json(schedule: Schedule, urdf: str, files: Mapping[str, str]) -> Iterator[bytes]:
    """Encode a schedule as JSON, part by part; equal schedules give equal bytes.

    Args:
        schedule: what to write.
        urdf: name of the URDF file in the same folder.
        files: SHA-256 of the other files of the set, by name; read when all of the motion is written.
    """
    head: dict[str, Any] = {
        "format": FORMAT,
        "robot": _robot(schedule, urdf),
        "duration": schedule.duration,
        "lower_bound": schedule.lower_bound,
        "grid_gap": schedule.grid_gap,
        "order_grid_gap": schedule.order_grid_gap,
        "clearance_cost": schedule.clearance_cost,
        "blend_gain": schedule.blend_gain,
    }
    yield _encoded("{\n" + ",\n".join(_member(key, value) for key, value in head.items()))
    yield from _rows("stages", map(stage_row, schedule.stages))
    yield from _rows("segments", map(segment_row, schedule.segments))
    yield from _rows("events", map(event_row, schedule.events))
    yield _encoded(',\n "motion": {')
    between = "\n  "
    for name, group in schedule.motion.groups.items():
        yield _encoded(f"{between}{_text(name)}: ")
        yield from _tables(_group_tables(group))
        between = ",\n  "
    yield b"\n }"
    tail: dict[str, Any] = {
        "provenance": asdict(schedule.provenance),
        "notes": list(schedule.notes),
        "files": dict(files),
        "verification": _verification(schedule.verification),
    }
    for key, value in tail.items():
        yield _encoded(",\n" + _member(key, value))
    yield b"\n}\n"


def _encoded(text: str) -> bytes:
    # A file name that is no UTF-8 arrives as lone surrogates, which JSON can only escape.
    return text.encode("utf-8", "backslashreplace")


def _text(value: Any) -> str:
    return json.dumps(value, allow_nan=False, ensure_ascii=False)


def _member(key: str, value: Any) -> str:
    return f" {json.dumps(key)}: {_text(value)}"


def _rows(key: str, rows: Iterable[dict[str, Any]]) -> Iterator[bytes]:
    """Yield a member that is a list, one entry per line."""
    begin, between, end = f",\n {json.dumps(key)}: [", "\n  ", "]"
    yield _encoded(begin)
    for row in rows:
        yield _encoded(between + _text(row))
        between, end = ",\n  ", "\n ]"
    yield _encoded(end)


def _group_tables(group: Trajectory) -> dict[str, FloatArray | IntArray]:
    """Collect a group's knots, and positions and velocities at its anchors."""
    anchor = anchors(group)
    return {
        "time": group.time,
        "acceleration": group.acceleration,
        "anchor": anchor,
        "position": group.position[anchor],
        "velocity": group.velocity[anchor],
    }


def _tables(tables: Mapping[str, FloatArray | IntArray]) -> Iterator[bytes]:
    """Yield an object of tables in blocks, which limits the memory."""
    before = "{"
    for name, table in tables.items():
        yield _encoded(f"{before}{json.dumps(name)}: [")
        for k in range(0, len(table), BLOCK):
            block = _text(table[k : k + BLOCK].tolist())[1:-1]
            yield _encoded((", " if k else "") + block)
        before = "], "
    yield b"]}"


def event_row(event: Event) -> dict[str, Any]:
    """Convert an event to its row in the file."""
    return {
        "time": event.time,
        "arm": event.arm,
        "task": event.task,
        "action": event.action,
        "frame": event.frame,
        **_pose(event.pose),
        "dwell": event.dwell,
        **({"velocity": list(event.velocity)} if event.moves else {}),
        **({"signal": event.signal} if event.signal else {}),
        **({"grasp": event.grasp} if event.grasp else {}),
        **({"width": event.width} if event.width else {}),
    }


def _robot(schedule: Schedule, urdf: str) -> dict[str, Any]:
    robot = schedule.robot
    return {
        "name": robot.name,
        "urdf": urdf,
        "joints": list(schedule.motion.joints),
        "groups": {name: list(group.joints) for name, group in schedule.motion.groups.items()},
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
    """Collect the limits by joint; null for an infinite limit."""

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
    """Encode a pose: xyz [m], and quaternion xyzw with w ≥ 0."""
    quaternion = pin.Quaternion(pose.rotation).coeffs()
    if quaternion[3] < 0:
        quaternion = -quaternion
    return {
        "xyz": [float(v) + 0.0 for v in pose.translation],
        "quat_xyzw": [float(v) + 0.0 for v in quaternion],
    }


def stage_row(stage: Stage) -> dict[str, Any]:
    """Convert a stage to its row in the file."""
    return field_values(stage) | {"tasks": list(stage.tasks)}


def segment_row(segment: Segment) -> dict[str, Any]:
    """Convert a segment to its row in the file."""
    row = field_values(segment)
    if segment.dwell is None:
        del row["dwell"]
    else:
        row["dwell"] = field_values(segment.dwell)
    if not segment.reason:
        del row["reason"]
    return row


def _verification(verification: Verification | None) -> dict[str, Any] | None:
    if verification is None:
        return None
    return {
        "passed": verification.passed,
        "checks": [field_values(check) for check in verification.checks],
    }
