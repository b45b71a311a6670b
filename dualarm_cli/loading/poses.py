"""Poses of the files as rigid transforms."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from dualarm_cli.loading.fields import Pose


def to_se3(pose: Pose) -> pin.SE3:
    """Returns the transform T_parent_child that a file's pose describes.

    `rpy` turns about the parent's fixed axes x, then y, then z, as in URDF:
    R = Rz(yaw) Ry(pitch) Rx(roll).

    Args:
        pose: translation [m] and rotation [rad]; what is missing is zero.
    """
    if pose.quat is not None:
        x, y, z, w = pose.quat
        rotation = pin.Quaternion(w, x, y, z).toRotationMatrix()
    elif pose.rpy is not None:
        rotation = pin.rpy.rpyToMatrix(*pose.rpy)
    else:
        rotation = np.eye(3)
    return pin.SE3(rotation, np.array(pose.xyz or [0.0, 0.0, 0.0]))
