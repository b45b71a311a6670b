"""Schema of robot files (`dualarm: robot/1`)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, WithJsonSchema, field_validator, model_validator
from pydantic.config import JsonDict

from dualarm_cli.files.source import quantities
from dualarm_cli.files.source.fields import (
    Angle,
    BodyPair,
    LinkLength,
    Name,
    Pose,
    Quantity,
    Section,
    Size,
    quantity_schema,
    refuse,
    text_pattern,
)
from dualarm_cli.files.source.quantities import Dimension
from dualarm_cli.model.robot import ArmKind

JointSpeed = Annotated[float, Quantity(quantities.ANGULAR_VELOCITY, 1e-6)]
Torque = Annotated[float, Quantity(quantities.TORQUE, 0.0)]


class RowSection(Section):
    """Row of a table: a revolute joint and the link that it moves."""

    joint: Name = Field(description="The joint's name; its link is called `<joint>_link`.")
    a: LinkLength = Field(default=0.0, description="Length of the common normal [m].")
    alpha: Angle = Field(default=0.0, description="Twist about the common normal [rad].")
    d: LinkLength = Field(default=0.0, description="Offset along the joint's axis [m].")
    theta: Angle = Field(default=0.0, description="Offset of the joint's position [rad].")
    lower: Angle = Field(description="Lowest position [rad].")
    upper: Angle = Field(description="Highest position [rad].")
    velocity: JointSpeed = Field(description="Largest speed [rad/s].")
    effort: Torque = Field(default=0.0, description="Largest torque [Nm]; 0: unknown.")
    radius: Size | None = Field(
        default=None,
        description="Radius of a capsule from this joint's origin to the next one's [m]; default: no shape.",
    )

    @model_validator(mode="after")
    def _range(self) -> RowSection:
        if self.lower > self.upper:
            raise refuse(
                f"lower limit {self.lower:g} rad is above upper limit {self.upper:g} rad", "lower"
            )
        return self


Rows = Annotated[list[RowSection], Field(min_length=1, max_length=12)]


class BasesSection(Section):
    """Base of each arm's table."""

    left: Pose = Field(
        default=Pose.model_construct(), description="Frame 0 of the left table in the root link."
    )
    right: Pose = Field(
        default=Pose.model_construct(), description="Frame 0 of the right table in the root link."
    )


class DhSection(Section):
    """Denavit-Hartenberg tables of the arms; every joint is revolute."""

    convention: Literal["standard", "modified"] = Field(
        default="standard",
        description="standard: Rz(theta + q) Tz(d) Tx(a) Rx(alpha); "
        "modified: Rx(alpha) Tx(a) Rz(theta + q) Tz(d), a and alpha those before the joint.",
    )
    left: Rows | None = Field(default=None, description="Rows of the left arm, base to flange.")
    right: Rows | None = Field(default=None, description="Rows of the right arm, base to flange.")
    bases: BasesSection = Field(
        default=BasesSection.model_construct(),
        description="Frame 0 of each arm's DH parameters; by default the root link.",
    )

    @model_validator(mode="after")
    def _some_arm(self) -> DhSection:
        if self.left is None and self.right is None:
            raise refuse("has no table; give left, right or both", code="E202")
        return self

    def tables(self) -> dict[str, list[RowSection]]:
        """Collect the given tables, left before right."""
        pairs = (("left", self.left), ("right", self.right))
        return {side: rows for side, rows in pairs if rows is not None}


JERK_RULE = "acceleration in 0.1 s"
"""Rule of the jerk limit for joints without one in robot file and URDF."""
_NULL: JsonDict = {"type": "null"}


def _rate_schema(rates: Sequence[Dimension], words: Sequence[str]) -> JsonDict:
    """Build the JSON Schema of a limit: a quantity, a rule, or nothing."""
    return {"anyOf": [quantity_schema(rates, 1e-6, words=words), _NULL]}


