"""Sound points are not called contradictory, however many there are; a bad point and a wrong scale are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from dualarm_cli.calibration import CALIBRATION_SOLVERS, CalibrationProblem
from dualarm_cli.calibration.judgement import check_consistency, judge

Problem = Callable[..., CalibrationProblem]
FILES = 400
"""Simulated files of each kind."""


def points_of(seed: int, n: int) -> np.ndarray:
    """N points in a box of 0.8 x 0.8 x 0.5 m."""
    random = np.random.default_rng(seed)
    return random.uniform([-0.4, -0.4, 0.0], [0.4, 0.4, 0.5], (n, 3))


def warnings_of(problem: CalibrationProblem) -> str:
    """What is said of the points, by least squares."""
    solution = CALIBRATION_SOLVERS["least_squares"].solve(problem)
    return " ".join(judge(problem, solution, "least_squares").warnings)


@pytest.mark.parametrize("n", [3, 4, 5, 6, 8, 12, 20, 30, 60])
@pytest.mark.parametrize("noise", [0.2e-3, 0.45e-3])
def test_a_false_alarm_comes_in_5_of_100_sound_files(
    problem: Problem, n: int, noise: float
) -> None:
    """Gaussian noise in every coordinate of both robots; the levels of the three tests sum to 4 %."""
    alarms = 0
    for k in range(FILES):
        text = warnings_of(problem(points_of(k, n), noise, seed=1000 + k))
        alarms += any(word in text for word in ("disagree by", "the others fit", "points span"))
    assert alarms <= 0.05 * FILES


@pytest.mark.parametrize("n", [4, 8, 30])
def test_noise_of_any_size_is_no_outlier_and_no_scale(problem: Problem, n: int) -> None:
    """3 mm, six times what touching is taken to have: too much, but of no single point or robot; 3 % by the levels."""
    made = [check_consistency(problem(points_of(k, n), 3e-3, seed=2000 + k)) for k in range(FILES)]
    assert sum(one.outlier is not None or one.scale is not None for one in made) <= 0.05 * FILES
    assert sum(one.too_much for one in made) > 0.95 * FILES


@pytest.mark.parametrize("n", [5, 8, 12, 20, 30, 60])
def test_a_point_5_mm_off_is_found_and_named(problem: Problem, n: int) -> None:
    """25 times the noise of 0.2 mm, in any direction, at any of the points: in 95 of 100 files at least."""
    named = told = 0
    for k in range(100):
        random = np.random.default_rng(k)
        one = problem(points_of(k, n), 0.2e-3, seed=3000 + k)
        bad, way, right = int(random.integers(n)), random.normal(size=3), one.right.copy()
        right[bad] += 5e-3 * way / np.linalg.norm(way)
        one = replace(one, right=right)
        text = warnings_of(one)
        told += "the robots disagree by" in text
        named += f"without P{bad + 1} the others fit" in text
    assert told >= 95
    assert named >= 95


@pytest.mark.parametrize("n", [4, 8, 12, 20, 30, 60])
def test_a_scale_of_one_percent_is_found(problem: Problem, n: int) -> None:
    """One robot's lengths 1 % longer, 5 to 10 mm over the box, noise 0.2 mm; what is found is 1 % to 0.2 %."""
    for k in range(30):
        one = problem(points_of(k, n), 0.2e-3, seed=4000 + k)
        found = check_consistency(replace(one, left=one.left * 1.01))
        assert found.contradicted
        assert found.scale == pytest.approx(1.01, abs=2e-3)
