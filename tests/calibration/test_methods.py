"""Least squares and the three-point frame against the paper's numbers, exact data and invariances."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dualarm_cli.calibration import CALIBRATION_SOLVERS, CalibrationProblem
from dualarm_cli.calibration.calibrate import calibrate
from dualarm_cli.calibration.rigid import fit_rigid, point_frame
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.rotations import exp_rotation, log_rotation
from dualarm_cli.model.touches import Touches

Problem = Callable[..., CalibrationProblem]
Truth = tuple[np.ndarray, np.ndarray]

# T_B2_B1 of [Qin2024] section 5.2, minus signs restored.
PRINTED = np.array(
    [
        [0.9891, 0.1420, -0.0380, -2.7878],
        [-0.1424, 0.9898, -0.0083, 0.2734],
        [0.0364, 0.0136, 0.9992, -0.0461],
    ]
)
# Least squares on the same points, computed apart from this code (to four or five digits).
LEAST_SQUARES = np.array(
    [
        [0.98957, 0.13902, -0.03783, -2.78849],
        [-0.13850, 0.99023, 0.01604, 0.23700],
        [0.03969, -0.01063, 0.99916, -0.04904],
    ]
)
NAMES = list(CALIBRATION_SOLVERS.names)


@pytest.mark.parametrize("use", ["joints", "xyz"])
def test_the_frame_method_gives_the_printed_matrix(use: str, qin: Touches) -> None:
    """Origin P2: the printed matrix within 5e-4, from Table 6 and from the printed points."""
    T = calibrate(qin, "frame", use).solution.matrix
    np.testing.assert_allclose(T[:3], PRINTED, atol=5e-4)


def test_the_frame_on_the_points_is_the_printed_one(qin: Touches) -> None:
    """T_cal_B1 as printed, whose minus signs are lost, and right-handed; 0.05 mm of rounding over 91 mm are 6e-4."""
    frame = point_frame(qin.left.xyz)
    printed = [[0.0301, 0.1238, 0.9918], [0.9518, 0.3066, 0.0094], [0.3053, 0.9438, 0.1271]]
    np.testing.assert_allclose(np.abs(frame), printed, atol=1e-3)
    assert np.linalg.det(frame) == pytest.approx(1.0, abs=1e-12)


def test_the_origin_of_the_text_is_another_one(qin: Touches) -> None:
    """P1 instead of P2 gives y = 0.2778 m: 4.4 mm from what is printed, as P1P2 differs by that."""
    from dataclasses import replace

    T = calibrate(replace(qin, origin=0), "frame", "xyz").solution.matrix
    assert T[1, 3] == pytest.approx(0.2778, abs=2e-4)
    np.testing.assert_allclose(T[:3, :3], PRINTED[:, :3], atol=5e-4)


def test_least_squares_leaves_what_it_must(qin: Touches) -> None:
    """5.0, 9.0, 4.0 mm at P1, P2, P3, 6.4 mm root mean square; the frame method 4.4, 0, 28.6 mm."""
    found = calibrate(qin, "least_squares", "joints")
    np.testing.assert_allclose(found.solution.matrix[:3], LEAST_SQUARES, atol=5e-4)
    np.testing.assert_allclose(found.judgement.distances * 1000, [5.0, 9.0, 4.0], atol=0.2)
    assert found.judgement.rms * 1000 == pytest.approx(6.4, abs=0.05)
    frame = calibrate(qin, "frame", "joints").judgement
    np.testing.assert_allclose(frame.distances * 1000, [4.4, 0.0, 28.6], atol=0.2)


def test_the_paper_s_triangle_is_told_to_be_nearly_a_line(qin: Touches) -> None:
    """P2 is 90.8 mm (left) and 104.2 mm (right) off P1P3; P1P2 differs by 4.3 mm."""
    judgement = calibrate(qin, "least_squares", "xyz").judgement
    assert judgement.left.height == pytest.approx(0.0908, abs=1e-4)
    assert judgement.right.height == pytest.approx(0.1042, abs=1e-4)
    text = " ".join(judgement.warnings)
    assert "nearly on one line" in text
    assert "P1 and P3" in text
    assert "disagree by 4.3 mm about the distance of P1 and P2" in text
    assert "three points are the minimum" in text


@pytest.mark.parametrize("method", NAMES)
@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
def test_exact_points_give_the_exact_transform(method: str, data: st.DataObject) -> None:
    """3 to 8 points of a box of 1 m, whatever the pose: rotation to 1e-10, translation to 1e-9 m."""
    seed = data.draw(st.integers(0, 2**32 - 1))
    count = data.draw(st.integers(3, 8))
    random = np.random.default_rng(seed)
    R = exp_rotation(random.uniform(-np.pi, np.pi) * random.normal(size=3) / 2.0)
    t = random.uniform(-3, 3, 3)
    right = random.uniform(-0.5, 0.5, (count, 3))
    right[:3] += np.eye(3)  # no line, no point: the first three are far from both
    names = tuple(str(k) for k in range(count))
    problem = CalibrationProblem(right @ R.T + t, right, names)
    found = CALIBRATION_SOLVERS[method].solve(problem)
    np.testing.assert_allclose(found.rotation, R, atol=1e-10)
    np.testing.assert_allclose(found.translation, t, atol=1e-9)
    assert np.linalg.det(found.rotation) == pytest.approx(1.0, abs=1e-12)


def test_the_order_of_points_does_not_matter(problem: Problem, spread_points: np.ndarray) -> None:
    """Least squares is the same to rounding for every order; so is its uncertainty."""
    given_order = problem(spread_points, 1e-3)
    solve = CALIBRATION_SOLVERS["least_squares"].solve
    first = solve(given_order)
    assert first.covariance is not None
    random = np.random.default_rng(0)
    for _ in range(20):
        order = random.permutation(8)
        names = tuple(given_order.names[k] for k in order)
        other = solve(CalibrationProblem(given_order.left[order], given_order.right[order], names))
        np.testing.assert_allclose(other.matrix, first.matrix, atol=1e-13)
        np.testing.assert_allclose(other.covariance, first.covariance, atol=1e-15)


def test_exchanging_the_robots_inverts_the_transform(
    problem: Problem, spread_points: np.ndarray
) -> None:
    """Errors count the same for both, so that least squares does not prefer one."""
    there = problem(spread_points, 1e-3)
    back = CalibrationProblem(there.right, there.left, there.names)
    solve = CALIBRATION_SOLVERS["least_squares"].solve
    np.testing.assert_allclose(solve(there).matrix @ solve(back).matrix, np.eye(4), atol=1e-12)


def test_no_other_motion_leaves_less(problem: Problem, spread_points: np.ndarray) -> None:
    """2,000 small motions of the result about it: none has a smaller sum of squares."""
    noisy = problem(spread_points, 2e-3)
    R, t = fit_rigid(noisy.left, noisy.right)
    random = np.random.default_rng(0)
    turns = exp_rotation(random.normal(size=(2000, 3)) * 1e-3)
    shifts = random.normal(size=(2000, 3)) * 1e-3
    moved = noisy.right @ np.swapaxes(turns @ R, -1, -2) + (t + shifts)[:, None]
    squares = ((noisy.left - moved) ** 2).sum(axis=(1, 2))
    assert squares.min() > ((noisy.left - noisy.right @ R.T - t) ** 2).sum()


@pytest.mark.parametrize("method", NAMES)
@pytest.mark.parametrize(
    ("points", "words"),
    [
        ([[0, 0, 0], [1, 0, 0]], "2 points do not determine"),
        ([[0, 0, 0]], "1 point does not determine"),
        ([[0, 0, 0], [1, 0, 0], [3, 0, 0]], "on one line"),
        ([[0, 0, 0], [1, 1, 1], [1, 1, 1]], "on one line"),
        ([[1, 1, 1], [1, 1, 1], [1, 1, 1]], "are the same"),
    ],
)
def test_points_that_determine_nothing_are_refused(
    method: str, points: list[list[float]], words: str, problem: Problem
) -> None:
    """Two points, a line, a point given twice: exit code 3 and what to do."""
    with pytest.raises(InfeasibleError, match=words) as caught:
        CALIBRATION_SOLVERS[method].solve(problem(np.array(points)))
    assert caught.value.exit_code == 3
    assert "touch" in str(caught.value)


def test_millimetres_for_metres_are_refused(problem: Problem, spread_points: np.ndarray) -> None:
    """Sizes that differ by a factor of 1000 cannot be the same points."""
    good = problem(spread_points)
    with pytest.raises(InfeasibleError, match="units"):
        CALIBRATION_SOLVERS["least_squares"].solve(
            CalibrationProblem(good.left * 1000.0, good.right, good.names)
        )


def test_a_line_to_within_the_stated_noise_is_a_line(problem: Problem) -> None:
    """The third point is 1 mm off a line of 1 m: no height for a noise of 0.5 mm, one for 0.1 mm."""
    points = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.5, 1e-3, 0.0]])
    solve = CALIBRATION_SOLVERS["least_squares"].solve
    with pytest.raises(InfeasibleError, match="3 times the noise"):
        solve(problem(points, stated=0.5e-3))
    with pytest.raises(InfeasibleError, match="95 % interval"):
        solve(problem(points, deviation=0.5e-3, seed=2))
    assert solve(problem(points, stated=0.01e-3)).covariance is not None


def test_a_mirrored_fit_is_never_given() -> None:
    """Points of one robot mirrored: what comes out is still a rotation."""
    random = np.random.default_rng(3)
    left = random.normal(size=(50, 6, 3))
    R, _ = fit_rigid(left, left * [1.0, 1.0, -1.0])
    np.testing.assert_allclose(np.linalg.det(R), 1.0, atol=1e-12)
    assert np.isfinite(log_rotation(R)).all()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"left": np.full((3, 3), np.nan)}, "finite"),
        ({"left": np.zeros((2, 3))}, "shape"),
        ({"noise": 0.0}, "noise"),
        ({"origin": 3}, "origin"),
    ],
)
def test_impossible_problems_are_refused(change: dict[str, object], words: str) -> None:
    """A programmer's mistake, not a user's: ValueError."""
    values = {"left": np.eye(3), "right": np.eye(3), "names": ("a", "b", "c")} | change
    with pytest.raises(ValueError, match=words):
        CalibrationProblem(**values)  # type: ignore[arg-type]
