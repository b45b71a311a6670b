"""Schedule: joint motion of a job with its stages, segments and events."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import field
from functools import cached_property, lru_cache
from importlib import import_module
from typing import Any, Literal, SupportsFloat

import numpy as np
import pinocchio as pin

from dualarm_cli.errors import MissingDependencyError, UsageError, check_type
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.products import product
from dualarm_cli.model.blending import BLENDINGS, STOPPING, Blending
from dualarm_cli.model.dwell import Dwell
from dualarm_cli.model.job import AFTER_DWELL, Job
from dualarm_cli.model.motion.joint_motion import JointMotion
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.robot import JointLimits, sliding_joints
from dualarm_cli.model.verification import Verification
from dualarm_cli.records import ShownInNotebooks, dataclass

DURATION = "duration"
"""Bottleneck of a stage whose duration the task file gives."""
TOOL_SPEED = "tool_speed"
"""Bottleneck of a transfer that was slowed for the limit of tool speed."""
SegmentKind = Literal["transfer", "approach", "dwell", "retract", "wait", "return", "path", "seam"]
MAX_SAMPLES = 250_000
"""Maximum number of samples of a motion: a gigabyte of memory for fifteen joints."""
WORK_ENDS: Mapping[str, str] = {"path": "path", "seam": "seam_end"}
"""Kinds of segments in which a moving tool works, and the final event's action."""
WaitReason = Literal[
    "", "platform", "partner", "shared_zone", "after", "window", "buffer", "conveyor", "end"
]
"""Reason of a wait; the glossary explains each."""


@dataclass(frozen=True)
class ScheduleArm:
    """Flange, tool and joints of an arm."""

    flange: str
    """Link of the URDF that carries the tool."""
    tcp: pin.SE3
    """Tool centre point in the flange frame."""
    joints: tuple[str, ...] = ()
    """Joints of the arm, base to flange; empty if the file omits them."""


@dataclass(frozen=True)
class ScheduleRobot:
    """Robot of a schedule."""

    name: str
    """Name for users."""
    urdf: str
    """Complete URDF text."""
    base: pin.SE3
    """Pose of the root link in the world."""
    arms: Mapping[str, ScheduleArm]
    """Arms by name."""
    limits: JointLimits
    """Limits that the motion keeps; infinite and `unstated` if the file omits them."""
    platform: tuple[str, ...] = ()
    """Joints that carry both arms."""
    tool_speed: float | None = None
    """Limit of the speed of every tool centre point [m/s], or None."""

    @cached_property
    def sliding(self) -> frozenset[str]:
        """Names of the prismatic joints."""
        return sliding_joints(self.urdf)

    @property
    def groups(self) -> dict[str, tuple[str, ...]]:
        """Joints that are timed together: platform, each arm, and all others."""
        named = {"platform": self.platform, **{name: arm.joints for name, arm in self.arms.items()}}
        taken: set[str] = set()
        groups = {}
        for name, joints in [*named.items(), ("others", self.limits.joints)]:
            if remaining := tuple(joint for joint in joints if joint not in taken):
                groups[name] = remaining
                taken.update(remaining)
        return groups

    @property
    def platform_slides(self) -> bool:
        """Whether all joints of the platform slide."""
        return bool(self.platform) and self.sliding.issuperset(self.platform)

    def __repr__(self) -> str:
        """Describe the robot in a line."""
        arms = ", ".join(self.arms)
        return f"<ScheduleRobot {self.name}: {len(self.limits.joints)} joints, arms {arms}>"

    @classmethod
    def of_job(cls, job: Job) -> ScheduleRobot:
        """Build a job's robot with its tools and the limits at the job's speed."""
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
    """Period that both arms start together; of asynchronous arms, one arm's stop."""

    start: float
    """Start time [s]."""
    end: float
    """End time of the last arm [s]."""
    tasks: tuple[str, ...]
    """Ids of its tasks, left arm's first; empty for the return."""
    platform_solver: str
    """Method that chose the platform angle."""
    platform_angle: float | None
    """Platform angle at the end [rad]; None without a one-joint platform."""
    platform_time: float
    """Minimum time of the platform alone [s]."""
    arm_times: Mapping[str, float]
    """Minimum transfer time of each arm alone [s]."""
    joint_times: Mapping[str, float]
    """Minimum transfer time of each joint alone [s]."""
    bottleneck: str
    """Joint that decides the transfer's duration, TOOL_SPEED or DURATION.

    Empty if nothing moves.
    """
    arm: str = ""
    """Arm of an asynchronous stage; empty for both arms."""
    saved: float = 0.0
    """Time gained by blending [s], compared with stops at the outer ends of lines."""


