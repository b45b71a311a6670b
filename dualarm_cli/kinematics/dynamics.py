"""Rigid-body dynamics of a robot by pinocchio: mass matrix and torques."""

from __future__ import annotations

from collections.abc import Mapping

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
        """Compute pinocchio's coordinates at joint positions [rad, m], shape (..., n)."""
        position, turns, first = q[..., self.order], self._turns, self._first
        coordinates = np.empty((*q.shape[:-1], self.model.nq))
        coordinates[..., first] = np.where(turns, cos(position), position)
        coordinates[..., first[turns] + 1] = sin(position[..., turns])
        return coordinates


class Dynamics:
    """Rigid-body dynamics; configurations are in the order of the robot's joints."""

    def __init__(self, cell: Cell, loads: Mapping[str, pin.Inertia] | None = None) -> None:
        """Build the model with the fixed tools and what they carry.

        Args:
            cell: robot, base and tools.
            loads: inertia of what each arm carries besides its fixed tool, in the flange frame; None for a robot
                without tools.
        """
        robot = cell.robot
        self._coordinates = JointCoordinates(robot)
        model, self._back = self._coordinates.model, self._coordinates.back
        model.gravity.linear = product(cell.base.rotation.T, model.gravity.linear)
        for arm in () if loads is None else robot.arms:
            flange = model.frames[model.getFrameId(arm.flange, pin.FrameType.BODY)]
            load = (loads or {}).get(arm.name, pin.Inertia.Zero())
            inertia = cell.tools[arm.name].inertia + load
            model.appendBodyToJoint(flange.parentJoint, inertia, flange.placement)
        self._model, self._data, self._robot = model, model.createData(), robot
        self.limit: FloatArray = robot.torques.effort - robot.torques.coulomb
        """Largest joint torques besides Coulomb friction [N m or N], shape (n,)."""

    @property
    def unknown(self) -> list[str]:
        """Joints without a torque limit, or whose link has no mass or that of a placeholder."""
        masses = np.array([inertia.mass for inertia in self._model.inertias[1:]])[self._back]
        effort, same = (
            self._robot.torques.effort,
            len(masses) >= PLACEHOLDERS and np.ptp(masses) == 0.0,
        )
        has_data = (effort > 0.0) & np.isfinite(effort) & (masses > 0.0) & (not same)
        return [name for name, has in zip(self._robot.joints, has_data, strict=True) if not has]

    def at(self, q: FloatArray, qd: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute the mass matrix (n, n) and torques without acceleration (n,) [N m or N].

        Rotors, springs and viscous friction count; Coulomb friction is in the limit.

        Args:
            q: positions [rad], shape (n,).
            qd: velocities [rad/s], shape (n,).
        """
        at, rates = self._coordinates.of(q), qd[self._coordinates.order]
        M = pin.crba(self._model, self._data, at)
        M = np.triu(M) + np.triu(M, 1).T
        bias = pin.nonLinearEffects(self._model, self._data, at, rates)[self._back]
        joint = self._robot.torques
        bias += joint.viscous * qd - joint.spring - joint.stiffness * q
        return M[np.ix_(self._back, self._back)] + np.diag(joint.rotor), bias

    def torques(
        self, q: FloatArray, v: FloatArray, a: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Compute torques at rest, of the motion, and of viscous friction [N m or N].

        Each has shape (k, n). Springs count at rest, rotors with the motion; Coulomb friction is in the limit.

        Args:
            q: positions [rad or m], shape (k, n).
            v: velocities, shape (k, n).
            a: accelerations, shape (k, n).
        """
        rest, whole, joint = np.empty(q.shape), np.empty(q.shape), self._robot.torques
        order, model, data = self._coordinates.order, self._model, self._data
        rates = (np.take(x, order, axis=1) for x in (v, a))
        rows = zip(self._coordinates.of(q), *rates, strict=True)
        for k, (at, velocity, acceleration) in enumerate(rows):
            rest[k] = pin.computeGeneralizedGravity(model, data, at)
            whole[k] = pin.rnea(model, data, at, velocity, acceleration)
        motion, rest = (whole - rest)[:, self._back], rest[:, self._back]
        rest -= joint.spring + joint.stiffness * q
        return rest, motion + joint.rotor * a, joint.viscous * v

    def linearised(
        self, q: FloatArray, v: FloatArray, a: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Compute torques (n,) and their derivatives (n, n) by q, v and a.

        Coulomb friction is in the limit.

        Args:
            q: positions [rad or m], shape (n,).
            v: velocities, shape (n,).
            a: accelerations, shape (n,).
        """
        back, order, joint = self._back, self._coordinates.order, self._robot.torques
        at, square = self._coordinates.of(q), np.ix_(back, back)
        by_q, by_v, by_a = pin.computeRNEADerivatives(
            self._model, self._data, at, v[order], a[order]
        )
        by_a = np.triu(by_a) + np.triu(by_a, 1).T
        torque = self._data.tau[back] + joint.rotor * a + joint.viscous * v
        torque -= joint.spring + joint.stiffness * q
        by_q, by_v = by_q[square] - np.diag(joint.stiffness), by_v[square] + np.diag(joint.viscous)
        return torque, by_q, by_v, by_a[square] + np.diag(joint.rotor)


POSTURES = 400
"""Number of random postures in which the empty robot has to hold itself."""
PLACEHOLDERS = 4
"""Least number of links whose equal masses count as placeholders."""


def limits_torques(cell: Cell) -> bool:
    """Check whether a plan has to stay within torques: the cell's rule and the robot's data.

    The data of a robot that cannot hold itself without tools lack springs or the true effort ([Featherstone2008]).
    """
    robot = cell.robot
    if cell.torque != "limited" or not (robot.torques.effort > 0.0).all():
        return False
    dynamics = Dynamics(cell)
    if dynamics.unknown:
        return False
    zero = np.zeros((POSTURES + 1, len(robot.joints)))
    shares = np.random.default_rng(0).uniform(size=zero[1:].shape)
    lower, upper = robot.limits.lower, robot.limits.upper
    postures = np.vstack([robot.postures["home"], lower + shares * (upper - lower)])
    at_rest, _, _ = dynamics.torques(postures, zero, zero)
    return bool((np.abs(at_rest) <= dynamics.limit).all())
