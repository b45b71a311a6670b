"""Gaps between boxes along their separating axes, against coal."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin

from dualarm_cli.collision.pair_groups import BoxPairs


def test_gaps_of_boxes_are_never_more_than_coals_distance_and_tell_who_touches():
    """Ten pairs of boxes at 300 random places each, many aligned as parts on tables are."""
    pin.seed(0)
    random = np.random.default_rng(0)
    b, n = 10, 300
    turned = [[pin.SE3.Random() for _ in range(b)] for _ in range(2)]
    for k in range(4):
        turned[0][k].rotation = turned[1][k].rotation = np.eye(3)
    half = random.uniform(0.02, 0.3, (2, b, 3))
    pairs = BoxPairs(
        np.arange(b),
        np.repeat([[0], [1]], b, axis=1),
        np.array([[place.rotation for place in side] for side in turned]),
        np.array([[place.translation for place in side] for side in turned]) * 0.2,
        half,
        np.zeros(b),
    )
    turns = [pin.SE3.Random().rotation if k % 2 else np.eye(3) for k in range(n)]
    ways = random.uniform(-0.5, 0.5, (n, 3))
    frames = {
        0: (np.repeat(np.eye(3)[..., None], n, axis=2), np.zeros((3, n))),
        1: (np.moveaxis(np.array(turns), 0, 2), ways.T),
    }
    which, row = np.repeat(np.arange(b), n), np.tile(np.arange(n), b)
    gaps = pairs.gaps(which, frames, row)
    distance = np.empty(b * n)
    for k, (w, r) in enumerate(zip(which, row, strict=True)):
        boxes = [coal.Box(*(2.0 * half[side, w])) for side in range(2)]
        places = []
        for side in range(2):
            R, p = frames[side][0][..., r], frames[side][1][:, r]
            places.append(coal.Transform3s(R @ pairs.R[side, w], p + R @ pairs.p[side, w]))
        result = coal.DistanceResult()
        coal.distance(boxes[0], places[0], boxes[1], places[1], coal.DistanceRequest(), result)
        distance[k] = result.min_distance
    apart = distance > 1e-6
    assert 0.2 < apart.mean() < 0.8
    assert (gaps[apart] <= distance[apart] + 1e-6).all()
    # Nearly parallel edges have no axis of their own: what little they may miss is on the safe side.
    assert (gaps[apart] > -1e-3).all()
    assert (gaps[distance < -1e-6] < 1e-6).all()
    # Boxes along the same axes that are apart along one of these alone lie side against side.
    along = np.isin(which, range(4)) & (row % 2 == 0)
    between = np.abs(ways[row] + pairs.p[1, which] - pairs.p[0, which])
    sides = ((between - half[0, which] - half[1, which]) > 0.0).sum(axis=1)
    beside = along & (sides == 1)
    assert beside.sum() > 50
    np.testing.assert_allclose(gaps[beside], distance[beside], atol=1e-6)
