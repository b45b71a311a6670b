"""Rigid-body dynamics of a robot by pinocchio: mass matrix and torques."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.elementary import cos, sin
from dualarm_cli.geometry.products import product
from dualarm_cli.model.cell import Cell
from dualarm_cli.model.robot import Robot


class JointCoordinates:
    """Pinocchio's model of a robot, and its coordinates at joint positions.

    Sines of the machine's C library depend on the processor. So revolute joints are unbounded ones for pinocchio: it
    takes their cosine and sine, and these are the project's own.
    """

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


class Dynamics:
    """Rigid-body dynamics; configurations are in the order of the robot's joints."""

    def __init__(self, cell: Cell) -> None:
        """Build the model, with the fixed tools.

        Args:
            cell: robot, base and tools.
        """
        robot = cell.robot
        self._coordinates = JointCoordinates(robot)
        model, self._back = self._coordinates.model, self._coordinates.back
        model.gravity.linear = product(cell.base.rotation.T, model.gravity.linear)
        for arm in robot.arms:
            flange = model.frames[model.getFrameId(arm.flange)]
            inertia = cell.tools[arm.name].inertia
            model.appendBodyToJoint(flange.parentJoint, inertia, flange.placement)
        self._model, self._data = model, model.createData()
        self.limit: FloatArray = robot.torques.effort
        """Largest joint torques [N m], shape (n,), 0 if the URDF has none."""
        masses = np.array([model.inertias[k].mass for k in range(1, model.njoints)])
        self._unknown = [
            robot.joints[j]
            for j in range(len(robot.joints))
            if self.limit[j] <= 0.0 or not np.isfinite(self.limit[j]) or masses[self._back[j]] <= 0
        ]

    @property
    def unknown(self) -> list[str]:
        """Joints without a torque limit, or whose link has no mass."""
        return self._unknown

    def at(self, q: FloatArray, qd: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute the mass matrix (n, n) and torques without acceleration (n,) [N m].

        Args:
            q: positions [rad], shape (n,).
            qd: velocities [rad/s], shape (n,).
        """
        q, qd = self._coordinates.of(q), qd[self._coordinates.order]
        M = pin.crba(self._model, self._data, q)
        M = np.triu(M) + np.triu(M, 1).T
        bias = pin.nonLinearEffects(self._model, self._data, q, qd)
        return M[np.ix_(self._back, self._back)], bias[self._back]
