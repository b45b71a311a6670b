"""Sequence problem and plan of the search over all stages, as arrays."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import field, fields, replace
from functools import cached_property

import numpy as np

from dualarm_cli.effort.stages import Mesh, SequenceSettings
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray, readonly
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.kinematics.platform_chain import PlatformChain
from dualarm_cli.kinematics.posture_source import PostureSource
from dualarm_cli.kinematics.srs_arm import SrsArm, closed_form
from dualarm_cli.model.lines import LineDirections
from dualarm_cli.model.motion.rest_to_rest import RestToRest
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.records import dataclass
from dualarm_cli.stages.plans.clearance import SequenceClearance
from dualarm_cli.stages.plans.slowing import Pace, Slowing


@dataclass(frozen=True)
class StopTarget:
    """Target of one arm's stop: pose or configurations, lines and dwell."""

    R_world_tool: FloatArray
    """Rotation of the tool centre point in the world, shape (3, 3); ignored for configurations."""
    p_world_tool: FloatArray
    """Position of the tool centre point in the world [m], shape (3,); ignored for configurations."""
    configurations: FloatArray | None
    """Joint configurations that are the targets instead [rad], shape (m, joints), or None."""
    yaw: FloatArray
    """Turns about the tool's z axis that are allowed [rad], shape (y,).

    Samples of all where free.
    """
    free_yaw: bool
    """Whether any turn about the tool's z axis will do."""
    approach: float
    """Length of the straight line to the target [m]."""
    retract: float
    """Length of the straight line away from it [m]."""
    dwell: float
    """Dwell at the target [s]."""
    directions: FloatArray = field(default_factory=lambda: LineDirections().vectors)
    """Directions outward, in the tool's frame, then the world's, (2, 2, 3)."""
    pace: Pace | None = None
    """Limits of transfer and lines under care; None for the arm's own."""

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for name in ("R_world_tool", "p_world_tool", "yaw", "directions"):
            object.__setattr__(self, name, readonly(getattr(self, name)))

    @property
    def lines_turn(self) -> bool:
        """Whether a yaw turns a line to another direction."""
        turning = self.directions[0] * np.array([[self.approach], [self.retract]])
        return bool(turning[:, :2].any())


@dataclass(frozen=True)
class ArmWork:
    """Kinematics, limits and stops of one arm, stage by stage."""

    name: str
    """Name of the arm."""
    kinematics: PostureSource
    """Kinematics of the arm in the carried frame."""
    limits: JointLimits
    """Limits of the arm's joints."""
    law: RestToRest
    """Rest-to-rest timing law of the joints."""
    R_tool_flange: FloatArray
    """Rotation of the flange in the tool frame, shape (3, 3)."""
    p_tool_flange: FloatArray
    """Position of the flange in the tool frame [m], shape (3,)."""
    stops: tuple[StopTarget | None, ...]
    """Target in each stage; None in idle stages."""
    start: FloatArray
    """Joints before the first stage [rad], shape (joints,); not used where the start is free."""
    robot_limits: JointLimits | None = None
    """Limits of the robot, valid in motion, if `limits` keep a margin; else None."""
    home_pace: Pace | None = None
    """Limits of the return and of idle stages; None without care and tool speed limit."""

    @property
    def joints(self) -> int:
        """Number of joints of the arm."""
        return len(self.start)

    @property
    def spare(self) -> int:
        """Number of joints beyond the six of a pose."""
        return self.joints - 6

    @property
    def closed_form(self) -> SrsArm:
        """Closed-form kinematics of the arm.

        Raises:
            UnsupportedError: it has none.
        """
        return closed_form(self.kinematics)

    @cached_property
    def stop_table(self) -> StopTable:
        """Stops of the arm as arrays."""
        return StopTable.of(self)

    @cached_property
    def slowing(self) -> Slowing | None:
        """Care of the arm's transfers and lines; None in a job without."""
        if (home := self.home_pace) is None:
            return None
        paces = [home if stop is None else stop.pace or home for stop in self.stops]
        lines = np.column_stack([self.stop_table.approach, self.stop_table.retract])
        tip = product(-self.R_tool_flange.T, self.p_tool_flange)
        return Slowing.of([*paces, home], lines, self.kinematics, tip)

    @property
    def yaw_turns_last_joint(self) -> bool:
        """Whether a free yaw leaves the last joint free, where it turns no line.

        Of arms without an arm angle it does not: their nodes have several yaws.
        """
        return self.kinematics.has_arm_angle and self.last_axis_is_tools

    def frees_last_joint(self, stop: StopTarget) -> bool:
        """Return whether the yaw of a stop leaves the last joint free."""
        return stop.free_yaw and not stop.lines_turn and self.yaw_turns_last_joint

    @property
    def last_axis_is_tools(self) -> bool:
        """Whether the last joint's axis coincides with the tool's z axis."""
        axis, point = self.kinematics.last_axis
        z_tool = self.R_tool_flange.T[:, 2]
        if norm(np.cross(axis, z_tool)) > 1e-9:
            return False
        # A point of the axis and the tool centre point, seen from the flange, on one line along the axis.
        tcp = product(-self.R_tool_flange.T, self.p_tool_flange)
        return bool(norm(np.cross(tcp - point, axis)) < 1e-9)


