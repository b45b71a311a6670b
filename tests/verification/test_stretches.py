"""Stretches between the edges of stages that may overlap."""

from __future__ import annotations

import dataclasses
from itertools import pairwise

import numpy as np
import pytest

from dualarm_cli.verification.clearance_checks import edges_of, stages_of


def with_stages(schedule, spans):
    """Returns a schedule of 8 s with stages at these spans."""
    stages = [dataclasses.replace(schedule.stages[0], start=start, end=end) for start, end in spans]
    return dataclasses.replace(schedule, stages=tuple(stages))


@pytest.mark.parametrize(
    ("spans", "edges", "stages"),
    [
        ([], [0, 8], [[0]]),
        ([(0, 3), (3, 8)], [0, 3, 8], [[0], [1]]),
        # A stage without length has no stretch.
        ([(0, 0), (0, 3), (3, 8)], [0, 3, 8], [[1], [2]]),
        # Ends that rounding alone parts from the next start are no edges.
        ([(0, 3 - 1e-12), (3, 8 - 1e-12)], [0, 3, 8], [[0], [1]]),
        ([(0, 3 + 1e-12), (3, 8 + 1e-12)], [0, 3, 8], [[0], [1]]),
        # Two arms: 0 to 2, 2 to 5; 0 to 3, 4 to 8. Nothing of the right arm's from 3 to 4 s.
        ([(0, 2), (0, 3), (2, 5), (4, 8)], [0, 2, 3, 4, 5, 8], [[0, 1], [1, 2], [2], [2, 3], [3]]),
        # Both wait from 2 to 3 s, and from 7 s: the last that began has it.
        ([(0, 2), (3, 7)], [0, 2, 3, 7, 8], [[0], [0], [1], [1]]),
        ([(1, 2), (3, 8)], [0, 1, 2, 3, 8], [[0], [0], [0], [1]]),
    ],
)
def test_stretches_by_hand(by_clocks, spans, edges, stages):
    """Edges at starts and ends; every stage has all the stretches that it lasts for."""
    schedule = with_stages(by_clocks.schedule, spans)
    found = edges_of(schedule)
    assert found == pytest.approx(edges, abs=1e-9)
    assert stages_of(schedule, found) == stages


@pytest.mark.parametrize("seed", range(20))
def test_each_stage_is_the_sum_of_its_stretches_and_no_motion_is_left_out(by_clocks, seed):
    """Random stages on whole half seconds, in order of their start."""
    rng = np.random.default_rng(seed)
    spans = sorted(
        tuple(sorted(0.5 * rng.choice(17, size=2, replace=False)))
        for _ in range(rng.integers(1, 9))
    )
    schedule = with_stages(by_clocks.schedule, spans)
    edges = edges_of(schedule)
    stretches = list(pairwise(edges))
    found = stages_of(schedule, edges)
    assert (edges[0], edges[-1]) == (0.0, schedule.duration)
    assert len(found) == len(stretches)
    assert all(found)
    for number, (start, end) in enumerate(spans):
        inside = [
            (a, b)
            for (a, b), stages in zip(stretches, found, strict=True)
            if number in stages and start - 1e-9 <= a and b <= end + 1e-9
        ]
        assert sum(b - a for a, b in inside) == pytest.approx(end - start)
        assert min(a for a, _ in inside) == pytest.approx(start)
