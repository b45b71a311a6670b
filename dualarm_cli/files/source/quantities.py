"""Quantities: conversion of numbers with or without units to SI."""

from __future__ import annotations

import math
import re

from dualarm_cli.files.source.text_source import quote
from dualarm_cli.records import dataclass

_NUMBER = r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?"
_QUANTITY = re.compile(rf"({_NUMBER})\s*([A-WYZa-wyz%][A-Za-z0-9/^%]*)?", re.ASCII)
_POWER = re.compile(r"s([23])$")
_LEADING_ZERO = re.compile(r"[-+]?0[0-9]", re.ASCII)
_DECIMAL_COMMA = re.compile(r"([-+]?[0-9]+),([0-9]+)(.*)", re.ASCII | re.DOTALL)
_MINUS_SIGNS = "\u2212\u2010\u2011\u2012\u2013\u2014\ufe63\uff0d"
_SPELLING = str.maketrans({"²": "^2", "³": "^3", "µ": "u", "μ": "u", "°": "deg", "\xa0": " "})
_SMALLEST = 1e-100
_DEG = math.pi / 180.0


@dataclass(frozen=True, eq=False)
class Dimension:
    """A physical quantity: its units, and the sizes that make sense."""

    name: str
    """Name in messages."""
    units: dict[str, float]
    """SI value of each unit; the first is the unit of plain numbers."""
    limit: float
    """Largest plausible magnitude [first unit]."""
    plain: float = math.inf
    """Largest plausible magnitude of a plain number [first unit]; beyond it another unit was meant.
    """
    meant: str = ""
    """Unit that was meant beyond `plain`."""

    @property
    def unit(self) -> str:
        """Unit of plain numbers."""
        return next(iter(self.units))


LENGTH = Dimension(
    "length", {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "um": 1e-6, "in": 0.0254}, 1e3, 50.0, "mm"
)
# Rounded values of 2 pi are turns.
ANGLE = Dimension("angle", {"rad": 1.0, "mrad": 1e-3, "deg": _DEG}, 1e3, 6.29, "deg")
TIME = Dimension("time", {"s": 1.0, "ms": 1e-3, "min": 60.0}, 1e5)
MASS = Dimension("mass", {"kg": 1.0, "g": 1e-3}, 1e5)
DENSITY = Dimension("density", {"kg/m^3": 1.0, "g/cm^3": 1e3}, 1e5)
TORQUE = Dimension("torque", {"Nm": 1.0, "kNm": 1e3}, 1e7)
INERTIA = Dimension("moment of inertia", {"kgm^2": 1.0, "gmm^2": 1e-9}, 1e6)
FRACTION = Dimension("fraction", {"": 1.0, "%": 0.01}, 1e3)
SPEED = Dimension("speed", {"m/s": 1.0, "mm/s": 1e-3}, 1e3, 20.0, "mm/s")
ACCELERATION = Dimension("acceleration", {"m/s^2": 1.0, "mm/s^2": 1e-3}, 1e6)
JERK = Dimension("jerk", {"m/s^3": 1.0, "mm/s^3": 1e-3}, 1e9)
ANGULAR_VELOCITY = Dimension("angular velocity", {"rad/s": 1.0, "deg/s": _DEG}, 1e4)
ANGULAR_ACCELERATION = Dimension("angular acceleration", {"rad/s^2": 1.0, "deg/s^2": _DEG}, 1e6)
ANGULAR_JERK = Dimension("angular jerk", {"rad/s^3": 1.0, "deg/s^3": _DEG}, 1e9)


class QuantityError(ValueError):
    """A quantity that cannot be read, or that is out of range.

    Its text is the whole message.
    """


def parse_quantity(
    value: object, dimension: Dimension, example: str = "", plain: float = math.inf
) -> float:
    """Convert a number or a text such as `120 mm` to SI.

    Args:
        value: a number, or text with a unit; a plain number is SI.
        dimension: the required dimension.
        example: a valid value for messages; default: one of the dimension.
        plain: largest magnitude of a plain number, if less than that of the dimension [first unit].

    Raises:
        QuantityError: no number, an unknown or foreign unit, or an absurd size.
    """
    number, unit = _split(value, example or _example(dimension))
    max_plain = min(plain, dimension.plain)
    sensible = abs(number) * dimension.units.get(dimension.meant, 0.0) < dimension.limit
    if abs(number) > max_plain and not unit and sensible:
        much = "a turn" if dimension is ANGLE else f"{max_plain:g} {dimension.unit}"
        raise QuantityError(
            f"{quote(value)} without a unit is {dimension.unit}, and more than {much}; "
            f"did you mean '{number:g} {dimension.meant}'?"
        )
    unit = unit or dimension.unit
    if unit not in dimension.units:
        units = [name for name in dimension.units if name]
        if not units:
            raise QuantityError(f"{quote(value)}: {dimension.name} has no unit; write {number:g}")
        raise QuantityError(
            f"unit {quote(unit)} in {quote(value)} is not one of {dimension.name}"
            f"; allowed: {', '.join(units)}"
        )
    result = number * dimension.units[unit]
    if not math.isfinite(result) or abs(result) > dimension.limit:
        span = f"-{dimension.limit:g} to {dimension.limit:g} {dimension.unit}".strip()
        raise QuantityError(f"{quote(value)} is outside the range of {dimension.name}: {span}")
    if 0.0 < abs(result) < _SMALLEST:
        raise QuantityError(f"{quote(value)} is too small; write 0")
    return result + 0.0  # -0.0 becomes 0.0


def split_quantity(value: str, example: str = "0.12 or '120 mm'") -> tuple[float, str]:
    """Split a text into number and unit, which may be empty.

    Args:
        value: text such as `120 mm`.
        example: a valid value for messages.

    Raises:
        QuantityError: it is not a number, with or without a unit.
    """
    text = value.strip().translate(_SPELLING).replace("g m", "gm")
    match = _QUANTITY.fullmatch(text) if len(text) <= 80 else None
    if match is None or _LEADING_ZERO.match(text):
        raise QuantityError(f"{quote(value)} is not a number{_advice(text, example)}")
    return float(match[1]), _POWER.sub(r"s^\1", match[2]) if match[2] else ""


def _split(value: object, example: str) -> tuple[float, str]:
    """Split a value into number and unit, which may be empty."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return float(value), ""
    if not isinstance(value, str):
        raise QuantityError(f"must be a number such as {example}, not {quote(value)}")
    return split_quantity(value, example)


def _advice(text: str, example: str) -> str:
    """Advise how to correct a number."""
    comma = _DECIMAL_COMMA.fullmatch(text)
    if comma:
        return f"; write a decimal point: {comma[1]}.{comma[2]}{comma[3]}"
    if any(sign in text for sign in _MINUS_SIGNS):
        return "; write the minus sign as '-' (U+002D)"
    if _LEADING_ZERO.match(text):
        return "; remove the leading zero"
    return f"; write one such as {example}"


def _example(dimension: Dimension) -> str:
    unit = list(dimension.units)[min(1, len(dimension.units) - 1)]
    if dimension is ANGLE:
        unit = "deg"
    return "0.8 or 80%" if dimension is FRACTION else f"'30 {unit}'"