@dataclass(frozen=True)
class StopTable:
    """Stops of one arm as arrays, a row per stage and alternative configuration."""

    first: IntArray
    """Row of each stage's first alternative, shape (n,); idle stages have some row of no meaning."""
    active: BoolArray
    """Flags of stages in which the arm works, shape (n,)."""
    R: FloatArray
    """Tool rotations, in the world or (configurations) in the carried frame, shape (m, 3, 3)."""
    p: FloatArray
    """Tool positions likewise [m], shape (m, 3)."""
    carried: BoolArray
    """Flags of configuration rows, which move with the platform, shape (m,)."""
    configuration: FloatArray
    """Joints of configuration rows [rad], shape (m, joints); zeros elsewhere."""
    directions: FloatArray
    """Directions of lines outward, `StopTarget.directions`, shape (m, 2, 2, 3)."""
    approach: FloatArray
    """Length of each stage's approach [m], shape (n,)."""
    retract: FloatArray
    """Length of each stage's retract [m], shape (n,)."""
    dwell: FloatArray
    """Dwell of each stage [s], shape (n,)."""

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for name in ("R", "p", "configuration", "approach", "retract", "dwell", "directions"):
            object.__setattr__(self, name, readonly(getattr(self, name)))

    @classmethod
    def of(cls, arm: ArmWork) -> StopTable:
        """Convert an arm's stops to arrays."""
        first: list[int] = []
        R: list[FloatArray] = []
        p: list[FloatArray] = []
        carried: list[bool] = []
        configuration: list[FloatArray] = []
        directions: list[FloatArray] = []
        for stop in arm.stops:
            first.append(len(R))
            if stop is None:
                continue
            count = 1 if stop.configurations is None else len(stop.configurations)
            directions.extend([stop.directions] * count)
            if stop.configurations is None:
                R.append(stop.R_world_tool)
                p.append(stop.p_world_tool)
                carried.append(False)
                configuration.append(np.zeros(arm.joints))
                continue
            R_flange, p_flange = arm.kinematics.forward(stop.configurations)
            R_tool = product(R_flange, arm.R_tool_flange.T)
            R.extend(R_tool)
            p.extend(p_flange - product(R_tool, arm.p_tool_flange))
            carried.extend([True] * count)
            configuration.extend(stop.configurations)
        if not R:
            # An arm without stops gets one placeholder row for its idle stages.
            R, p, carried, configuration, directions = (
                [np.eye(3)],
                [np.zeros(3)],
                [False],
                [np.zeros(arm.joints)],
                [np.zeros((2, 2, 3))],
            )
        return cls(
            np.minimum(np.array(first, dtype=np.int64), len(R) - 1),
            np.array([stop is not None for stop in arm.stops]),
            np.array(R).reshape(-1, 3, 3),
            np.array(p).reshape(-1, 3),
            np.array(carried, dtype=np.bool_),
            np.array(configuration).reshape(-1, arm.joints),
            np.array(directions),
            *(
                np.array([0.0 if stop is None else getattr(stop, name) for stop in arm.stops])
                for name in ("approach", "retract", "dwell")
            ),
        )


