"""Numbers with units: converted, moved, multiplied as by hand."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dualarm_cli.files.source.amounts import (
    DIMENSIONS,
    in_unit,
    one_unit,
    read_amount,
    scaled,
    shifted,
)
from dualarm_cli.files.source.quantities import QuantityError, parse_quantity


def test_no_two_dimensions_share_a_unit() -> None:
    """Else a unit alone would not say what a number is."""
    units = [unit for dimension in DIMENSIONS for unit in dimension.units if unit]
    assert len(units) == len(set(units))


@pytest.mark.parametrize(
    ("value", "si", "written"),
    [(3, 3, 3), (0.5, 0.5, 0.5), ("120 mm", 0.12, "120.0 mm"), ("50%", 0.5, "50.0 %"), ("2", 2.0, 2.0)],
)  # fmt: skip
def test_an_amount_is_what_it_says(value: object, si: float, written: object) -> None:
    """And can be written into a file again."""
    amount = read_amount(value)
    assert (amount.si, amount.written) == (si, written)


@given(
    st.sampled_from([(d, unit) for d in DIMENSIONS for unit in d.units if unit]),
    st.floats(-100, 100).filter(lambda x: x == 0.0 or abs(x) > 1e-3),
)
def test_what_is_written_is_read_as_the_same_number(unit: tuple, number: float) -> None:
    """To the last bit, by the reader of files."""
    dimension, name = unit
    amount = read_amount(f"{number!r} {name}")
    assert parse_quantity(amount.written, dimension) == amount.si + 0.0


@pytest.mark.parametrize("value", [True, None, [1], "x", "3 parsec", "1,5", "2000 m"])
def test_what_is_no_number_is_refused(value: object) -> None:
    """As in any other file."""
    with pytest.raises(QuantityError):
        read_amount(value)


def test_units_are_those_of_the_first_that_has_one() -> None:
    """0 and 0.2 among millimetres are 0 mm and 200 mm."""
    amounts = one_unit([read_amount(0), read_amount("120 mm"), read_amount(0.2)])
    assert [amount.shown for amount in amounts] == ["0 mm", "120 mm", "200 mm"]
    with pytest.raises(QuantityError, match="is a length, '5 deg' is an angle"):
        in_unit(read_amount("1 m"), read_amount("5 deg"))


@pytest.mark.parametrize(
    ("found", "by", "moved"),
    [(0.75, "20 mm", "0.77 m"), ("120 mm", "-2 cm", "100.0 mm"), (2, 1, 3), (0.1, 0.2, 0.3), ("80%", "5%", "85.0 %"),
     ("1 deg", 0, "1.0 deg")],
)  # fmt: skip
def test_a_shift_is_added(found: object, by: object, moved: object) -> None:
    """A unit is kept so that the reader sees whether it belongs there; counts stay whole."""
    result = shifted(read_amount(found), read_amount(by)).written
    assert result == moved
    assert type(result) is type(moved)


def test_a_shift_by_another_dimension_is_refused() -> None:
    """Also a factor must have no unit."""
    with pytest.raises(QuantityError, match="'5 deg' is an angle"):
        shifted(read_amount("1 m"), read_amount("5 deg"))
    with pytest.raises(
        QuantityError, match=r"cannot scale a value; write a factor such as 0.9 or 90%"
    ):
        scaled(read_amount(1.0), read_amount("5 mm"))


@pytest.mark.parametrize(
    ("found", "by", "result"),
    [
        (7.6, "150%", 11.4),
        ("100 mm", 0.5, "50.0 mm"),
        (3, 2, 6),
        (0.5235987755982989, "100%", 0.5235987755982989),
    ],
)
def test_a_factor_multiplies(found: object, by: object, result: object) -> None:
    """In the file's unit; one changes nothing, however many digits there are."""
    assert scaled(read_amount(found), read_amount(by)).written == result
