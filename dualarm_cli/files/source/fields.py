"""Field types of the file schemas: quantities with units, names and poses.

The JSON Schema of a quantity is a number, or text with a unit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
import pinocchio as pin
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    WithJsonSchema,
    model_validator,
)
from pydantic.config import JsonDict
from pydantic_core import PydanticCustomError, core_schema

from dualarm_cli.files.source import quantities
from dualarm_cli.files.source.quantities import (
    Dimension,
    QuantityError,
    parse_quantity,
    split_quantity,
)
from dualarm_cli.files.source.text_source import quote
from dualarm_cli.model.part_flow import PoseRange
from dualarm_cli.records import dataclass

MAX_NAME_LENGTH = 120
"""Maximum length of a name or id."""
QUATERNION_TOLERANCE = 1e-3
"""Tolerance of a quaternion's norm."""
SMALLEST_POSITIVE = 1e-9
"""Least size, rate or duration that counts as positive [SI]."""
LONGEST_CLEARANCE = 1.0
"""Longest clearance, stand-off, tolerance, grip or opening of jaws without a unit [m]."""
LONGEST_REACH = 5.0
"""Longest tool, link, line or radius of a curve without a unit [m]."""


def refuse(message: str, key: str = "", code: str = "E200") -> PydanticCustomError:
    """Create the error that a validator raises; `key` points at one key of the mapping."""
    return PydanticCustomError("refused", "{text}", {"text": message, "key": key, "code": code})


class Section(BaseModel):
    """A mapping of an input file: no conversions, no unknown keys, frozen.

    A default that is a section is made by `model_construct`: validating it when its module is loaded would build its
    schema at once, which `defer_build` puts off.
    """

    model_config = ConfigDict(
        strict=True, extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True
    )


@dataclass(frozen=True)
class Quantity:
    """Field annotation of a number with or without unit, in SI after validation."""

    dimension: Dimension
    """Dimension of the quantity."""
    low: float = -math.inf
    """Minimum [SI]."""
    high: float = math.inf
    """Maximum [SI]."""
    plain: float = math.inf
    """Largest plain number, if smaller than that of the dimension."""

    def read(self, value: object) -> float:
        """Parse the value [SI]; raises an error for pydantic."""
        try:
            number = parse_quantity(value, self.dimension, plain=self.plain)
        except QuantityError as error:
            raise refuse(str(error)) from None
        if number < self.low:
            relation = "at least " + self._limit(value, self.low)
            relation = "positive" if number <= 0.0 < self.low < 1e-3 else relation
            raise refuse(f"{quote(value)}: {self.dimension.name} must be {relation}")
        if number > self.high:
            most = self._limit(value, self.high)
            raise refuse(f"{quote(value)}: {self.dimension.name} must be at most {most}")
        return number

    def _limit(self, value: object, limit: float) -> str:
        """Format a limit [SI] in the unit of a value."""
        unit = (isinstance(value, str) and split_quantity(value)[1]) or self.dimension.unit
        return f"{limit / self.dimension.units[unit]:g} {unit}".rstrip() if limit else "0"

    def __get_pydantic_core_schema__(
        self, source: type[Any], handler: GetCoreSchemaHandler
    ) -> core_schema.CoreSchema:
        """Parse the value before pydantic checks that it is a finite float."""
        return core_schema.no_info_before_validator_function(self.read, handler(source))

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """Build the JSON Schema: a number within the range, or text with a unit."""
        most = min(self.plain, self.dimension.plain)
        return quantity_schema(
            [self.dimension], max(self.low, -most), min(self.high, most, self.dimension.limit)
        )


