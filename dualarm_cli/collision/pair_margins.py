"""Margins of pairs of solids' hulls in many postures at once, components first."""

from __future__ import annotations

import numpy as np

from dualarm_cli.collision.distances import box_distance, dot, segment_distance
from dualarm_cli.collision.pair_groups import Boxes, Frames, PairGroup, Rounds, Singles
from dualarm_cli.collision.solids import WORLD

ENOUGH = 0.01
"""Margins that balls around two solids show to be greater than this are not looked at more closely [m]."""


def pair_margins(group: PairGroup, frames: Frames, center: Singles, half: Singles) -> Singles:
    """Returns the margins of all q pairs of a group's hulls [m], shape (q, n), in n postures.

    Args:
        group: the pairs.
        frames: of the group's joints.
        center: middles of the capsules [m], shape (3, s, n).
        half: from there to one end [m], shape (3, s, n).
    """
    planes = group.planes
    margins = np.empty((len(group.pairs), center.shape[2]), dtype=np.float32)
    rounds, flats = len(group.rounds.first), len(planes.hulls)
    margins[:rounds] = _round_margins(group.rounds, center, half)
    if flats:
        height = dot(planes.normal, center[:, planes.hulls])
        height -= np.abs(dot(planes.normal, half[:, planes.hulls]))
        margins[rounds : rounds + flats] = height - planes.slack
    first = rounds + flats
    for boxes in group.boxes:
        last = first + len(boxes.hull)
        margins[first:last] = _box_margins(boxes, frames[boxes.joint], center, half)
        first = last
    return margins


def _round_margins(pairs: Rounds, center: Singles, half: Singles) -> Singles:
    """Returns the margins of p pairs of capsules [m], shape (p, n), for middles and half vectors (3, s, n) [m]."""
    apart = center[:, pairs.first]
    apart -= center[:, pairs.second]
    margin = np.sqrt(dot(apart, apart))
    margin -= pairs.ball
    near = np.nonzero(margin < ENOUGH)
    if len(near[0]):
        ends = []
        for hulls in (pairs.first, pairs.second):
            at = slice(None), hulls[near[0]], near[1]
            middle, to_end = center[at].astype(np.float64), half[at].astype(np.float64)
            ends += [middle + to_end, middle - to_end]
        margin[near] = segment_distance(*ends) - pairs.slack[near[0], 0]
    return margin


def _box_margins(
    boxes: Boxes, frame: tuple[Singles, Singles], center: Singles, half: Singles
) -> Singles:
    """Returns the margins of p capsules from boxes [m], shape (p, n), for middles and half vectors (3, s, n) [m].

    By the balls around the capsules, along the axes that the boxes have in common; the nearest ones exactly.
    """
    R, p = frame
    middle = center[:, boxes.hulls]
    if boxes.joint != WORLD:
        middle -= p[:, None]
    apart = _seen(boxes, R, middle)[:, boxes.hull]
    apart -= boxes.p
    margin = _from_balls(apart, boxes.half, boxes.ball)
    pair, row = np.nonzero(margin < ENOUGH)
    if not len(pair):
        return margin
    middle = apart[:, pair, row]
    to_end = _seen(boxes, R[:, :, row], half[:, boxes.hulls[boxes.hull[pair]], row])
    ends = [(middle + sign * to_end).astype(np.float64) for sign in (1.0, -1.0)]
    exact = box_distance(ends[0], ends[1], boxes.half[:, pair, 0].astype(np.float64))
    margin[pair, row] = exact - boxes.slack[pair, 0]
    return margin


def _from_balls(middle: Singles, half: Singles, ball: Singles) -> Singles:
    """Returns how far balls about middles (3, ...) are from boxes about the origin at least [m], shape (...)."""
    outside = np.abs(middle)
    outside -= half
    np.maximum(outside, 0.0, out=outside)
    found: Singles = np.sqrt(dot(outside, outside))
    found -= ball
    return found


def _seen(boxes: Boxes, R: Singles, x: Singles) -> Singles:
    """Returns vectors (3, ..., n) along the axes of boxes, of that shape, for rotations (3, 3, n) of their joint."""
    if boxes.joint != WORLD:
        x = np.stack([dot(R[:, k], x) for k in range(3)])
    if boxes.axes is None:
        return x
    found: Singles = (boxes.axes @ x.reshape(3, -1)).reshape(x.shape)
    return found
