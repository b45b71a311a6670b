"""What is said about weak or wrong points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from dualarm_cli.calibration import CALIBRATION_SOLVERS, CalibrationProblem
from dualarm_cli.calibration.judgement import Judgement, judge
from dualarm_cli.calibration.spread import measure_spread

Problem = Callable[..., CalibrationProblem]


def judged(problem: CalibrationProblem, method: str = "least_squares") -> Judgement:
    """Returns the judgement of a method's result."""
    return judge(problem, CALIBRATION_SOLVERS[method].solve(problem), method)


def test_good_points_bring_no_warning(problem: Problem, spread_points: np.ndarray) -> None:
    """Eight points in a box of 1.2 m with a noise of 0.1 mm, stated or not; residuals as large as that."""
    for stated in (None, 0.1e-3):
        found = judged(problem(spread_points, 0.1e-3, stated))
        assert found.warnings == ()
        assert 0.05e-3 < found.rms < 0.4e-3
        assert found.widths is not None
        assert (found.widths[3:] < np.radians(0.05)).all()


def test_nearly_collinear_points_are_told_with_what_to_do(problem: Problem) -> None:
    """Five points within 50 mm of a line of 1 m; 250 mm off they pass."""
    for off, warned in ((0.05, True), (0.25, False)):
        points = np.array([[0, 0, 1], [1, 0, 1], [0.5, off, 1], [0.3, 0, 1 - off], [0.8, 0, 1]])
        text = " ".join(judged(problem(points, 0.02e-3)).warnings)
        assert ("nearly on one line" in text) == warned
        if warned:
            assert "none is more than 50.0 mm (left)" in text
            assert "touch a point at least 500 mm off it" in text


def test_a_mirrored_robot_is_told(problem: Problem, spread_points: np.ndarray) -> None:
    """One axis with its sign lost: residuals of decimetres, and the word mirror."""
    good = problem(spread_points, 0.1e-3)
    mirrored = CalibrationProblem(good.left, good.right * [1, 1, -1], good.names)
    found = judged(mirrored)
    assert found.rms > 0.1
    assert "mirror image" in " ".join(found.warnings)
    assert "mirror" not in " ".join(judged(good).warnings)


def test_a_point_given_twice_is_told(problem: Problem, spread_points: np.ndarray) -> None:
    """P8 repeats P2 in both robots."""
    good = problem(spread_points)
    left, right = good.left.copy(), good.right.copy()
    left[7], right[7] = left[1], right[1]
    found = judged(CalibrationProblem(left, right, good.names))
    assert [w for w in found.warnings if w.startswith("P2 and P8 are the same point")]


def test_the_point_to_blame_is_named(problem: Problem, spread_points: np.ndarray) -> None:
    """P5 is 20 mm off for one robot; noise elsewhere 0.1 mm."""
    good = problem(spread_points, 0.1e-3)
    right = good.right.copy()
    right[4, 0] += 0.02
    text = " ".join(judged(CalibrationProblem(good.left, right, good.names)).warnings)
    assert "without P5 the others fit" in text
    assert "disagree by" in text


def test_exchanged_points_are_told(problem: Problem, spread_points: np.ndarray) -> None:
    """The right robot's P1 and P2 in the wrong order: distances disagree."""
    good = problem(spread_points)
    right = good.right[[1, 0, *range(2, 8)]]
    text = " ".join(judged(CalibrationProblem(good.left, right, good.names)).warnings)
    assert "disagree by" in text


def test_noise_that_does_not_explain_the_residuals_is_told(
    problem: Problem, spread_points: np.ndarray
) -> None:
    """2 mm where 0.2 mm are stated, and what it would take; 2 mm stated is believed."""
    noisy = problem(spread_points, 2e-3, 0.2e-3)
    text = " ".join(judged(noisy).warnings)
    assert "larger than a noise of 0.2 mm explains" in text
    assert judged(replace(noisy, noise=2e-3)).warnings == ()


def test_fitted_tools_take_degrees_of_freedom(problem: Problem, spread_points: np.ndarray) -> None:
    """Sixteen times the variance in squares: no wonder with 9 degrees (21.7 at 1 %), one with 3 (11.3)."""
    noisy = problem(spread_points[:5], 1e-3)
    solution = CALIBRATION_SOLVERS["least_squares"].solve(noisy)
    squares = float((solution.residuals(noisy.left, noisy.right) ** 2).sum())
    stated = replace(noisy, noise=float(np.sqrt(squares / 16.0 / 2.0)))
    for fitted, warned in ((0, False), (6, True)):
        text = " ".join(judge(stated, solution, "least_squares", fitted).warnings)
        assert ("larger than a noise" in text) == warned


def test_a_robot_that_measures_longer_is_told(problem: Problem, spread_points: np.ndarray) -> None:
    """2 % more in every length."""
    good = problem(spread_points)
    long = CalibrationProblem(good.left * 1.02, good.right, good.names)
    assert "span 1.0200 times" in " ".join(judged(long).warnings)


def test_the_frame_method_says_what_it_leaves_out(
    problem: Problem, spread_points: np.ndarray
) -> None:
    """P4 to P8 play no part; how sure it is needs the noise."""
    words = judged(problem(spread_points), "frame").warnings
    assert "first three points only; P4, P5, P6, P7, P8" in words[0]
    assert "only if the noise is stated" in words[-1]
    assert judged(problem(spread_points, stated=0.5e-3), "frame").widths is not None


def test_spread_is_that_of_a_triangle() -> None:
    """Sides 3, 4, 5: 5 long, height 3 x 4 / 5; turned and moved it is the same."""
    found = measure_spread(np.array([[0.0, 0, 0], [3, 0, 0], [3, 4, 0]]))
    assert (found.length, found.height) == pytest.approx((5.0, 2.4))
    assert found.ends == (0, 2)
    assert found.deviations[2] == pytest.approx(0.0, abs=1e-15)
