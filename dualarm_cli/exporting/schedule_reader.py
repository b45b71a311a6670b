"""Reader of `schedule.json`; it leaves defects of the motion to the verifier."""

from __future__ import annotations

import hashlib
import math
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pinocchio as pin

from dualarm_cli.errors import InputError, check_type
from dualarm_cli.exporting.json_reader import JsonReader
from dualarm_cli.exporting.schedule_json import FORMAT
from dualarm_cli.files.robots.urdf import read_urdf
from dualarm_cli.files.source.text_source import read_text
from dualarm_cli.geometry import products
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.dwell import Dwell
from dualarm_cli.model.motion.joint_motion import JointMotion, followed
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.model.schedule import (
    Event,
    Provenance,
    Schedule,
    ScheduleArm,
    ScheduleRobot,
    Segment,
    SegmentKind,
    Stage,
    WaitReason,
)

SEGMENT_KINDS: tuple[str, ...] = get_args(SegmentKind)
WAIT_REASONS: tuple[str, ...] = get_args(WaitReason)
UNIT_TOLERANCE = 1e-6
"""Tolerance on the length of a unit quaternion."""


def read_schedule(path: str | Path) -> Schedule:
    """Read a schedule from a file, or from a folder's `schedule.json`.

    NaN in a trajectory, unsorted times and broken limits are read as they are: they are findings, not crashes.
    Stated facts that the data model derives itself (`duration`, `files`) are kept in `extra`.

    Raises:
        InputError: no such file, not JSON, or a member that cannot be understood, with its path.
        UsageError: an argument of a wrong type.
    """
    check_type("path", path, str, PathLike)
    path = Path(path)
    file = path / "schedule.json" if path.is_dir() else path
    reader = _Reader(str(file))
    document = reader.document(file, tables=("motion",))
    form = document.get("format")
    if form != FORMAT:
        reader.fail("format", f"is {form!r}, not '{FORMAT}'; plan again with this version")
    robot = reader.member(document, "robot", dict)
    joints = tuple(reader.names(robot, "joints", "robot.joints"))
    if len(set(joints)) != len(joints) or not joints:
        reader.fail("robot.joints", "must name every joint once")
    motion = reader.motion(document, robot, joints)
    schedule_robot = reader.robot(robot, joints, file.parent)
    return Schedule(
        robot=schedule_robot,
        motion=motion,
        stages=tuple(
            reader.each(document, "stages", partial(reader.stage, arms=tuple(schedule_robot.arms)))
        ),
        segments=tuple(reader.each(document, "segments", reader.segment)),
        events=tuple(reader.each(document, "events", reader.event)),
        provenance=_provenance(document.get("provenance")),
        lower_bound=reader.number(document, "lower_bound", "lower_bound", None),
        grid_gap=reader.number(document, "grid_gap", "grid_gap", None),
        order_grid_gap=reader.number(document, "order_grid_gap", "order_grid_gap", None),
        clearance_cost=reader.number(document, "clearance_cost", "clearance_cost", None),
        blend_gain=reader.number(document, "blend_gain", "blend_gain", None),
        notes=tuple(reader.names(document, "notes", "notes", ())),
        extra=reader.stated(document),
    )


def torn_files(path: Path, schedule: Schedule) -> list[str]:
    """List the files of a schedule's set that are missing or changed.

    Args:
        path: the schedule's file or folder.
        schedule: as read from there.
    """
    folder = path if path.is_dir() else path.parent
    stated = schedule.extra.get("files")
    torn = []
    for name, digest in stated.items() if isinstance(stated, dict) else ():
        file = folder / Path(str(name)).name
        if not file.is_file():
            torn.append(f"{name} is missing")
        else:
            with file.open("rb") as opened:
                if hashlib.file_digest(opened, "sha256").hexdigest() != digest:
                    torn.append(f"{name} was changed")
    return torn


