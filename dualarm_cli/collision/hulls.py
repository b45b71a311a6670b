"""Capsules around solids: the round hulls that many postures are tested by."""

from __future__ import annotations

from collections.abc import Sequence

import coal
import numpy as np

from dualarm_cli.collision.solids import Solid
from dualarm_cli.collision.tree import JointTree
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class Hulls:
    """A capsule around each of s solids, in the tree's frame of its joint; of half-spaces it means nothing."""

    center: FloatArray
    """Middles [m], shape (s, 3)."""
    half: FloatArray
    """From there to one end [m], shape (s, 3)."""
    radius: FloatArray
    """Radii [m], shape (s,)."""
    length: FloatArray
    """Lengths of `half` [m], shape (s,)."""

    @classmethod
    def of(cls, solids: Sequence[Solid], tree: JointTree) -> Hulls:
        """Returns the capsules of some solids.

        Args:
            solids: what they are around.
            tree: of the robot.
        """
        ends = [_hull(solid, tree) for solid in solids]
        half = np.array([0.5 * (a - b) for a, b, _ in ends]).reshape(-1, 3)
        return cls(
            np.array([0.5 * (a + b) for a, b, _ in ends]).reshape(-1, 3),
            half,
            np.array([radius for *_, radius in ends]),
            norm(half, axis=1),
        )


def is_rough(one: Solid, other: Solid) -> bool:
    """Returns whether the margin of two solids' hulls may be less than their own."""
    forms = [solid.geometry for solid in (one, other)]
    exact = [isinstance(form, coal.Capsule | coal.Sphere) for form in forms]
    boxes = [isinstance(form, coal.Box | coal.Halfspace) for form in forms]
    return not (all(exact) or (any(exact) and any(boxes)))


def keeps_form(solid: Solid) -> bool:
    """Returns whether a solid is tested as a box or half-space rather than as a round hull."""
    return isinstance(
        solid.geometry, coal.Halfspace | coal.Box | coal.ConvexBase
    ) and not isinstance(solid.geometry, coal.Capsule | coal.Sphere | coal.Cylinder)


def box_around(geometry: coal.CollisionGeometry) -> tuple[FloatArray, FloatArray]:
    """Returns centre and half sides of the box around a solid in its own frame [m]."""
    if isinstance(geometry, coal.Box):
        return np.zeros(3), np.array(geometry.halfSide).ravel()
    geometry.computeLocalAABB()
    low = np.array(geometry.aabb_local.min_).ravel()
    high = np.array(geometry.aabb_local.max_).ravel()
    return 0.5 * (low + high), 0.5 * (high - low)


def _hull(solid: Solid, tree: JointTree) -> tuple[FloatArray, FloatArray, float]:
    """Returns both ends, in the tree's frame of its joint, and the radius of a capsule around a solid [m].

    A cylinder lies within the capsule about its own axis, a box within that about its longest side's middle line with
    half the diagonal of the others as its radius. A half-space has none, and is never asked for it.
    """
    form = solid.geometry
    if isinstance(form, coal.Halfspace):
        return np.zeros(3), np.zeros(3), 0.0
    center, end = np.zeros(3), np.zeros(3)
    if isinstance(form, coal.Sphere):
        radius = float(form.radius)
    elif isinstance(form, coal.Capsule | coal.Cylinder):
        end[2], radius = form.halfLength, float(form.radius)
    else:
        center, half = box_around(form)
        longest = int(np.argmax(half))
        end[longest] = half[longest]
        radius = float(norm(np.delete(half, longest)))
    own = tree.R_joint_own[solid.joint].T
    one, other = (
        product(own, np.asarray(solid.pose.act(center + sign * end))) for sign in (1.0, -1.0)
    )
    return one, other, radius