@dataclass(frozen=True)
class SequenceProblem:
    """Fixed order of stages for which the fastest rest-to-rest plan is sought.

    In a stage platform and arms leave together; an arm's approach begins when its own transfer and the platform's are
    over; approach, dwell and retract follow; the stage ends when the last arm is done. In a hand-over all lines and
    dwells of both arms follow one another, once both have arrived.
    """

    platform: PlatformChain
    """Joints that carry the arms."""
    platform_law: RestToRest | None
    """Rest-to-rest time of the platform's joint; None where it cannot be turned (or there is none)."""
    platform_range: tuple[float, float]
    """Lowest and highest platform angle [rad]; not used where it cannot be turned."""
    platform_start: FloatArray
    """Platform joints before the first stage [rad], shape (k,), and always where it cannot be turned."""
    arms: tuple[ArmWork, ...]
    """Arms, one or two, each with an entry per stage."""
    free_start: bool
    """Whether the motion may begin anywhere: it then begins where the first transfer would end."""
    returns: bool
    """Whether the motion ends in its start, with a last transfer of platform and all arms."""
    handing: tuple[bool, ...] = ()
    """Flags of hand-over stages; empty for none."""
    clearance: SequenceClearance | None = None
    """Collision test; None disables collision checking."""
    launches: tuple[IntArray, ...] | None = None
    """Launch numbers of approach and retract by arm, shape (n, 2) each.

    None if all line ends are at rest.
    """
    with_margin: tuple[ArmWork, ...] = ()
    """Arms with narrowed position limits for line ends in motion; empty without."""
    settings: SequenceSettings = SequenceSettings()
    """Numbers of the search."""
    meshes: tuple[Mesh, ...] = ()
    """Grids of the search in place of its effort's; empty for those."""
    progress: Callable[[str], None] = field(default=lambda _: None, compare=False, repr=False)
    """Receiver of the search's share of its work, in words."""

    def under(self, law: Callable[[RestToRest], RestToRest]) -> SequenceProblem:
        """Return the same stages under another timing law of the arms' joints.

        Args:
            law: function of the rest-to-rest law.
        """
        arms = tuple(replace(arm, law=law(arm.law)) for arm in self.arms)
        return replace(self, arms=arms)

    @property
    def has_arm_angles(self) -> bool:
        """Whether all arms have closed forms over an arm angle."""
        return all(work.kinematics.has_arm_angle for work in self.arms)

    @property
    def stages(self) -> int:
        """Number of stages."""
        return len(self.arms[0].stops)

    @property
    def handover_stages(self) -> IntArray:
        """Indices of the hand-over stages."""
        return np.flatnonzero(self.hands_over)

    @property
    def hands_over(self) -> BoolArray:
        """Flags of hand-over stages, shape (n,); empty if not given."""
        return np.array(self.handing, dtype=np.bool_)

    @property
    def turns(self) -> bool:
        """Whether the platform angle is a decision."""
        return self.platform_law is not None


