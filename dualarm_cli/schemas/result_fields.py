# ruff: noqa: E501 (tables, one row a line)
# fmt: off
"""Members of `schedule.json`, and the tables of both result files: unit and meaning.

A test compares both tables with files of real plans.

`<name>` stands for a name that is a key, `[]` for each entry of a list.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Annotated, Any, TypedDict, get_args, get_origin, get_type_hints, is_typeddict

from dualarm_cli.report.comparisons import (
    PerturbationReport,
    ReachReport,
    ScheduleComparison,
    SolverComparison,
    StudyReport,
    WhyReport,
)
from dualarm_cli.report.document import (
    ArmName,
    ClearanceCost,
    DwellRow,
    GridGap,
    JointName,
    LowerBound,
    Name,
    OrderGridGap,
    Report,
    SettingsRow,
    StageRow,
    VerificationRow,
)

GroupName = Annotated[str, "group"]


class SchedulePose(TypedDict):
    """Pose of a frame."""

    xyz: Annotated[tuple[float, float, float], "m", "Position of the URDF's root link in the world."]
    quat_xyzw: Annotated[tuple[float, float, float, float], "", "Its rotation."]


class ArmMembers(TypedDict):
    """Arm of the robot."""

    flange: Annotated[str, "", "Link to which the tool is bolted."]
    tcp: ScheduleTcp
    joints: Annotated[list[str], "", "Joints of the arm, base to flange."]


class ScheduleTcp(TypedDict):
    """Tool centre point."""

    xyz: Annotated[tuple[float, float, float], "m", "Tool centre point in the flange frame."]
    quat_xyzw: Annotated[tuple[float, float, float, float], "", "Its rotation."]


class ScheduleLimits(TypedDict):
    """Limits of a joint."""

    lower: Annotated[float | None, "rad", "Lowest position (m for a joint that slides, here and below)."]
    upper: Annotated[float | None, "rad", "Highest position."]
    velocity: Annotated[float, "rad/s", "Largest speed, at the job's `speed`."]
    acceleration: Annotated[float, "rad/s²", "Largest acceleration."]
    jerk: Annotated[float | None, "rad/s³", "Largest jerk; none where it is not limited."]
    source: Annotated[str, "", "Where acceleration and jerk come from: datasheet, measured, urdf, joint_limits or assumed; `urdf, jerk assumed` where they differ."]


class RobotMembers(TypedDict):
    """Robot of the schedule."""

    name: Annotated[str, "", "Name of the robot."]
    urdf: Annotated[str, "", "Name of the URDF file in the schedule's folder."]
    joints: Annotated[list[str], "", "Moving joints, in the order of the robot's columns."]
    groups: dict[GroupName, Annotated[list[str], "", "Joints that are timed together, in the order of the columns of `motion.<group>`: the platform's, each arm's, and `others`. Every moving joint is in one group."]]
    base: SchedulePose
    platform: Annotated[list[str], "", "Joints that carry both arms."]
    arms: dict[ArmName, ArmMembers]
    limits: dict[JointName, ScheduleLimits]
    tool_speed: Annotated[float | None, "m/s", "Cap on the speed of every tool centre point, or none."]


class ScheduleStage(StageRow):
    """Stage of the schedule."""

    arm: Annotated[str, "", "The arm whose stage it is with `mode: free`; empty where it is both arms'."]


class ScheduleSegment(TypedDict):
    """Segment of an arm."""

    arm: Annotated[str, "", "left or right."]
    kind: Annotated[str, "", "transfer, approach, dwell, retract, wait, return, path or seam."]
    task: Annotated[str, "", "Task; empty for a return."]
    action: Annotated[str, "", "What is done at the target, such as pick or place."]
    start: Annotated[float, "s", "Start."]
    end: Annotated[float, "s", "End."]
    dwell: DwellRow
    reason: Annotated[str, "", "Why the arm waits; only for waits."]


class ScheduleEvent(TypedDict):
    """Event of a tool."""

    time: Annotated[float, "s", "When a tool is commanded to be somewhere."]
    arm: Annotated[str, "", "left or right."]
    task: Annotated[str, "", "Task."]
    action: Annotated[str, "", "pick, place, move, give, take, take_tool, leave_tool, or the begin and end of a path or seam."]
    frame: Annotated[str, "", "Frame that is there, such as left_tcp."]
    xyz: Annotated[tuple[float, float, float], "m", "Commanded position of that frame in the world."]
    quat_xyzw: Annotated[tuple[float, float, float, float], "", "Commanded rotation."]
    dwell: Annotated[float, "s", "How long the tool stands there."]
    velocity: Annotated[tuple[float, float, float], "m/s", "Velocity of the conveyor that the tool moves with during the dwell; absent where it stands."]
    signal: Annotated[str, "", "Name of the signal that is set then; absent where there is none."]
    grasp: Annotated[str, "", "Name of the grasp of the part; absent for a part without grasps."]
    width: Annotated[float, "m", "Distance of the tool's jaws on the part: they close to it, or open from it; absent if unknown."]


class ScheduleMotion(TypedDict):
    """Motion of a group of joints."""

    time: Annotated[list[float], "s", "Knots of the group, shape (k,)."]
    acceleration: Annotated[list[list[float]], "rad/s²", "Accelerations at the knots, shape (k, joints); they change linearly between them."]
    anchor: Annotated[list[int], "", "Knots, counted from 0, at which position and velocity are stated, shape (m,); the first one always is."]
    position: Annotated[list[list[float]], "rad", "Positions at the anchors, shape (m, joints) (m for joints that slide, here and above)."]
    velocity: Annotated[list[list[float]], "rad/s", "Velocities at the anchors."]


class ScheduleProvenance(TypedDict):
    """Origin of the schedule."""

    version: Annotated[str, "", "Version of dualarm."]
    inputs: dict[Name, Annotated[str, "", "SHA-256 of each input file."]]
    settings: SettingsRow
    seed: Annotated[int, "", "Seed of all randomness."]


class ScheduleFile(TypedDict):
    """Members of `schedule.json`."""

    format: Annotated[str, "", "`dualarm.schedule/2`."]
    robot: RobotMembers
    duration: Annotated[float, "s", "Length of the motion: the period where it returns to the start."]
    lower_bound: LowerBound
    grid_gap: GridGap
    order_grid_gap: OrderGridGap
    clearance_cost: ClearanceCost
    blend_gain: Annotated[float | None, "s", "How much shorter the plan is than the same stages with stops at the outer ends of lines; none where tools stop there."]
    stages: list[ScheduleStage]
    segments: list[ScheduleSegment]
    events: list[ScheduleEvent]
    motion: dict[GroupName, ScheduleMotion]
    provenance: ScheduleProvenance
    notes: Annotated[list[str], "", "Choices and assumptions that a reader should know."]
    files: dict[Name, Annotated[str, "", "SHA-256 of each file of the set."]]
    verification: VerificationRow | None


def member_rows(kind: Any, path: str) -> Iterator[tuple[str, tuple[str, str]]]:
    """Yield the path, unit and meaning of each member below a type."""
    hints = get_type_hints(kind, include_extras=True) if is_typeddict(kind) else {}
    for name, inner in hints.items():
        yield from member_rows(inner, f"{path}.{name}" if path else name)
    outer, inner = get_origin(kind), get_args(kind)
    if outer is Annotated:
        yield path, (inner[1], inner[2])
    elif outer is dict:
        yield from member_rows(inner[1], f"{path}.<{get_args(inner[0])[1]}>")
    elif outer is list:
        yield from member_rows(inner[0], f"{path}[]")
    else:
        for part in inner:
            yield from member_rows(part, path)


SCHEDULE = dict(member_rows(ScheduleFile, ""))
"""Unit and meaning of the members of `schedule.json`."""
REPORT = dict(member_rows(Report, ""))
"""Unit and meaning of the members of `report.json`."""
RESULTS: Mapping[str, tuple[str, type]] = {
    "schedule": ("What a plan writes to schedule.json.", ScheduleFile),
    "report": ("What a plan writes to report.json.", Report),
    "schedule-comparison": ("What `dualarm compare schedules --json` prints.", ScheduleComparison),
    "comparison": ("What `dualarm compare solvers --json` prints.", SolverComparison),
    "reach": ("What `dualarm robot reach --json` prints.", ReachReport),
    "sweep": ("What `dualarm sweep --json` prints.", StudyReport),
    "perturbation": ("What `dualarm sweep --perturb --json` prints.", PerturbationReport),
    "why": ("What `dualarm why --json` prints.", WhyReport),
}
"""Description and members of each kind of result."""
