"""Distances between bodies over a whole motion: measured, with proven lower bounds.

In an interval from t0 to t1 a joint moves no faster than its greatest speed there, w_k (exact: speed is a parabola
between knots), and joint k moves the points of a pair of solids against each other by no more than r_k per radian
(`levers`). So their distance changes by no more than L = sum_k r_k w_k per second, and with the distances d0 and d1 at
the ends nowhere in the interval is it less than (d0 + d1 - L (t1 - t0)) / 2. Intervals whose bound is too
low are halved until the least bound is within the precision of the least measured distance. So a contact of any
duration is found or excluded. Our own; the bound is that of conservative advancement.
"""

from __future__ import annotations

from collections.abc import Sequence

import coal
import numpy as np
import pinocchio as pin

from dualarm_cli.collision.solids import WORLD, Pair, Solid, geometry_model, solid_distance
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray, distinct
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class ProofSettings:
    """Step lengths, work limits and precision of the proof of clearance."""

    first_step: float = 0.08
    """Length of the first intervals [s]; longer in long motions, to limit memory."""
    max_first_intervals: int = 20_000
    """Maximum number of first intervals, besides those due to edges."""
    shortest: float = 1e-9
    """Length below which intervals are not halved [s]."""
    max_halved: int = 2_000_000
    """Maximum number of halved intervals, before the allowance of `halved_per_knot`.

    A fast seam of 3 s on a body that it may touch needs 240,000; motions far beyond limits need
    a number in proportion to their length.
    """
    halved_per_knot: int = 20
    """Additional halved intervals for each knot and pair.

    Jobs need up to 0.2.
    """
    failed_below: float = -1e6
    """Distance below which coal's iteration has failed [m]."""
    precision: float = 5e-4
    """Largest gap between certified and measured least distance [m]."""
    numerical: float = 1e-6
    """Error bound of distances by coal [m], subtracted from every certified one."""


PROOF = ProofSettings()

Windows = Sequence[tuple[float, float]] | None
"""Windows in which a pair counts [s], or None for always."""


class UnprovenError(ValueError):
    """Error for a motion whose proof needs more halved intervals than allowed."""


@dataclass(frozen=True)
class Certified:
    """Least margin of all pairs in one interval between edges."""

    margin: float
    """Proven lower bound of distance less requirement [m]."""
    met: float
    """Least measured margin [m]."""
    pair: int
    """Number of the pair with the least measured margin."""
    time: float
    """Time of the least measured margin [s]."""


