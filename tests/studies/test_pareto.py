"""The Pareto set against its definition."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from dualarm_cli.studies.rows import pareto_set

COSTS = st.tuples(st.integers(0, 40), st.integers(1, 4)).flatmap(
    # Few different numbers, so that there are ties and equal rows.
    lambda shape: arrays(np.float64, shape, elements=st.integers(0, 4).map(float))
)


@given(COSTS)
def test_a_row_is_kept_if_and_only_if_no_other_dominates_it(costs: np.ndarray) -> None:
    """At least as good in all and better in one: by two loops."""
    kept = pareto_set(costs)
    for k, row in enumerate(costs):
        dominated = any(
            all(a <= b for a, b in zip(other, row, strict=True))
            and any(a < b for a, b in zip(other, row, strict=True))
            for other in costs
        )
        assert kept[k] == (not dominated)


def test_many_rows_go_in_blocks() -> None:
    """Points on a line x + y = n are all kept; those above none."""
    x = np.arange(700.0)
    front = np.column_stack([x, 700.0 - x])
    kept = pareto_set(np.vstack([front + 1.0, front]))
    assert kept.tolist() == [False] * 700 + [True] * 700
