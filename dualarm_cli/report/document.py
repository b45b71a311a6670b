"""Types of the members of `report.json`; the reference has their units and meanings."""

from __future__ import annotations

from typing import Any, TypedDict

from dualarm_cli.model.verification import Verdict


class ReportBodies(TypedDict):
    """Bodies with and without shapes."""

    text: str
    checked: list[str]
    without_shape: list[str]
    without_part: list[str]


class ReportClearance(TypedDict):
    """Least clearance of a stage."""

    stage: int
    clearance: float
    margin: float
    required: float
    bodies: tuple[str, str]
    time: float


class ReportCorner(TypedDict):
    """Point that a tool passes in motion."""

    arm: str
    task: str
    action: str
    line: str
    time: float
    speed: float
    joint: str
    limit: str
    beside: float


class ReportBlending(TypedDict):
    """Gain and corners of blending."""

    gain: float
    share: float
    largest_deviation: float
    corners: list[ReportCorner]


class ReportBudget(TypedDict):
    """Line of the task file's budget."""

    name: str
    allowed: float
    measured: float | None
    kept: bool
    file: str
    line: int
    column: int
    text: str


class ReportWork(TypedDict):
    """Work of an arm in a stage."""

    arm: str
    action: str
    task: str


class ReportStage(TypedDict):
    """Stage with its work."""

    start: float
    end: float
    duration: float
    tasks: list[str]
    work: list[ReportWork]
    platform_solver: str
    platform_angle: float | None
    platform_time: float
    arm_times: dict[str, float]
    joint_times: dict[str, float]
    bottleneck: str
    saved: float


class ReportDwells(TypedDict):
    """Shares of an arm's dwells."""

    gripper: float
    settle: float
    handshake: float


ReportArm = TypedDict(
    "ReportArm",
    {
        "transfer": float,
        "approach": float,
        "dwell": float,
        "retract": float,
        "return": float,
        "path": float,
        "seam": float,
        "dwell_shares": ReportDwells,
        "waiting": float,
        "waited": dict[str, float],
        "utilisation": float,
        "drawn_out_for_platform": float,
    },
)
"""Time of each activity of an arm."""


class ReportCause(TypedDict):
    """Arm and task that a wait is for."""

    arm: str
    task: str | None


ReportWait = TypedDict(
    "ReportWait",
    {
        "arm": str,
        "start": float,
        "end": float,
        "length": float,
        "reason": str,
        "task": str | None,
        "for": ReportCause | None,
    },
)
"""Wait of an arm."""


class ReportUse(TypedDict):
    """Largest used fractions of a joint's limits."""

    velocity: float
    acceleration: float
    jerk: float


class ReportSensitivity(TypedDict):
    """Cycle times with a changed limit."""

    joint: str | None
    limit: str
    value: float | None
    lower: float | None
    higher: float | None


class ReportCheck(TypedDict):
    """Row of the verification."""

    name: str
    verdict: Verdict
    measured: float | None
    allowed: float | None
    unit: str
    detail: str


class ReportDelay(TypedDict):
    """Tolerated delays of an arm."""

    arm: str
    clear: float
    lacking: float | None
    bodies: tuple[str, str] | None
    time: float | None


class ReportVerification(TypedDict):
    """Result of the verification."""

    passed: bool
    caveats: list[str]
    checks: list[ReportCheck]
    clearances: list[ReportClearance]
    delays: list[ReportDelay]


class Report(TypedDict):
    """Members of `report.json` [SI units].

    Rows of kinds of work have the members in the reference.
    """

    format: str
    robot: str
    cycle_time: float
    closes: bool
    parts: int
    parts_per_hour: float | None
    lower_bound: float | None
    gap: float | None
    grid_gap: float | None
    order_grid_gap: float | None
    mode: str
    order: str
    open: bool
    bodies: ReportBodies
    collisions: str
    smallest_clearance: ReportClearance | None
    skew: str | None
    clearance_cost: float | None
    blending: ReportBlending | None
    budget: list[ReportBudget]
    paths: list[dict[str, Any]]
    seams: list[dict[str, Any]]
    conveyors: list[dict[str, Any]]
    stages: list[ReportStage]
    bottlenecks: dict[str, int]
    arms: dict[str, ReportArm]
    tool_changes: dict[str, dict[str, Any]]
    waits: list[ReportWait]
    buffers: dict[str, dict[str, Any]]
    limits_used: dict[str, ReportUse]
    sliding_joints: list[str]
    platform_slides: bool
    platform_travel: float
    elbow_imbalance: float | None
    joint_travel: dict[str, float]
    speed: float
    tool_speed_cap: float | None
    assumed_limits: list[str]
    assumptions: list[str]
    without_jerk_limit: list[str]
    sensitivity: list[ReportSensitivity]
    verification: ReportVerification | None
    settings: dict[str, Any]
    notes: list[str]
    assumed: list[str]
