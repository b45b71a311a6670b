"""Mass matrix and torques of a robot with its tools, where its URDF has inertias and torque limits."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.products import product
from dualarm_cli.kinematics.joint_coordinates import JointCoordinates
from dualarm_cli.model.cell import Cell


class Dynamics:
    """Rigid-body dynamics; configurations are in the order of the robot's joints."""

    def __init__(self, cell: Cell) -> None:
        """Builds the model; a tool's mass sits at its tool centre point.

        Args:
            cell: robot, base and tools.
        """
        robot = cell.robot
        self._coordinates = JointCoordinates(robot)
        model, self._back = self._coordinates.model, self._coordinates.back
        model.gravity.linear = product(cell.base.rotation.T, model.gravity.linear)
        for arm in robot.arms:
            tool = cell.tools[arm.name]
            flange = model.frames[model.getFrameId(arm.flange)]
            if tool.mass > 0.0:
                inertia = pin.Inertia(tool.mass, np.zeros(3), np.zeros((3, 3)))
                model.appendBodyToJoint(flange.parentJoint, inertia, flange.placement * tool.tcp)
        self._model, self._data = model, model.createData()
        self.limit: FloatArray = np.array(model.upperEffortLimit)[self._back]
        """Largest torque of every joint [N m], 0 where the URDF has none, shape (n,)."""
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
        """Returns mass matrix (n, n) and torques at no acceleration (n,) [N m].

        Args:
            q: positions [rad], shape (n,).
            qd: velocities [rad/s], shape (n,).
        """
        q, qd = self._coordinates.of(q), qd[self._coordinates.order]
        M = pin.crba(self._model, self._data, q)
        M = np.triu(M) + np.triu(M, 1).T
        rest = pin.nonLinearEffects(self._model, self._data, q, qd)
        return M[np.ix_(self._back, self._back)], rest[self._back]