ACCELERATION = _rate_schema(
    [quantities.ANGULAR_ACCELERATION, quantities.ACCELERATION],
    [rf"\s*top speed in {text_pattern([quantities.TIME])}"],
)
JERK = _rate_schema(
    [quantities.ANGULAR_JERK, quantities.JERK],
    ["none", rf"\s*acceleration in {text_pattern([quantities.TIME])}"],
)
MARGIN: JsonDict = {
    "anyOf": [quantity_schema([quantities.ANGLE, quantities.LENGTH], 0.0, 50.0), _NULL]
}
Position = Annotated[
    Any, WithJsonSchema(quantity_schema([quantities.ANGLE, quantities.LENGTH], -50.0, 50.0))
]
"""Position of a joint, parsed once its type is known."""


def _named_by_tables(schema: JsonDict) -> None:
    """Make joints and flange of an arm optional in the schema.

    With `dh` they have defaults.
    """
    schema.pop("required", None)


def _with_tables_or_urdf(schema: JsonDict) -> None:
    """Require joints and flange of arms without `dh`, and either `dh` or `urdf`."""
    arm: JsonDict = {"required": ["joints", "flange"]}
    sides: JsonDict = {"left": arm, "right": arm}
    tables: JsonDict = {"required": ["dh"], "properties": {"dh": {"type": "object"}}}
    schema["if"] = {"not": tables}
    schema["then"] = {"required": ["urdf"], "properties": {"arms": {"properties": sides}}}


class ArmSection(Section):
    """Arm of the robot."""

    model_config = ConfigDict(json_schema_extra=_named_by_tables)

    joints: Annotated[list[Name], Field(min_length=1, max_length=12)] = Field(
        description="Joints from base to flange, by their names in the URDF; with dh the default is those of its rows."
    )
    flange: Name = Field(
        description="Link to which the tool is bolted; with dh its name, by default `flange` "
        "of a single arm, `left_flange` and `right_flange` of two."
    )
    hand: Name | None = Field(
        default=None,
        description="Link of the arm's own hand, such as its tool frame: `init` and `reach` then assume no gripper. "
        "Needed where the hand has no shapes; `import` takes it from the end effectors of the SRDF.",
    )
    kind: ArmKind | None = Field(
        default=None,
        description="Kind of inverse kinematics; default: measured on the URDF.",
    )


class ArmsSection(Section):
    """Arms of the robot: two, or one."""

    left: ArmSection | None = Field(default=None, description="The left arm.")
    right: ArmSection | None = Field(default=None, description="The right arm.")


class LimitSection(Section):
    """Acceleration, jerk and position margin of a joint; positions and velocity come from the URDF."""

    acceleration: Any = Field(
        default=None,
        description=f"Largest acceleration; a plain number is {quantities.ANGULAR_ACCELERATION.unit} "
        f"({quantities.ACCELERATION.unit} for a joint that slides). A rule takes it from the velocity limit: "
        "`top speed in 0.3 s`.",
        json_schema_extra=ACCELERATION,
    )
    jerk: Any = Field(
        default=None,
        description=f"Largest jerk; a plain number is {quantities.ANGULAR_JERK.unit} "
        f"({quantities.JERK.unit} for a joint that slides). A rule takes it from the acceleration limit: "
        f"`acceleration in 0.1 s`. `none`: unlimited. Default: `{JERK_RULE}`, assumed.",
        json_schema_extra=JERK,
    )
    source: Literal["datasheet", "measured", "joint_limits", "assumed"] = Field(
        default="assumed",
        description="Source of acceleration and jerk: datasheet, measured, joint_limits (joint_limits.yaml), or "
        "assumed; every report lists the assumed ones.",
    )
    position_margin: Any = Field(
        default=None,
        description="Margin to both position limits, also to soft ones of the URDF; a plain number is "
        f"{quantities.ANGLE.unit} ({quantities.LENGTH.unit} for a joint that slides). Default: none.",
        json_schema_extra=MARGIN,
    )


