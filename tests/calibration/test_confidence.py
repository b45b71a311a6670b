"""95 % regions cover the truth in 95 % of trials, and their factors are those of the tables."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from dualarm_cli.calibration import CALIBRATION_SOLVERS, CalibrationProblem
from dualarm_cli.calibration.rigid import (
    fit_rigid,
    pose_covariance,
    relative_pose,
    residual_variance,
)
from dualarm_cli.calibration.spread import interval_factor, region_limit
from dualarm_cli.geometry.rotations import log_rotation
from dualarm_cli.model.touches import Touches

TRIALS = 2000
NOISE = 0.5e-3
Problem = Callable[..., CalibrationProblem]


def trials(
    points: np.ndarray, truth: tuple[np.ndarray, np.ndarray], seed: int, noise: float = NOISE
) -> tuple[np.ndarray, np.ndarray]:
    """Returns both robots' points with fresh noise in every trial, shape (2000, n, 3)."""
    random = np.random.default_rng(seed)
    R, t = truth
    left = points + noise * random.normal(size=(TRIALS, *points.shape))
    right = (points - t) @ R + noise * random.normal(size=(TRIALS, *points.shape))
    return left, right


def errors(R: np.ndarray, t: np.ndarray, truth: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Returns what the truth is away from results, as translation and rotation vector, shape (n, 6)."""
    turn = log_rotation(truth[0] @ np.swapaxes(R, -1, -2))
    return np.concatenate([truth[1] - t, turn], axis=1)


@pytest.mark.parametrize("stated", [True, False])
@pytest.mark.parametrize("count", [8, 4])
def test_the_region_covers_the_truth_in_95_of_100_trials(
    stated: bool, count: int, spread_points: np.ndarray, truth: tuple[np.ndarray, np.ndarray]
) -> None:
    """0.5 mm in every coordinate of both robots, 2,000 trials: 95 +- 3 %, region and single intervals.

    By chance alone the share varies by 0.5 % (one standard deviation).
    """
    left, right = trials(spread_points[:count], truth, seed=count)
    R, t = fit_rigid(left, right)
    degrees = None if stated else 3 * count - 6
    variance = np.full(TRIALS, 2 * NOISE**2) if stated else residual_variance(left, right)
    C = pose_covariance(left, right, R, variance)
    e = errors(R, t, truth)
    inside = np.einsum("ni,nij,nj->n", e, np.linalg.inv(C), e) <= region_limit(degrees)
    assert inside.mean() == pytest.approx(0.95, abs=0.03)
    widths = interval_factor(degrees) * np.sqrt(np.einsum("nii->ni", C))
    np.testing.assert_allclose((np.abs(e) <= widths).mean(axis=0), 0.95, atol=0.03)


@pytest.mark.parametrize("stated", [True, False])
def test_single_intervals_hold_on_the_paper_s_thin_triangle(
    stated: bool, qin: Touches, truth: tuple[np.ndarray, np.ndarray]
) -> None:
    """Table 6's triangle with 2 mm of noise, where the rotation is unsure by degrees: 95 +- 3 % each."""
    left, right = trials(qin.left.xyz, truth, 3, 2e-3)
    R, t = fit_rigid(left, right)
    variance = np.full(TRIALS, 2 * 2e-3**2) if stated else residual_variance(left, right)
    C = pose_covariance(left, right, R, variance)
    widths = interval_factor(None if stated else 3) * np.sqrt(np.einsum("nii->ni", C))
    covered = (np.abs(errors(R, t, truth)) <= widths).mean(axis=0)
    np.testing.assert_allclose(covered, 0.95, atol=0.03)
    assert np.degrees(widths[:, 3:].max(axis=1)).mean() > 2.0


def test_solutions_carry_that_covariance(problem: Problem, spread_points: np.ndarray) -> None:
    """Stated: from twice the noise squared, no degrees; estimated: from the residuals, 3 x 8 - 6 of them."""
    solve = CALIBRATION_SOLVERS["least_squares"].solve
    noisy, stated = problem(spread_points, NOISE), problem(spread_points, NOISE, NOISE)
    by_residuals, by_noise = solve(noisy), solve(stated)
    assert (by_residuals.degrees, by_noise.degrees) == (18, None)
    expected = pose_covariance(noisy.left, noisy.right, by_noise.rotation, 2 * NOISE**2)
    np.testing.assert_allclose(by_noise.covariance, expected)
    variance = residual_variance(noisy.left, noisy.right)
    np.testing.assert_allclose(by_residuals.covariance, expected * variance / (2 * NOISE**2))


def test_the_frame_s_covariance_covers_as_well(
    problem: Problem, truth: tuple[np.ndarray, np.ndarray]
) -> None:
    """Its own error propagation: 95 +- 3 % of 2,000 trials on a triangle of about 1 m; none without stated noise."""
    triangle = np.array([[-1.2, 0.0, 1.4], [-1.2, 0.7, 1.0], [-0.6, 1.1, 1.3]])
    solve = CALIBRATION_SOLVERS["frame"].solve
    solution = solve(problem(triangle, stated=NOISE))
    assert solve(problem(triangle)).covariance is None
    assert solution.covariance is not None
    left, right = trials(triangle, truth, seed=1)
    e = errors(*relative_pose(left, right, 1), truth)
    distance = np.einsum("ni,ij,nj->n", e, np.linalg.inv(solution.covariance), e)
    assert (distance <= region_limit(None)).mean() == pytest.approx(0.95, abs=0.03)
    best = solve_least(problem(triangle, stated=NOISE))
    # Least squares is never less sure than the frame.
    assert np.linalg.eigvalsh(solution.covariance - best).min() > -1e-12


def solve_least(problem: CalibrationProblem) -> np.ndarray:
    """Returns the covariance of least squares."""
    covariance = CALIBRATION_SOLVERS["least_squares"].solve(problem).covariance
    assert covariance is not None
    return covariance


def test_factors_are_those_of_the_tables() -> None:
    """Normal 1.960, Student t 3.182 (3), 2.101 (18); chi squared 12.592 (6); F(6, 3) = 8.94, F(6, 18) = 2.66."""
    assert interval_factor(None) == pytest.approx(1.960, abs=5e-4)
    assert interval_factor(3) == pytest.approx(3.182, abs=5e-4)
    assert interval_factor(18) == pytest.approx(2.101, abs=5e-4)
    assert region_limit(None) == pytest.approx(12.592, abs=5e-4)
    assert region_limit(3) / 6 == pytest.approx(8.94, abs=5e-3)
    assert region_limit(18) / 6 == pytest.approx(2.66, abs=5e-3)
