"""Pairs of solids that can never meet, whatever the joints do: their chains are too short."""

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
"""What rounding may be off [m]."""


@dataclass(frozen=True)
class _Ball:
    """Where a solid is always within, in the frame of a joint below it."""

    center: FloatArray
    """Middle [m], shape (3,)."""
    radius: float
    """Radius [m]; infinite where there is none."""


class Reach:
    """Where solids can be, whatever the joints of one robot do."""

    def __init__(self, model: pin.Model) -> None:
        """Looks up how joints move.

        Args:
            model: of the robot's URDF; every joint has one degree of freedom.
        """
        self._model = model
        twists = np.array([_twist(model, joint) for joint in range(1, model.njoints)]).reshape(
            -1, 6
        )
        self._axis = dict(enumerate(twists[:, 3:], start=1))
        self._slides = {joint for joint, axis in self._axis.items() if not axis.any()}

    def can_meet(self, one: Solid, other: Solid, pair: Pair, within: float = 0.0) -> bool:
        """Returns whether two solids can come within their required clearance and a little more of each other.

        From the last joint that moves both, each solid is within a ball about a point of the axis of the next joint
        towards it: as far from it as the lengths of the links from there on add up to.

        Args:
            one: the pair's first solid.
            other: its second one.
            pair: for its clearance.
            within: what is added to the clearance [m].
        """
        below = [_chain(self._model, solid.joint) for solid in (one, other)]
        common = max(set(below[0]) & set(below[1]), key=below[0].index)
        balls = [
            self._ball(solid, chain[chain.index(common) + 1 :])
            for solid, chain in zip((one, other), below, strict=True)
        ]
        far = pair.required + within + SURE
        if balls[0] is not None and balls[1] is not None:
            apart = float(norm(balls[0].center - balls[1].center))
            return apart - balls[0].radius - balls[1].radius < far
        for ball, fixed in ((balls[0], other), (balls[1], one)):
            if ball is not None and np.isfinite(ball.radius):
                return _distance(ball.center, fixed) - ball.radius < far
        return True

    def _ball(self, solid: Solid, chain: Sequence[int]) -> _Ball | None:
        """Returns where a solid is always within, in the frame that its chain of joints begins in.

        None where it does not move.
        """
        if not chain:
            return None
        placements = [self._model.jointPlacements[joint] for joint in chain[:2]]
        if not self._slides.isdisjoint(chain):
            return _Ball(np.asarray(placements[0].translation), np.inf)
        rest = solid.extent + sum(
            float(norm(self._model.jointPlacements[joint].translation)) for joint in chain[2:]
        )
        if len(chain) == 1:
            return _Ball(np.asarray(placements[0].translation), rest)
        # The next joint's origin goes round on a circle about the first one's axis.
        axis, step = self._axis[chain[0]], placements[1].translation
        along = float(product(axis, step))
        center = np.asarray(placements[0].act(along * axis))
        return _Ball(center, float(norm(step - along * axis)) + rest)


def _chain(model: pin.Model, joint: int) -> list[int]:
    """Returns the joints from the root to one."""
    chain = [joint]
    while joint:
        joint = model.parents[joint]
        chain.append(joint)
    return chain[::-1]


def _twist(model: pin.Model, joint: int) -> FloatArray:
    """Returns how a joint moves in its own frame: linear and angular, shape (6,)."""
    joint_model = model.joints[joint]
    data = joint_model.createData()
    joint_model.calc(data, pin.neutral(model))
    return np.asarray(data.S, dtype=np.float64).reshape(6)


def _distance(point: FloatArray, solid: Solid) -> float:
    """Returns how far a point is from a solid, both in one frame [m]."""
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
