# ruff: noqa: E501 (tables, one row a line)
# fmt: off
"""Members of the documents of `compare`, `compare_solvers`, `reach`, `sweep` and `perturb`: type, unit and meaning.

`Annotated` holds unit and meaning, as in `document.py`.
"""

from __future__ import annotations

from typing import Annotated, TypedDict

from dualarm_cli.model.studies.evaluation import Status
from dualarm_cli.model.studies.study import Apply, Sense
from dualarm_cli.report.document import ArmName, JointName, Name, ReportPath, ReportSeam

GroupName = Annotated[str, "group"]
Level = float | str | bool
"""Value of a parameter."""


class ComparedSchedule(TypedDict):
    """Side of a comparison of two schedules."""

    schedule: Annotated[str, "", "Name of the schedule."]
    robot: Annotated[str, "", "Name of its robot."]
    duration: Annotated[float, "s", "Length of its motion."]
    stages: Annotated[int, "", "Number of its stages."]


class StageCause(TypedDict):
    """Cause of the longer version of a stage."""

    part: Annotated[str, "", "transfer, approach, dwell, retract, path, seam or wait."]
    arm: Annotated[str, "", "Arm that ends the longer version."]
    joint: Annotated[str, "", "Joint that decides the longer version's transfer; empty for other parts."]
    cause: Annotated[str, "", "displacement, limits or timing for a transfer; time for other parts."]
    a_time: Annotated[float, "s", "Time of the part in A."]
    b_time: Annotated[float, "s", "Time of the part in B."]
    a_displacement: Annotated[float | None, "rad", "Displacement of the joint in A (m if it slides)."]
    b_displacement: Annotated[float | None, "rad", "Displacement of the joint in B (m if it slides)."]
    slides: Annotated[bool, "", "Whether the joint slides."]


class StageComparison(TypedDict):
    """Stage of A, of B or of both."""

    a: Annotated[int | None, "", "Number of the stage in A, from 1; none if it is only in B."]
    b: Annotated[int | None, "", "Number of the stage in B, from 1; none if it is only in A."]
    work: Annotated[list[str], "", "Tasks and actions of the stage."]
    match: Annotated[str, "", "same work, different simultaneous work, only in A or only in B."]
    a_duration: Annotated[float | None, "s", "Length in A."]
    b_duration: Annotated[float | None, "s", "Length in B."]
    difference: Annotated[float, "s", "Length in B less that in A; a missing stage has no length."]
    a_bottleneck: Annotated[str | None, "", "Joint that decides the stage in A."]
    b_bottleneck: Annotated[str | None, "", "Joint that decides the stage in B."]
    blame: StageCause | None


class CauseSum(TypedDict):
    """Sum of the differences with one cause."""

    name: Annotated[str, "", "Joint, or part of a stage."]
    stages: Annotated[int, "", "Number of stages with this cause."]
    difference: Annotated[float, "s", "Sum of their differences."]


class ScheduleComparison(TypedDict):
    """Document of `compare`: two schedules stage by stage [SI units]."""

    format: Annotated[str, "", "`dualarm.schedule-comparison/1`."]
    a: ComparedSchedule
    b: ComparedSchedule
    difference: Annotated[float, "s", "Duration of B less that of A."]
    relative: Annotated[float | None, "", "Difference as a share of A's duration."]
    identical: Annotated[bool, "", "Whether both motions are the same."]
    stages: list[StageComparison]
    blamed: list[CauseSum]
    notes: Annotated[list[str], "", "Differences of robots, limits, settings and order."]
    sentence: Annotated[str, "", "The result in a sentence."]


class ComparedCase(TypedDict):
    """Choice of methods."""

    method: Annotated[str, "", "Method of the platform, path or seam."]
    redundancy: Annotated[str, "", "Resolver of the arms' redundancy."]
    timing: Annotated[str, "", "Solver that timed the transfers."]
    blend: Annotated[str, "", "lines or none."]


class ComparedCurves(TypedDict):
    """Curves of a path."""

    task: Annotated[str, "", "Task."]
    time: Annotated[list[float], "s", "Instants."]
    force: dict[ArmName, Annotated[list[float], "1/m", "Contraction force of each arm, if the file has critical points."]]
    manipulability: dict[ArmName, Annotated[list[float], "", "Manipulability of each arm."]]
    manipulability_together: Annotated[list[float], "", "Manipulability of both arms together."]


