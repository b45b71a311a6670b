"""Numbers of studies: units, spans, and differences that show."""

from __future__ import annotations

import pytest

from dualarm_cli.model.place import Place
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.model.studies.study import OBJECTIVES, Amount, Parameter, Span, tidy

MM = {"unit": "mm", "factor": 1e-3, "base": "m"}
HERE = Place("study.yaml", 1, 1)


def test_an_amount_keeps_its_unit_and_knows_its_si_value() -> None:
    """250 mm are 0.25 m; plain numbers are SI."""
    amount = Amount(250.0, **MM)  # type: ignore[arg-type]
    assert amount.si == pytest.approx(0.25)
    assert (amount.written, amount.shown) == ("250.0 mm", "250 mm")
    plain = Amount(3)
    assert (plain.si, plain.written, plain.shown) == (3, 3, "3")


def test_a_span_is_linear_and_as_people_write_it() -> None:
    """From -100 to 200 mm: a third of the way is 0, without a sign; 0.1 + 0.2 is 0.3."""
    span = Span(Amount(-100.0, **MM), Amount(200.0, **MM))  # type: ignore[arg-type]
    shown = [span.at(share).shown for share in (0.0, 1 / 3, 0.5, 1.0)]
    assert shown == ["-100 mm", "0 mm", "50 mm", "200 mm"]
    assert span.at(0.25).si == pytest.approx(-0.025)
    assert tidy(0.1 + 0.2) == 0.3
    assert str(tidy(-0.0)) == "0.0"
    assert tidy(123456.789012) == 123456.789012


def test_a_parameter_is_of_numbers_or_of_words() -> None:
    """One word among numbers makes it no number; the unit is that of the range or of the first value."""
    mm, word = Amount(1.0, **MM), "quick"  # type: ignore[arg-type]
    for levels, span, numeric, unit in [
        ((mm, mm), None, True, "mm"),
        ((mm, word), None, False, "mm"),
        ((word, mm), None, False, ""),
        ((True, False), None, False, ""),
        ((), Span(mm, mm), True, "mm"),
    ]:
        parameter = Parameter("p", (), levels, span, HERE)
        assert (parameter.is_numeric, parameter.unit) == (numeric, unit)


@pytest.mark.parametrize(
    ("name", "value", "less", "shown", "step"),
    [
        # A millisecond, a tenth of a percent, a tenth of a millimetre, a hundredth of a radian show.
        ("cycle_time", 2.0, 1.999, "2.000", 1e-3),
        ("gap", 0.25, 0.249, "25.0", 1e-3),
        ("clearance", 0.0100, 0.0101, "10.0", 1e-4),
        ("travel", 3.14, 3.13, "3.14", 1e-2),
        ("torque", 0.993, 0.992, "99.3", 1e-3),
    ],
)
def test_costs_are_in_the_steps_that_show(
    name: str, value: float, less: float, shown: str, step: float
) -> None:
    """The better value costs one step less, what differs by less than half a step costs the same."""
    objective = OBJECTIVES[name]
    assert objective.step == pytest.approx(step)
    assert objective.shown(value) == shown
    assert objective.shown(None) == "–"
    assert objective.cost(value) - objective.cost(less) == pytest.approx(step)
    assert objective.cost(value) == objective.cost(value + 0.4 * step)
    assert abs(objective.cost(value)) == pytest.approx(value)
    assert objective.label.startswith(objective.title)


def test_settings_remember_what_a_person_named() -> None:
    """None is not named; a later name adds to the earlier ones; a schedule records all but the names."""
    one = PlanSettings().naming(platform="exact", redundancy=None)
    both = one.naming(timing="trapezoid")
    assert (both.platform, both.timing, both.redundancy) == ("exact", "trapezoid", "arm_angle")
    assert both.named == {"platform", "timing"}
    assert "named" not in both.as_dict()
    assert both.as_dict()["platform"] == "exact"
    assert PlanSettings().seed == 0
