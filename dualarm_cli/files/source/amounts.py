"""Numbers of files with their units: reading, conversion, shift and scale."""

from __future__ import annotations

from dualarm_cli.files.source import quantities
from dualarm_cli.files.source.quantities import (
    Dimension,
    QuantityError,
    parse_quantity,
    split_quantity,
)
from dualarm_cli.files.source.text_source import quote
from dualarm_cli.model.studies.study import Amount, tidy

DIMENSIONS = (
    quantities.LENGTH,
    quantities.ANGLE,
    quantities.TIME,
    quantities.MASS,
    quantities.DENSITY,
    quantities.INERTIA,
    quantities.TORQUE,
    quantities.FRACTION,
    quantities.SPEED,
    quantities.ACCELERATION,
    quantities.JERK,
    quantities.ANGULAR_VELOCITY,
    quantities.ANGULAR_ACCELERATION,
    quantities.ANGULAR_JERK,
)
"""Every dimension of a file; unit names are unique."""
_DIMENSION_OF = {unit: d for d in DIMENSIONS for unit in d.units if unit}


def read_amount(value: object) -> Amount:
    """Read a number with its unit, of any dimension.

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
        units = ", ".join(_DIMENSION_OF)
        raise QuantityError(f"unknown unit {quote(unit)} in {quote(value)}; allowed: {units}")
    parse_quantity(value, dimension)
    return Amount(number, unit, dimension.units[unit], dimension.unit)


def in_unit(amount: Amount, reference: Amount) -> Amount:
    """Convert an amount to the unit of another one.

    Raises:
        QuantityError: they are not of one dimension.
    """
    if amount.unit == reference.unit:
        return amount
    if amount.unit and reference.unit and _dimension(amount) is not _dimension(reference):
        raise QuantityError(
            f"{quote(amount.shown)} is {_named(amount)}, {quote(reference.shown)} is {_named(reference)}"
        )
    return Amount(
        tidy(amount.si / reference.factor), reference.unit, reference.factor, reference.base
    )


def one_unit(amounts: list[Amount]) -> list[Amount]:
    """Convert amounts to the unit of the first that has one.

    Raises:
        QuantityError: they are not of one dimension.
    """
    lead = next((a for a in amounts if a.unit), amounts[0])
    return [in_unit(amount, lead) for amount in amounts]


def shifted(amount: Amount, by: Amount) -> Amount:
    """Add an amount to a file's number, in the file's unit.

    If only the other one has a unit, the result is in SI with its unit, which shows whether it belongs there.

    Raises:
        QuantityError: they are not of one dimension.
    """
    moved = in_unit(by, amount) if amount.unit or not by.unit else by
    if moved.number == 0:
        return amount
    if amount.unit == moved.unit:
        return _like(amount, amount.number + moved.number, by)
    return Amount(tidy(amount.si + by.si), by.base, 1.0, by.base)


def scaled(amount: Amount, by: Amount) -> Amount:
    """Multiply a file's number by a factor, in the file's unit.

    Raises:
        QuantityError: the factor is not a plain number or fraction.
    """
    if by.base:
        raise QuantityError(
            f"{quote(by.shown)} cannot scale a value; write a factor such as 0.9 or 90%"
        )
    return amount if by.si == 1.0 else _like(amount, amount.number * by.si, by)


def _like(amount: Amount, number: float, by: Amount) -> Amount:
    """Build an amount in a file's unit; integers stay integers."""
    whole = isinstance(amount.number, int) and isinstance(by.number, int) and not by.unit
    return Amount(int(number) if whole else tidy(number), amount.unit, amount.factor, amount.base)


def _dimension(amount: Amount) -> Dimension:
    """Find the dimension of an amount that has a unit."""
    return _DIMENSION_OF[amount.unit]


def _named(amount: Amount) -> str:
    name = _dimension(amount).name
    return f"{'an' if name[0] in 'aeiou' else 'a'} {name}"