class ComparedRow(ComparedCase):
    """Plan of one choice of methods."""

    status: Annotated[str, "", "verified, failed, infeasible or not served."]
    reason: Annotated[str, "", "Why there is no verified plan."]
    cycle_time: Annotated[float | None, "s", "Cycle time."]
    parts_per_hour: Annotated[float | None, "1/h", "Throughput."]
    gap: Annotated[float | None, "", "Share of the cycle time above the lower bound."]
    grid_gap: Annotated[float | None, "", "Excess over the bound of the search's grid, before refinement."]
    elbow_imbalance: Annotated[float | None, "rad", "Mean difference of both elbows' travel."]
    clearance: Annotated[float | None, "m", "Least clearance."]
    clearance_cost: Annotated[float | None, "s", "Additional time for collision avoidance."]
    platform_travel: Annotated[float | None, "rad", "Total travel of the platform (m if it slides)."]
    deciding_stages: dict[GroupName, Annotated[int, "", "Stages whose transfer each group decides."]] | None
    deciding_time: dict[GroupName, Annotated[float, "s", "Time that each group, lines and dwells decide."]] | None
    platform_slides: Annotated[bool, "", "Whether all joints of the platform slide."]
    caveats: Annotated[list[str], "", "Sentences on gaps of the verification."]
    paths: list[ReportPath]
    path_curves: list[ComparedCurves]
    seams: list[ReportSeam]


class ComparedJob(TypedDict):
    """Comparison of methods on a job, best first."""

    tasks: Annotated[str, "", "Name of the job."]
    robot: Annotated[str, "", "Name of the robot."]
    stages: Annotated[int | None, "", "Number of stages; none where the planner chooses arms or order."]
    open: Annotated[bool, "", "Whether the planner chooses arms or order."]
    parts: Annotated[int, "", "Number of tasks that pick or place a part."]
    closes: Annotated[bool, "", "Whether the motion returns to the start."]
    lower_bound: Annotated[float | None, "s", "No plan of the job is shorter."]
    lower_bound_assumptions: Annotated[list[str], "", "Conditions of the bound."]
    rows: list[ComparedRow]
    winner: ComparedCase | None
    sentence: Annotated[str, "", "The result in a sentence."]


class ComparedClock(ComparedCase):
    """Planning time of a row."""

    tasks: Annotated[str, "", "Name of the job."]
    planning_time: Annotated[float, "s", "Wall time, which differs from run to run."]


class SolverSettings(TypedDict):
    """Settings of a comparison of methods."""

    effort: Annotated[str, "", "quick, normal or thorough."]
    seed: Annotated[int, "", "Seed of all randomness."]


class SolverComparison(TypedDict):
    """Document of `compare_solvers`: methods on jobs [SI units]."""

    format: Annotated[str, "", "`dualarm.comparison/1`."]
    settings: SolverSettings
    comparisons: list[ComparedJob]
    wall_clock: list[ComparedClock]


class ReachedFrame(TypedDict):
    """Reach of a frame of the cell."""

    xyz: Annotated[list[float], "m", "Position in the world."]
    reached: dict[ArmName, Annotated[list[bool], "", "Whether each arm, and `both`, reaches it, by platform position."]]


class TcpPose(TypedDict):
    """Pose of a tool centre point."""

    xyz: Annotated[list[float], "m", "Position of the tool centre point: in the world, as `grip` in the frame of the other tool."]
    rpy: Annotated[list[float], "rad", "Its roll, pitch and yaw."]


class HandoverRow(TypedDict):
    """Pose of a hand-over that either arm can give."""

    score: Annotated[float, "", "Least of both arms' relative manipulability and distance from joint limits, from 0 to 1; less far from home."]
    grip: TcpPose
    tools: dict[ArmName, TcpPose]
    joints: dict[ArmName, dict[JointName, Annotated[float, "rad", "Posture of each arm."]]]


