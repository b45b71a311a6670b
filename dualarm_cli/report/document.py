# ruff: noqa: E501 (tables, one row a line)
# fmt: off
"""Members of `report.json`: type, unit and meaning, for type checkers, the JSON Schema and the reference.

`Annotated` holds unit and meaning. Keys that are names have a type that names them.
"""

from __future__ import annotations

from typing import Annotated, TypedDict

from dualarm_cli.model.budget import CycleKind
from dualarm_cli.model.verification import Verdict

ArmName = Annotated[str, "arm"]
JointName = Annotated[str, "joint"]
Name = Annotated[str, "name"]
LowerBound = Annotated[float | None, "s", "No plan is shorter (with `blend` none: none that is at rest after every transfer and line): of the same stages where the file gives the order, of all orders where the planner chose it; the conditions are in `notes`. None if no bound was computed."]
GridGap = Annotated[float | None, "", "How far the best plan of the search's grid was above that grid's own bound, before it was refined."]
OrderGridGap = Annotated[float | None, "", "By what share another order may be quicker on the grid of the search for orders, which proves nothing of plans; none for a given order."]
ClearanceCost = Annotated[float | None, "s", "How much longer the plan is than the same method's plan without collision checking, both with all stops."]


class ReportBodies(TypedDict):
    """Bodies with and without shapes."""

    text: Annotated[str, "", "Which bodies have shapes, and which have none, in a sentence."]
    checked: Annotated[list[str], "", "Links, tools, parts and obstacles that have shapes."]
    without_shape: Annotated[list[str], "", "Moving links and tools without shapes."]
    without_part: Annotated[list[str], "", "Tasks that carry something without a shape: they name no `part`."]


class ReportClearance(TypedDict):
    """Least clearance of a stage."""

    stage: Annotated[int, "", "Stage, counted from 0."]
    clearance: Annotated[float, "m", "Least distance of the two bodies, proven over the whole stage."]
    margin: Annotated[float, "m", "That less what is required; no pair has less."]
    required: Annotated[float, "m", "What is required of the pair."]
    bodies: Annotated[tuple[str, str], "", "The two bodies."]
    time: Annotated[float, "s", "When."]
    near: Annotated[bool, "", "Whether both are links of the robot with at most three joints between them."]


class ReportCorner(TypedDict):
    """Point that a tool passes in motion."""

    arm: Annotated[str, "", "Arm whose tool passes the outer end of a line, or the target of a move, in motion."]
    task: Annotated[str, "", "Task."]
    action: Annotated[str, "", "What is done at the target, such as pick or place."]
    line: Annotated[str, "", "approach or retract; empty for the target of a move."]
    time: Annotated[float, "s", "When the tool is there."]
    speed: Annotated[float, "m/s", "How fast it is there."]
    joint: Annotated[str, "", "The joint that is nearest to one of its limits in the adjacent transfer."]
    limit: Annotated[str, "", "Which limit that is: velocity, acceleration or jerk."]
    beside: Annotated[float, "m", "How far the tool gets from the line where it need not be straight, or from the target of a move."]


class ReportBlending(TypedDict):
    """Gain and corners of blending."""

    gain: Annotated[float, "s", "How much shorter the plan is than the same stages with stops at the outer ends of lines; none where tools stop there."]
    share: Annotated[float, "", "The same as a share of the cycle time with these stops."]
    largest_deviation: Annotated[float, "m", "Largest distance of a tool from a line beyond the straight part, until it is as far out as the whole line."]
    corners: list[ReportCorner]


class ReportBudget(TypedDict):
    """Line of the task file's budget."""

    name: Annotated[str, "", "cycle_time, clearance or skew: a limit of the task file's `budget`."]
    allowed: Annotated[float, "s or m", "Longest cycle time, or least clearance or skew."]
    measured: Annotated[float | None, "s or m", "What the plan has; none where no clearance or skew is proven."]
    kept: Annotated[bool, "", "Whether the plan meets it."]
    file: Annotated[str, "", "Task file, as the command names it."]
    line: Annotated[int, "", "Its line."]
    column: Annotated[int, "", "Its column."]
    cycle_kind: Annotated[CycleKind, "", "Cycle time that is compared: nominal, 95% or worst."]
    text: Annotated[str, "", "All that in a sentence."]