class ClearanceProof:
    """Distances of pairs of solids of one robot along one motion."""

    def __init__(
        self,
        model: pin.Model,
        solids: Sequence[Solid],
        pairs: Sequence[Pair],
        windows: Sequence[Windows],
        trajectory: Trajectory,
    ) -> None:
        """Prepare coal's geometries.

        Args:
            model: of the robot's URDF.
            solids: of the cell.
            pairs: solids that must keep apart.
            windows: spans in which each pair counts.
            trajectory: finite, with rising times; its joints are the model's, in any order.
        """
        self._model, self._data = model, model.createData()
        # A pair may count twice, with another requirement at another time; pinocchio has it once.
        places = {(pair.first, pair.second): None for pair in pairs}
        self._geometry, self._solids = geometry_model(solids, places), solids
        self._numbers = list(places)
        number_of = {place: number for number, place in enumerate(places)}
        self._place = np.array([number_of[pair.first, pair.second] for pair in pairs])
        self._distances = pin.GeometryData(self._geometry)
        # Stored because pinocchio fills the same ones each time: wrapping them again is slow.
        self._results = list(self._distances.distanceResults)
        self._required = np.array([pair.required for pair in pairs])
        self._windows = windows
        self._trajectory = trajectory
        order = [trajectory.joints.index(name) for name in model.names[1:]]
        self._order = np.array(order, dtype=np.int64)
        self._levers = levers(model, solids, pairs)
        self._speeds = interval_speeds(trajectory)[:, self._order]

    def certify(
        self,
        edges: FloatArray,
        precision: float = PROOF.precision,
        other_margins: FloatArray | None = None,
    ) -> list[Certified]:
        """Prove the least margin (distance less requirement) in each interval [m]; infinite without pairs.

        Args:
            edges: instants that divide the motion into intervals [s], rising, shape (s + 1,).
            precision: largest gap between certified and measured margin [m].
            other_margins: margins of other pairs there [m], shape (s,); pairs whose balls have more are left out.

        Raises:
            UnprovenError: the number of halved intervals exceeds its limit.
        """
        intervals = [Certified(np.inf, np.inf, -1, 0.0) for _ in edges[:-1]]
        if not len(self._required):
            return intervals
        times = self._instants(edges)
        stretch = np.searchsorted(edges, times[:-1], side="right") - 1
        stretch = np.clip(stretch, 0, len(intervals) - 1)
        low, high, pair = self._first_intervals(times)
        # All pairs share their first intervals, and the speeds in them.
        rates = product(self._fastest(times[:-1], times[1:]), self._levers.T)
        if other_margins is None:
            margins = self._all_margins(times)
            at_low, at_high = margins[low, pair], margins[high, pair]
        else:
            least = self._ball_margins(times)
            bound = least[low, pair] + least[high, pair]
            bound -= rates[low, pair] * (times[high] - times[low])
            near = 0.5 * bound < other_margins[stretch[low]]
            low, high, pair = low[near], high[near], pair[near]
            at_low = self._margins_at(times[low], pair)
            at_high = self._margins_at(times[high], pair)
        begin, end, interval = times[low], times[high], stretch[low]
        proven = np.full(len(intervals), np.inf)
        met = np.full(len(intervals), np.inf)
        met_at = np.full(len(intervals), -1), np.zeros(len(intervals))
        _lower(met, met_at, interval, at_low, pair, begin)
        _lower(met, met_at, interval, at_high, pair, end)
        rate = rates[low, pair]
        knots = len(self._trajectory.time)
        allowance = PROOF.max_halved + PROOF.halved_per_knot * knots * len(self._required)
        while len(pair):
            bound = 0.5 * (at_low + at_high - rate * (end - begin))
            bound = np.where(rate == 0.0, np.minimum(at_low, at_high), bound)
            settled = (bound >= met[interval] - precision) | (end - begin < PROOF.shortest)
            allowance -= int(np.count_nonzero(~settled))
            if allowance < 0:
                raise UnprovenError
            np.minimum.at(proven, interval[settled], bound[settled])
            unsettled = ~settled
            begin, end = begin[unsettled], end[unsettled]
            pair, interval = pair[unsettled], interval[unsettled]
            at_low, at_high = at_low[unsettled], at_high[unsettled]
            middle = 0.5 * (begin + end)
            between = self._margins_at(middle, pair)
            _lower(met, met_at, interval, between, pair, middle)
            begin, end = np.concatenate([begin, middle]), np.concatenate([middle, end])
            at_low = np.concatenate([at_low, between])
            at_high = np.concatenate([between, at_high])
            pair, interval = np.tile(pair, 2), np.tile(interval, 2)
            rate = (self._fastest(begin, end) * self._levers[pair]).sum(axis=1)
        return [
            Certified(float(low) - PROOF.numerical, float(margin), int(pair), float(time))
            for low, margin, pair, time in zip(proven, met, *met_at, strict=True)
        ]

    def _instants(self, edges: FloatArray) -> FloatArray:
        """List the ends of the first intervals [s], with all edges and ends of windows."""
        marks = [*edges.tolist()]
        for windows in self._windows:
            marks += [t for window in windows or () for t in window]
        marked = distinct(np.clip(np.array(marks), edges[0], edges[-1]))
        step = max(PROOF.first_step, float(marked[-1] - marked[0]) / PROOF.max_first_intervals)
        parts = np.ceil(np.diff(marked) / step).astype(np.int64)
        pieces = [
            np.linspace(a, b, n, endpoint=False)
            for a, b, n in zip(marked[:-1], marked[1:], parts, strict=True)
        ]
        return np.concatenate([*pieces, marked[-1:]])

    def _first_intervals(self, times: FloatArray) -> tuple[IntArray, IntArray, IntArray]:
        """List the first intervals in which each pair counts: first and last instant, pair."""
        counts = np.ones((len(times) - 1, len(self._required)), dtype=np.bool_)
        for pair, windows in enumerate(self._windows):
            if windows is not None:
                inside: BoolArray = np.zeros(len(times) - 1, dtype=np.bool_)
                for start, stop in windows:
                    inside |= (times[:-1] >= start) & (times[1:] <= stop)
                counts[:, pair] = inside
        low, columns = np.nonzero(counts)
        return low, low + 1, columns

    def _all_margins(self, times: FloatArray) -> FloatArray:
        """Measure the margins of all pairs at instants [m], shape (t, pairs)."""
        q = self._trajectory.clamped(times)[0][:, self._order]
        distances = np.empty((len(times), len(self._results)))
        for row, position in enumerate(q):
            pin.computeDistances(self._model, self._data, self._geometry, self._distances, position)
            distances[row] = [result.min_distance for result in self._results]
            for place in np.flatnonzero(distances[row] < PROOF.failed_below).tolist():
                distances[row, place] = self._distance_from_cold_start(place)
        return distances[:, self._place] - self._required

    def _ball_margins(self, times: FloatArray) -> FloatArray:
        """Compute the margins of bounding balls at instants [m], shape (t, pairs)."""
        forms = [shape.geometry for shape in self._geometry.geometryObjects]
        for form in forms:
            form.computeLocalAABB()
        middle = [np.asarray(form.aabb_center).ravel() for form in forms]
        radius = np.array([form.aabb_radius for form in forms])
        centers = np.empty((len(times), len(forms), 3))
        for row, q in enumerate(self._trajectory.clamped(times)[0][:, self._order]):
            pin.updateGeometryPlacements(
                self._model, self._data, self._geometry, self._distances, q
            )
            centers[row] = [
                place.act(p) for place, p in zip(self._distances.oMg, middle, strict=True)
            ]
        first, second = np.array(self._numbers)[self._place].T
        apart = np.sqrt(np.square(centers[:, first] - centers[:, second]).sum(axis=2))
        return np.asarray(apart - radius[first] - radius[second] - self._required)

    def _margins_at(self, times: FloatArray, pairs: IntArray) -> FloatArray:
        """Measure the margin of one pair at each instant [m], shape (n,)."""
        margins = np.empty(len(times))
        order = np.argsort(times, kind="stable")
        q = self._trajectory.clamped(times[order])[0][:, self._order]
        before = np.nan
        for row, position in zip(order.tolist(), q, strict=True):
            if times[row] != before:
                pin.updateGeometryPlacements(
                    self._model, self._data, self._geometry, self._distances, position
                )
                before = times[row]
            pair = int(self._place[pairs[row]])
            margins[row] = pin.computeDistance(self._geometry, self._distances, pair).min_distance
            if margins[row] < PROOF.failed_below:
                margins[row] = self._distance_from_cold_start(pair)
        return margins - self._required[pairs]

    def _distance_from_cold_start(self, place: int) -> float:
        """Measure the distance of one pair without coal's warm start [m]."""
        numbers = self._numbers[place]
        solid_a, solid_b = (self._solids[k] for k in numbers)
        poses = (self._distances.oMg[k] for k in numbers)
        pose_a, pose_b = (coal.Transform3s(pose.rotation, pose.translation) for pose in poses)
        return solid_distance(solid_a, pose_a, solid_b, pose_b)

    def _fastest(self, begin: FloatArray, end: FloatArray) -> FloatArray:
        return speeds_within(self._trajectory.time, self._speeds, begin, end)