class ReachedTable(TypedDict):
    """Reach over a table [SI units]."""

    format: Annotated[str, "", "`dualarm.reach/1`."]
    name: Annotated[str, "", "Robot, or its file."]
    height: Annotated[float, "m", "Height of the tool centre point."]
    tilt: Annotated[float, "rad", "Tilt of the tool from straight down."]
    step: Annotated[float, "m", "Spacing of the points."]
    platform: list[Annotated[float | None, "`platform_unit`", "Platform positions; one without a value for a fixed platform."]]
    platform_unit: Annotated[str, "", "rad or m."]
    x: Annotated[list[float], "m", "Columns of the points."]
    y: Annotated[list[float], "m", "Rows of the points."]
    area: dict[ArmName, Annotated[list[float], "m²", "Area that each arm, and `both`, reaches, by platform position."]]
    area_at_any: dict[ArmName, Annotated[float, "m²", "Area reached from any platform position."]]
    positions: dict[ArmName, Annotated[list[list[int]], "", "Number of platform positions from which each point is reached, shape (y, x)."]]
    frames: dict[Name, ReachedFrame]


class ReachReport(ReachedTable, total=False):
    """Document of `reach`: reach over a table, and hand-overs if requested [SI units]."""

    handover_distance: Annotated[float, "m", "Distance of the tool centre points of hand-overs."]
    handovers: list[HandoverRow]


class StudyObjective(TypedDict):
    """Objective of a study."""

    name: Annotated[str, "", "cycle_time, gap, clearance, travel or torque."]
    sense: Annotated[Sense, "", "minimise or maximise."]
    unit: Annotated[str, "", "SI unit."]
    together: Annotated[str | None, "", "sum, largest or least over several task files."]


class StudyTarget(TypedDict):
    """Value of a file that a parameter changes."""

    file: Annotated[str, "", "tasks, cell, robot, robot.left or robot.right."]
    path: Annotated[str, "", "Path to the value."]
    apply: Annotated[Apply, "", "set, shift or scale."]


class StudyParameter(TypedDict):
    """Parameter of a study."""

    name: Annotated[str, "", "Name of the parameter."]
    unit: Annotated[str, "", "Unit of its values, as the study writes it."]
    numeric: Annotated[bool, "", "Whether its values are numbers."]
    targets: list[StudyTarget]
    values: list[Annotated[Level, "`unit`", "Values; none for a range."]] | None
    range: Annotated[list[float] | None, "`unit`", "Smallest and largest value; none for values."]


class StudyJob(TypedDict):
    """Plan of a task file."""

    tasks: Annotated[str, "", "Task file."]
    status: Annotated[Status, "", "planned, or why there is no verified plan."]
    cycle_time: Annotated[float | None, "s", "Cycle time."]
    lower_bound: Annotated[float | None, "s", "No plan of the same stages is shorter."]
    gap: Annotated[float | None, "", "Share of the cycle time above the lower bound."]
    clearance: Annotated[float | None, "m", "Least clearance."]
    travel: Annotated[float | None, "rad", "Total travel of all joints that turn."]
    torque: Annotated[float | None, "", "Largest torque as a share of the joint's effort."]
    torque_joint: Annotated[str, "", "Joint of that torque; empty without torques."]
    limiting: dict[JointName, Annotated[float, "s", "Time of transfers that each joint, lines and dwells decide."]]
    caveats: Annotated[list[str], "", "Sentences on gaps of the verification."]


class StudyFigures(TypedDict):
    """Plans of all task files, and their totals."""

    cycle_time: Annotated[float | None, "s", "Sum of the cycle times."]
    gap: Annotated[float | None, "", "Largest gap."]
    clearance: Annotated[float | None, "m", "Least clearance."]
    travel: Annotated[float | None, "rad", "Sum of the travels."]
    torque: Annotated[float | None, "", "Largest torque share."]
    jobs: list[StudyJob]


class StudyReference(StudyFigures):
    """Plans of the unchanged files."""

    status: Annotated[Status, "", "Worst status of all task files."]


class StudyPoint(StudyReference):
    """Point of a study with its plans."""

    rank: Annotated[int | None, "", "Rank, from 1; none without a plan."]
    point: Annotated[int, "", "Number of the point, in order of creation."]
    values: dict[Name, Annotated[Level, "", "Value of each parameter, in the unit of the parameter."]]
    pareto: Annotated[bool, "", "Member of the Pareto set."]
    reasons: Annotated[list[str], "", "Why there is no plan."]


