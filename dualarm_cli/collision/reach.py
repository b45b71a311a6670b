"""Pairs of solids that never meet, because their kinematic chains are too short."""

from __future__ import annotations

from collections.abc import Sequence

import coal
import numpy as np
import pinocchio as pin

from dualarm_cli.collision.solids import Pair, Solid
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.records import dataclass

SURE = 1e-6
"""Allowance for rounding [m]."""


@dataclass(frozen=True)
class _Ball:
    """Ball that always contains a solid, in the frame of a joint below it."""

    center: FloatArray
    """Middle [m], shape (3,)."""
    radius: float
    """Radius [m]; infinite if unbounded."""


class Reach:
    """Bounds of the positions of solids over all joint values of a robot."""

    def __init__(self, model: pin.Model) -> None:
        """Compute the axes of the joints.

        Args:
            model: model of the robot's URDF; every joint has one degree of freedom.
        """
        self._model = model
        twists = np.array([_twist(model, joint) for joint in range(1, model.njoints)]).reshape(
            -1, 6
        )
        self._axis = dict(enumerate(twists[:, 3:], start=1))
        self._slides = {joint for joint, axis in self._axis.items() if not axis.any()}

    def can_meet(self, solid_a: Solid, solid_b: Solid, pair: Pair, within: float = 0.0) -> bool:
        """Check whether two solids can come within their required clearance and `within`.

        From the last joint that moves both, each solid is within a ball about a point of the axis of its next joint.
        The radius is the sum of the lengths of the following links.

        Args:
            solid_a: first solid of the pair.
            solid_b: second solid of the pair.
            pair: pair with the required clearance.
            within: distance that is added to the clearance [m].
        """
        below = [_chain(self._model, solid.joint) for solid in (solid_a, solid_b)]
        common = max(set(below[0]) & set(below[1]), key=below[0].index)
        balls = [
            self._ball(solid, chain[chain.index(common) + 1 :])
            for solid, chain in zip((solid_a, solid_b), below, strict=True)
        ]
        far = pair.required + within + SURE
        if balls[0] is not None and balls[1] is not None:
            distance = float(norm(balls[0].center - balls[1].center))
            return distance - balls[0].radius - balls[1].radius < far
        for ball, fixed in ((balls[0], solid_b), (balls[1], solid_a)):
            if ball is not None and np.isfinite(ball.radius):
                return _distance(ball.center, fixed) - ball.radius < far
        return True

    def _ball(self, solid: Solid, chain: Sequence[int]) -> _Ball | None:
        """Compute a ball that always contains a solid, or None if it does not move.

        It is in the frame in which the solid's chain of joints begins.
        """
        if not chain:
            return None
        placements = [self._model.jointPlacements[joint] for joint in chain[:2]]
        if not self._slides.isdisjoint(chain):
            return _Ball(np.asarray(placements[0].translation), np.inf)
        length = solid.extent + sum(
            float(norm(self._model.jointPlacements[joint].translation)) for joint in chain[2:]
        )
        if len(chain) == 1:
            return _Ball(np.asarray(placements[0].translation), length)
        # The next joint's origin moves on a circle about the axis of the first one.
        axis, step = self._axis[chain[0]], placements[1].translation
        along = float(product(axis, step))
        center = np.asarray(placements[0].act(along * axis))
        return _Ball(center, float(norm(step - along * axis)) + length)


def _chain(model: pin.Model, joint: int) -> list[int]:
    """List the joints from the root to a joint."""
    chain = [joint]
    while joint:
        joint = model.parents[joint]
        chain.append(joint)
    return chain[::-1]


def _twist(model: pin.Model, joint: int) -> FloatArray:
    """Compute the motion axis of a joint in its own frame: linear and angular, shape (6,)."""
    joint_model = model.joints[joint]
    data = joint_model.createData()
    joint_model.calc(data, pin.neutral(model))
    return np.asarray(data.S, dtype=np.float64).reshape(6)


def _distance(point: FloatArray, solid: Solid) -> float:
    """Compute the distance of a point from a solid in the same frame [m]."""
    dot = coal.Sphere(SURE)
    places = [
        coal.Transform3s(np.eye(3), point),
        coal.Transform3s(solid.pose.rotation, solid.pose.translation),
    ]
    return float(
        coal.distance(
            dot,
            places[0],
            solid.geometry,
            places[1],
            coal.DistanceRequest(),
            coal.DistanceResult(),
        )
    )
