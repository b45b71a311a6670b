"""Pinocchio's model of a robot, which takes no sines from the machine's C library.

Their last digits depend on the processor. Joints that turn are unbounded ones for pinocchio: it takes them by cosine
and sine, and these are the project's own.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.elementary import cos, sin
from dualarm_cli.model.robot import Robot


class JointCoordinates:
    """A robot's model, and its coordinates by the positions of the robot's joints."""

    def __init__(self, robot: Robot) -> None:
        """Build the model."""
        urdf = robot.urdf.replace('type="revolute"', 'type="continuous"')
        self.model: pin.Model = pin.buildModelFromXML(urdf)
        self.order = np.array([robot.joints.index(name) for name in self.model.names[1:]])
        """Place of each of the model's joints among the robot's, shape (n,)."""
        self.back = np.argsort(self.order, kind="stable")
        """Place of each of the robot's joints among the model's, shape (n,)."""
        self._first, sizes = np.array(self.model.idx_qs)[1:], np.array(self.model.nqs)[1:]
        self._turns = sizes == 2

    def of(self, q: FloatArray) -> FloatArray:
        """Compute pinocchio's coordinates at joint positions [rad, m], shape (n,)."""
        position, turns, first = q[self.order], self._turns, self._first
        coordinates = np.empty(self.model.nq)
        coordinates[first] = np.where(turns, cos(position), position)
        coordinates[first[turns] + 1] = sin(position[turns])
        return coordinates