class TorqueSection(Section):
    """Torques of a joint; of a sliding joint forces in N, and masses."""

    effort: Torque | None = Field(
        default=None, description="Largest torque [Nm]; default: the URDF's effort."
    )
    derating: Annotated[float, Quantity(quantities.FRACTION, 0.01, 1.0)] = Field(
        default=1.0, description="Fraction of the effort that may be used."
    )
    rated_effort: Torque | None = Field(
        default=None, description="Largest effective (RMS) torque over a cycle [Nm]; default: none."
    )
    coulomb_friction: Torque = Field(default=0.0, description="Coulomb friction [Nm].")
    viscous_friction: Annotated[float, Field(ge=0.0, le=1e5)] = Field(
        default=0.0, description="Viscous friction [Nm s/rad]."
    )
    rotor_inertia: Annotated[float, Field(ge=0.0, le=1e5)] = Field(
        default=0.0,
        description="Inertia of motor and gear at the joint, times the gear ratio squared [kg m²].",
    )
    spring: Annotated[float, Quantity(quantities.TORQUE)] = Field(
        default=0.0,
        description="Torque of springs and counterweights at position 0 [Nm], towards larger positions.",
    )
    spring_stiffness: Annotated[float, Field(ge=-1e6, le=1e6)] = Field(
        default=0.0, description="Change of that torque by position [Nm/rad]."
    )


class RobotFile(Section):
    """A robot: URDF or tables, platform, arms, limits and named postures."""

    model_config = ConfigDict(json_schema_extra=_with_tables_or_urdf)

    dualarm: Literal["robot/1"] = Field(description="Kind and version of the file.")
    name: Name = Field(description="The robot's name.")
    urdf: Name | None = Field(
        default=None, description="Path of the URDF, relative to this file; or give dh instead."
    )
    dh: DhSection | None = Field(
        default=None,
        description="Denavit-Hartenberg parameters instead of a URDF.",
    )
    platform: Annotated[list[Name], Field(max_length=2)] = Field(
        default_factory=list,
        description="Joints that carry both arms, world side first: none, one or two.",
    )
    arms: ArmsSection = Field(description="Arms: left, right or both.")
    limits: dict[Name, LimitSection] = Field(
        default_factory=dict,
        description="Acceleration, jerk and margin of the moving joints, by name; `default`: all others.",
    )
    torques: dict[Name, TorqueSection] = Field(
        default_factory=dict,
        description="Torque limits of the moving joints, friction, rotors and springs, by name; `default`: all others.",
    )
    frozen: dict[Name, Position] = Field(
        default_factory=dict,
        description="Positions [rad, or m] of joints outside platform and arms; default: 0.",
    )
    postures: dict[Name, dict[Name, Position]] = Field(
        default_factory=dict,
        description="Named postures: joint positions [rad, or m]; joints that are not named are at 0.",
    )
    allowed_contacts: list[BodyPair] = Field(
        default_factory=list,
        description="Pairs of links whose shapes may touch, because the shapes are wider than the links.",
    )
    assumed_contacts: list[BodyPair] = Field(
        default_factory=list,
        description="Pairs of links that touch by assumption, as from `dualarm robot import`; each plan lists them.",
    )

    @field_validator("frozen", mode="before")
    @classmethod
    def _without_joints(cls, frozen: Any) -> Any:
        # As the import's comments say: the line of the last joint is deleted.
        return {} if frozen is None else frozen

    @model_validator(mode="before")
    @classmethod
    def _names_of_tables(cls, data: Any) -> Any:
        return _with_table_names(data) if isinstance(data, dict) and "dh" in data else data


def _with_table_names(data: dict[str, Any]) -> dict[str, Any]:
    """Complete joints and flanges of a file from its tables.

    Faulty tables are reported at their place; here they must not be reported a second time.
    """
    tables, arms = data["dh"], data.get("arms")
    if not isinstance(tables, dict) or not isinstance(arms, dict):
        return data
    sides = [side for side in ("left", "right") if side in tables]
    filled = dict(arms)
    for side, arm in arms.items():
        if side not in ("left", "right") or not isinstance(arm, dict):
            continue
        rows = tables.get(side)
        rows = rows if isinstance(rows, list) else []
        names = [row.get("joint") for row in rows if isinstance(row, dict)]
        joints = [name for name in names if isinstance(name, str) and name.strip()]
        flange = "flange" if len(sides) < 2 else f"{side}_flange"
        filled[side] = {"joints": joints[:12] or ["joint"], "flange": flange, **arm}
    return {**data, "arms": filled}
