"""Sensitivity of functions whose shares, slopes and ranks are known."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dualarm_cli.model.studies.study import Sampling
from dualarm_cli.studies.document import (
    StudySensitivity,
    numeric_factor,
    sensitivity,
    word_factor,
)
from dualarm_cli.studies.search import sample_shares


def _grid(function, *levels) -> StudySensitivity:
    """Returns the sensitivity of a function on a whole grid."""
    points = np.array(list(product(*levels)), dtype=np.float64)
    values = np.array([function(*point) for point in points])
    factors = [numeric_factor(f"p{k}", points[:, k], own) for k, own in enumerate(levels)]
    return sensitivity(factors, values, stepped=True)


def _of(found: StudySensitivity, name: str):
    return next(one for one in found.influences if one.parameter == name)


@given(st.lists(st.floats(-5, 5).filter(lambda b: abs(b) > 0.1), min_size=2, max_size=3))
def test_of_a_linear_function_everything_is_known(slopes: list[float]) -> None:
    """Levels -1, 0, 1: variances are 2/3 b^2; effects 2|b|; standardised slopes b / norm(b); all of it linear."""
    found = _grid(
        lambda *x: 7.0 + sum(b * a for b, a in zip(slopes, x, strict=True)),
        *[[-1, 0, 1]] * len(slopes),
    )
    norm = float(np.hypot.reduce(slopes))
    for k, slope in enumerate(slopes):
        one = _of(found, f"p{k}")
        assert one.effect == pytest.approx(2 * abs(slope))
        assert one.share == pytest.approx(slope**2 / norm**2)
        assert one.slope == pytest.approx(slope / norm)
    assert found.is_grid
    assert found.linear_share == pytest.approx(1.0)
    assert sum(share for _, _, share in found.pairs) == pytest.approx(0.0, abs=1e-9)
    order = [one.share for one in found.influences]
    assert order == sorted(order, reverse=True)


def test_a_product_is_interaction_alone() -> None:
    """X y over -1, 0, 1: means by either are 0, so that all of the variance is the pair's; a line explains nothing."""
    found = _grid(lambda x, y: x * y, [-1, 0, 1], [-1, 0, 1])
    assert [one.share for one in found.influences] == pytest.approx([0.0, 0.0], abs=1e-12)
    ((one, other, share),) = found.pairs
    assert ({one, other}, share) == ({"p0", "p1"}, pytest.approx(1.0))
    assert found.linear_share == pytest.approx(0.0, abs=1e-12)
    assert any("a linear fit explains 0% only" in note for note in found.notes)


def test_a_curve_has_rank_correlation_one_and_a_smaller_slope() -> None:
    """exp(3x): rising, so ranks agree wholly; a line does not."""
    found = _grid(lambda x: np.exp(3 * x), list(np.linspace(0, 2, 9)))
    one = _of(found, "p0")
    assert one.rank_correlation == pytest.approx(1.0)
    assert one.slope is not None and one.slope < 0.85
    assert one.share == pytest.approx(1.0)


def test_a_symmetric_curve_is_seen_by_its_main_effect_only() -> None:
    """x^2 over -2 .. 2: effect 4, no slope, no rank correlation."""
    one = _of(_grid(lambda x, y: x * x, [-2, -1, 0, 1, 2], [0, 1]), "p0")
    assert one.effect == pytest.approx(4.0)
    assert one.share == pytest.approx(1.0)
    assert one.slope == pytest.approx(0.0, abs=1e-12)
    assert one.rank_correlation == pytest.approx(0.0, abs=1e-12)


def test_words_have_main_effects_and_do_not_hide_the_slope_of_numbers() -> None:
    """Y = 10 (word) + x: within each word the slope is 1."""
    x = np.tile([0.0, 1.0, 2.0], 2)
    word = np.repeat([0, 1], 3)
    values = 10.0 * word + x
    found = sensitivity(
        [word_factor("w", word, 2), numeric_factor("x", x, [0, 1, 2])], values, True
    )
    w, number = _of(found, "w"), _of(found, "x")
    assert (w.slope, w.rank_correlation) == (None, None)
    assert w.effect == pytest.approx(10.0)
    assert w.share == pytest.approx(25 / (25 + 2 / 3))
    assert number.slope == pytest.approx(np.std(x) / np.std(values))
    assert found.linear_share == pytest.approx(1.0)