def _lower(
    met: FloatArray,
    met_at: tuple[IntArray, FloatArray],
    interval: IntArray,
    value: FloatArray,
    pair: IntArray,
    time: FloatArray,
) -> None:
    """Lower the least measured margins with their pairs and times, earliest first."""
    least = np.full(len(met), np.inf)
    np.minimum.at(least, interval, value)
    rows = np.flatnonzero((value == least[interval]) & (value < met[interval]))
    if not len(rows):
        return
    value, pair, time, interval = value[rows], pair[rows], time[rows], interval[rows]
    order = np.lexsort((pair, time, interval))
    firsts = order[np.concatenate([[True], np.diff(interval[order]) > 0])]
    k = interval[firsts]
    met[k], met_at[0][k], met_at[1][k] = value[firsts], pair[firsts], time[firsts]


def interval_speeds(trajectory: Trajectory) -> FloatArray:
    """Compute the greatest joint speeds between knots [rad/s], shape (max(1, k - 1), n)."""
    v, a = np.abs(trajectory.velocity), trajectory.acceleration
    if len(v) == 1:
        return v
    fastest = np.maximum(v[:-1], v[1:])
    # Speed is a parabola between knots; its vertex counts where acceleration changes its sign.
    # Two knots at one time are a jump of acceleration: there is no parabola.
    turns = (a[:-1] * a[1:] < 0) & (np.diff(trajectory.time)[:, None] > 0)
    step = np.divide(
        np.square(a[:-1]), 2.0 * trajectory.jerk, out=np.zeros_like(fastest), where=turns
    )
    vertex = np.abs(trajectory.velocity[:-1] - step)
    return np.where(turns, np.maximum(fastest, vertex), fastest)


