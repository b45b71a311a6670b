"""Rotations as turns about three given axes, at any angles to each other: the two ways for each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.kinematics.platform_chain import rotation_z

ALIGNED = 1e-12
"""Sine of the angle of the outer axes below which only the sum or difference of their turns counts."""
SLACK = 1e-12
"""How far an angle may pass what the axes allow, by rounding [rad]."""


@dataclass(frozen=True)
class Turns:
    """Turns about three axes."""

    q: FloatArray
    """Angles [rad], finite everywhere, shape (..., 2, 3)."""
    possible: BoolArray
    """Whether the rotation can be made, shape (...)."""
    aligned: BoolArray
    """Whether the first angle is free and took its reference, shape (...)."""


def three_turns(R_12: FloatArray, R_23: FloatArray, M: FloatArray, reference: FloatArray) -> Turns:
    """Returns the angles of M = Rz(a) R_12 Rz(b) R_23 Rz(c), as the subproblems of Paden and Kahan do [Murray1994].

    With alpha, beta the angles of the axes 1 to 2 and 2 to 3, and theta from 1 to 3 as M has it, the middle angle
    counted from where the outer axes are nearest is phi, half of it
    tan² (phi/2) = sin((theta + alpha - beta)/2) sin((theta - alpha + beta)/2) /
    (sin((alpha + beta + theta)/2) sin((alpha + beta - theta)/2)): the spherical triangle of the three axes, exact near
    its ends. Way 0 has phi >= 0, way 1 phi <= 0. The third angle is what is left, so that nothing is lost where the
    outer axes are nearly aligned; where they are, the first angle is the reference. Our own derivation.

    Args:
        R_12: second frame in the first, its z the axis, shape (3, 3).
        R_23: third frame in the second, shape (3, 3).
        M: rotations, shape (..., 3, 3).
        reference: first angle where it is free [rad], broadcast against (...).
    """
    first, last = R_12[2], R_23[:, 2]  # axes 1 and 3 in frame 2, joint 2 at zero
    alpha = np.arctan2(np.hypot(first[0], first[1]), first[2])
    beta = np.arctan2(np.hypot(last[0], last[1]), last[2])
    x, y = M[..., 0, 2], M[..., 1, 2]
    sine = np.hypot(x, y)
    theta = np.arctan2(sine, M[..., 2, 2])
    near = np.sin(0.5 * (theta + alpha - beta)) * np.sin(0.5 * (theta - alpha + beta))
    far = np.sin(0.5 * (alpha + beta + theta)) * np.sin(0.5 * (alpha + beta - theta))
    least, most = abs(alpha - beta), min(alpha + beta, 2.0 * np.pi - alpha - beta)
    possible = (theta >= least - SLACK) & (theta <= most + SLACK)
    phi = 2.0 * np.arctan2(np.sqrt(np.maximum(near, 0.0)), np.sqrt(np.maximum(far, 0.0)))
    b = np.stack([phi, -phi], axis=-1) + (
        np.arctan2(first[1], first[0]) - np.arctan2(last[1], last[0])
    )
    outer = R_12 @ rotation_z(b) @ last
    aligned = sine < ALIGNED
    turned = (x + 1j * y)[..., None] * (outer[..., 0] - 1j * outer[..., 1])
    a = np.where(aligned[..., None], np.asarray(reference)[..., None], np.angle(turned))
    middle = rotation_z(a) @ R_12 @ rotation_z(b) @ R_23
    # Rz(c) = middle^T M: its first column.
    left = np.swapaxes(middle, -1, -2) @ M[..., None, :, :1]
    c = np.arctan2(left[..., 1, 0], left[..., 0, 0])
    return Turns(np.stack([a, b, c], axis=-1), possible, aligned)