Length = Annotated[float, Quantity(quantities.LENGTH)]
Distance = Annotated[float, Quantity(quantities.LENGTH, 0.0)]
Clearance = Annotated[float, Quantity(quantities.LENGTH, 0.0, plain=LONGEST_CLEARANCE)]
StraightLine = Annotated[float, Quantity(quantities.LENGTH, 0.0, plain=LONGEST_REACH)]
Symmetry = Annotated[int, Field(ge=1, le=360)]
LinkLength = Annotated[float, Quantity(quantities.LENGTH, plain=LONGEST_REACH)]
Size = Annotated[float, Quantity(quantities.LENGTH, SMALLEST_POSITIVE)]
WithinReach = Annotated[float, Quantity(quantities.LENGTH, SMALLEST_POSITIVE, plain=LONGEST_REACH)]
SmallSize = Annotated[
    float, Quantity(quantities.LENGTH, SMALLEST_POSITIVE, plain=LONGEST_CLEARANCE)
]
Angle = Annotated[float, Quantity(quantities.ANGLE)]
Duration = Annotated[float, Quantity(quantities.TIME, 0.0)]
Mass = Annotated[float, Quantity(quantities.MASS, 0.0)]
Density = Annotated[float, Quantity(quantities.DENSITY, SMALLEST_POSITIVE)]
ToolSpeed = Annotated[float, Quantity(quantities.SPEED, 1e-6)]
SpeedFraction = Annotated[float, Quantity(quantities.FRACTION, 1e-3, 1.0)]
Tilt = Annotated[float, Quantity(quantities.ANGLE, 0.01, math.pi / 2.0)]
Scale = Annotated[float, Quantity(quantities.FRACTION, SMALLEST_POSITIVE)]


def check_name(text: str) -> str:
    """Validate a name and return it: printable, trimmed, not too long."""
    if not text.strip():
        raise refuse("must not be empty")
    if len(text) > MAX_NAME_LENGTH:
        raise refuse(f"{quote(text)} has {len(text)} characters; at most {MAX_NAME_LENGTH}")
    if not text.isprintable():
        raise refuse(f"{quote(text)} has characters that cannot be printed; remove them")
    if text != text.strip():
        raise refuse(f"{quote(text)} begins or ends with a space; remove it")
    return text


NAME_SCHEMA: JsonDict = {
    "type": "string",
    "minLength": 1,
    "maxLength": MAX_NAME_LENGTH,
    "pattern": r"^\S(.*\S)?$",
}
"""JSON Schema of the names that `check_name` accepts.

A schema cannot express which characters are printable.
"""
Name = Annotated[str, AfterValidator(check_name), WithJsonSchema(NAME_SCHEMA)]
BodyPair = Annotated[list[Name], Field(min_length=2, max_length=2)]
Vector3 = Annotated[list[Length], Field(min_length=3, max_length=3)]
ToolVector3 = Annotated[list[LinkLength], Field(min_length=3, max_length=3)]
BeltSpeed = Annotated[float, Quantity(quantities.SPEED, -10.0, 10.0)]
Velocity3 = Annotated[list[BeltSpeed], Field(min_length=3, max_length=3)]
Angles3 = Annotated[list[Angle], Field(min_length=3, max_length=3)]


def _unit_quaternion(values: list[float]) -> list[float]:
    norm = math.sqrt(sum(v * v for v in values))
    if abs(norm - 1.0) > QUATERNION_TOLERANCE:
        raise refuse(
            f"a quaternion [x, y, z, w] must have length 1, not {norm:.6g}; divide by its length"
        )
    return [v / norm for v in values]


QuaternionPart = Annotated[float, Quantity(Dimension("quaternion part", {"": 1.0}, 10.0))]
Quaternion = Annotated[
    list[QuaternionPart], Field(min_length=4, max_length=4), AfterValidator(_unit_quaternion)
]


class Pose(Section):
    """A pose: translation, then rotation by `rpy` or `quat`; missing values are zero."""

    xyz: Vector3 | None = Field(default=None, description="Translation [m]; default zero.")
    rpy: Angles3 | None = Field(
        default=None,
        description="Rotations about the fixed axes x, then y, then z [rad], as in URDF.",
    )
    quat: Quaternion | None = Field(
        default=None, description="Unit quaternion [x, y, z, w] instead of rpy."
    )

    @model_validator(mode="after")
    def _one_rotation(self) -> Pose:
        if self.rpy is not None and self.quat is not None:
            raise refuse("rpy and quat both give the rotation; keep one", "quat")
        return self


class ToolPose(Pose):
    """A pose on a tool or flange; missing values are zero."""

    xyz: ToolVector3 | None = Field(default=None, description="Translation [m]; default zero.")


class FramedPose(Pose):
    """A pose in the world or in a named frame."""

    in_: Name | None = Field(
        default=None, alias="in", description="Named reference frame; default: world."
    )


DirectionPart = Annotated[float, Quantity(Dimension("direction component", {"": 1.0}, 1e3))]


