"""Rotations as arrays: exponential, logarithm and the matrix of a cross product, for many at once."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.elementary import arctan2, cos, cube, sin
from dualarm_cli.geometry.products import norm, product

SMALL = 1e-6
"""Angles below this are taken by their series [rad]."""


def skew(vector: FloatArray) -> FloatArray:
    """Returns matrices K (..., 3, 3) with K u = v x u for vectors v (..., 3)."""
    x, y, z = np.moveaxis(np.asarray(vector, dtype=np.float64), -1, 0)
    zero = np.zeros_like(x)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def exp_rotation(vector: FloatArray) -> FloatArray:
    """Returns rotations (..., 3, 3) by rotation vectors (..., 3) [rad] (Rodrigues' formula)."""
    angle = norm(vector, axis=-1)[..., None, None]
    safe = np.where(angle < SMALL, 1.0, angle)
    one = np.where(angle < SMALL, 1.0 - np.square(angle) / 6.0, sin(safe) / safe)
    two = np.where(
        angle < SMALL, 0.5 - np.square(angle) / 24.0, (1.0 - cos(safe)) / np.square(safe)
    )
    K = skew(vector)
    return np.eye(3) + one * K + two * product(K, K)


def right_jacobian(vector: FloatArray) -> FloatArray:
    """Compute matrices from rates of rotation vectors (..., 3) to angular velocities.

    Angular velocities are in the turned frame; shape (..., 3, 3).
    """
    angle = norm(vector, axis=-1)[..., None, None]
    safe = np.where(angle < SMALL, 1.0, angle)
    one = np.where(angle < SMALL, 0.5, (1.0 - cos(safe)) / np.square(safe))
    two = np.where(angle < SMALL, 1.0 / 6.0, (safe - sin(safe)) / cube(safe))
    K = skew(vector)
    return np.eye(3) - one * K + two * product(K, K)


def rpy_angles(R: FloatArray) -> FloatArray:
    """Returns roll, pitch, yaw (3,) [rad] with R = Rz(yaw) Ry(pitch) Rx(roll), for one rotation (3, 3).

    Pitch and roll are read after the yaw has been taken off, so that the three agree with R to rounding also where
    pitch is a quarter turn and the yaw alone means nothing.
    """
    yaw = float(arctan2(R[1, 0], R[0, 0]))
    c, s = cos(yaw), sin(yaw)
    level = product(np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]), R)
    pitch = arctan2(-level[2, 0], level[0, 0])
    roll = arctan2(-level[1, 2], level[1, 1])
    return np.array([roll, pitch, yaw]) + 0.0


def log_rotation(R: FloatArray) -> FloatArray:
    """Returns rotation vectors (..., 3) [rad] of rotations (..., 3, 3), angles up to pi.

    Through the quaternion of the largest component, so that it is exact for small angles and near half a turn.
    """
    quaternion = to_quaternion(R)
    vector, w = quaternion[..., :3], quaternion[..., 3:]
    vector = np.where(w < 0.0, -vector, vector)
    sine = norm(vector, axis=-1, keepdims=True)
    angle = 2.0 * arctan2(sine, np.abs(w))
    scale = np.where(sine < SMALL, 2.0, angle / np.where(sine < SMALL, 1.0, sine))
    found: FloatArray = vector * scale
    return found


def to_quaternion(R: FloatArray) -> FloatArray:
    """Returns unit quaternions x, y, z, w (..., 4) of rotations (..., 3, 3)."""
    R = np.asarray(R, dtype=np.float64)
    xx, yy, zz = R[..., 0, 0], R[..., 1, 1], R[..., 2, 2]
    # Row k of the symmetric matrix 4 q q^T: the one with the largest diagonal is the best conditioned.
    yz, zx, xy = R[..., 2, 1], R[..., 0, 2], R[..., 1, 0]
    zy, xz, yx = R[..., 1, 2], R[..., 2, 0], R[..., 0, 1]
    rows = np.stack(
        [
            np.stack([1.0 + xx - yy - zz, yx + xy, zx + xz, yz - zy], axis=-1),
            np.stack([yx + xy, 1.0 - xx + yy - zz, zy + yz, zx - xz], axis=-1),
            np.stack([zx + xz, zy + yz, 1.0 - xx - yy + zz, xy - yx], axis=-1),
            np.stack([yz - zy, zx - xz, xy - yx, 1.0 + xx + yy + zz], axis=-1),
        ],
        axis=-2,
    )
    best = np.argmax(np.diagonal(rows, axis1=-2, axis2=-1), axis=-1)
    row = np.take_along_axis(rows, best[..., None, None], axis=-2)[..., 0, :]
    found: FloatArray = row / norm(row, axis=-1, keepdims=True)
    return found


def from_quaternion(q: FloatArray) -> FloatArray:
    """Compute rotations (..., 3, 3) from quaternions x, y, z, w of any length."""
    q = q / norm(q, axis=-1, keepdims=True)
    K = skew(q[..., :3])
    return np.asarray(np.eye(3) + 2.0 * (q[..., 3, None, None] * K + product(K, K)))