class StudyFailure(TypedDict):
    """Points that failed for the same reason."""

    status: Annotated[Status, "", "Status of the points."]
    count: Annotated[int, "", "Number of points."]
    example: Annotated[str, "", "Reason of the first point."]
    points: Annotated[list[int], "", "Numbers of the points."]


class StudyInfluence(TypedDict):
    """Influence of a parameter on an objective."""

    name: Annotated[str, "", "Name of the parameter."]
    main_effect: Annotated[float | None, "", "Largest less least mean of its values, in the objective's unit."]
    share: Annotated[float | None, "", "Share of the variance that it explains alone."]
    slope: Annotated[float | None, "", "Standardised regression coefficient."]
    rank_correlation: Annotated[float | None, "", "Spearman's rank correlation."]


class StudyInteraction(TypedDict):
    """Interaction of two parameters."""

    between: Annotated[list[str], "", "Names of both parameters."]
    share: Annotated[float, "", "Share of the variance that their interaction explains."]


class StudySensitivities(TypedDict):
    """Sensitivity of an objective to the parameters."""

    objective: Annotated[str, "", "Name of the objective."]
    plans: Annotated[int, "", "Number of analysed plans."]
    whole_grid: Annotated[bool, "", "Whether the plans fill the grid; shares are exact then."]
    parameters: list[StudyInfluence]
    interactions: list[StudyInteraction]
    linear_share: Annotated[float | None, "", "Share of the variance that a linear fit explains."]
    notes: Annotated[list[str], "", "Remarks on the reliability."]


class StudyReport(TypedDict):
    """Document of `sweep`: points of a layout study, best first [SI units]."""

    format: Annotated[str, "", "`dualarm.sweep/1`."]
    version: Annotated[str, "", "Version of dualarm."]
    study: Annotated[str, "", "Name of the study."]
    tasks: Annotated[list[str], "", "Task files."]
    objectives: list[StudyObjective]
    parameters: list[StudyParameter]
    settings: dict[Name, Annotated[Level, "", "Settings of the plans, as the study names them."]]
    method: dict[Name, Annotated[Level, "", "Choice of points: `name`, and its settings."]]
    counts: dict[Name, Annotated[int, "", "Number of points, of those with a plan, in the Pareto set, and by other status."]]
    reference: StudyReference
    rows: list[StudyPoint]
    failures: list[StudyFailure]
    sensitivity: list[StudySensitivities]
    inputs: dict[Name, Annotated[str, "", "SHA-256 of each input file."]]


class Distribution(TypedDict):
    """Distribution of times over draws."""

    least: Annotated[float, "s", "Shortest time."]
    median: Annotated[float, "s", "Time that half of the draws do not exceed."]
    percentile_95: Annotated[float, "s", "Time that 95 % of the draws do not exceed."]
    worst: Annotated[float, "s", "Longest time."]


class ReactingStage(TypedDict):
    """Stage of draws, by its work."""

    work: Annotated[str, "", "Tasks and actions; empty for the return."]
    nominal: Annotated[float | None, "s", "Length in the nominal plan; none if it lacks the stage."]
    share: Annotated[float | None, "", "Covariance with the cycle time as a share of its variance."]
    time: Distribution


class DrawRow(TypedDict):
    """Plan of a draw."""

    draw: Annotated[int, "", "Number of the draw, from 1."]
    status: Annotated[Status, "", "planned, or why there is no verified plan."]
    cycle_time: Annotated[float | None, "s", "Cycle time."]
    clearance: Annotated[float | None, "m", "Least clearance."]
    stages: dict[Name, Annotated[float, "s", "Length of each stage by its work."]]
    reasons: Annotated[list[str], "", "Why there is no plan."]


