"""Paths of all joints through free space: two trees that grow towards each other, short cuts, rounded corners."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray

Free = Callable[[FloatArray], BoolArray]
"""Whether postures (n, columns) are free, shape (n,)."""

STRIDE = 0.15
"""Longest edge of a tree, in weighted joints [rad]."""
SPACING = 0.02
"""Distance of the postures that are looked at along an edge [rad]."""
MOST_EDGES = 3000
"""Edges after which the search gives up."""
SHORT_CUTS = 150
"""Short cuts that are tried."""
CORNERS = (2, 4, 8, 16, 32)
"""Control points per edge that are tried when corners are rounded: the more, the sharper."""
GRIDPOINTS = 129
"""Points of the rounded path."""


def free_path(
    free: Free, start: FloatArray, goal: FloatArray, lower: FloatArray, upper: FloatArray, seed: int
) -> FloatArray | None:
    """Returns a smooth path between two free postures, shape (GRIDPOINTS, columns), None where none was found.

    RRT-Connect [Kuffner2000], then random short cuts, then a cubic B-spline whose control points lie on the path, the
    closer the nearer it has to follow it. The path is free at SPACING; what moves with it in time is the caller's.

    Args:
        free: tells which postures are free.
        start: where it begins [rad], shape (columns,).
        goal: where it ends [rad], shape (columns,).
        lower: least joints [rad], shape (columns,).
        upper: greatest joints [rad], shape (columns,).
        seed: of all randomness.
    """
    random = np.random.default_rng(seed)
    corners = _connect(free, start, goal, lower, upper, random)
    if corners is None:
        return None
    corners = _shortened(free, corners, random)
    for count in CORNERS:
        path = _rounded(corners, count)
        if free(path).all() and free(_along(path[:-1], path[1:])).all():
            return path
    return None


def _connect(
    free: Free,
    start: FloatArray,
    goal: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    random: np.random.Generator,
) -> FloatArray | None:
    """Returns the corners of a free path, shape (c, columns)."""
    trees = [_Tree(start), _Tree(goal)]
    low, high = np.minimum(start, goal), np.maximum(start, goal)
    for k in range(MOST_EDGES):
        # Most of what is tried lies about the straight way: transfers are short.
        wide = 0.5 if k % 4 else 3.0
        sample = random.uniform(np.maximum(lower, low - wide), np.minimum(upper, high + wide))
        here, there = trees[k % 2], trees[1 - k % 2]
        tip = here.grow(free, sample, 1)
        if tip is None:
            continue
        target = here.points[tip]
        end = there.grow(free, target, 64)
        if end is not None and np.array_equal(there.points[end], target):
            ways = [here.way(tip), there.way(end)]
            if k % 2:
                ways.reverse()
            return np.vstack([ways[0], ways[1][::-1][1:]])
        if len(trees[0].points) + len(trees[1].points) > MOST_EDGES:
            break
    return None


class _Tree:
    """Postures that are joined by free edges."""

    def __init__(self, root: FloatArray) -> None:
        self.points = [np.asarray(root)]
        self._parents = [0]

    def grow(self, free: Free, towards: FloatArray, strides: int) -> int | None:
        """Adds edges from the nearest posture towards another one; returns the last one's number, None for none."""
        every = np.array(self.points)
        number = int(np.argmin(((every - towards) ** 2).sum(axis=1)))
        grown = None
        for _ in range(strides):
            here = self.points[number]
            length = float(np.abs(towards - here).max())
            if length == 0.0:
                return number
            there = towards if length <= STRIDE else here + (towards - here) * (STRIDE / length)
            if not free(_along(here[None], there[None])).all():
                break
            self.points.append(there)
            self._parents.append(number)
            grown = number = len(self.points) - 1
            if length <= STRIDE:
                break
        return grown

    def way(self, number: int) -> FloatArray:
        """Returns the postures from the root to one, shape (c, columns)."""
        way = [self.points[number]]
        while number:
            number = self._parents[number]
            way.append(self.points[number])
        return np.array(way[::-1])


def _along(start: FloatArray, end: FloatArray) -> FloatArray:
    """Returns postures along edges (e, columns), their ends included and SPACING apart at most."""
    longest = float(np.abs(end - start).max(initial=0.0))
    count = max(2, int(np.ceil(longest / SPACING)) + 1)
    share = np.linspace(0.0, 1.0, count)[None, :, None]
    return (start[:, None] + share * (end - start)[:, None]).reshape(-1, start.shape[1])


def _shortened(free: Free, corners: FloatArray, random: np.random.Generator) -> FloatArray:
    """Returns a path with fewer and nearer corners."""
    for _ in range(SHORT_CUTS):
        if len(corners) < 3:
            break
        length = np.concatenate([[0.0], np.abs(np.diff(corners, axis=0)).max(axis=1).cumsum()])
        one, other = np.sort(random.uniform(0.0, length[-1], 2))
        i, j = (int(np.searchsorted(length, x, side="right")) - 1 for x in (one, other))
        if i == j:
            continue
        ends = [
            corners[k]
            + (corners[k + 1] - corners[k]) * ((x - length[k]) / (length[k + 1] - length[k]))
            for k, x in ((i, one), (j, other))
        ]
        if free(_along(ends[0][None], ends[1][None])).all():
            corners = np.vstack([corners[: i + 1], ends, corners[j + 1 :]])
    return corners


def _rounded(corners: FloatArray, count: int) -> FloatArray:
    """Returns the clamped cubic B-spline with so many control points along each edge, shape (GRIDPOINTS, columns)."""
    # Edges are weighted by their length, so that the spline does not linger.
    length = np.concatenate([[0.0], np.abs(np.diff(corners, axis=0)).max(axis=1).cumsum()])
    kept = np.concatenate([[True], np.diff(length) > 0.0])
    corners, length = corners[kept], length[kept]
    at = np.linspace(0.0, length[-1], max(4, count * (len(corners) - 1) + 1))
    control = np.stack([np.interp(at, length, column) for column in corners.T], axis=1)
    pieces = len(control) - 3
    knots = np.concatenate([[0.0] * 3, np.arange(pieces + 1.0), [float(pieces)] * 3])
    x = np.linspace(0.0, pieces, GRIDPOINTS)
    span = np.clip(x.astype(np.int64), 0, pieces - 1) + 3
    # De Boor's algorithm for all points at once.
    points = [control[span - 3 + k] for k in range(4)]
    for level in range(1, 4):
        for k in range(3, level - 1, -1):
            low = knots[span - 3 + k]
            high = knots[span + 1 + k - level]
            share = ((x - low) / (high - low))[:, None]
            points[k] = (1.0 - share) * points[k - 1] + share * points[k]
    return points[3]