@dataclass(frozen=True)
class Segment:
    """Activity of one arm between two times."""

    arm: str
    """Arm: left or right."""
    kind: SegmentKind
    """Kind of activity."""
    task: str
    """Id of the task; empty for a return."""
    action: str
    """Action at its target, such as pick or place; empty for a return."""
    start: float
    """Start time [s]."""
    end: float
    """End time [s]."""
    dwell: Dwell | None = None
    """Times of a dwell by purpose."""
    reason: WaitReason = ""
    """Reason of a wait; empty for other kinds, or if unknown."""


@dataclass(frozen=True)
class Event:
    """Time at which a tool is commanded to be at a pose."""

    time: float
    """Time [s]; the tool then stands still for `dwell`."""
    arm: str
    """Arm: left or right."""
    task: str
    """Id of the task."""
    action: str
    """Action, such as pick, place, move or take_tool."""
    frame: str
    """Name of the frame, such as left_tcp: always the arm's fixed tool."""
    pose: pin.SE3
    """Commanded pose of that frame in the world."""
    dwell: float = 0.0
    """Time at rest at the pose [s]."""
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Velocity of the conveyor from `time` on, for `dwell`, in the world [m/s].

    Zero for a target that stands still.
    """
    signal: str = ""
    """Signal that is set at `time`; empty for none."""
    grasp: str = ""
    """Grasp of the part; empty for a part without grasps."""
    width: float = 0.0
    """Distance of the tool's jaws on the part [m]; 0 if unknown."""

    @property
    def moves(self) -> bool:
        """Whether the tool moves with a conveyor instead of standing still."""
        return any(self.velocity)

    @property
    def changes_held(self) -> float:
        """Time at which the held object changes, if it does [s].

        This is the event or the end of the dwell.
        """
        return self.time + (self.dwell if self.action in AFTER_DWELL else 0.0)

    def __repr__(self) -> str:
        """Describe the event in a line."""
        return f"<Event at {self.time:.3f} s: {self.arm} {self.action} {self.task}>"