def speeds_within(
    knots: FloatArray, speeds: FloatArray, begin: FloatArray, end: FloatArray
) -> FloatArray:
    """Compute the greatest joint speeds within intervals [rad/s], shape (n, joints).

    Args:
        knots: their times [s], shape (k,).
        speeds: between knots (`interval_speeds`).
        begin: starts of the intervals [s], shape (n,).
        end: ends of the intervals [s], shape (n,).
    """
    first = np.clip(np.searchsorted(knots, begin, side="right") - 1, 0, len(speeds) - 1)
    last = np.clip(np.searchsorted(knots, end, side="left") - 1, first, len(speeds) - 1)
    return _range_maximum(speeds, first, last)


def _range_maximum(values: FloatArray, first: IntArray, last: IntArray) -> FloatArray:
    """Compute the maximum of rows first to last, inclusive, by doubling tables."""
    result = np.empty((len(first), values.shape[1]))
    level = np.frexp(last - first + 1)[1] - 1
    table, k = values, 0
    while True:
        rows = np.flatnonzero(level == k)
        if len(rows):
            result[rows] = np.maximum(table[first[rows]], table[last[rows] - (1 << k) + 1])
        if k >= level.max(initial=0):
            return result
        table = np.maximum(table[: -(1 << k)], table[1 << k :])
        k += 1


def levers(model: pin.Model, solids: Sequence[Solid], pairs: Sequence[Pair]) -> FloatArray:
    """Bound the lever of each joint on each pair of solids [m/rad], shape (pairs, joints).

    A joint that carries only one of the two solids moves its points by no more than their distance from the joint's
    origin: at most the length of the chain to the solid's joint plus its extent there. Sliding joints have lever 1.

    Args:
        model: of the robot's URDF; one velocity per joint.
        solids: of the cell.
        pairs: of solids.
    """
    reach = [reaches(model, solid) for solid in solids]
    table = np.zeros((len(pairs), model.nv))
    for row, pair in enumerate(pairs):
        lever_a, lever_b = reach[pair.first], reach[pair.second]
        for joint in set(lever_a) ^ set(lever_b):
            table[row, model.idx_vs[joint]] = lever_a.get(joint, 0.0) + lever_b.get(joint, 0.0)
    return table


def reaches(model: pin.Model, solid: Solid) -> dict[int, float]:
    """Bound the distance of a solid's points from each joint that carries it [m]."""
    levers: dict[int, float] = {}
    joint, reach = solid.joint, solid.extent
    while joint != WORLD:
        slides = "P" in model.joints[joint].shortname().removeprefix("JointModel")[:1]
        if slides:
            reach += max(
                abs(model.lowerPositionLimit[model.idx_qs[joint]]),
                abs(model.upperPositionLimit[model.idx_qs[joint]]),
            )
        levers[joint] = 1.0 if slides else reach
        reach += float(norm(model.jointPlacements[joint].translation))
        joint = model.parents[joint]
    return levers
