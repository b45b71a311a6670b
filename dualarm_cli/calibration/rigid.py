"""Rigid motion between two point sets: least squares, and [Qin2024]'s frame method."""

from __future__ import annotations

import numpy as np

from dualarm_cli.calibration.problem import CalibrationProblem, CalibrationSolution
from dualarm_cli.calibration.spread import interval_factor, refuse_lines
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.rotations import log_rotation, skew
from dualarm_cli.refusals import Refusal

STEP = 1e-6
"""Step of the finite differences, relative to the triangle's size."""


def solve_frame(problem: CalibrationProblem) -> CalibrationSolution:
    """Compute the relative pose from frames on three points ([Qin2024] Eq. 7-10).

    The first three points are used.

    Other points are ignored. The uncertainty is known only for stated noise: the method has no residuals to estimate it
    from.

    Args:
        problem: three points or more.

    Raises:
        InfeasibleError: the first three points are on a line, or as near to one as their noise.
    """
    first = CalibrationProblem(
        problem.left[:3], problem.right[:3], problem.names[:3], problem.noise, problem.origin
    )
    refuse_lines(first)
    R, t = relative_pose(first.left, first.right, first.origin)
    covariance = None if first.noise is None else _covariance(first, R, t) * first.noise**2
    return CalibrationSolution(R, t, covariance, None)


def point_frame(points: FloatArray) -> FloatArray:
    """Build the frames on three points (..., 3, 3), as rotations (..., 3, 3).

    Columns: x along P1P2, z along P1P2 × P1P3, y = z × x ([Qin2024] section 2.3).
    """
    x = points[..., 1, :] - points[..., 0, :]
    z = np.cross(x, points[..., 2, :] - points[..., 0, :])
    x = x / np.linalg.norm(x, axis=-1, keepdims=True)
    z = z / np.linalg.norm(z, axis=-1, keepdims=True)
    return np.stack([x, np.cross(z, x), z], axis=-1)


def relative_pose(
    left: FloatArray, right: FloatArray, origin: int
) -> tuple[FloatArray, FloatArray]:
    """Compute the relative pose T_left_cal T_right_cal^-1 ([Qin2024] Eq. 10).

    Returns rotations (..., 3, 3) and translations (..., 3) [m].

    Args:
        left: three points in the left frame [m], shape (..., 3, 3), a point a row.
        right: the same points in the right frame [m], shape (..., 3, 3).
        origin: index of the point at the frame's origin. It matters if the triangles are not congruent; the paper's
            text says P1 (0) and its printed matrices have P2 (1).
    """
    R = point_frame(left) @ np.swapaxes(point_frame(right), -1, -2)
    return R, left[..., origin, :] - (R @ right[..., origin, :, None])[..., 0]


def _covariance(problem: CalibrationProblem, R: FloatArray, t: FloatArray) -> FloatArray:
    """Compute the pose's first-order covariance for unit noise, shape (6, 6)."""
    points = np.stack([problem.left, problem.right])
    step = STEP * float(np.ptp(points, axis=1).max())
    moved = points + step * np.eye(18).reshape(18, 2, 3, 3)
    back = points - step * np.eye(18).reshape(18, 2, 3, 3)
    slopes = []
    for side in (moved, back):
        turned, shifted = relative_pose(side[:, 0], side[:, 1], problem.origin)
        slopes.append(np.concatenate([shifted - t, log_rotation(turned @ R.T)], axis=1))
    slope = (slopes[0] - slopes[1]) / (2.0 * step)
    covariance: FloatArray = slope.T @ slope
    return covariance


LOOSEST = np.pi / 2.0
"""Least refused half width of the rotation's 95 % interval [rad]."""


def solve_least_squares(problem: CalibrationProblem) -> CalibrationSolution:
    """Compute the least-squares pose over all points ([Kabsch1976], [Umeyama1991] without scale).

    With equal noise in every coordinate of both robots this is the maximum-likelihood estimate.

    Args:
        problem: three points or more.

    Raises:
        InfeasibleError: the points are on a line, or as near to one as their noise.
    """
    left, right = problem.left, problem.right
    refuse_lines(problem)
    R, t = fit_rigid(left, right)
    degrees = None if problem.noise is not None else 3 * len(left) - 6
    # A residual contains the noise of both robots: its variance is twice that of a coordinate.
    variance = (
        2.0 * problem.noise**2 if problem.noise is not None else residual_variance(left, right)
    )
    covariance = pose_covariance(left, right, R, variance)
    refuse_loose_turn(covariance, degrees, float(np.sqrt(variance)))
    return CalibrationSolution(R, t, covariance, degrees)


def refuse_loose_turn(covariance: FloatArray, degrees: int | None, noise: float) -> None:
    """Raise if the rotation's uncertainty is too large to be useful.

    Args:
        covariance: of translation and rotation vector, shape (6, 6).
        degrees: of freedom of the noise's estimate; None where it was stated.
        noise: standard deviation of one coordinate of a residual [m].

    Raises:
        InfeasibleError: its 95 % interval reaches a quarter turn.
    """
    # The axis of the largest uncertainty is in general no axis of the frame.
    deviation = float(np.sqrt(np.linalg.eigvalsh(covariance[3:, 3:])[-1]))
    width = interval_factor(degrees) * deviation
    if width >= LOOSEST:
        data = {"degrees": np.degrees(width), "mm": noise * 1000}
        raise InfeasibleError(Refusal("loose_turn", measured=width, allowed=LOOSEST, data=data))


def fit_rigid(left: FloatArray, right: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Fit rigid motions to many point sets by least squares.

    Returns rotations (..., 3, 3) and translations (..., 3) [m].

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
    """Estimate a residual coordinate's variance [m^2]: sum of squares / (3 n - 6).

    Args:
        left: points in the left frame [m], shape (..., n, 3), n > 2.
        right: the same points in the right frame [m], shape (..., n, 3).
    """
    R, t = fit_rigid(left, right)
    residuals = left - (right @ np.swapaxes(R, -1, -2) + t[..., None, :])
    total: FloatArray = (residuals**2).sum(axis=(-1, -2)) / (3 * left.shape[-2] - 6)
    return total


def pose_covariance(
    left: FloatArray, right: FloatArray, R: FloatArray, variance: FloatArray | float
) -> FloatArray:
    """Compute covariances (..., 6, 6) of the least-squares pose [m, rad].

    A small turn w about the centroid moves point x by w × x, so that its information is (tr(M) I - M) / variance with M
    = sum x x^T; that of a shift of the centroid is n / variance, and the two are independent. The right base's origin,
    t - centroid away, moves by shift + w × (t - centroid). First order; own derivation. Intervals of single numbers
    stay valid for rotations uncertain by several degrees. The joint region of all six does not, because the origin then
    moves on an arc: on the triangle of [Qin2024] it covers 94 % with a noise of 0.5 mm, but 85 % with 2 mm.

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
    covariance = np.zeros((*R.shape[:-2], 6, 6))
    covariance[..., :3, :3] = variance / n * np.eye(3) + lever @ turn @ np.swapaxes(lever, -1, -2)
    covariance[..., :3, 3:] = lever @ turn
    covariance[..., 3:, :3] = turn @ np.swapaxes(lever, -1, -2)
    covariance[..., 3:, 3:] = turn
    return covariance
