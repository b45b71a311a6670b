"""Least squares: the rigid motion that leaves the least sum of squared distances."""

from __future__ import annotations

import numpy as np

from dualarm_cli.calibration.confidence import interval_factor
from dualarm_cli.calibration.problem import CalibrationProblem
from dualarm_cli.calibration.solution import CalibrationSolution
from dualarm_cli.calibration.spread import refuse_lines
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.rotations import skew

LOOSEST = np.pi / 2.0
"""Half width of the rotation's 95 % interval from which on it means nothing [rad]."""


def solve_least_squares(problem: CalibrationProblem) -> CalibrationSolution:
    """Returns the pose of least squares over all points ([Kabsch1976], [Umeyama1991] without scale).

    With equal noise in every coordinate of both robots this is the estimate of greatest likelihood.

    Args:
        problem: three points or more.

    Raises:
        InfeasibleError: the points are on a line, or as near to one as their noise.
    """
    left, right = problem.left, problem.right
    refuse_lines(problem)
    R, t = fit_rigid(left, right)
    degrees = None if problem.noise is not None else 3 * len(left) - 6
    # Both robots' noise is in a residual, so that its variance is twice that of a coordinate.
    variance = (
        2.0 * problem.noise**2 if problem.noise is not None else residual_variance(left, right)
    )
    covariance = pose_covariance(left, right, R, variance)
    refuse_loose_turn(covariance, degrees, float(np.sqrt(variance)))
    return CalibrationSolution(R, t, covariance, degrees)


def refuse_loose_turn(covariance: FloatArray, degrees: int | None, noise: float) -> None:
    """Raises where the rotation is so unsure that it means nothing.

    Args:
        covariance: of translation and rotation vector, shape (6, 6).
        degrees: of freedom of the noise's estimate; None where it was stated.
        noise: standard deviation of one coordinate of a residual [m].

    Raises:
        InfeasibleError: its 95 % interval reaches a quarter turn.
    """
    # The axis about which the rotation is least sure need not be one of the frame's.
    deviation = float(np.sqrt(np.linalg.eigvalsh(covariance[3:, 3:])[-1]))
    width = interval_factor(degrees) * deviation
    if width >= LOOSEST:
        raise InfeasibleError(
            "the points do not determine how the robots are turned: about one axis the 95 % "
            f"interval is ±{np.degrees(width):.0f} deg, as "
            "the points are nearly on one line or do not match (a coordinate of a residual is "
            f"{noise * 1000:.3g} mm on average); "
            "touch more points, well spread in all directions, and look at tools and robot files"
        )


def fit_rigid(left: FloatArray, right: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Returns rotations (..., 3, 3) and translations (..., 3) [m] of least squares, for many sets of points.

    With H = sum (l - mean l) (r - mean r)^T = U S V^T, R = U diag(1, 1, det U V^T) V^T: the last sign keeps
    it from being a reflection.

    Args:
        left: points in the left frame [m], shape (..., n, 3).
        right: the same points in the right frame [m], shape (..., n, 3).
    """
    middle_left, middle_right = left.mean(axis=-2), right.mean(axis=-2)
    H = np.swapaxes(left - middle_left[..., None, :], -1, -2) @ (right - middle_right[..., None, :])
    U, _, Vt = np.linalg.svd(H)
    signs = np.ones(U.shape[:-1])
    signs[..., 2] = np.sign(np.linalg.det(U @ Vt))
    R = (U * signs[..., None, :]) @ Vt
    return R, middle_left - (R @ middle_right[..., None])[..., 0]


def residual_variance(left: FloatArray, right: FloatArray) -> FloatArray:
    """Returns the variance of one coordinate of a residual [m^2], shape (...): sum of squares / (3 n - 6).

    Args:
        left: points in the left frame [m], shape (..., n, 3), n > 2.
        right: the same points in the right frame [m], shape (..., n, 3).
    """
    R, t = fit_rigid(left, right)
    rest = left - (right @ np.swapaxes(R, -1, -2) + t[..., None, :])
    total: FloatArray = (rest**2).sum(axis=(-1, -2)) / (3 * left.shape[-2] - 6)
    return total


def pose_covariance(
    left: FloatArray, right: FloatArray, R: FloatArray, variance: FloatArray | float
) -> FloatArray:
    """Returns covariances (..., 6, 6) of translation and rotation vector [m, rad] of least squares.

    A small turn w about the centroid moves point x by w × x, so that its information is (tr(M) I - M) / variance
    with M = sum x x^T, and that of a shift of the centroid n / variance; neither knows of the other. The right
    base's origin, t - centroid away, moves by shift + w × (t - centroid). To first order; our own derivation.
    Intervals of single numbers stay right where the rotation is unsure by several degrees; the region of all six
    together does not, as the origin then moves on an arc: on the triangle of [Qin2024] it covers 94 % with a noise of
    0.5 mm, but 85 % with 2 mm.

    Args:
        left: points in the left frame [m], shape (..., n, 3).
        right: the same points in the right frame [m], shape (..., n, 3).
        R: rotations of least squares, shape (..., 3, 3).
        variance: of one coordinate of a residual [m^2], shape (...).
    """
    n = left.shape[-2]
    variance = np.asarray(variance, dtype=np.float64)[..., None, None]
    x = (right - right.mean(axis=-2, keepdims=True)) @ np.swapaxes(R, -1, -2)
    M = np.swapaxes(x, -1, -2) @ x
    trace = np.trace(M, axis1=-2, axis2=-1)[..., None, None]
    turn = variance * np.linalg.inv(trace * np.eye(3) - M)
    lever = -skew(-(R @ right.mean(axis=-2)[..., None])[..., 0])
    found = np.zeros((*R.shape[:-2], 6, 6))
    found[..., :3, :3] = variance / n * np.eye(3) + lever @ turn @ np.swapaxes(lever, -1, -2)
    found[..., :3, 3:] = lever @ turn
    found[..., 3:, :3] = turn @ np.swapaxes(lever, -1, -2)
    found[..., 3:, 3:] = turn
    return found
