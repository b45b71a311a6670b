"""Paths of task files: curves of one tool or both, speeds and methods."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from dualarm_cli.files.source import quantities
from dualarm_cli.files.source.fields import (
    Angle,
    Distance,
    Length,
    Name,
    Quantity,
    Section,
    SmallSize,
    ToolSpeed,
    Vector3,
    WithinReach,
    refuse,
)
from dualarm_cli.files.source.quantities import Dimension
from dualarm_cli.files.source.yaml_source import Loc
from dualarm_cli.files.tasks.schema_curves import CurveSection, PathAcceleration
from dualarm_cli.files.tasks.schema_tasks import TaskHead, TaskSection
from dualarm_cli.files.tasks.task_reader import KindReading, TaskReader
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.elementary import cos, sin
from dualarm_cli.model.dwell import Dwell
from dualarm_cli.model.job import PoseTarget, Stop, Task
from dualarm_cli.model.process_work import PathWork

PathJerk = Annotated[float, Quantity(quantities.JERK, 1e-6)]
Stiffness = Annotated[float, Quantity(Dimension("stiffness", {"": 1.0}, 1e3), 0.0)]


class CriticalPoint(Section):
    """Target of an elbow's virtual spring, carried by the platform or waist.

    It is a point, or a place on a circle.
    """

    xyz: Vector3 | None = Field(default=None, description="The point [m].")
    radius: Distance | None = Field(default=None, description="Radius of the circle [m].")
    height: Length | None = Field(
        default=None, description="Height of the circle above the last platform joint [m]."
    )
    angle: Angle | None = Field(
        default=None, description="Angle on the circle, from x towards y [rad]."
    )

    @model_validator(mode="after")
    def _check_exactly_one(self) -> CriticalPoint:
        circle = [getattr(self, key) for key in ("radius", "height", "angle")]
        if self.xyz is not None and any(value is not None for value in circle):
            raise refuse("a critical point is given by xyz, or by radius, height and angle", "xyz")
        if self.xyz is None and any(value is None for value in circle):
            raise refuse("a critical point needs xyz, or radius, height and angle")
        return self


class CriticalPoints(Section):
    """The critical point of each arm."""

    left: CriticalPoint | None = Field(default=None, description="Of the left elbow.")
    right: CriticalPoint | None = Field(default=None, description="Of the right elbow.")


class PathSection(CurveSection):
    """Curves of tools, their speed, and the method that finds the joints.

    The curves are those of a single tool or of both.
    """

    arm: Literal["left", "right"] | None = Field(default=None, description="The arm that follows.")
    left: CurveSection | None = Field(
        default=None, description="Path of the left tool, where both follow together."
    )
    right: CurveSection | None = Field(
        default=None, description="Path of the right tool, where both follow together."
    )
    in_: Name | None = Field(
        default=None, alias="in", description="Named frame of all poses that name none."
    )
    speed: ToolSpeed = Field(
        description="Speed of the tool with the longer path [m/s]; a turn by 1 rad counts as 0.1 m at least. "
        "The tool stops at corners, without `blend`."
    )
    blend: WithinReach | None = Field(
        default=None,
        description="How far the tool may leave the corner of two straight pieces, so that it need not stop there [m]. "
        "A curve takes at most half of each piece. Not for both tools. Default: `blend` of the defaults, else stops.",
    )
    acceleration: PathAcceleration | None = Field(
        default=None, description="Acceleration along the path [m/s²]; default: speed / 0.2 s."
    )
    jerk: PathJerk | None = Field(
        default=None, description="Jerk along the path [m/s³]; default: reached in 0.1 s."
    )
    slower: Literal["allowed", "forbidden"] = Field(
        default="forbidden",
        description="Whether the speed may be reduced where the joints' limits need it.",
    )
    tolerance: SmallSize = Field(
        default=1e-4, description="How far the tools may leave the path [m]."
    )
    redundancy: Name | None = Field(default=None, description="Method that finds the joints.")
    posture: Name | None = Field(
        default=None,
        description="Posture near which the path begins; default: the planner's choice.",
    )
    critical_points: CriticalPoints = Field(
        default=CriticalPoints.model_construct(),
        description="Where virtual springs pull the elbows.",
    )
    stiffness: Stiffness = Field(default=10.0, description="Of the virtual springs.")
    torque: Literal["limited", "ignored"] = Field(
        default="ignored", description="Whether torques are kept within the URDF's limits."
    )

    @property
    def both(self) -> bool:
        """Whether both tools follow."""
        return self.left is not None or self.right is not None

    @model_validator(mode="after")
    def _one_or_both(self) -> PathSection:
        has_curve = self.through is not None or self.poses is not None
        if self.both:
            for key in ("left", "right"):
                curve = getattr(self, key)
                if curve is None:
                    raise refuse(
                        f"'{key}' is missing: where both follow, both need a path", code="E202"
                    )
                if curve.through is None and curve.poses is None:
                    raise refuse("no path; give 'through' or 'poses'", key)
            for key in ("through", "poses", "arm"):
                if getattr(self, key) is not None:
                    raise refuse(f"'{key}' does not go with 'left' and 'right'", key)
        elif not has_curve:
            raise refuse("no path; give 'through' or 'poses', or 'left' and 'right' for both arms")
        return self


class PathTask(TaskHead):
    """A task that may follow a path."""

    path: PathSection | None = Field(
        default=None, description="A path that one tool or both follow at a speed."
    )

    @model_validator(mode="after")
    def _follower(self) -> PathTask:
        if self.path is not None and not (self.arm or self.path.arm or self.path.both):
            raise refuse("'arm' is missing", code="E202")
        return self


def followers(reader: TaskReader, section: TaskSection, loc: Loc) -> list[Task]:
    """Create each arm's task of a path.

    The tool's last pose is its only stop.

    Args:
        reader: of the file.
        section: the task as the file has it.
        loc: its location in the file.
    """
    assert isinstance(section, PathTask) and section.path is not None  # selected by its key
    path, place = section.path, (*loc, "path")
    wrong = _wrong_arms(reader.arms, path, section.arm)
    if section.arm == "any":
        return []
    if wrong:
        reader.note(place, wrong)
        return []
    for key in ("approach", "retract", "dwell", "part"):
        if getattr(section, key) is not None:
            reader.note((*loc, key), f"'{key}' does not go with a path; remove it")
    work = _work(reader, path, place, section.arm or path.arm)
    if work is None:
        return []
    tasks = []
    for arm, curve in work.paths.items():
        end = PoseTarget(curve.pose(curve.length))
        stop = Stop("path", end, 0.0, 0.0, Dwell(), work.place)
        tasks.append(Task(section.id, arm, (stop,), tuple(section.after), path=work))
    return tasks


def _work(reader: TaskReader, section: PathSection, loc: Loc, arm: str | None) -> PathWork | None:
    """Create the path of a section, or report what is wrong and return None."""
    if reader.curves.frame(section.in_, (*loc, "in")) is None:
        return None
    curves: dict[str, tuple[CurveSection, Loc]] = {}
    if section.both:
        for name in ("left", "right"):
            curves[name] = (getattr(section, name), (*loc, name))
    elif arm is not None:
        curves[arm] = (section, loc)
    paths = {
        name: reader.curves.read(curve, place, section.in_)
        for name, (curve, place) in curves.items()
    }
    valid_paths = {name: path for name, path in paths.items() if path is not None}
    reader.check_posture(section.posture, (*loc, "posture"))
    if len(valid_paths) < len(paths):
        return None
    points = {
        name: _critical_point(point)
        for name in valid_paths
        if (point := getattr(section.critical_points, name)) is not None
    }
    blend = reader.defaults.blend if section.blend is None else section.blend
    if section.both:
        # Rounding would move corners to other fractions of the paths: the tools would lose synchrony.
        if section.blend is not None:
            reader.note(
                (*loc, "blend"),
                "'blend' goes with paths of one tool; remove it, or give both tools curves without corners",
            )
        blend = None
    return PathWork(
        paths=valid_paths,
        speed=section.speed,
        acceleration=section.acceleration,
        jerk=section.jerk,
        redundancy=section.redundancy,
        posture=section.posture,
        slower=section.slower == "allowed",
        tolerance=section.tolerance,
        critical_points=points,
        stiffness=section.stiffness,
        torque=section.torque == "limited",
        blend=blend or 0.0,
        place=reader.place(loc),
    )


def _critical_point(section: CriticalPoint) -> FloatArray:
    if section.xyz is not None:
        return np.array(section.xyz)
    radius, angle, height = section.radius or 0.0, section.angle or 0.0, section.height or 0.0
    return np.array([radius * cos(angle), radius * sin(angle), height])


def _wrong_arms(arms: Sequence[str], section: PathSection, task_arm: str | None) -> str:
    """Describe the error in the arms of a path and its task, if any."""
    if section.both:
        if task_arm is not None:
            return "'arm' does not go with 'left' and 'right' of the path"
        missing = [name for name in ("left", "right") if name not in arms]
        return f"the robot has no {missing[0]} arm" if missing else ""
    if section.arm is not None and task_arm is not None and section.arm != task_arm:
        return f"the task's arm is {task_arm}, its path's is {section.arm}; keep one"
    arm = section.arm or task_arm
    if arm not in arms:
        return f"the robot has no {arm} arm; it has {', '.join(arms)}"
    return ""


READING = KindReading(key="path", plural="paths", task_keys=PathTask, shares=followers)
