"""A posture to start from: collision-free, far from limits and singular postures, tools down in front of the robot."""

from __future__ import annotations

from itertools import product

import numpy as np
import pinocchio as pin

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.elementary import tanh
from dualarm_cli.geometry.linear_systems import singular_values
from dualarm_cli.model.robot import Robot
from dualarm_cli.robot_import.contacts import (
    in_model_order,
    random_postures,
    sampled_range,
    touches,
)

LOOKED_AT = 4000
"""Postures that are compared."""
TRIED = 400
"""Of them, those that are tested for collisions at most, best first."""
FEW = 40
"""Postures of each arm that are combined with the other's."""


def propose_home(robot: Robot, seed: int) -> FloatArray | None:
    """Returns a posture (joints,) [rad or m]; None where all that were tried collide.

    The platform is at 0 or nearest to it; one that slides, where that collides, in the middle or at an end.

    Args:
        robot: with its allowed contacts.
        seed: of the random postures.
    """
    columns = robot.columns(robot.platform)
    lower, upper = robot.limits.lower[columns], robot.limits.upper[columns]
    places = [np.clip(0.0, lower, upper)]
    if robot.platform and robot.sliding.issuperset(robot.platform):
        places += [0.5 * (lower + upper), upper, lower]
    found = (_home_at(robot, seed, place) for place in places)
    return next((home for home in found if home is not None), None)


def _home_at(robot: Robot, seed: int, place: FloatArray) -> FloatArray | None:
    """Returns a posture with the platform at a place (k,) [rad or m]; None where all that were tried collide."""
    model = pin.buildModelFromXML(robot.urdf)
    data = model.createData()
    limits = robot.limits
    middle = np.clip(0.0, limits.lower, limits.upper)
    middle[robot.columns(robot.platform)] = place
    lower, upper = sampled_range(robot)
    width, centre = upper - lower, 0.5 * (lower + upper)
    postures = random_postures(robot, LOOKED_AT, seed)
    # Around the middle of the ranges: what random arms do in the outer half is seldom worth starting from.
    postures = centre + 0.7 * (postures - centre)
    postures[:, robot.columns(robot.platform)] = middle[robot.columns(robot.platform)]
    ordered = in_model_order(model, robot, postures)
    best: dict[str, list[int]] = {}
    for arm in robot.arms:
        columns = robot.columns(arm.joints)
        moved = [model.idx_vs[model.getJointId(name)] for name in arm.joints]
        frame = model.getFrameId(arm.flange)
        side = {"left": 1.0, "right": -1.0}[arm.name] if len(robot.arms) > 1 else 0.0
        score = np.empty(len(postures))
        for k, (q, in_order) in enumerate(zip(postures, ordered, strict=True)):
            jacobian = pin.computeFrameJacobian(model, data, in_order, frame, pin.LOCAL)[:, moved]
            values = singular_values(jacobian)
            pin.framesForwardKinematics(model, data, in_order)
            pose = data.oMf[frame]
            room = np.min(
                0.5 - np.abs(q[columns] - centre[columns]) / np.maximum(width[columns], 1e-9)
            )
            down = -pose.rotation[2, 2]
            front = tanh(4.0 * pose.translation[0])
            own_side = tanh(4.0 * side * pose.translation[1])
            score[k] = 2.0 * room + down + 0.5 * front + 0.5 * own_side + 2.0 * min(values[-1], 0.2)
        best[arm.name] = np.argsort(-score, kind="stable")[:TRIED].tolist()

    def together(numbers: dict[str, list[int]]) -> FloatArray:
        """Returns postures with each arm as in the sampled postures of some numbers, shape (n, joints)."""
        rows = np.tile(middle, (len(next(iter(numbers.values()))), 1))
        for name, chosen in numbers.items():
            columns = robot.columns(robot.arm(name).joints)
            rows[:, columns] = postures[np.ix_(chosen, columns)]
        return rows

    free: dict[str, list[int]] = {}
    for name, numbers in best.items():
        clear = ~touches(robot, together({name: numbers}), [name])
        free[name] = [number for number, ok in zip(numbers, clear, strict=True) if ok][:FEW]
    if not all(free.values()):
        return None
    # The best of one arm with the best of the other first.
    pairs = sorted(product(*(range(len(found)) for found in free.values())), key=sum)[:TRIED]
    candidates = together(
        {name: [found[pair[a]] for pair in pairs] for a, (name, found) in enumerate(free.items())}
    )
    usable = np.flatnonzero(~touches(robot, candidates, list(free)))
    return candidates[usable[0]] if len(usable) else None
