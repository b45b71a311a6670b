"""Time-optimal transfers within limits of velocity, acceleration, jerk and torque: a nonlinear program for IPOPT.

The jerk is constant in equal intervals; torques are limited at knots and middles. Torques are CasADi expressions by the
recursive Newton-Euler algorithm.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.cell import Cell
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.robot import Arm

INTERVALS, ITERATIONS = 24, 400
"""Number of intervals, and maximum number of IPOPT's iterations."""


def torque_function(cell: Cell, arm: Arm) -> Any:
    """Returns the torques of an arm's joints by positions, velocities and accelerations, the others at home.

    Args:
        cell: robot and tools; springs, rotors and viscous friction of the robot count.
        arm: whose joints turn.
    """
    robot = cell.robot
    model = pin.buildModelFromXML(robot.urdf)
    for other in robot.arms:
        frame = model.frames[model.getFrameId(other.flange)]
        model.appendBodyToJoint(frame.parentJoint, cell.tools[other.name].inertia, frame.placement)
    home = pin.neutral(model)
    for name, value in zip(robot.joints, robot.postures["home"], strict=True):
        home[model.joints[model.getJointId(name)].idx_q] = value
    locked = [k for k, name in enumerate(model.names) if k and name not in arm.joints]
    model = pin.buildReducedModel(model, locked, home)
    data = model.createData()
    pin.forwardKinematics(model, data, np.ones(model.nq))
    q, v, a = (ca.SX.sym(name, model.nq) for name in "qva")
    zero = ca.SX.zeros(3)
    # Angular velocity, its rate, and acceleration of each joint's frame; the base accelerates against gravity.
    state = {0: (zero, zero, ca.SX(-model.gravity.linear))}
    force: dict[int, Any] = {}
    moment: dict[int, Any] = {}
    placed: dict[int, tuple[Any, Any, FloatArray]] = {}
    for k in range(1, model.njoints):
        place, body = model.jointPlacements[k], model.inertias[k]
        axis = pin.log3(place.rotation.T @ data.liMi[k].rotation)
        cross = pin.skew(axis)
        turn = np.eye(3) + ca.sin(q[k - 1]) * cross + (1 - ca.cos(q[k - 1])) * (cross @ cross)
        R, p = place.rotation @ turn, place.translation
        w0, dw0, a0 = state[model.parents[k]]
        w, spin = R.T @ w0, axis * v[k - 1]
        dw = R.T @ dw0 + axis * a[k - 1] + ca.cross(w, spin)
        w = w + spin
        acceleration = R.T @ (a0 + ca.cross(dw0, p) + ca.cross(w0, ca.cross(w0, p)))
        state[k], placed[k] = (w, dw, acceleration), (R, p, axis)
        c, inertia = body.lever, body.inertia
        force[k] = body.mass * (acceleration + ca.cross(dw, c) + ca.cross(w, ca.cross(w, c)))
        moment[k] = inertia @ dw + ca.cross(w, inertia @ w) + ca.cross(c, force[k])
    torque = ca.SX.zeros(model.nq)
    for k in range(model.njoints - 1, 0, -1):
        R, p, axis = placed[k]
        torque[k - 1] = ca.dot(axis, moment[k])
        if parent := model.parents[k]:
            force[parent] += R @ force[k]
            moment[parent] += R @ moment[k] + ca.cross(p, R @ force[k])
    columns, joint = robot.columns(list(model.names)[1:]), robot.torques
    torque += joint.rotor[columns] * a + joint.viscous[columns] * v
    torque -= joint.spring[columns] + joint.stiffness[columns] * q
    return ca.Function("torque", [q, v, a], [torque])


def optimal_duration(
    cell: Cell, arm: Arm, start: FloatArray, end: FloatArray, guess: Trajectory
) -> float | None:
    """Returns the duration of the optimum from rest to rest [s]; None where IPOPT finds none.

    Args:
        cell: robot and tools.
        arm: the arm.
        start: its joints (n,) at the start [rad].
        end: those at the end.
        guess: a motion between both to begin with.
    """
    n, N, limits = len(arm.joints), INTERVALS, cell.robot.limits.select(arm.joints)
    torques = torque_function(cell, arm)
    effort = cell.robot.torques.effort[cell.robot.columns(arm.joints)]
    T, x = ca.SX.sym("T"), [ca.SX.sym(name, n, N + 1) for name in "qva"]
    q, v, a = x
    h = T / N
    middle_a = (a[:, :-1] + a[:, 1:]) / 2
    middle_v = v[:, :-1] + h / 4 * (a[:, :-1] + middle_a)
    middle_q = q[:, :-1] + h / 2 * v[:, :-1] + h * h / 24 * (2 * a[:, :-1] + middle_a)
    both = [ca.horzcat(*pair) for pair in ((q, middle_q), (v, middle_v), (a, middle_a))]
    share = torques.map(2 * N + 1)(*both) / np.tile(effort[:, None], (1, 2 * N + 1))
    equal = ca.vertcat(
        ca.vec(q[:, 1:] - q[:, :-1] - h * v[:, :-1] - h * h / 6 * (2 * a[:, :-1] + a[:, 1:])),
        ca.vec(v[:, 1:] - v[:, :-1] - h / 2 * (a[:, :-1] + a[:, 1:])),
        ca.vec(q[:, [0, -1]] - np.array([start, end]).T),
        ca.vec(v[:, [0, -1]]),
        ca.vec(a[:, [0, -1]]),
    )
    jerk = (a[:, 1:] - a[:, :-1]) / np.tile(limits.jerk[:, None], (1, N))
    bounded = ca.vertcat(ca.vec(share), ca.vec(jerk - h), ca.vec(-jerk - h))
    lower = [-np.ones(share.numel()), np.full(2 * jerk.numel(), -np.inf)]
    upper = [np.ones(share.numel()), np.zeros(2 * jerk.numel())]
    zero = np.zeros(equal.numel())
    most = [np.tile(row, N + 1) for row in (limits.velocity, limits.acceleration)]
    motion = guess.at(np.linspace(0.0, guess.duration, N + 1))
    options = {
        "print_time": False,
        "ipopt": {"print_level": 0, "sb": "yes", "max_iter": ITERATIONS},
    }
    solver = ca.nlpsol(
        "transfer", "ipopt",
        {"x": ca.vertcat(T, *(ca.vec(part) for part in x)), "f": T, "g": ca.vertcat(equal, bounded)},
        options,
    )  # fmt: skip
    solution = solver(
        x0=np.concatenate([[guess.duration], *(part.ravel() for part in motion)]),
        lbx=np.concatenate([[0.0], np.tile(limits.lower, N + 1), *(-part for part in most)]),
        ubx=np.concatenate([[np.inf], np.tile(limits.upper, N + 1), *most]),
        lbg=np.concatenate([zero, *lower]),
        ubg=np.concatenate([zero, *upper]),
    )
    return float(solution["f"]) if solver.stats()["success"] else None