class ReportVarying(TypedDict):
    """Cycle times of a plan whose dwells vary."""

    least: Annotated[float, "s", "Cycle time with every dwell at its least."]
    nominal: Annotated[float, "s", "Cycle time of the plan."]
    percentile_95: Annotated[float, "s", "Time that 95 % of the cycles do not exceed; dwells vary independently, each as a triangle."]
    worst: Annotated[float, "s", "Cycle time with every dwell at its greatest."]
    dwells: Annotated[int, "", "Number of dwells that vary."]
    text: Annotated[str, "", "All that in a sentence."]


class ReportFollowed(TypedDict):
    """Measures of a followed path or seam."""

    task: Annotated[str, "", "Task."]
    method: Annotated[str, "", "Method that found the joints."]
    duration: Annotated[float, "s", "Duration."]
    length: Annotated[float, "m", "Length of the curve; with both arms that of the longer one."]
    manipulability: dict[ArmName, Annotated[float, "", "Mean manipulability of each arm."]]
    joint_travel: Annotated[float, "rad", "Total travel of all joints that turn."]
    slide_travel: Annotated[float, "m", "Total travel of all joints that slide."]
    platform_travel: Annotated[float, "rad", "Travel of the platform's joints that turn; of a sliding one in m."]
    platform_slides: Annotated[bool, "", "Whether all joints of the platform slide."]
    limit_room: Annotated[float, "rad", "Least distance of a joint from its position limit (m where it slides)."]
    limit_joint: Annotated[str, "", "That joint."]
    limit_slides: Annotated[bool, "", "Whether it slides."]
    speed_share: Annotated[float, "", "Largest share of a joint's speed limit."]
    speed_joint: Annotated[str, "", "That joint."]
    clearance: Annotated[float | None, "m", "Least clearance proven during the motion; none if it was not checked."]


class ReportPath(ReportFollowed):
    """Followed path."""

    arms: Annotated[list[str], "", "Arms that follow it."]
    tool_error: Annotated[float, "m", "Largest distance of a tool from its path."]
    tool_angle_error: Annotated[float, "rad", "Largest angle of a tool from its path."]
    rounded_corners: list[Annotated[float, "m", "How far the tool leaves each corner that `blend` rounds."]]
    elbow_distance: dict[ArmName, Annotated[float, "m", "Mean distance of the elbow from its critical point."]] | None
    least_elbow_distance: dict[ArmName, Annotated[float, "m", "Mean of the least distance that the elbow can have there, tool and platform kept; none for arms without closed forms."]] | None
    manipulability_together: Annotated[float | None, "", "Mean manipulability of both arms together."]
    least_manipulability_together: Annotated[float | None, "", "Least manipulability of both arms together."]


class ReportSeam(ReportFollowed):
    """Worked seam."""

    master: Annotated[str | None, "", "Arm that carries the part."]
    slave: Annotated[str, "", "Arm that works on it."]
    speed: Annotated[float, "m/s", "Median speed along the seam between its ramps."]
    ramps: Annotated[list[float], "s", "Durations of both ramps."]
    residual: Annotated[float, "m", "Largest distance by which the chain of both arms is open."]
    residual_angle: Annotated[float, "rad", "Largest angle by which it is open."]
    lean: Annotated[float, "rad", "Largest angle that the tool leans."]
    part_way: Annotated[float, "m", "Travel of the part."]
    part_turn: Annotated[float, "rad", "How far the part turns."]
    part_xyz: Annotated[tuple[float, float, float], "m", "Where the part is at the start."]
    part_rpy: Annotated[tuple[float, float, float], "rad", "How it is turned at the start."]
    least_manipulability: dict[ArmName, Annotated[float, "", "Least manipulability of each arm."]]


class ReportMeeting(TypedDict):
    """Pick or place on a conveyor."""

    arm: Annotated[str, "", "Arm that meets a part."]
    task: Annotated[str, "", "Task."]
    action: Annotated[str, "", "pick or place."]
    conveyor: Annotated[str, "", "Conveyor."]
    speed: Annotated[float, "m/s", "Its speed."]
    time: Annotated[float, "s", "When the tool meets the part."]
    passes: Annotated[float, "s", "When the part passes its pose in the file."]
    gone: Annotated[float, "m", "How far the part is past that pose when the tool meets it."]
    within: Annotated[float, "m", "How far it may be."]
    waited: Annotated[float, "s", "How long the arm waited for the part."]


class ReportWork(TypedDict):
    """Work of an arm in a stage."""

    arm: Annotated[str, "", "Arm that does something in the stage."]
    action: Annotated[str, "", "What it does, such as pick, place or move."]
    task: Annotated[str, "", "Task that this belongs to."]