@dataclass(frozen=True)
class ArmDecisions:
    """Decisions of an arm, a row per stage (n), idle rows arbitrary.

    The same type carries many candidates of one stage: rows are then candidates. An arm without closed forms has no
    arm angle: each psi is then a distance along its self-motion, which is counted from `near` (`moved_along`,
    `LineFollowing`); all are 0 for an arm without a spare joint.
    """

    target: IntArray
    """Index of the chosen configuration; 0 for poses, shape (n,)."""
    yaw: FloatArray
    """Turn about the tool's z axis [rad], shape (n,)."""
    branch: IntArray
    """Branch of the inverse kinematics, shape (n,)."""
    psi_target: FloatArray
    """Arm angle at the target [rad], shape (n,).

    Without closed forms it is the self-motion distance from `near`.
    """
    psi_approach: FloatArray
    """Arm angle where the approach starts [rad]; linear along the line, shape (n,).

    Without closed forms its difference
    from `psi_target` is the drift along the self-motion during the approach, from the target outward."""
    psi_retract: FloatArray
    """Arm angle where the retract ends [rad]; linear along the line, shape (n,).

    Without closed forms as for the
    approach."""
    near: FloatArray
    """Joints whose whole turns those at the target are nearest to [rad], shape (n, joints).

    Without closed forms the
    posture from which the one at the target is found."""

    @classmethod
    def idle(cls, start: FloatArray, stages: int) -> ArmDecisions:
        """Return placeholder rows for idle stages.

        Args:
            start: the arm's joints before the first stage [rad], shape (joints,).
            stages: number of rows.
        """
        number, angle = np.zeros(stages, dtype=np.int64), np.zeros(stages)
        return cls(number, angle, number, angle, angle, angle, np.tile(start, (stages, 1)))

    def take(self, rows: IntArray | slice) -> ArmDecisions:
        """Select rows in the order of the index."""
        return ArmDecisions(*(getattr(self, field.name)[rows] for field in fields(self)))

    def at(self, q_target: FloatArray) -> ArmDecisions:
        """Set the reference joints of the whole turns [rad], shape (n, joints)."""
        return replace(self, near=q_target)

    def compact(self) -> ArmDecisions:
        """Convert to single precision, with angles accurate to 2e-7 rad."""
        small = {np.dtype(np.float64): np.float32, np.dtype(np.int64): np.int16}
        values = (getattr(self, field.name) for field in fields(self))
        return ArmDecisions(*(v.astype(small.get(v.dtype, v.dtype)) for v in values))

    def put(self, rows: IntArray, replacements: ArmDecisions) -> ArmDecisions:
        """Replace rows by all rows of other decisions."""
        merged = {}
        for column in fields(self):
            values = np.array(getattr(self, column.name))
            values[rows] = getattr(replacements, column.name)
            merged[column.name] = values
        return replace(self, **merged)


@dataclass(frozen=True)
class Decisions:
    """Decisions of a whole plan."""

    angle: FloatArray
    """Platform angle of each stage [rad], shape (n,); where it cannot be turned, zeros."""
    arms: tuple[ArmDecisions, ...]
    """Decisions by arm, in the problem's order."""

    @property
    def kind(self) -> bytes:
        """Key of branches, targets and yaws; polishing keeps it."""
        rows = [np.stack([arm.branch, arm.target, np.round(arm.yaw, 6)]) for arm in self.arms]
        return np.concatenate(rows).tobytes()

    def take(self, rows: IntArray) -> Decisions:
        """Select the rows of given stages."""
        return Decisions(self.angle[rows], tuple(arm.take(rows) for arm in self.arms))

    def put(self, rows: IntArray, replacements: Decisions) -> Decisions:
        """Replace given stages by those of another plan."""
        return self.put_all(rows, replacements.take(rows))

    def put_all(self, rows: IntArray, part: Decisions) -> Decisions:
        """Replace given stages by all stages of a partial plan."""
        angle = np.array(self.angle)
        angle[rows] = part.angle
        arms = zip(self.arms, part.arms, strict=True)
        return Decisions(angle, tuple(mine.put(rows, theirs) for mine, theirs in arms))