@dataclass(frozen=True)
class JointSamples:
    """Samples of the joint motion."""

    joints: tuple[str, ...]
    """Names of the n joints, in column order."""
    time: FloatArray
    """Sample times [s], shape (k,)."""
    position: FloatArray
    """Positions [rad], or [m] of prismatic joints, shape (k, n)."""
    velocity: FloatArray
    """Velocities [rad/s or m/s], shape (k, n)."""
    acceleration: FloatArray
    """Accelerations [rad/s² or m/s²], shape (k, n)."""

    def __repr__(self) -> str:
        """Describe the samples in a line."""
        rows, columns = self.position.shape
        return f"<JointSamples: {columns} joints at {rows} times up to {self.time[-1]:.3f} s>"

    def to_dataframe(self) -> Any:
        """Convert to a pandas data frame by time [s], three columns for each joint.

        Columns have names such as `left_s_velocity`.

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


def too_many_samples(duration: float, rate: float) -> str | None:
    """Explain why a motion [s] has too many samples at a rate [Hz].

    Returns None if it has not.
    """
    if duration * rate <= MAX_SAMPLES:
        return None
    # Rounded down: the rate that is named is allowed.
    allowed = math.floor(1e3 * MAX_SAMPLES / duration) / 1e3
    return (
        f"{duration:,.0f} s at a rate of {rate:g} Hz have {duration * rate:,.0f} samples; "
        f"at most {MAX_SAMPLES:,} are allowed: ask for at most {allowed:.10g} Hz"
    )


@lru_cache(maxsize=8)
def _pinocchio_model(urdf: str) -> pin.Model:
    """Build the pinocchio model of a URDF."""
    return pin.buildModelFromXML(urdf)


@dataclass(frozen=True)
class Provenance:
    """Origin of a schedule; enough to reproduce it."""

    version: str
    """Version of dualarm."""
    inputs: Mapping[str, str]
    """SHA-256 of every input, by name."""
    settings: Mapping[str, Any]
    """All requested settings."""
    seed: int
    """Random seed."""


@dataclass(frozen=True, eq=False)
class Schedule(ShownInNotebooks):
    """Plan of a job: motion, stages, segments and events. It equals only itself."""

    robot: ScheduleRobot
    """Robot that executes it."""
    motion: JointMotion
    """Motion of all joints, by groups that are timed together."""
    stages: tuple[Stage, ...]
    """Stages in time order."""
    segments: tuple[Segment, ...]
    """Segments by arm and time."""
    events: tuple[Event, ...]
    """Events in time order."""
    provenance: Provenance
    """Inputs, settings and version that produced it."""
    lower_bound: float | None = None
    """Lower bound of every plan of the same stages [s], or None."""
    grid_gap: float | None = None
    """Grid gap: relative excess over the grid's own bound, before refinement; or None."""
    order_grid_gap: float | None = None
    """Bound of the relative gain by another order, on the search grid.

    It does not bound their plans. None if the order was given or no bound is known.
    """
    clearance_cost: float | None = None
    """Additional time for collision avoidance [s], or None.

    Compared with the same method's plan without collision checking.
    """
    blend_gain: float | None = None
    """Time gained by blending [s]; None if tools stop at the outer ends of lines."""
    verification: Verification | None = None
    """Result of the verification, or None."""
    notes: tuple[str, ...] = ()
    """Remarks for users: choices, assumptions, unused input."""
    extra: Mapping[str, Any] = field(default_factory=dict)
    """Redundant values of a file that are checked: `duration` and `files`."""

    @property
    def trajectory(self) -> Trajectory:
        """Motion of all joints, with the knots of all groups."""
        return self.motion.trajectory

    def sample(self, rate: float) -> JointSamples:
        """Sample the motion of all joints at equal steps, and at its end.

        Args:
            rate: samples per second [Hz].

        Raises:
            UsageError: a rate that is not above 0, not finite, or above the limit that an export has too.
        """
        check_type("rate", rate, SupportsFloat)
        if not 0.0 < rate < math.inf:
            raise UsageError(f"rate {rate:g}: must be above 0 Hz")
        if reason := too_many_samples(self.duration, rate):
            raise UsageError(reason)
        time = np.arange(math.ceil(self.duration * rate)) / rate
        time = np.append(time[time < self.duration], self.duration)
        motion = self.trajectory
        return JointSamples(motion.joints, time, *motion.at(time + motion.time[0]))

    def joint(self, name: str) -> JointSamples:
        """Select one joint's motion at its knots; arrays have one column.

        The jerk is constant between knots.

        Args:
            name: of the joint, such as `left_s`.

        Raises:
            UsageError: unknown joint.
        """
        if name not in self.trajectory.joints:
            names = ", ".join(self.trajectory.joints)
            raise UsageError(f"joint {name!r}: {self.robot.name} has {names}")
        motion = self.trajectory.select([name])
        return JointSamples(
            (name,), motion.time, motion.position, motion.velocity, motion.acceleration
        )

    def tool_pose(self, arm: str, time: float) -> pin.SE3:
        """Compute the pose of an arm's tool centre point in the world.

        Args:
            arm: left or right; the point is that of the arm's fixed tool.
            time: from 0 to the duration [s].

        Raises:
            UsageError: unknown arm, several times, or a time outside the motion.
        """
        return self._tool(arm, time)[0]

    def jacobian(self, arm: str, time: float) -> FloatArray:
        """Compute the Jacobian of an arm's tool in the world, shape (6, n).

        It maps velocities of all n joints, in the order of `trajectory.joints`, to the linear velocity [m/s] of the
        point and the angular velocity [rad/s] of the tool. Arguments and errors are those of `tool_pose`.
        """
        return self._tool(arm, time)[1]

    def _tool(self, arm: str, time: float) -> tuple[pin.SE3, FloatArray]:
        """Compute the pose and the Jacobian of a tool; see `tool_pose` and `jacobian`."""
        if arm not in self.robot.arms:
            raise UsageError(f"arm {arm!r}: {self.robot.name} has {', '.join(self.robot.arms)}")
        if np.ndim(time) > 0:
            raise UsageError(f"time of shape {np.shape(time)}: must be one time [s]")
        check_type("time", time, SupportsFloat)
        model, motion, part = (
            _pinocchio_model(self.robot.urdf),
            self.trajectory,
            self.robot.arms[arm],
        )
        order = [motion.joints.index(name) for name in model.names[1:]]
        position = motion.at(time + motion.time[0])[0]
        data, frame = model.createData(), model.getFrameId(part.flange, pin.FrameType.BODY)
        pin.forwardKinematics(model, data, position[order])
        in_flange = pin.computeFrameJacobian(model, data, position[order], frame, pin.LOCAL)
        # The model's data hold the frame, which later calculations overwrite.
        pose = self.robot.base * pin.updateFramePlacement(model, data, frame) * part.tcp
        turned = pin.SE3(pose.rotation, np.zeros(3)) * part.tcp.inverse()
        jacobian = np.empty((6, len(order)))
        jacobian[:, order] = product(turned.action, in_flange)
        return pose, jacobian

    def plot(
        self,
        quantity: Literal["position", "velocity", "acceleration"] = "velocity",
        joints: str | Sequence[str] | None = None,
        axes: Any = None,
    ) -> Any:
        """Draw a quantity of joints over time with matplotlib; returns the axes.

        Args:
            quantity: position, velocity or acceleration.
            joints: names of joints, or of one; None for all.
            axes: matplotlib axes to draw into; None for a new figure.

        Raises:
            MissingDependencyError: matplotlib is not installed.
            UsageError: unknown quantity or joint, or no joint.
        """
        # Figures are a layer above: they are imported when one is drawn.
        figures: Any = import_module("dualarm_cli.report.figures.motion_figure")
        return figures.plot_motion(self, quantity, joints, axes)

    def __repr__(self) -> str:
        """Describe the schedule in a line."""
        verdict = "not verified" if self.verification is None else self.verification.verdict
        stages = f"{len(self.stages)} stages"
        return f"<Schedule of {self.robot.name}: {self.duration:.3f} s, {stages}, {verdict}>"

    def to_dataframe(self, rate: float = 250.0) -> Any:
        """Sample all joints into a pandas data frame; see `sample` and `JointSamples.to_dataframe`."""
        return self.sample(rate).to_dataframe()

    @property
    def blending(self) -> Blending:
        """Blending law of the schedule.

        Raises:
            UsageError: the schedule names an unknown law.
        """
        name = str(self.provenance.settings.get("blend", STOPPING.name))
        if name not in BLENDINGS.names:
            names = ", ".join(BLENDINGS.names)
            raise UsageError(
                f"settings.blend {name!r} of the schedule: known are {names}; plan again"
            )
        return BLENDINGS[name]

    @property
    def duration(self) -> float:
        """Duration of the motion [s]; the period if it closes."""
        return self.trajectory.duration