class StageRow(TypedDict):
    """Stage of a plan, in both files."""

    start: Annotated[float, "s", "Start of the stage: both arms start it together. With `mode: free` a stage is one arm's stop. Members that name a stage count from 0; tables of the terminal, and `dualarm platform --stage`, count from 1."]
    end: Annotated[float, "s", "When the last of its arms is done."]
    tasks: Annotated[list[str], "", "Tasks worked on, the left arm's first; empty for the return."]
    platform_solver: Annotated[str, "", "Method that gave the platform angle."]
    platform_angle: Annotated[float | None, "rad", "Where the platform stands at the end (m where it slides); none without a platform of one joint."]
    platform_time: Annotated[float, "s", "How long the platform alone would need."]
    arm_times: dict[ArmName, Annotated[float, "s", "How long each arm alone would need for its transfer."]]
    joint_times: dict[JointName, Annotated[float, "s", "How long each joint alone would need for its transfer."]]
    bottleneck: Annotated[str, "", "Joint that needs longest for the stage's transfers and so decides how long they take; `tool_speed` where the cap on the tools' speed decides, `duration` where the task file gives the time; empty where nothing moves."]
    saved: Annotated[float, "s", "How much shorter the stage is than with stops at the outer ends of lines."]


class TorquePeak(TypedDict):
    """Largest torque as a share of the effort."""

    torque: Annotated[float, "Nm", "Its magnitude (N where the joint slides)."]
    share: Annotated[float, "", "That as a share of the joint's effort."]
    time: Annotated[float, "s", "When."]
    carrying: Annotated[str, "", "What the arms carry then; empty for tools alone."]


class ReportStageTorque(TorquePeak):
    """Joint of a stage that is nearest to its effort."""

    joint: Annotated[str, "", "That joint."]


class ReportStage(StageRow):
    """Stage with its work."""

    duration: Annotated[float, "s", "End less start."]
    work: list[ReportWork]
    torque: ReportStageTorque | None
    care: Annotated[str, "", "Limits of a task or of a held part that slow the bottleneck, such as `cup: speed 0.5`; empty for none."]


class DwellRow(TypedDict):
    """Shares of a dwell, or of all dwells of an arm, in both files."""

    gripper: Annotated[float, "s", "Share for the gripper."]
    settle: Annotated[float, "s", "Share for coming to rest."]
    handshake: Annotated[float, "s", "Share for signals."]


class ReportWaits(TypedDict):
    """Waiting time of an arm by its reason."""

    platform: Annotated[float, "s", "Waits until the platform is there."]
    partner: Annotated[float, "s", "Waits until the other arm has finished the stage."]
    shared_zone: Annotated[float, "s", "Waits until the other arm has cleared the space."]
    after: Annotated[float, "s", "Waits for a task that this one comes after."]
    window: Annotated[float, "s", "Waits for a time before which a task must not begin."]
    buffer: Annotated[float, "s", "Waits for a part in a buffer, or for room."]
    conveyor: Annotated[float, "s", "Waits for a part on a conveyor."]
    end: Annotated[float, "s", "Waits at the end, when its work is done."]


ReportArm = TypedDict(
    "ReportArm",
    {
        "transfer": Annotated[float, "s", "Time on transfers between stops."],
        "approach": Annotated[float, "s", "Time on straight approaches."],
        "dwell": Annotated[float, "s", "Time at targets."],
        "retract": Annotated[float, "s", "Time on straight retracts."],
        "return": Annotated[float, "s", "Time on the return to the start."],
        "path": Annotated[float, "s", "Time on paths."],
        "seam": Annotated[float, "s", "Time on seams."],
        "dwell_shares": DwellRow,
        "waiting": Annotated[float, "s", "Time that the arm waits."],
        "waited": ReportWaits,
        "drawn_out_for_platform": Annotated[float, "s", "How much longer its transfers take so that it arrives with a slower platform."],
        "utilisation": Annotated[float, "", "Share of the cycle in which the arm does not wait."],
    },
)
"""Time of each activity of an arm."""


class ReportChanges(TypedDict):
    """Tool changes of an arm."""

    changes: Annotated[int, "", "How often the arm changes its tool; visits one right after the other are one change."]
    visits: Annotated[int, "", "How often it visits a stand."]
    time: Annotated[float, "s", "Time of transfers to stands, lines and dwells there."]


