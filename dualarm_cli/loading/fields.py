"""Field types of the file schemas: quantities with units, names, poses."""

from __future__ import annotations

import math
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, model_validator
from pydantic.json_schema import WithJsonSchema
from pydantic_core import PydanticCustomError

from dualarm_cli.loading import quantities
from dualarm_cli.loading.quantities import Dimension, QuantityError, parse_quantity
from dualarm_cli.loading.text_source import quote

MAX_NAME_LENGTH = 120
"""Longest name or id."""
QUATERNION_TOLERANCE = 1e-3
"""How far a quaternion's norm may be from 1."""
SMALLEST_POSITIVE = 1e-9
"""Least size, rate or duration that counts as positive [SI]."""


def refuse(message: str, key: str = "", code: str = "E200") -> PydanticCustomError:
    """Returns the error that a validator raises; `key` points at one key of the mapping."""
    return PydanticCustomError("refused", "{text}", {"text": message, "key": key, "code": code})


class Section(BaseModel):
    """A mapping of an input file: no conversions, no unknown keys, frozen."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)


def _quantity(dimension: Dimension, low: float | None = None, high: float | None = None) -> Any:
    """Returns the field type of a physical quantity, in SI after validation."""

    def read(value: object) -> float:
        try:
            number = parse_quantity(value, dimension)
        except QuantityError as error:
            raise refuse(str(error)) from None
        if low is not None and number < low:
            relation = "positive" if low > 0.0 else f"at least {low:g}"
            raise refuse(f"{quote(value)}: {dimension.name} must be {relation}")
        if high is not None and number > high:
            raise refuse(f"{quote(value)}: {dimension.name} must be at most {high:g}")
        return number

    units = ", ".join(unit for unit in dimension.units if unit)
    schema = {
        "anyOf": [{"type": "number"}, {"type": "string"}],
        "description": f"{dimension.name}: a plain number is {dimension.unit or 'a fraction'}; "
        f"or text with a unit ({units})",
    }
    return Annotated[float, BeforeValidator(read), WithJsonSchema(schema)]


Length = _quantity(quantities.LENGTH)
Distance = _quantity(quantities.LENGTH, 0.0)
Size = _quantity(quantities.LENGTH, SMALLEST_POSITIVE)
Angle = _quantity(quantities.ANGLE)
Duration = _quantity(quantities.TIME, 0.0)
Mass = _quantity(quantities.MASS, 0.0)
ToolSpeed = _quantity(quantities.SPEED, 1e-6)
SpeedFraction = _quantity(quantities.FRACTION, 1e-3, 1.0)
Scale = _quantity(quantities.FRACTION, SMALLEST_POSITIVE)


def check_name(text: str) -> str:
    """Returns a name that is fit to be shown and written; raises otherwise."""
    if not text.strip():
        raise refuse("must not be empty")
    if len(text) > MAX_NAME_LENGTH:
        raise refuse(f"{quote(text)} has {len(text)} characters; at most {MAX_NAME_LENGTH}")
    if not text.isprintable():
        raise refuse(f"{quote(text)} has characters that cannot be printed; remove them")
    if text != text.strip():
        raise refuse(f"{quote(text)} begins or ends with a space; remove it")
    return text


Name = Annotated[str, AfterValidator(check_name)]
Vector3 = Annotated[list[Length], Field(min_length=3, max_length=3)]
Angles3 = Annotated[list[Angle], Field(min_length=3, max_length=3)]


def _unit_quaternion(values: list[float]) -> list[float]:
    norm = math.sqrt(sum(v * v for v in values))
    if abs(norm - 1.0) > QUATERNION_TOLERANCE:
        raise refuse(f"a quaternion [x, y, z, w] must have length 1, not {norm:.6g}; divide by its length")
    return [v / norm for v in values]


QuaternionPart = _quantity(Dimension("quaternion", {"": 1.0}, 10.0))
Quaternion = Annotated[
    list[QuaternionPart], Field(min_length=4, max_length=4), AfterValidator(_unit_quaternion)
]


class Pose(Section):
    """A pose: translation, then rotation given by `rpy` or `quat`; what is missing is zero."""

    xyz: Vector3 | None = Field(None, description="Translation [m]; default zero.")
    rpy: Angles3 | None = Field(
        None, description="Turns about the fixed axes x, then y, then z [rad], as in URDF."
    )
    quat: Quaternion | None = Field(None, description="Unit quaternion [x, y, z, w] instead of rpy.")

    @model_validator(mode="after")
    def _one_rotation(self) -> Pose:
        if self.rpy is not None and self.quat is not None:
            raise refuse("rpy and quat both give the rotation; keep one", "quat")
        return self


class FramedPose(Pose):
    """A pose in the world or in a named frame."""

    in_: Name | None = Field(None, alias="in", description="Named frame that it is given in; default world.")
