"""Schedule: the joint motion of a job with everything that happens in it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import field
from functools import cached_property
from typing import Any, Literal

import numpy as np
import pinocchio as pin

from dualarm_cli.errors import MissingDependencyError, UsageError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.blending import BLENDINGS, STOPPING, Blending
from dualarm_cli.model.job import AFTER_DWELL, Dwell, Job
from dualarm_cli.model.joint_motion import JointMotion
from dualarm_cli.model.robot import JointLimits, sliding_joints
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.model.verification import Verification
from dualarm_cli.records import dataclass

DURATION = "duration"
"""What decides a stage whose transfer takes the time that the task file gives it."""
TOOL_SPEED = "tool_speed"
"""What the bottleneck of a transfer is called that was slowed for a cap on the tools' speed."""
SegmentKind = Literal["transfer", "approach", "dwell", "retract", "wait", "return", "path", "seam"]
WORK_ENDS: Mapping[str, str] = {"path": "path", "seam": "seam_end"}
"""Kinds of segments in which a tool works on its way, and the action of the event that each leads to."""
WaitReason = Literal[
    "", "platform", "partner", "shared_zone", "after", "window", "buffer", "conveyor", "end"
]
"""Why an arm waits: for the platform to be there; for the other arm to finish the stage; for it to be out of the way;
for a task that has to be done before; for the time before which a task must not begin; for a part in a buffer or room
in it; for a part that a conveyor brings; because its work is done."""


@dataclass(frozen=True)
class ScheduleArm:
    """What a reader needs to find an arm's tool."""

    flange: str
    """Link of the URDF to which the tool is bolted."""
    tcp: pin.SE3
    """Tool centre point in the flange frame."""
    joints: tuple[str, ...] = ()
    """The arm's own joints, base to flange; empty where the file does not say."""


@dataclass(frozen=True)
class ScheduleRobot:
    """The robot as far as a schedule needs it."""

    name: str
    """What people call it."""
    urdf: str
    """Complete URDF text."""
    base: pin.SE3
    """Pose of the root link in the world."""
    arms: Mapping[str, ScheduleArm]
    """Arms by name."""
    limits: JointLimits
    """Limits that the motion keeps; infinite and `unstated` where the file does not say."""
    platform: tuple[str, ...] = ()
    """Joints that carry both arms."""
    tool_speed: float | None = None
    """Cap on the speed of every tool centre point [m/s], or None."""

    @cached_property
    def sliding(self) -> frozenset[str]:
        """Names of the joints that slide."""
        return sliding_joints(self.urdf)

    @property
    def groups(self) -> dict[str, tuple[str, ...]]:
        """Joints that are timed together, by the name of their group: the platform's, each arm's, and all others'."""
        named = {"platform": self.platform, **{name: arm.joints for name, arm in self.arms.items()}}
        taken: set[str] = set()
        found = {}
        for name, joints in [*named.items(), ("others", self.limits.joints)]:
            if own := tuple(joint for joint in joints if joint not in taken):
                found[name] = own
                taken.update(own)
        return found

    @property
    def platform_slides(self) -> bool:
        """Whether all joints of the platform slide."""
        return bool(self.platform) and self.sliding.issuperset(self.platform)

    @classmethod
    def of_job(cls, job: Job) -> ScheduleRobot:
        """Returns a job's robot with its tools and with limits at the job's speed."""
        robot, cell = job.cell.robot, job.cell
        return cls(
            name=robot.name,
            urdf=robot.urdf,
            base=cell.base,
            arms={
                arm.name: ScheduleArm(arm.flange, cell.tools[arm.name].tcp, arm.joints)
                for arm in robot.arms
            },
            limits=job.limits,
            platform=robot.platform,
            tool_speed=job.tool_speed,
        )


@dataclass(frozen=True)
class Stage:
    """A stretch of the schedule that both arms start together; of asynchronous arms, one arm's stop."""

    start: float
    """When it starts [s]."""
    end: float
    """When the last of its arms is done [s]."""
    tasks: tuple[str, ...]
    """Ids of the tasks worked on, left arm's first; empty for the return to the start."""
    platform_solver: str
    """The method that gave the platform angle."""
    platform_angle: float | None
    """Where the platform stands at the end [rad]; None without a one-joint platform."""
    platform_time: float
    """How long the platform alone would need [s]."""
    arm_times: Mapping[str, float]
    """How long each arm alone would need for its transfer [s]."""
    joint_times: Mapping[str, float]
    """How long each joint alone would need for its transfer [s]."""
    bottleneck: str
    """The joint that decides the transfer's duration, TOOL_SPEED where a cap does, DURATION where the
    task file does; empty where nothing moves."""
    arm: str = ""
    """The arm whose stage it is by its own clock; empty where it is both arms'."""
    saved: float = 0.0
    """How much shorter it is than with stops at the outer ends of lines [s]."""


@dataclass(frozen=True)
class Segment:
    """What one arm does between two instants."""

    arm: str
    """left or right."""
    kind: SegmentKind
    """What it is."""
    task: str
    """Id of the task; empty for a return."""
    action: str
    """What is done at its target, such as pick or place; empty for a return."""
    start: float
    """When it starts [s]."""
    end: float
    """When it ends [s]."""
    dwell: Dwell | None = None
    """The shares of a dwell."""
    reason: WaitReason = ""
    """Why the arm waits; empty where it does not, or where that is not known."""