class ReportCause(TypedDict):
    """Arm and task that a wait is for."""

    arm: Annotated[str, "", "Arm that it waits for."]
    task: Annotated[str | None, "", "Task that it waits for."]


ReportWait = TypedDict(
    "ReportWait",
    {
        "arm": Annotated[str, "", "Arm that waits."],
        "start": Annotated[float, "s", "Start."],
        "end": Annotated[float, "s", "End."],
        "length": Annotated[float, "s", "Length."],
        "reason": Annotated[str, "", "Reason: as under `arms.<arm>.waited`."],
        "task": Annotated[str | None, "", "Task before which it waits."],
        "for": ReportCause | None,
    },
)
"""Wait of an arm."""


class ReportBuffer(TypedDict):
    """Use of a buffer."""

    capacity: Annotated[int, "", "Parts that the buffer holds at most."]
    initial: Annotated[int, "", "Parts in it at the start."]
    final: Annotated[int, "", "Parts in it at the end."]
    most: Annotated[int, "", "Most parts that were in it."]
    empty: Annotated[float, "s", "How long it was empty."]
    full: Annotated[float, "s", "How long it was full."]


class ReportUse(TypedDict):
    """Largest used fractions of a joint's limits."""

    velocity: Annotated[float, "", "Largest share of the joint's speed limit that is used."]
    acceleration: Annotated[float, "", "Largest share of its acceleration limit."]
    jerk: Annotated[float, "", "Largest share of its jerk limit."]


class ReportTorque(TorquePeak):
    """Torques of a joint."""

    unit: Annotated[str, "", "Nm, or N where the joint slides."]
    effort: Annotated[float, "`unit`", "Largest torque that it may have."]
    effective: Annotated[float, "`unit`", "Effective (RMS) torque over the motion."]
    rated: Annotated[float | None, "`unit`", "Largest effective torque; none where the robot file gives none."]
    acceleration_factor: Annotated[float | None, "", "Factor by which accelerations of this motion could rise, and speeds by its root, before the joint reaches its effort; none where it is at rest."]


class ReportEnergy(TypedDict):
    """Mechanical work of the joints of an arm or the platform over the motion."""

    work: Annotated[float, "J", "Positive work: what the motors put in."]
    braking: Annotated[float, "J", "Work that they take out while they brake or lower."]
    net: Annotated[float, "J", "Work less braking."]


class ReportLowerEffort(TypedDict):
    """Effect of lower efforts on the same motion, slowed between rests."""

    share: Annotated[float, "", "By how much all efforts are lower."]
    cycle_time: Annotated[float | None, "s", "Cycle time then; none where a joint could not hold still."]
    joint: Annotated[str, "", "Joint that decides."]


class ReportTorques(TypedDict):
    """Torques over the whole motion, with tools and parts."""

    joints: dict[JointName, ReportTorque]
    energy: dict[ArmName, ReportEnergy]
    lower_effort: ReportLowerEffort | None


class ReportSensitivity(TypedDict):
    """Cycle times with a changed limit."""

    joint: Annotated[str | None, "", "Joint; empty for all together."]
    limit: Annotated[str, "", "acceleration or jerk."]
    value: Annotated[float | None, "rad/s² or rad/s³", "The limit (m/s² or m/s³ of a joint that slides)."]
    lower: Annotated[float, "s", "Cycle time with the limit 10 % lower."]
    higher: Annotated[float, "s", "Cycle time with the limit 10 % higher."]


class CheckRow(TypedDict):
    """Row of the verification."""

    name: Annotated[str, "", "Stable name of the check."]
    verdict: Annotated[Verdict, "", "passed, failed or not checked."]
    measured: Annotated[float | None, "`unit`", "Worst value found; none where there is nothing to measure."]
    allowed: Annotated[float | None, "`unit`", "What it may be."]
    unit: Annotated[str, "", "Unit of both; empty for counts and ratios."]
    detail: Annotated[str, "", "Where the worst value is, or why nothing was checked."]


class ReportDelay(TypedDict):
    """Tolerated delays of an arm."""

    arm: Annotated[str, "", "The arm that is late."]
    clear: Annotated[float, "s", "No delay up to it lacks clearance, proven."]
    lacking: Annotated[float | None, "s", "A delay that lacks clearance, or none."]
    bodies: Annotated[tuple[str, str] | None, "", "The two bodies that come too near at this delay, or none."]
    time: Annotated[float | None, "s", "Time of the violation in the plan, or none."]


