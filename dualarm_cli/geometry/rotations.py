"""Batched rotations: exponential, logarithm, quaternions, roll-pitch-yaw and cross-product matrices."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.elementary import arctan2, cos, cube, sin
from dualarm_cli.geometry.products import norm, product

SMALL = 1e-6
"""Angle below which series replace closed formulas [rad]."""


def skew(vector: FloatArray) -> FloatArray:
    """Build cross-product matrices (..., 3, 3) of vectors (..., 3): K u = v x u."""
    x, y, z = np.moveaxis(np.asarray(vector, dtype=np.float64), -1, 0)
    zero = np.zeros_like(x)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def outward(directions: FloatArray, R_tool: FloatArray, R_world: FloatArray) -> FloatArray:
    """Compute unit vectors from targets to the outer ends of their lines, shape (..., 2, 3).

    Args:
        directions: of approach and retract, `LineDirections.vectors`, shape (..., 2, 2, 3).
        R_tool: rotations of the tool, shape (..., 3, 3).
        R_world: rotations of the world, in the same frame.
    """
    turning: FloatArray = product(directions[..., 0, :, :], np.swapaxes(R_tool, -1, -2))
    if not directions[..., 1, :, :].any():
        return turning
    fixed: FloatArray = product(directions[..., 1, :, :], np.swapaxes(R_world, -1, -2))
    return turning + fixed


def exp_rotation(vector: FloatArray) -> FloatArray:
    """Compute rotations (..., 3, 3) from rotation vectors (..., 3) [rad] by Rodrigues' formula."""
    angle = norm(vector, axis=-1)[..., None, None]
    safe = np.where(angle < SMALL, 1.0, angle)
    first = np.where(angle < SMALL, 1.0 - np.square(angle) / 6.0, sin(safe) / safe)
    second = np.where(
        angle < SMALL, 0.5 - np.square(angle) / 24.0, (1.0 - cos(safe)) / np.square(safe)
    )
    K = skew(vector)
    return np.eye(3) + first * K + second * product(K, K)


def right_jacobian(vector: FloatArray) -> FloatArray:
    """Compute the right Jacobians of rotation vectors (..., 3): rates to angular velocities.

    Angular velocities are in the rotated frame; shape (..., 3, 3).
    """
    angle = norm(vector, axis=-1)[..., None, None]
    safe = np.where(angle < SMALL, 1.0, angle)
    first = np.where(angle < SMALL, 0.5, (1.0 - cos(safe)) / np.square(safe))
    second = np.where(angle < SMALL, 1.0 / 6.0, (safe - sin(safe)) / cube(safe))
    K = skew(vector)
    return np.eye(3) - first * K + second * product(K, K)


def rpy_angles(R: FloatArray) -> FloatArray:
    """Compute roll, pitch, yaw (3,) [rad] with R = Rz(yaw) Ry(pitch) Rx(roll).

    Pitch and roll are read after the yaw is removed. So the three agree with R to rounding also at a pitch of a
    quarter turn, where the yaw is arbitrary.
    """
    yaw = float(arctan2(R[1, 0], R[0, 0]))
    c, s = cos(yaw), sin(yaw)
    level = product(np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]), R)
    pitch = arctan2(-level[2, 0], level[0, 0])
    roll = arctan2(-level[1, 2], level[1, 1])
    return np.array([roll, pitch, yaw]) + 0.0


def log_rotation(R: FloatArray) -> FloatArray:
    """Compute rotation vectors (..., 3) [rad] of rotations, angles up to pi.

    The quaternion of the largest component keeps it exact for small angles and near half a turn.
    """
    quaternion = to_quaternion(R)
    vector, w = quaternion[..., :3], quaternion[..., 3:]
    vector = np.where(w < 0.0, -vector, vector)
    sine = norm(vector, axis=-1, keepdims=True)
    angle = 2.0 * arctan2(sine, np.abs(w))
    scale = np.where(sine < SMALL, 2.0, angle / np.where(sine < SMALL, 1.0, sine))
    rotation_vector: FloatArray = vector * scale
    return rotation_vector


def to_quaternion(R: FloatArray) -> FloatArray:
    """Compute unit quaternions x, y, z, w (..., 4) of rotations (..., 3, 3)."""
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
    largest = np.argmax(np.diagonal(rows, axis1=-2, axis2=-1), axis=-1)
    row = np.take_along_axis(rows, largest[..., None, None], axis=-2)[..., 0, :]
    quaternion: FloatArray = row / norm(row, axis=-1, keepdims=True)
    return quaternion


def from_quaternion(q: FloatArray) -> FloatArray:
    """Compute rotations (..., 3, 3) from quaternions x, y, z, w of any length."""
    q = q / norm(q, axis=-1, keepdims=True)
    K = skew(q[..., :3])
    return np.asarray(np.eye(3) + 2.0 * (q[..., 3, None, None] * K + product(K, K)))
