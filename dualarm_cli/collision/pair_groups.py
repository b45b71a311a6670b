"""Pairs of solids as arrays, as the quick test takes them."""

from __future__ import annotations

from collections.abc import Sequence

import coal
import numpy as np

from dualarm_cli.collision.box_pairs import BoxPairs
from dualarm_cli.collision.hulls import Hulls, box_around, is_rough, keeps_form
from dualarm_cli.collision.solids import Pair, Solid
from dualarm_cli.collision.tree import JointTree
from dualarm_cli.compiled.pair_margins import BOX, CAPSULE, PLANE, SolidPairs
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.products import product
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class PairGroup:
    """Pairs that are tested together."""

    joints: frozenset[int]
    """Joints whose frames are needed."""
    arrays: SolidPairs
    """The pairs as the compiled function takes them."""
    pairs: tuple[Pair, ...]
    """All of them."""
    rough: tuple[Pair, ...]
    """Those of which a hull is wider than the solid."""
    both_boxes: BoxPairs
    """Those of the rough ones that are two boxes."""


def pair_group(
    solids: Sequence[Solid], hulls: Hulls, tree: JointTree, pairs: Sequence[Pair]
) -> PairGroup:
    """Returns pairs of solids as arrays.

    Args:
        solids: of the cell.
        hulls: around them.
        tree: of the robot.
        pairs: of the solids.
    """
    capsules: dict[int, int] = {}
    boxes: dict[int, int] = {}
    normals: list[FloatArray] = []
    rows: list[tuple[int, int, int]] = []
    lengths: list[tuple[float, float]] = []
    rough = np.array([is_rough(solids[p.first], solids[p.second]) for p in pairs], dtype=np.bool_)
    for pair in pairs:
        one, other = pair.first, pair.second
        # The one that is kept as it is: what stands, or else a box.
        if keeps_form(solids[one]) and not keeps_form(solids[other]):
            one, other = other, one
        solid = solids[other]
        slack = float(hulls.radius[one]) + pair.required
        length = float(hulls.length[one])
        first = capsules.setdefault(one, len(capsules))
        if isinstance(solid.geometry, coal.Halfspace):
            normal = product(solid.pose.rotation, np.asarray(solid.geometry.n).ravel())
            slack += float(solid.geometry.d + product(normal, solid.pose.translation))
            rows.append((first, PLANE, len(normals)))
            normals.append(normal)
        elif keeps_form(solid):
            rows.append((first, BOX, boxes.setdefault(other, len(boxes))))
        else:
            slack += float(hulls.radius[other])
            length += float(hulls.length[other])
            rows.append((first, CAPSULE, capsules.setdefault(other, len(capsules))))
        lengths.append((slack, slack + length))
    around, placed = list(capsules), [_placed(solids[box], tree) for box in boxes]
    joints = {solids[number].joint for number in (*capsules, *boxes)}
    row = np.array(rows, dtype=np.int64).reshape(-1, 3)
    length_pairs = np.array(lengths).reshape(-1, 2)
    arrays = SolidPairs.of(
        {
            "joint": np.array(sorted(tree.above(joints)), dtype=np.int64),
            "capsule_joint": np.array([solids[k].joint for k in around], dtype=np.int64),
            "center": hulls.center[around],
            "half": hulls.half[around],
            "one": row[:, 0],
            "kind": row[:, 1],
            "other": row[:, 2],
            "slack": length_pairs[:, 0],
            "ball": length_pairs[:, 1],
            "rough": np.where(rough, np.cumsum(rough) - 1, -1),
            "normal": np.array(normals).reshape(-1, 3),
            "box_joint": np.array([solids[box].joint for box in boxes], dtype=np.int64),
            "axes": np.array([axes for axes, *_ in placed]).reshape(-1, 3, 3),
            "box_center": np.array([center for _, center, _ in placed]).reshape(-1, 3),
            "box_half": np.array([half for *_, half in placed]).reshape(-1, 3),
        }
    )
    doubtful = tuple(pair for pair, own in zip(pairs, rough, strict=True) if own)
    return PairGroup(
        frozenset(joints), arrays, tuple(pairs), doubtful, BoxPairs.of(solids, tree, doubtful)
    )


def _placed(solid: Solid, tree: JointTree) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns axes, centre and half sides of the box around a solid; axes in its joint's frame, one a row."""
    own = tree.R_joint_own[solid.joint].T
    axes = product(own, solid.pose.rotation).T
    center, half = box_around(solid.geometry)
    return axes, product(axes, own, np.asarray(solid.pose.act(center))), half
