"""The three-point frame method of [Qin2024]."""

from __future__ import annotations

import numpy as np

from dualarm_cli.calibration.problem import CalibrationProblem
from dualarm_cli.calibration.solution import CalibrationSolution
from dualarm_cli.calibration.spread import refuse_lines
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.rotations import log_rotation

STEP = 1e-6
"""Step of the finite differences, relative to the size of the triangle."""


def solve_frame(problem: CalibrationProblem) -> CalibrationSolution:
    """Returns the pose of a frame on the first three points as both robots see it ([Qin2024] Eq. 7 to 10).

    Other points play no part. How sure it is can be said where the noise is stated only: the method leaves no
    residuals of its own to estimate it from.

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
    """Returns rotations (..., 3, 3) of the frames on three points (..., 3, 3), x, y, z in the columns.

    x along P1P2, z along P1P2 × P1P3, y = z × x ([Qin2024] section 2.3).
    """
    x = points[..., 1, :] - points[..., 0, :]
    z = np.cross(x, points[..., 2, :] - points[..., 0, :])
    x = x / np.linalg.norm(x, axis=-1, keepdims=True)
    z = z / np.linalg.norm(z, axis=-1, keepdims=True)
    return np.stack([x, np.cross(z, x), z], axis=-1)


def relative_pose(
    left: FloatArray, right: FloatArray, origin: int
) -> tuple[FloatArray, FloatArray]:
    """Returns rotations (..., 3, 3) and translations (..., 3) [m] of T_left_cal T_right_cal^-1 ([Qin2024] Eq. 10).

    Args:
        left: three points in the left frame [m], shape (..., 3, 3), a point a row.
        right: the same points in the right frame [m], shape (..., 3, 3).
        origin: which of them is the frame's origin. It matters where the triangles are not congruent; the paper's
            text says P1 (0) and its printed matrices have P2 (1).
    """
    R = point_frame(left) @ np.swapaxes(point_frame(right), -1, -2)
    return R, left[..., origin, :] - (R @ right[..., origin, :, None])[..., 0]


def _covariance(problem: CalibrationProblem, R: FloatArray, t: FloatArray) -> FloatArray:
    """Returns the pose's covariance for a noise of 1 m in every coordinate, to first order, shape (6, 6)."""
    points = np.stack([problem.left, problem.right])
    step = STEP * float(np.ptp(points, axis=1).max())
    moved = points + step * np.eye(18).reshape(18, 2, 3, 3)
    back = points - step * np.eye(18).reshape(18, 2, 3, 3)
    slopes = []
    for side in (moved, back):
        turned, shifted = relative_pose(side[:, 0], side[:, 1], problem.origin)
        slopes.append(np.concatenate([shifted - t, log_rotation(turned @ R.T)], axis=1))
    slope = (slopes[0] - slopes[1]) / (2.0 * step)
    found: FloatArray = slope.T @ slope
    return found