def _provenance(value: object) -> Provenance:
    """Read the provenance; missing members become unknown."""
    members = value if isinstance(value, dict) else {}
    inputs, settings, seed = (members.get(key) for key in ("inputs", "settings", "seed"))
    return Provenance(
        version=str(members.get("version", "unknown")),
        inputs=inputs if isinstance(inputs, dict) else {},
        settings=settings if isinstance(settings, dict) else {},
        seed=seed if isinstance(seed, int) else 0,
    )


class _Reader(JsonReader):
    """Reader of a schedule's members."""

    def stated(self, document: dict[str, Any]) -> dict[str, Any]:
        """Read the stated duration, and the hashes of the set's other files."""
        stated: dict[str, Any] = {}
        duration = self.number(document, "duration", "duration", None)
        if duration is not None:
            stated["duration"] = duration
        if "files" in document:
            files = self.member(document, "files", dict)
            stated["files"] = {name: self.text(files, name, f"files.{name}") for name in files}
        return stated

    def motion(
        self, document: dict[str, Any], robot: dict[str, Any], joints: tuple[str, ...]
    ) -> JointMotion:
        """Read the motion; every joint belongs to one group."""
        part = self.member(document, "motion", dict)
        names = self.member(robot, "groups", dict, "robot.groups")
        groups = {name: tuple(self.names(names, name, f"robot.groups.{name}")) for name in names}
        if sorted(joint for columns in groups.values() for joint in columns) != sorted(joints):
            self.fail("robot.groups", "must name every joint of robot.joints in one group")
        return JointMotion(
            joints,
            {
                name: self.group(self.member(part, name, dict, f"motion.{name}"), name, columns)
                for name, columns in groups.items()
            },
        )

    def group(self, part: dict[str, Any], name: str, joints: tuple[str, ...]) -> Trajectory:
        """Integrate a group's motion from its accelerations and anchors."""
        path = f"motion.{name}"
        time = self.vector(part, "time", path)
        anchor = self.vector(part, "anchor", path)
        rises = anchor[0] == 0 and (np.diff(anchor) > 0).all() and anchor[-1] < len(time)
        if not rises or (anchor % 1 != 0).any():
            self.fail(
                f"{path}.anchor", f"must be knots that rise from 0 to {len(time) - 1} at most"
            )
        shape = (len(time), len(joints))
        acceleration = self.array(part.get("acceleration"), f"{path}.acceleration", shape)
        position, velocity = (
            self.array(part.get(what), f"{path}.{what}", (len(anchor), len(joints)))
            for what in ("position", "velocity")
        )
        # The verifier reports values that are not finite.
        with np.errstate(invalid="ignore", over="ignore"):
            anchors = anchor.astype(np.int64), position, velocity
            return followed(joints, time, acceleration, anchors)

    def vector(self, part: dict[str, Any], key: str, path: str) -> FloatArray:
        """Return a non-empty list of numbers."""
        value = part.get(key)
        if not isinstance(value, np.ndarray):
            self.fail(f"{path}.{key}", "must be a list" if key in part else "is missing")
        if not len(value):
            self.fail(f"{path}.{key}", "is empty")
        return self.array(value, f"{path}.{key}", value.shape[:1])

    def pose(self, value: object, path: str) -> pin.SE3:
        if not isinstance(value, dict):
            self.fail(path, "must have xyz and quat_xyzw")
        xyz = self.array(value.get("xyz"), f"{path}.xyz", (3,))
        quat = self.array(value.get("quat_xyzw"), f"{path}.quat_xyzw", (4,))
        if not (np.isfinite(xyz).all() and np.isfinite(quat).all()):
            self.fail(path, "must be finite")
        with np.errstate(over="ignore"):
            norm = float(products.norm(quat))
        if abs(norm - 1.0) > UNIT_TOLERANCE:
            self.fail(f"{path}.quat_xyzw", f"must be of unit length, not {norm:g}")
        return pin.SE3(pin.Quaternion(quat / norm).toRotationMatrix(), xyz)

    def robot(self, part: dict[str, Any], joints: tuple[str, ...], folder: Path) -> ScheduleRobot:
        members = self.member(part, "arms", dict, "robot.arms")
        if not set(members) <= {"left", "right"}:
            # Exports are named after the arms.
            self.fail("robot.arms", "must be left, right or both")
        platform = self.names(part, "platform", "robot.platform", ())
        if not set(platform) <= set(joints):
            self.fail("robot.platform", "must name joints of robot.joints")
        arms = {name: self.arm(arm, f"robot.arms.{name}", joints) for name, arm in members.items()}
        named = [*platform, *(joint for arm in arms.values() for joint in arm.joints)]
        whole = "platform" in part and all(arm.joints for arm in arms.values())
        for joint in joints:
            if (count := named.count(joint)) > 1 or (whole and not count):
                what = "named twice" if count else "of none"
                self.fail(
                    "robot.arms", f"joint '{joint}' is {what}; arms and platform must name it once"
                )
        return ScheduleRobot(
            name=self.text(part, "name", "robot.name", "unnamed"),
            urdf=self.urdf(self.text(part, "urdf", "robot.urdf"), folder),
            base=self.pose(part.get("base"), "robot.base"),
            arms=arms,
            limits=self.limits(part.get("limits") or {}, joints),
            platform=tuple(platform),
            tool_speed=self.number(part, "tool_speed", "robot.tool_speed", None),
        )

    def urdf(self, name: str, folder: Path) -> str:
        """Read the URDF in the schedule's folder; files outside it are refused."""
        try:
            file = (folder / name).resolve()
            inside = bool(name) and file.is_relative_to(folder.resolve())
        except (OSError, ValueError, RuntimeError):
            # An invalid file name, or a cycle of symbolic links.
            self.fail("robot.urdf", f"{name!r} cannot be read in the schedule's folder")
        if not inside:
            self.fail("robot.urdf", f"{name!r} must lie in the schedule's own folder")
        try:
            source = read_text(file, name)
        except InputError as error:
            message = error.diagnostics[0].message
            self.fail("robot.urdf", f"{name!r} in the schedule's folder: {message}")
        # The libraries crash on some URDFs; refuse these as in a robot file.
        read_urdf(source)
        return source.text

    def arm(self, value: object, path: str, joints: tuple[str, ...]) -> ScheduleArm:
        if not isinstance(value, dict):
            self.fail(path, "must be an object")
        arm_joints = self.names(value, "joints", f"{path}.joints", ())
        if not set(arm_joints) <= set(joints):
            self.fail(f"{path}.joints", "must name joints of robot.joints")
        return ScheduleArm(
            self.text(value, "flange", f"{path}.flange"),
            self.pose(value.get("tcp"), f"{path}.tcp"),
            tuple(arm_joints),
        )

    def limits(self, part: object, joints: tuple[str, ...]) -> JointLimits:
        """Read the stated limits; missing ones are infinite and `unstated`."""
        if not isinstance(part, dict):
            self.fail("robot.limits", "must be an object by joint")
        open_ended = {"lower": -math.inf, "upper": math.inf}
        columns: dict[str, list[float]] = {}
        for what in ("lower", "upper", "velocity", "acceleration", "jerk"):
            columns[what] = []
            for joint in joints:
                row = part.get(joint) or {}
                path = f"robot.limits.{joint}.{what}"
                if not isinstance(row, dict):
                    self.fail(f"robot.limits.{joint}", "must be an object")
                value = self.number(row, what, path, open_ended.get(what, math.inf))
                columns[what].append(math.inf if value is None else value)
        source = tuple(str((part.get(joint) or {}).get("source", "unstated")) for joint in joints)
        try:
            return JointLimits(
                joints=joints,
                source=source,
                **{what: np.array(column) for what, column in columns.items()},
            )
        except ValueError as error:
            self.fail("robot.limits", str(error))

    def event(self, row: dict[str, Any], path: str) -> Event:
        return Event(
            time=self.instant(row, "time", f"{path}.time"),
            arm=self.text(row, "arm", f"{path}.arm"),
            task=self.text(row, "task", f"{path}.task"),
            action=self.text(row, "action", f"{path}.action"),
            frame=self.text(row, "frame", f"{path}.frame"),
            pose=self.pose(row, path),
            dwell=self.number(row, "dwell", f"{path}.dwell", 0.0) or 0.0,
            velocity=self.velocity(row.get("velocity"), f"{path}.velocity"),
            signal=self.text(row, "signal", f"{path}.signal"),
            grasp=self.text(row, "grasp", f"{path}.grasp"),
            width=self.number(row, "width", f"{path}.width", 0.0) or 0.0,
        )

    def velocity(self, value: object, path: str) -> tuple[float, float, float]:
        if value is None:
            return 0.0, 0.0, 0.0
        components = self.array(value, path, (3,))
        if not np.isfinite(components).all():
            self.fail(path, "must be finite")
        x, y, z = components.tolist()
        return x, y, z

    def segment(self, row: dict[str, Any], path: str) -> Segment:
        kind: Any = self.text(row, "kind", f"{path}.kind")
        if kind not in SEGMENT_KINDS:
            self.fail(f"{path}.kind", f"'{kind}' is not one of {', '.join(SEGMENT_KINDS)}")
        reason: Any = self.text(row, "reason", f"{path}.reason")
        if reason not in WAIT_REASONS:
            reasons = ", ".join(WAIT_REASONS[1:])
            self.fail(f"{path}.reason", f"'{reason}' is not one of {reasons}")
        dwell = row.get("dwell")
        shares = None
        if isinstance(dwell, dict):
            shares = Dwell(
                *(
                    self.number(dwell, name, f"{path}.dwell.{name}", 0.0) or 0.0
                    for name in ("gripper", "settle", "handshake")
                )
            )
        return Segment(
            arm=self.text(row, "arm", f"{path}.arm"),
            kind=kind,
            task=self.text(row, "task", f"{path}.task"),
            action=self.text(row, "action", f"{path}.action"),
            start=self.instant(row, "start", f"{path}.start"),
            end=self.instant(row, "end", f"{path}.end"),
            dwell=shares,
            reason=reason,
        )

    def times(self, row: dict[str, Any], key: str, path: str) -> dict[str, float]:
        times = row.get(key) or {}
        if not isinstance(times, dict):
            self.fail(f"{path}.{key}", "must be an object of times by name")
        return {
            name: self.number(times, name, f"{path}.{key}.{name}", 0.0) or 0.0 for name in times
        }

    def stage(self, row: dict[str, Any], path: str, arms: tuple[str, ...]) -> Stage:
        arm = self.text(row, "arm", f"{path}.arm")
        if arm and arm not in arms:
            self.fail(f"{path}.arm", f"'{arm}' is not one of {', '.join(arms)}")
        return Stage(
            start=self.instant(row, "start", f"{path}.start"),
            end=self.instant(row, "end", f"{path}.end"),
            tasks=tuple(self.names(row, "tasks", f"{path}.tasks")),
            platform_solver=self.text(row, "platform_solver", f"{path}.platform_solver"),
            platform_angle=self.number(row, "platform_angle", f"{path}.platform_angle", None),
            platform_time=self.number(row, "platform_time", f"{path}.platform_time", 0.0) or 0.0,
            arm_times=self.times(row, "arm_times", path),
            joint_times=self.times(row, "joint_times", path),
            bottleneck=self.text(row, "bottleneck", f"{path}.bottleneck"),
            arm=arm,
            saved=self.number(row, "saved", f"{path}.saved", 0.0) or 0.0,
        )