@dataclass(frozen=True)
class Event:
    """An instant at which a tool is commanded to be somewhere."""

    time: float
    """When [s]; the tool then stands still for `dwell`."""
    arm: str
    """left or right."""
    task: str
    """Id of the task."""
    action: str
    """pick, place, move, take_tool or another one of `Action`."""
    frame: str
    """Name of the frame that is there, such as left_tcp: that of the arm's own tool, whatever tool is on besides."""
    pose: pin.SE3
    """Commanded pose of that frame in the world."""
    dwell: float = 0.0
    """How long it stands there [s]."""
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Of the conveyor that it moves with from `time` on, for `dwell`, in the world [m/s]; zero where it stands."""
    signal: str = ""
    """Name of the signal that is set at `time`; empty for none."""

    @property
    def moves(self) -> bool:
        """Whether the tool is to move with a conveyor instead of standing still."""
        return any(self.velocity)

    @property
    def changes_held(self) -> float:
        """When what its arm holds changes, if it does [s]: at once, or at the end of the dwell."""
        return self.time + (self.dwell if self.action in AFTER_DWELL else 0.0)


@dataclass(frozen=True)
class JointSamples:
    """Joint motion at instants."""

    joints: tuple[str, ...]
    """Names of the n joints, in column order."""
    time: FloatArray
    """Instants [s], shape (k,)."""
    position: FloatArray
    """[rad], or [m] where a joint slides, shape (k, n)."""
    velocity: FloatArray
    """[rad/s or m/s], shape (k, n)."""
    acceleration: FloatArray
    """[rad/s² or m/s²], shape (k, n)."""

    def to_dataframe(self) -> Any:
        """Returns a pandas data frame: by time [s], three columns for each joint, such as `left_s_velocity`.

        Raises:
            MissingDependencyError: pandas is not installed.
        """
        try:
            import pandas
        except ModuleNotFoundError:
            raise MissingDependencyError("pandas", "dataframe") from None
        kinds = ("position", "velocity", "acceleration")
        columns = {
            f"{joint}_{kind}": getattr(self, kind)[:, k]
            for k, joint in enumerate(self.joints)
            for kind in kinds
        }
        return pandas.DataFrame(columns, index=pandas.Index(self.time, name="time"))


@dataclass(frozen=True)
class Provenance:
    """Where a schedule comes from; enough to make it again."""

    version: str
    """Version of dualarm."""
    inputs: Mapping[str, str]
    """SHA-256 of every input, by name."""
    settings: Mapping[str, Any]
    """Everything that was asked for."""
    seed: int
    """Seed of all randomness."""


@dataclass(frozen=True)
class Schedule:
    """The answer: who does what from when to when."""

    robot: ScheduleRobot
    """The robot that plays it."""
    motion: JointMotion
    """The motion of all its moving joints, by groups that are timed together."""
    stages: tuple[Stage, ...]
    """In time order."""
    segments: tuple[Segment, ...]
    """In order of arm and time."""
    events: tuple[Event, ...]
    """In time order."""
    provenance: Provenance
    """Where it comes from."""
    lower_bound: float | None = None
    """A bound on every plan of the same stages [s], or None."""
    grid_gap: float | None = None
    """How far the best plan on the method's grid was from that grid's own bound, as a share, before it was refined."""
    order_grid_gap: float | None = None
    """By what share another order may at most be quicker than this one on the grid of the search for orders, which says
    nothing of their plans; None where the order was given or no bound is known."""
    clearance_cost: float | None = None
    """How much longer it is than the same method's plan where nothing has to be collision-free [s], or None."""
    blend_gain: float | None = None
    """How much shorter it is than the same stages with stops at the outer ends of lines [s]; None where tools stop
    there."""
    verification: Verification | None = None
    """The judgement, once there is one."""
    notes: tuple[str, ...] = ()
    """What a reader should know: choices, assumptions, what was not used."""
    extra: Mapping[str, Any] = field(default_factory=dict)
    """What a file states and the data model derives itself: `duration` and `files`, kept to be checked."""

    @property
    def trajectory(self) -> Trajectory:
        """The motion of all joints together, with the knots of all groups."""
        return self.motion.trajectory

    def sample(self, rate: float) -> JointSamples:
        """Returns the motion of all joints at equal steps from the start, and at its end.

        Args:
            rate: samples per second [Hz].

        Raises:
            UsageError: a rate that is not above 0, or not finite.
        """
        if not 0.0 < rate < math.inf:
            raise UsageError(f"rate {rate:g}: must be above 0 Hz")
        time = np.arange(math.ceil(self.duration * rate)) / rate
        time = np.append(time[time < self.duration], self.duration)
        motion = self.trajectory
        return JointSamples(motion.joints, time, *motion.at(time + motion.time[0]))

    def joint(self, name: str) -> JointSamples:
        """Returns one joint's motion at its knots, between which its jerk is constant; its arrays have one column.

        Args:
            name: of the joint, such as `left_s`.

        Raises:
            UsageError: there is no such joint.
        """
        if name not in self.trajectory.joints:
            known = ", ".join(self.trajectory.joints)
            raise UsageError(f"joint {name!r}: {self.robot.name} has {known}")
        own = self.trajectory.select([name])
        return JointSamples((name,), own.time, own.position, own.velocity, own.acceleration)

    def to_dataframe(self, rate: float = 250.0) -> Any:
        """Returns samples of all joints as a pandas data frame; see `sample` and `JointSamples.to_dataframe`."""
        return self.sample(rate).to_dataframe()

    @property
    def blending(self) -> Blending:
        """Law of where tools were allowed to pass in motion.

        Raises:
            UsageError: the schedule names a law that there is not.
        """
        name = str(self.provenance.settings.get("blend", STOPPING.name))
        if name not in BLENDINGS.names:
            known = ", ".join(BLENDINGS.names)
            raise UsageError(
                f"settings.blend {name!r} of the schedule: known are {known}; plan again"
            )
        return BLENDINGS[name]

    @property
    def duration(self) -> float:
        """Length of the motion [s]; the period where it closes."""
        return self.trajectory.duration
