from __future__ import annotations

import contextlib
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dualarm_cli.files.source import quantities as q
from dualarm_cli.files.source.quantities import Dimension, QuantityError, parse_quantity


@pytest.mark.parametrize(
    ("value", "dimension", "expected"),
    [
        (2, q.LENGTH, 2.0),
        ("120 mm", q.LENGTH, 0.12),
        ("120mm", q.LENGTH, 0.12),
        ("-1.5 cm", q.LENGTH, -0.015),
        ("5 µm", q.LENGTH, 5e-6),
        ("10 in", q.LENGTH, 0.254),
        ("1e2 mm", q.LENGTH, 0.1),
        ("30 deg", q.ANGLE, math.pi / 6),
        ("30deg", q.ANGLE, math.pi / 6),
        ("-90°", q.ANGLE, -math.pi / 2),
        ("0.12 s", q.TIME, 0.12),
        ("30 ms", q.TIME, 0.03),
        ("2 min", q.TIME, 120.0),
        ("250 mm/s", q.SPEED, 0.25),
        ("130 deg/s", q.ANGULAR_VELOCITY, 130 * math.pi / 180),
        ("180 deg/s^2", q.ANGULAR_ACCELERATION, math.pi),
        ("180 deg/s²", q.ANGULAR_ACCELERATION, math.pi),
        ("180 deg/s2", q.ANGULAR_ACCELERATION, math.pi),
        ("360 deg/s³", q.ANGULAR_JERK, 2 * math.pi),
        ("9810 mm/s^2", q.ACCELERATION, 9.81),
        ("800 g", q.MASS, 0.8),
        ("80%", q.FRACTION, 0.8),
        ("80 %", q.FRACTION, 0.8),
        (0.8, q.FRACTION, 0.8),
    ],
)
def test_units_become_si(value: object, dimension: Dimension, expected: float) -> None:
    """Hand arithmetic for every dimension; a space before the unit is optional."""
    assert parse_quantity(value, dimension) == pytest.approx(expected, rel=1e-15)


@pytest.mark.parametrize(
    ("value", "dimension", "message"),
    [
        (
            "30 kg",
            q.LENGTH,
            "unit 'kg' in '30 kg' is not one of length; allowed: m, mm, cm, um, in",
        ),
        (
            "3 mm",
            Dimension("direction component", {"": 1.0}, 1e3),
            "'3 mm': direction component has no unit; write 3",
        ),
        (
            "30 mmm",
            q.LENGTH,
            "unit 'mmm' in '30 mmm' is not one of length; allowed: m, mm, cm, um, in",
        ),
        ("1,5", q.LENGTH, "'1,5' is not a number; write a decimal point: 1.5"),
        ("1,5 mm", q.LENGTH, "'1,5 mm' is not a number; write a decimal point: 1.5 mm"),
        ("−5", q.LENGTH, "'−5' is not a number; write the minus sign as '-' (U+002D)"),
        ("017", q.LENGTH, "'017' is not a number; remove the leading zero"),
        ("12:30", q.TIME, "'12:30' is not a number; write one such as '30 ms'"),
        ("0x10", q.LENGTH, "'0x10' is not a number; write one such as '30 mm'"),
        ("pi/2", q.ANGLE, "'pi/2' is not a number; write one such as '30 deg'"),
        ("٣", q.ANGLE, "'٣' is not a number; write one such as '30 deg'"),
        ("", q.FRACTION, "'' is not a number; write one such as 0.8 or 80%"),
        (True, q.LENGTH, "must be a number such as '30 mm', not true"),
        (None, q.LENGTH, "must be a number such as '30 mm', not nothing"),
        ([1], q.LENGTH, "must be a number such as '30 mm', not a list of 1"),
        (1e308, q.LENGTH, "1e+308 is outside the range of length: -1000 to 1000 m"),
        ("5 km", q.LENGTH, "unit 'km' in '5 km' is not one of length; allowed: m, mm, cm, um, in"),
        (math.nan, q.LENGTH, "nan is outside the range of length: -1000 to 1000 m"),
        (1e-320, q.LENGTH, "1e-320 is too small; write 0"),
        (180, q.ANGLE, "180 without a unit is rad, and more than a turn; did you mean '180 deg'?"),
        (
            "-90",
            q.ANGLE,
            "'-90' without a unit is rad, and more than a turn; did you mean '-90 deg'?",
        ),
        (150, q.LENGTH, "150 without a unit is m, and more than 50 m; did you mean '150 mm'?"),
        (
            -50.5,
            q.LENGTH,
            "-50.5 without a unit is m, and more than 50 m; did you mean '-50.5 mm'?",
        ),
        (250, q.SPEED, "250 without a unit is m/s, and more than 20 m/s; did you mean '250 mm/s'?"),
        ("1e6 rad", q.ANGLE, "'1e6 rad' is outside the range of angle: -1000 to 1000 rad"),
    ],
)
def test_what_is_no_quantity_is_quoted_with_what_to_write(
    value: object, dimension: Dimension, message: str
) -> None:
    """The message quotes the text and says what is allowed."""
    with pytest.raises(QuantityError) as caught:
        parse_quantity(value, dimension)
    assert str(caught.value).startswith(message)


def test_negative_zero_becomes_zero() -> None:
    """A sign on nothing would show up in outputs."""
    assert math.copysign(1.0, parse_quantity(-0.0, q.LENGTH)) == 1.0
    assert math.copysign(1.0, parse_quantity("-0 mm", q.LENGTH)) == 1.0


@given(st.text(max_size=40))
def test_any_text_is_a_number_or_refused(text: str) -> None:
    """No text gets anything but a finite number or a QuantityError."""
    with contextlib.suppress(QuantityError):
        assert math.isfinite(parse_quantity(text, q.ANGLE))


def test_a_plain_number_at_the_limit_and_any_with_its_unit_are_read() -> None:
    """What is meant in metres can always be written so."""
    assert parse_quantity(50, q.LENGTH) == 50
    assert parse_quantity("150 m", q.LENGTH) == 150
    assert parse_quantity("1 m", q.LENGTH, plain=0.5) == 1
    assert parse_quantity(20, q.SPEED) == 20
    with pytest.raises(QuantityError, match=r"more than 0.5 m; did you mean '1 mm'"):
        parse_quantity(1, q.LENGTH, plain=0.5)


@given(st.floats(-50, 50).filter(lambda x: x == 0 or abs(x) > 1e-90))
def test_plain_numbers_and_their_text_mean_the_same(x: float) -> None:
    """A number, its text and its text with the SI unit agree to the last bit."""
    assert parse_quantity(x, q.LENGTH) == parse_quantity(f"{x!r} m", q.LENGTH) == x
