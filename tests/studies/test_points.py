"""Points: every combination once, samples spread as they should be."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dualarm_cli.errors import UsageError
from dualarm_cli.model.studies.study import Amount, Sampling
from dualarm_cli.studies.search import SEARCH, count_points, sample_shares, study_points


def _numbers(points) -> list[tuple]:
    return [tuple(v.number if isinstance(v, Amount) else v for v in point) for point in points]


@given(st.lists(st.integers(1, 4), min_size=1, max_size=4))
def test_a_grid_has_every_combination_once_in_order(make_study, sizes: list[int]) -> None:
    """As nested loops would go."""
    study = make_study(**{f"p{k}": list(range(size)) for k, size in enumerate(sizes)})
    assert _numbers(study_points(study)) == list(product(*(range(size) for size in sizes)))


def test_words_and_numbers_make_a_grid(make_study) -> None:
    """The last parameter changes first."""
    study = make_study(a=[1, 2], b=["x", "y", "z"])
    assert _numbers(study_points(study)) == list(product([1, 2], ["x", "y", "z"]))
    assert count_points(study) == 6


def test_samples_are_crossed_with_steps(make_study) -> None:
    """Each step has the same samples."""
    study = make_study(
        sampling=Sampling("latin_hypercube", 5, 3), a=["x", "y"], b=(0.0, 1.0), c=(2.0, 4.0)
    )
    points = _numbers(study_points(study))
    assert count_points(study) == len(points) == 10
    assert [p[0] for p in points] == ["x"] * 5 + ["y"] * 5
    assert [p[1:] for p in points[:5]] == [p[1:] for p in points[5:]]
    assert all(0.0 <= b <= 1.0 and 2.0 <= c <= 4.0 for _, b, c in points)


@given(st.integers(2, 60), st.integers(1, 5), st.integers(0, 2**32 - 1))
def test_every_part_of_every_side_has_one_sample(count: int, sides: int, seed: int) -> None:
    """That is what a Latin hypercube is."""
    shares = sample_shares(Sampling("latin_hypercube", count, seed), sides)
    assert shares.shape == (count, sides)
    for column in shares.T:
        assert sorted(np.floor(column * count).astype(int)) == list(range(count))


@given(st.integers(2, 40), st.integers(1, 40), st.integers(0, 1000))
def test_a_longer_halton_sequence_begins_with_the_shorter_one(
    count: int, more: int, seed: int
) -> None:
    """So that a study can be lengthened without planning anything again."""
    short = sample_shares(Sampling("halton", count, seed), 3)
    long = sample_shares(Sampling("halton", count + more, seed), 3)
    assert (long[:count] == short).all()


@pytest.mark.parametrize("method", ["latin_hypercube", "halton"])
def test_the_seed_decides(method) -> None:
    """The same one the same points, another one others."""
    one, same, other = (sample_shares(Sampling(method, 8, seed), 2) for seed in (1, 1, 2))
    assert (one == same).all()
    assert not (one == other).any()


def test_a_range_without_steps_needs_samples_or_a_search(make_study) -> None:
    """It says which parameter and what to do."""
    with pytest.raises(
        UsageError, match=r"s.yaml:3:3: the range of 'b' has no steps; give it step or count"
    ):
        study_points(make_study(a=[1], b=(0.0, 1.0)))


def test_too_many_points_are_refused_before_they_are_made(make_study) -> None:
    """With their number."""
    study = make_study(a=list(range(1000)), b=list(range(1000)))
    assert count_points(study) == 1_000_000 > SEARCH.max_points
    with pytest.raises(UsageError, match="has 1,000,000 points, at most 100,000"):
        study_points(study)