class LineSection(Section):
    """Straight line of the tool to a target, or away from it."""

    distance: StraightLine = Field(description="Length of the line [m].")
    direction: Annotated[list[DirectionPart], Field(min_length=3, max_length=3)] | None = Field(
        default=None,
        description="Vector along which the tool moves; default: along its own z axis, to the target or back.",
    )
    in_: Name | None = Field(
        default=None,
        alias="in",
        description="Frame of the direction: tool, which turns with the tool, world, or a frame of the cell.",
    )

    @model_validator(mode="after")
    def _framed(self) -> LineSection:
        if self.direction is None and self.in_ is not None:
            raise refuse("'in' is the frame of a direction; give direction, or remove it", "in")
        if self.direction is not None and self.in_ is None:
            raise refuse(
                "'in' is missing: give in: tool, in: world, or a frame of the cell", "direction"
            )
        if self.direction is not None and math.hypot(*self.direction) < SMALLEST_POSITIVE:
            raise refuse(
                "a direction has a length; give [0, 0, 1] for upwards in the world", "direction"
            )
        return self


class VariesSection(Section):
    """Deviations of a pose, evenly distributed, along and about the axes of its frame."""

    xy: Clearance = Field(default=0.0, description="Largest deviation along x, and along y [m].")
    z: Clearance = Field(default=0.0, description="Largest deviation along z [m].")
    yaw: Annotated[float, Quantity(quantities.ANGLE, 0.0, math.pi)] = Field(
        default=0.0, description="Largest turn about z [rad]."
    )

    @model_validator(mode="after")
    def _something(self) -> VariesSection:
        if not (self.xy or self.z or self.yaw):
            raise refuse("no deviation; give xy, z or yaw above 0, or remove 'varies'")
        return self

    def about(self, of: str, centre: pin.SE3) -> PoseRange:
        """Build the range of a pose about a centre in the world."""
        return PoseRange(of, centre, self.xy, self.z, self.yaw)


def to_se3(pose: Pose) -> pin.SE3:
    """Compute the transform T_parent_child of a pose in a file.

    `rpy` turns about the parent's fixed axes x, then y, then z, as in URDF:
    R = Rz(yaw) Ry(pitch) Rx(roll).

    Args:
        pose: translation [m] and rotation [rad]; what is missing is zero.
    """
    if pose.quat is not None:
        x, y, z, w = pose.quat
        rotation = pin.Quaternion(w, x, y, z).toRotationMatrix()
    elif pose.rpy is not None:
        rotation = pin.rpy.rpyToMatrix(*pose.rpy)
    else:
        rotation = np.eye(3)
    return pin.SE3(rotation, np.array(pose.xyz or [0.0, 0.0, 0.0]))


NUMBER = r"[-+]?(\.[0-9]+|(0|[1-9][0-9]*)(\.[0-9]*)?)([eE][-+]?[0-9]+)?"
"""Pattern of numbers in files: a decimal point, no leading zero."""
_SPELLINGS = {"^2": "(\\^2|2|²)", "^3": "(\\^3|3|³)", "um": "[uµμ]m", "deg": "(deg|°)"}
"""Patterns of alternative spellings of units."""


def quantity_schema(
    dimensions: Sequence[Dimension],
    low: float = -math.inf,
    high: float = math.inf,
    words: Sequence[str] = (),
) -> JsonDict:
    """Build the JSON Schema of a bounded number, or of text with a unit.

    A schema cannot express the range of text with a unit.

    Args:
        dimensions: the quantities that are accepted.
        low: least plain number.
        high: greatest plain number.
        words: patterns of texts that may stand in place of a quantity.
    """
    units = [unit for dimension in dimensions for unit in dimension.units if unit]
    plain = " or ".join(dict.fromkeys(d.unit for d in dimensions if d.unit))
    number: JsonDict = {"type": "number", "title": plain or "number"}
    if low > -math.inf:
        number["minimum"] = low
    if high < math.inf:
        number["maximum"] = high
    text: JsonDict = {
        "type": "string",
        "title": f"with a unit: {', '.join(units)}" if units else "number as text",
        "pattern": "|".join(f"^{pattern}$" for pattern in (text_pattern(dimensions), *words)),
    }
    return {"anyOf": [number, text]}


def text_pattern(dimensions: Sequence[Dimension]) -> str:
    """Build the pattern of a number as text with an optional unit."""
    units = [_unit(unit) for dimension in dimensions for unit in dimension.units if unit]
    return rf"\s*{NUMBER}\s*" + (rf"({'|'.join(units)})?\s*" if units else "")


def _unit(unit: str) -> str:
    """Build the pattern of a unit's spellings."""
    for plain, pattern in _SPELLINGS.items():
        unit = unit.replace(plain, pattern)
    return unit