def test_a_number_that_is_called_like_a_word_s_value_keeps_its_slope() -> None:
    """`w=1` is a name like any other: y = 10 (word) + x has the same slopes whatever x is called."""
    x, word = np.tile([0.0, 1.0, 2.0], 2), np.repeat([0, 1], 3)
    found = [
        sensitivity(
            [numeric_factor(name, x, [0, 1, 2]), word_factor("w", word, 2)], 10.0 * word + x, True
        )
        for name in ("x", "w=1")
    ]
    assert _of(found[1], "w=1").slope == pytest.approx(_of(found[0], "x").slope)
    assert found[1].linear_share == pytest.approx(1.0)


@pytest.mark.parametrize("seed", range(5))
def test_of_samples_the_shares_are_estimates_and_what_does_nothing_has_about_none(
    seed: int,
) -> None:
    """2 a + b over the unit cube: shares of variance are 4/5, 1/5, 0."""
    x = sample_shares(Sampling("latin_hypercube", 400, seed), 3)
    factors = [numeric_factor(name, x[:, k], []) for k, name in enumerate("abc")]
    found = sensitivity(factors, 2 * x[:, 0] + x[:, 1], stepped=False)
    assert not found.is_grid
    # Four parts of a side tell 1 - 1/16 of what is linear along it. Columns correlate by chance by r of about 0.05, at
    # most 0.15: b then explains (1 + 2 r)^2 / (5 + 4 r), and the slope of a is 2 / sqrt(5 + 4 r).
    assert _of(found, "a").share == pytest.approx(0.8 * 15 / 16, abs=0.06)
    assert _of(found, "b").share == pytest.approx(0.2 * 15 / 16, abs=0.1)
    assert _of(found, "c").share == pytest.approx(0.0, abs=0.05)
    assert _of(found, "a").slope == pytest.approx(2 / np.sqrt(5), abs=0.07)
    assert "shares are estimates, because the plans do not fill the grid" in found.notes
    assert "a linear fit explains 100%: slopes are more reliable than shares" in found.notes


def test_chance_explains_nothing_on_average() -> None:
    """Random numbers over a parameter with five values: without the correction each would explain about 4 of 19."""
    rng = np.random.default_rng(1)
    shares = []
    for _ in range(200):
        levels = rng.integers(0, 5, 20)
        factors = [
            numeric_factor("p", levels.astype(float), range(5)),
            numeric_factor("q", rng.random(20), []),
        ]
        shares.append(_of(sensitivity(factors, rng.random(20), False), "p").share)
    assert np.mean(shares) < 0.08


def test_few_plans_are_said_to_be_few() -> None:
    """And nothing is claimed where there are too few, or where all are the same."""
    one = sensitivity([numeric_factor("p", [1.0], [1.0, 2.0])], np.array([3.0]), True)
    assert one.notes == ("no sensitivity: fewer than two plans",)
    same = sensitivity([numeric_factor("p", [1.0, 2.0], [1.0, 2.0])], np.array([3.0, 3.0]), True)
    assert same.notes == ("no sensitivity: the objective is constant",)
    near = [numeric_factor("p", [1.0, 2.0], [1.0, 2.0])], np.array([0.02, 0.02003])
    assert sensitivity(*near, True, step=1e-4).notes == same.notes
    assert sensitivity(*near, True, step=1e-5).influences[0].share == pytest.approx(1.0)
    two = sensitivity(
        [numeric_factor(n, [1.0, 2.0], [1.0, 2.0]) for n in "pq"], np.array([3.0, 4.0]), True
    )
    assert any(
        note.startswith("2 plans for 2 parameters: the result is only an indication")
        for note in two.notes
    )
    assert all(one.slope is None for one in two.influences)


def test_parameters_that_vary_together_have_no_slopes() -> None:
    """Which of them does it cannot be told."""
    x = np.arange(10.0)
    factors = [numeric_factor("p", x, []), numeric_factor("q", 3 * x + 1, [])]
    found = sensitivity(factors, x**2, False)
    assert [one.slope for one in found.influences] == [None, None]


def test_values_without_any_plan_leave_a_smaller_grid() -> None:
    """Of 3 x 2 the last row is missing: shares of the remaining 2 x 2 are exact, and it is said."""
    points = np.array([(0, 0), (0, 1), (1, 0), (1, 1)], dtype=np.float64)
    factors = [
        numeric_factor("p", points[:, 0], [0, 1, 2]),
        numeric_factor("q", points[:, 1], [0, 1]),
    ]
    found = sensitivity(factors, points @ [3.0, 4.0], True)
    assert found.is_grid
    assert _of(found, "q").share == pytest.approx(16 / 25)
    assert "values without any plan are left out" in found.notes
    broken = sensitivity(
        [numeric_factor("p", points[:3, 0], [0, 1]), numeric_factor("q", points[:3, 1], [0, 1])],
        points[:3] @ [3.0, 4.0],
        True,
    )
    assert not broken.is_grid