class PerturbationReport(TypedDict):
    """Document of `sweep --perturb`: plans of drawn poses and dwells [SI units]."""

    format: Annotated[str, "", "`dualarm.perturbation/1`."]
    version: Annotated[str, "", "Version of dualarm."]
    tasks: Annotated[str, "", "Task file."]
    settings: dict[Name, Annotated[Level, "", "Effort of the plans, and seed of the draws."]]
    varying: dict[Name, Annotated[int, "", "Number of targets, frames and dwells that vary."]]
    counts: dict[Name, Annotated[int, "", "Number of draws, of those with a plan, and by other status."]]
    nominal: Annotated[float | None, "s", "Cycle time of the plan without deviations."]
    stated: dict[Name, Annotated[float, "s", "`95%` and `worst` cycle that its report states, by dwells alone; empty if none varies."]]
    cycle_time: Distribution | None
    stages: list[ReactingStage]
    failures: list[StudyFailure]
    rows: list[DrawRow]
    inputs: dict[Name, Annotated[str, "", "SHA-256 of each input file."]]


class WhyPiece(TypedDict):
    """Motion, dwell or wait of an arm or of the platform."""

    group: Annotated[str, "", "Arm, or platform."]
    kind: Annotated[str, "", "transfer, approach, dwell, retract, return, path, seam or wait; turn for the platform."]
    task: Annotated[str, "", "Task; empty for the platform and returns."]
    action: Annotated[str, "", "Action at the target; empty for the platform and returns."]
    stage: Annotated[int, "", "Number of its stage, from 1."]
    start: Annotated[float, "s", "Start."]
    end: Annotated[float, "s", "End."]
    length: Annotated[float, "s", "Time that it takes by itself, without waiting for others."]
    slack: Annotated[float, "s", "Delay that does not make the cycle longer."]


class WhyLink(TypedDict):
    """Part of the critical path."""

    piece: Annotated[int | None, "", "Index among the pieces; none for time that no motion decides."]
    start: Annotated[float, "s", "Begin of the time that it decides."]
    end: Annotated[float, "s", "End of the time that it decides."]


class WhyShare(TypedDict):
    """Part of the cycle time by what decides it."""

    group: Annotated[str, "", "Arm, or platform; empty for time that no motion decides."]
    kind: Annotated[str, "", "Kind of piece."]
    time: Annotated[float, "s", "Time on the critical path."]


class WhyStop(TypedDict):
    """Part of a lever with an estimate of its own."""

    share: Annotated[float, "", "Share of the change; negative for the other direction."]
    change: Annotated[str, "", "Old and new value, or the difference."]
    estimate: Annotated[float, "s", "Estimated gain."]


class WhyLever(TypedDict):
    """Change of a file, with what it gains."""

    name: Annotated[str, "", "What is changed."]
    change: Annotated[str, "", "Old and new value, or the difference."]
    kind: Annotated[str, "", "process, search, layout or robot."]
    values: dict[Name, Annotated[float | str | bool | list[float | str], "", "New values by file and JSON pointer, as `dualarm.load` and studies take them."]]
    estimate: Annotated[float | None, "s", "Estimated gain, with order, postures and platform angles of the plan."]
    reason: Annotated[str, "", "Why there is no estimate; empty if there is one."]
    status: Annotated[str, "", "Result of its plan; empty if it was not re-planned."]
    cycle_time: Annotated[float | None, "s", "Cycle time, re-planned and verified."]
    gain: Annotated[float | None, "s", "Gain, re-planned and verified."]
    stops: Annotated[list[WhyStop], "", "Parts of the change; for the largest estimates of task and cell file."]


class WhyCombination(TypedDict):
    """Levers together, re-planned."""

    levers: Annotated[list[int], "", "Indices of the levers."]
    status: Annotated[Status, "", "Result of planning again."]
    cycle_time: Annotated[float | None, "s", "Cycle time, verified."]
    gain: Annotated[float | None, "s", "Gain, verified."]


class WhyReport(TypedDict):
    """Document of `why`: critical path, slack and levers of a plan [SI units]."""

    format: Annotated[str, "", "`dualarm.why/1`."]
    version: Annotated[str, "", "Version of dualarm."]
    job: Annotated[str, "", "Task file."]
    effort: Annotated[str, "", "Effort of the plan and of plans re-planned."]
    cycle_time: Annotated[float, "s", "Cycle time of the plan."]
    required: Annotated[float | None, "s", "Cycle time of the budget, or none."]
    shares: list[WhyShare]
    critical_path: list[WhyLink]
    pieces: list[WhyPiece]
    levers: list[WhyLever]
    combinations: list[WhyCombination]
    sentences: Annotated[list[str], "", "Result in words."]
