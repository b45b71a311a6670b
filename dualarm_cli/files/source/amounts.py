"""Numbers as files have them, with their units: read, converted, moved."""

from __future__ import annotations

from dualarm_cli.files.source import quantities
from dualarm_cli.files.source.quantities import (
    Dimension,
    QuantityError,
    parse_quantity,
    split_quantity,
)
from dualarm_cli.files.source.text_source import quote
from dualarm_cli.model.study import Amount, tidy

DIMENSIONS = (
    quantities.LENGTH,
    quantities.ANGLE,
    quantities.TIME,
    quantities.MASS,
    quantities.TORQUE,
    quantities.FRACTION,
    quantities.SPEED,
    quantities.ACCELERATION,
    quantities.JERK,
    quantities.ANGULAR_VELOCITY,
    quantities.ANGULAR_ACCELERATION,
    quantities.ANGULAR_JERK,
)
"""Every dimension that a file can have; no two share the name of a unit."""
_DIMENSION_OF = {unit: d for d in DIMENSIONS for unit in d.units if unit}


def read_amount(value: object) -> Amount:
    """Return a number with its unit, whatever its dimension.

    Args:
        value: a number, or text such as `120 mm`.

    Raises:
        QuantityError: no number, an unknown unit, or an absurd size.
    """
    if isinstance(value, int | float) and not isinstance(value, bool):
        return Amount(value)
    if not isinstance(value, str):
        raise QuantityError(f"must be a number such as 0.12 or '120 mm', not {quote(value)}")
    number, unit = split_quantity(value)
    if not unit:
        return Amount(number)
    dimension = _DIMENSION_OF.get(unit)
    if dimension is None:
        known = ", ".join(_DIMENSION_OF)
        raise QuantityError(f"unknown unit {quote(unit)} in {quote(value)}; known: {known}")
    parse_quantity(value, dimension)
    return Amount(number, unit, dimension.units[unit], dimension.unit)


def in_unit(amount: Amount, other: Amount) -> Amount:
    """Return an amount in the unit of another one.

    Raises:
        QuantityError: they are not of one dimension.
    """
    if amount.unit == other.unit:
        return amount
    if amount.unit and other.unit and _dimension(amount) is not _dimension(other):
        raise QuantityError(
            f"{quote(amount.shown)} is {_named(amount)}, {quote(other.shown)} is {_named(other)}"
        )
    return Amount(tidy(amount.si / other.factor), other.unit, other.factor, other.base)


def one_unit(amounts: list[Amount]) -> list[Amount]:
    """Return amounts in one unit: that of the first that has one.

    Raises:
        QuantityError: they are not of one dimension.
    """
    lead = next((a for a in amounts if a.unit), amounts[0])
    return [in_unit(amount, lead) for amount in amounts]


def shifted(found: Amount, by: Amount) -> Amount:
    """Return a file's number plus another, in the file's unit.

    Where only the other one has a unit the result is SI with its unit, so that whoever reads it sees whether it belongs
    there.

    Raises:
        QuantityError: they are not of one dimension.
    """
    moved = in_unit(by, found) if found.unit or not by.unit else by
    if moved.number == 0:
        return found
    if found.unit == moved.unit:
        return _like(found, found.number + moved.number, by)
    return Amount(tidy(found.si + by.si), by.base, 1.0, by.base)


def scaled(found: Amount, by: Amount) -> Amount:
    """Return a file's number times another, in the file's unit.

    Raises:
        QuantityError: the other one is no plain number or fraction.
    """
    if by.base:
        raise QuantityError(
            f"{quote(by.shown)} cannot scale a value; write a factor such as 0.9 or 90%"
        )
    return found if by.si == 1.0 else _like(found, found.number * by.si, by)


def _like(found: Amount, number: float, by: Amount) -> Amount:
    """Return a number in a file's unit; a whole one where all were whole, as counts are."""
    whole = isinstance(found.number, int) and isinstance(by.number, int) and not by.unit
    return Amount(int(number) if whole else tidy(number), found.unit, found.factor, found.base)


def _dimension(amount: Amount) -> Dimension:
    """Return the dimension of an amount that has a unit."""
    return _DIMENSION_OF[amount.unit]


def _named(amount: Amount) -> str:
    name = _dimension(amount).name
    return f"{'an' if name[0] in 'aeiou' else 'a'} {name}"