class VerificationRow(TypedDict):
    """Checks of the verification, in both files."""

    passed: Annotated[bool, "", "Whether no check failed."]
    checks: list[CheckRow]


class ReportVerification(VerificationRow):
    """Result of the verification."""

    caveats: Annotated[list[str], "", "Sentences on what a pass leaves open: collisions not, or not fully, checked."]
    clearances: list[ReportClearance]
    delays: list[ReportDelay]


class SettingsRow(TypedDict):
    """Settings of a plan."""

    platform: Annotated[str, "", "Method that chose the platform angles."]
    redundancy: Annotated[str, "", "Resolver of the arms' redundancy."]
    timing: Annotated[str, "", "Solver that timed the transfers."]
    blend: Annotated[str, "", "Where tools do not stop: lines, at the outer ends of lines, or none."]
    effort: Annotated[str, "", "quick, normal or thorough."]
    follower: Annotated[str | None, "", "Method of paths, where one was named."]
    seam_solver: Annotated[str | None, "", "Method of seams, where one was named."]
    seed: Annotated[int, "", "Seed of all randomness."]
    time_limit: Annotated[float | None, "s", "Time limit of the search for orders; none without one."]


class Report(TypedDict):
    """Members of `report.json` [SI units]."""

    format: Annotated[str, "", "`dualarm.report/1`."]
    robot: Annotated[str, "", "Name of the robot."]
    cycle_time: Annotated[float, "s", "Length of the motion: the period where it returns to the start."]
    closes: Annotated[bool, "", "Whether it returns to the start."]
    parts: Annotated[int, "", "Number of tasks that pick or place a part."]
    parts_per_hour: Annotated[float | None, "1/h", "Throughput; none for a motion too short to mean anything."]
    lower_bound: LowerBound
    gap: Annotated[float | None, "", "Share of the cycle time that lies above the lower bound."]
    grid_gap: GridGap
    order_grid_gap: OrderGridGap
    mode: Annotated[str, "", "paired or free."]
    order: Annotated[str, "", "given or optimise."]
    open: Annotated[bool, "", "Whether the planner chose arms or order."]
    bodies: ReportBodies
    collisions: Annotated[str, "", "What was proven about collisions, in a sentence."]
    smallest_clearance: ReportClearance | None
    near_links: ReportClearance | None
    skew: Annotated[str | None, "", "How late each arm may be against the other, in a sentence; none where that was not proven."]
    clearance_cost: ClearanceCost
    blending: ReportBlending | None
    budget: list[ReportBudget]
    varying: ReportVarying | None
    paths: list[ReportPath]
    seams: list[ReportSeam]
    conveyors: list[ReportMeeting]
    stages: list[ReportStage]
    torques: ReportTorques | None
    bottlenecks: dict[JointName, Annotated[int, "", "In how many stages each joint is the bottleneck."]]
    arms: dict[ArmName, ReportArm]
    tool_changes: dict[ArmName, ReportChanges]
    waits: list[ReportWait]
    buffers: dict[Name, ReportBuffer]
    limits_used: dict[JointName, ReportUse]
    sliding_joints: Annotated[list[str], "", "Joints that slide: their positions and rates are in m, m/s, m/s² and m/s³."]
    platform_slides: Annotated[bool, "", "Whether all joints of the platform slide."]
    platform_travel: Annotated[float, "rad", "Total travel of the platform; in m if it slides."]
    elbow_imbalance: Annotated[float | None, "rad", "Mean difference of both elbows' travel, which [Bottin2021] makes zero."]
    joint_travel: dict[JointName, Annotated[float, "rad", "Travel of each joint (m if it slides)."]]
    speed: Annotated[float, "", "The job's share of full speed."]
    tool_speed_cap: Annotated[float | None, "m/s", "Cap on the speed of the tools, or none."]
    assumed_limits: Annotated[list[str], "", "Joints whose acceleration or jerk limits are assumed."]
    assumptions: Annotated[list[str], "", "Sentences that name the assumed limits."]
    without_jerk_limit: Annotated[list[str], "", "Joints whose jerk is not limited: the robot file says `jerk: none`."]
    sensitivity: list[ReportSensitivity]
    verification: ReportVerification | None
    settings: SettingsRow
    notes: Annotated[list[str], "", "Choices and assumptions that a reader should know."]
    assumed: Annotated[list[str], "", "What the result assumes, in short."]
