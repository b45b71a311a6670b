"""One path of all joints for a stage's transfer: one arm after the other, then both at once if that fails."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dualarm_cli.collision.clearance import SLACK, CellClearance
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job
from dualarm_cli.postures.stage_plan import StagePlan

Free = Callable[[FloatArray], BoolArray]
"""Whether postures (n, columns) are free, shape (n,)."""

STRIDE = 0.06
"""Longest edge of a tree [s]: joints are measured by how long they take at top speed."""
SPACING = 0.008
"""Distance of the postures that are looked at along an edge [s]."""
NARROW, WIDE = 0.2, 1.0
"""How far about the straight way postures are drawn, mostly and sometimes [s]."""
MOST_EDGES = 2500
"""Edges after which the search gives up."""
TRAPPED = 8
"""A tree of no more postures, after a fifth of the edges, does not come out of where it began."""
POINTS = 65
"""Points of a path that is shortened."""
SHORT_CUTS = 400
"""Short cuts that are tried."""
CORNERS = (8, 12, 16, 24, 32, 48, 64)
"""Edges of control points that are tried when corners are rounded: the more, the sharper."""
GRIDPOINTS = 129
"""Points of the rounded path."""


def free_points(
    free: Free,
    start: FloatArray,
    goal: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    seed: int,
) -> FloatArray | None:
    """Returns points along a path between two free postures, shape (POINTS, columns), None where none was found.

    RRT-Connect [Kuffner2000], then random short cuts, of all joints or of some [Geraerts2007]. Joints are measured by
    how long they take at top speed. Straight lines between the points are free at SPACING.

    Args:
        free: tells which postures are free.
        start: where it begins [s], shape (columns,).
        goal: where it ends [s], shape (columns,).
        lower: least joints [s], shape (columns,).
        upper: greatest joints [s], shape (columns,).
        seed: of all randomness.
    """
    random = np.random.default_rng(seed)
    corners = _connect(free, start, goal, lower, upper, random)
    if corners is None:
        return None
    return _shortened(free, _resampled(corners, POINTS), random)


def rounded_path(free: Free, points: FloatArray) -> FloatArray | None:
    """Returns a smooth path along given points, shape (GRIDPOINTS, columns), None where none is free.

    A cubic B-spline whose control points lie on the path, the closer the nearer it has to follow it.

    Args:
        free: tells which postures are free.
        points: of the path [s], shape (c, columns).
    """
    for count in CORNERS:
        path = _rounded(points, count)
        if free(_interpolated(path[:-1], path[1:])).all():
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
        if k == MOST_EDGES // 5 and min(len(tree.points) for tree in trees) <= TRAPPED:
            break
        # Most of what is tried lies about the straight way: transfers are short.
        wide = NARROW if k % 4 else WIDE
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
        stops = _strides(self.points[number], towards, strides)
        grown, looked = (None if stops else number), 0
        while looked < len(stops):
            # Few at first: most edges are not free for long, and a call costs as much as many postures.
            some = stops[looked : 2 * looked + 1]
            rows = [_interpolated(here[None], there[None]) for here, there in some]
            is_free, first = free(np.vstack(rows)), 0
            for (_, there), row in zip(some, rows, strict=True):
                if not is_free[first : first + len(row)].all():
                    return grown
                first += len(row)
                self.points.append(there)
                self._parents.append(number)
                grown = number = len(self.points) - 1
            looked += len(some)
        return grown

    def way(self, number: int) -> FloatArray:
        """Returns the postures from the root to one, shape (c, columns)."""
        way = [self.points[number]]
        while number:
            number = self._parents[number]
            way.append(self.points[number])
        return np.array(way[::-1])


def _strides(
    here: FloatArray, towards: FloatArray, most: int
) -> list[tuple[FloatArray, FloatArray]]:
    """Returns the ends of edges of STRIDE one after the other from a posture towards another one, at most so many."""
    found = []
    for _ in range(most):
        length = float(np.abs(towards - here).max())
        if length == 0.0:
            break
        there = towards if length <= STRIDE else here + (towards - here) * (STRIDE / length)
        found.append((here, there))
        here = there
    return found


def _interpolated(start: FloatArray, end: FloatArray) -> FloatArray:
    """Returns postures along edges (e, columns), their ends included and SPACING apart at most."""
    longest = float(np.abs(end - start).max(initial=0.0))
    count = max(2, int(np.ceil(longest / SPACING)) + 1)
    share = np.linspace(0.0, 1.0, count)[None, :, None]
    return (start[:, None] + share * (end - start)[:, None]).reshape(-1, start.shape[1])


def _lengths(points: FloatArray) -> FloatArray:
    """Returns how far points (c, columns) are along their path, shape (c,)."""
    steps = np.abs(np.diff(points, axis=0)).max(axis=1)
    return np.concatenate([[0.0], steps.cumsum()])


def _resampled(corners: FloatArray, count: int) -> FloatArray:
    """Returns points along a path at equal distances, shape (count, columns)."""
    length = _lengths(corners)
    kept = np.concatenate([[True], np.diff(length) > 0.0])
    at = np.linspace(0.0, length[-1], count)
    return np.stack([np.interp(at, length[kept], column[kept]) for column in corners.T], axis=1)


def _shortened(free: Free, points: FloatArray, random: np.random.Generator) -> FloatArray:
    """Returns a path whose joints go straight wherever that is free, points at equal distances again."""
    columns = points.shape[1]
    for k in range(SHORT_CUTS):
        if k % 40 == 39:
            points = _resampled(points, len(points))
        i, j = np.sort(random.integers(0, len(points), 2)).tolist()
        if j - i < 2:
            continue
        # All joints, or each with even odds, or one.
        odds = random.random(columns)
        which = np.asarray(odds < (2.0, 0.5, 0.0)[k % 3])
        which[int(np.argmin(odds))] = True
        share = np.linspace(0.0, 1.0, j - i + 1)[:, None]
        straight = points[i] + share * (points[j] - points[i])
        tried = np.where(which, straight, points[i : j + 1])
        if free(_interpolated(tried[:-1], tried[1:])).all():
            points = np.vstack([points[:i], tried, points[j + 1 :]])
    return _resampled(points, len(points))


def _rounded(points: FloatArray, count: int) -> FloatArray:
    """Returns the clamped cubic B-spline with control points at equal distances, shape (GRIDPOINTS, columns).

    Args:
        points: of a path, shape (c, columns).
        count: edges between the control points, at least 3.
    """
    control = _resampled(points, count + 1)
    pieces = len(control) - 3
    knots = np.concatenate([[0.0] * 3, np.arange(pieces + 1.0), [float(pieces)] * 3])
    x = np.linspace(0.0, pieces, GRIDPOINTS)
    span = np.clip(x.astype(np.int64), 0, pieces - 1) + 3
    # De Boor's algorithm for all points at once.
    level_points = [control[span - 3 + k] for k in range(4)]
    for level in range(1, 4):
        for k in range(3, level - 1, -1):
            low, high = knots[span - 3 + k], knots[span + 1 + k - level]
            share = ((x - low) / (high - low))[:, None]
            level_points[k] = (1.0 - share) * level_points[k - 1] + share * level_points[k]
    return level_points[3]


KEPT = SLACK / 2.0
"""What paths keep beyond the required clearance, for what their timing leaves them by [m]."""

SPARE = 0.008
"""What they keep more before their corners are rounded, if their ends do [m]."""

Way = Callable[[FloatArray], FloatArray]
"""All joints (n, columns) [rad] at shares (n,) of a path."""


def transfer_path(
    model: CellModel,
    job: Job,
    cell: CellClearance,
    plan: StagePlan,
    held: IntArray,
    seed: int,
) -> FloatArray | None:
    """Returns all joints along a path that keeps clear, shape (GRIDPOINTS, columns) [rad]; None where none was found.

    Of each arm that touches anything a path of its own is found in its joints and the progress of all others along
    theirs ([Erdmann1987]: one after the other); if there is none, one in all joints.

    Args:
        model: the job's cell.
        job: what is to be done.
        cell: hulls and pairs.
        plan: the stage, for where its transfer begins and ends.
        held: what each arm holds, shape (arms,).
        seed: of all randomness.
    """
    limits = job.cell.robot.limits
    start, goal, speed = plan.start, plan.arrival, limits.velocity

    def margins(rows: FloatArray) -> FloatArray:
        return cell.margins(rows, np.tile(held, (len(rows), 1)))

    def free(x: FloatArray) -> BoolArray:
        return np.asarray(margins(x * speed) >= KEPT)

    def well_free(x: FloatArray) -> BoolArray:
        return np.asarray(margins(x * speed) >= kept)

    at_ends = float(margins(np.stack([start, goal])).min())
    if at_ends < KEPT:
        return None
    kept = min(KEPT + SPARE, at_ends)
    points = _one_by_one(model, cell, plan, held, speed, (limits.lower, limits.upper), kept, seed)
    path = None if points is None else rounded_path(free, points / speed)
    if path is None:
        ends = [joints / speed for joints in (start, goal, limits.lower, limits.upper)]
        both = free_points(well_free, ends[0], ends[1], ends[2], ends[3], seed)
        path = None if both is None else rounded_path(free, both)
    if path is None:
        return None
    path = path * speed
    # What is scaled there and back is off by rounding.
    path[0], path[-1] = start, goal
    return path


def _one_by_one(
    model: CellModel,
    cell: CellClearance,
    plan: StagePlan,
    held: IntArray,
    speed: FloatArray,
    span: tuple[FloatArray, FloatArray],
    kept: float,
    seed: int,
) -> FloatArray | None:
    """Returns all joints at points of a path, shape (GRIDPOINTS, columns) [rad], None where an arm has none."""
    share = np.linspace(0.0, 1.0, GRIDPOINTS)
    rows = plan.start + share[:, None] * (plan.arrival - plan.start)
    for a, name in enumerate(cell.arms):
        if (cell.own_margins(a, rows, np.full(len(rows), held[a])) >= KEPT).all():
            continue
        columns = model.arms[name].columns
        top = np.append(1.0 / _length(rows, speed), speed[columns])
        others = _along(share, rows)

        def expanded(
            x: FloatArray, top: FloatArray = top, columns: list[int] = columns
        ) -> FloatArray:
            there: FloatArray = others(x[:, 0] * top[0])  # noqa: B023 - called within the round
            there[:, columns] = x[:, 1:] * top[1:]
            return there

        def free(x: FloatArray, a: int = a, expanded: Way = expanded) -> BoolArray:
            there = expanded(x)
            margin = cell.own_margins(a, there, np.full(len(there), held[a]))
            cross = cell.cross_margins(there, np.tile(held, (len(there), 1)))
            return np.asarray(np.minimum(margin, cross) >= kept)

        ends = [
            np.append(u, joints[columns]) / top
            for u, joints in (
                (0.0, plan.start),
                (1.0, plan.arrival),
                (0.0, span[0]),
                (1.0, span[1]),
            )
        ]
        points = free_points(free, ends[0], ends[1], ends[2], ends[3], seed)
        if points is None:
            return None
        rows = expanded(points)
        share = np.linspace(0.0, 1.0, len(rows))
    return rows


def _length(rows: FloatArray, speed: FloatArray) -> float:
    """Returns about how long a path takes at top speed [s], not zero."""
    return max(float((np.abs(np.diff(rows, axis=0)) / speed).max(axis=1).sum()), 1e-3)


def _along(share: FloatArray, rows: FloatArray) -> Way:
    """Returns the joints at any share of a path, straight between its points."""

    def way(at: FloatArray) -> FloatArray:
        return np.stack([np.interp(at, share, column) for column in rows.T], axis=1)

    return way
