"""Proof of clearance over a whole motion: distances at instants, and how fast they can change in between.

In an interval from t0 to t1 a joint moves no faster than its greatest speed there, w_k (exact: speed is a parabola
between knots), and joint k moves the points of a pair of solids against each other by no more than r_k per radian
(`levers`). So their distance changes by no more than L = sum_k r_k w_k per second, and with the distances d0 and d1 at
the ends nowhere in the interval is it less than (d0 + d1 - L (t1 - t0)) / 2. Intervals whose bound is too low to tell
are halved, until the least bound is within the precision of the least distance that was met. Nothing is left to luck
between instants: a contact of any length is found or excluded. Our own; the bound is that of conservative advancement.
"""

from __future__ import annotations

from collections.abc import Sequence

import coal
import numpy as np
import pinocchio as pin

from dualarm_cli.collision.solids import WORLD, Pair, Solid, geometry_model, solid_distance
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray, distinct
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class ProofSettings:
    """Resolution of the proof of clearance."""

    first_step: float = 0.08
    """Length of the first intervals [s]; longer in motions of so many more that they would fill the memory."""
    most_first: int = 20_000
    """First intervals at most, but for those that edges make; whichever are too long are halved."""
    shortest: float = 1e-9
    """Intervals are not halved below this [s]: the bound then is what it is."""
    most_halved: int = 2_000_000
    """Maximum number of halved intervals, before the allowance of `halved_each`.

    A fast seam of 3 s on a body that it may touch needs 240,000; motions far beyond limits need as many as they are
    long.
    """
    halved_each: int = 20
    """Additional halved intervals that are allowed for each knot and pair.

    Jobs need up to 0.2 for each.
    """
    nonsense: float = -1e6
    """Distance below which coal's iteration has failed [m]."""
    precision: float = 5e-4
    """How far the certified least distance may be below the least one met [m]."""
    numerical: float = 1e-6
    """What distances by coal may be off [m]; it is taken off every certified one."""


PROOF = ProofSettings()

Windows = Sequence[tuple[float, float]] | None
"""When a pair counts [s]; None for always."""


class UnprovenError(ValueError):
    """A motion that goes too far between its knots for a proof."""


@dataclass(frozen=True)
class Certified:
    """The least margin of one stretch of the motion, over all pairs."""

    margin: float
    """Proven: distance less what is required is nowhere smaller [m]."""
    met: float
    """The least margin that was met [m]."""
    pair: int
    """The pair that met it."""
    time: float
    """When [s]."""


class ClearanceProof:
    """Distances of the pairs of solids of one robot along one motion."""

    def __init__(
        self,
        model: pin.Model,
        solids: Sequence[Solid],
        pairs: Sequence[Pair],
        windows: Sequence[Windows],
        trajectory: Trajectory,
    ) -> None:
        """Prepares coal's geometries.

        Args:
            model: of the robot's URDF.
            solids: of the cell.
            pairs: which of them must keep apart.
            windows: when each pair counts.
            trajectory: finite, with rising times; its joints are the model's, in any order.
        """
        self._model, self._data = model, model.createData()
        # A pair may count twice, with another requirement at another time; pinocchio knows it once.
        places = {(pair.first, pair.second): None for pair in pairs}
        self._geometry, self._solids = geometry_model(solids, places), solids
        self._numbers = list(places)
        number_of = {place: number for number, place in enumerate(places)}
        self._place = np.array([number_of[pair.first, pair.second] for pair in pairs])
        self._distances = pin.GeometryData(self._geometry)
        # Kept, as pinocchio fills the same ones each time, and each would be wrapped anew otherwise.
        self._results = list(self._distances.distanceResults)
        self._required = np.array([pair.required for pair in pairs])
        self._windows = windows
        self._trajectory = trajectory
        order = [trajectory.joints.index(name) for name in model.names[1:]]
        self._order = np.array(order, dtype=np.int64)
        self._levers = levers(model, solids, pairs)
        self._speeds = interval_speeds(trajectory)[:, self._order]

    def certify(
        self, edges: FloatArray, precision: float = PROOF.precision, known: FloatArray | None = None
    ) -> list[Certified]:
        """Returns the proven least margin between each edge and the next; infinite where no pair counts.

        Args:
            edges: instants that part the motion [s], rising, shape (s + 1,).
            precision: how far a certified margin may be below the least one met [m].
            known: margins that other pairs have there [m], shape (s,): pairs whose balls show more are left out.

        Raises:
            UnprovenError: more intervals would have to be halved than any job needs.
        """
        found = [Certified(np.inf, np.inf, -1, 0.0) for _ in edges[:-1]]
        if not len(self._required):
            return found
        times = self._instants(edges)
        stretch = np.clip(np.searchsorted(edges, times[:-1], side="right") - 1, 0, len(found) - 1)
        low, high, pair = self._first_intervals(times)
        # All pairs have their first intervals in common, and speeds in them.
        rates = product(self._fastest(times[:-1], times[1:]), self._levers.T)
        if known is None:
            margins = self._all_margins(times)
            at_low, at_high = margins[low, pair], margins[high, pair]
        else:
            least = self._ball_margins(times)
            bound = least[low, pair] + least[high, pair]
            bound -= rates[low, pair] * (times[high] - times[low])
            near = 0.5 * bound < known[stretch[low]]
            low, high, pair = low[near], high[near], pair[near]
            at_low, at_high = (
                self._margins_at(times[low], pair),
                self._margins_at(times[high], pair),
            )
        begin, end, where = times[low], times[high], stretch[low]
        proven = np.full(len(found), np.inf)
        met = np.full(len(found), np.inf)
        met_at = np.full(len(found), -1), np.zeros(len(found))
        _lower(met, met_at, where, at_low, pair, begin)
        _lower(met, met_at, where, at_high, pair, end)
        rate = rates[low, pair]
        room = PROOF.most_halved + PROOF.halved_each * len(self._trajectory.time) * len(
            self._required
        )
        while len(pair):
            bound = 0.5 * (at_low + at_high - rate * (end - begin))
            bound = np.where(rate == 0.0, np.minimum(at_low, at_high), bound)
            settled = (bound >= met[where] - precision) | (end - begin < PROOF.shortest)
            room -= int(np.count_nonzero(~settled))
            if room < 0:
                raise UnprovenError
            np.minimum.at(proven, where[settled], bound[settled])
            left = ~settled
            begin, end, pair, where = begin[left], end[left], pair[left], where[left]
            at_low, at_high = at_low[left], at_high[left]
            middle = 0.5 * (begin + end)
            between = self._margins_at(middle, pair)
            _lower(met, met_at, where, between, pair, middle)
            begin, end = np.concatenate([begin, middle]), np.concatenate([middle, end])
            at_low = np.concatenate([at_low, between])
            at_high = np.concatenate([between, at_high])
            pair, where = np.tile(pair, 2), np.tile(where, 2)
            rate = (self._fastest(begin, end) * self._levers[pair]).sum(axis=1)
        return [
            Certified(float(low) - PROOF.numerical, float(margin), int(pair), float(time))
            for low, margin, pair, time in zip(proven, met, *met_at, strict=True)
        ]

    def _instants(self, edges: FloatArray) -> FloatArray:
        """Returns the ends of the first intervals [s]: all edges and windows' ends among them."""
        marks = [*edges.tolist()]
        for windows in self._windows:
            marks += [t for window in windows or () for t in window]
        marked = distinct(np.clip(np.array(marks), edges[0], edges[-1]))
        step = max(PROOF.first_step, float(marked[-1] - marked[0]) / PROOF.most_first)
        parts = np.ceil(np.diff(marked) / step).astype(np.int64)
        pieces = [
            np.linspace(a, b, n, endpoint=False)
            for a, b, n in zip(marked[:-1], marked[1:], parts, strict=True)
        ]
        return np.concatenate([*pieces, marked[-1:]])

    def _first_intervals(self, times: FloatArray) -> tuple[IntArray, IntArray, IntArray]:
        """Returns numbers of the instants at both ends, and the pair, of every interval in which a pair counts."""
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
        """Returns the margins of all pairs at some instants [m], shape (t, pairs)."""
        q = self._trajectory.at(times)[0][:, self._order]
        found = np.empty((len(times), len(self._results)))
        for row, position in enumerate(q):
            pin.computeDistances(self._model, self._data, self._geometry, self._distances, position)
            found[row] = [result.min_distance for result in self._results]
            for place in np.flatnonzero(found[row] < PROOF.nonsense).tolist():
                found[row, place] = self._anew(place)
        return found[:, self._place] - self._required

    def _ball_margins(self, times: FloatArray) -> FloatArray:
        """Compute the margins of bounding balls at instants [m], shape (t, pairs)."""
        forms = [shape.geometry for shape in self._geometry.geometryObjects]
        for form in forms:
            form.computeLocalAABB()
        middle = [np.asarray(form.aabb_center).ravel() for form in forms]
        radius = np.array([form.aabb_radius for form in forms])
        centers = np.empty((len(times), len(forms), 3))
        for row, q in enumerate(self._trajectory.at(times)[0][:, self._order]):
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
        """Returns the margin of one pair at each instant [m], shape (n,)."""
        margins = np.empty(len(times))
        order = np.argsort(times, kind="stable")
        q = self._trajectory.at(times[order])[0][:, self._order]
        before = np.nan
        for row, position in zip(order.tolist(), q, strict=True):
            if times[row] != before:
                pin.updateGeometryPlacements(
                    self._model, self._data, self._geometry, self._distances, position
                )
                before = times[row]
            pair = int(self._place[pairs[row]])
            margins[row] = pin.computeDistance(self._geometry, self._distances, pair).min_distance
            if margins[row] < PROOF.nonsense:
                margins[row] = self._anew(pair)
        return margins - self._required[pairs]

    def _anew(self, place: int) -> float:
        """Measure the distance of one pair without coal's warm start [m]."""
        numbers = self._numbers[place]
        one, other = (self._solids[k] for k in numbers)
        poses = (self._distances.oMg[k] for k in numbers)
        here, there = (coal.Transform3s(pose.rotation, pose.translation) for pose in poses)
        return solid_distance(one, here, other, there)

    def _fastest(self, begin: FloatArray, end: FloatArray) -> FloatArray:
        return speeds_within(self._trajectory.time, self._speeds, begin, end)


def _lower(
    met: FloatArray,
    met_at: tuple[IntArray, FloatArray],
    where: IntArray,
    value: FloatArray,
    pair: IntArray,
    time: FloatArray,
) -> None:
    """Lower the least margins met, with their pairs and times; of equal ones the earliest counts."""
    least = np.full(len(met), np.inf)
    np.minimum.at(least, where, value)
    rows = np.flatnonzero((value == least[where]) & (value < met[where]))
    if not len(rows):
        return
    value, pair, time, where = value[rows], pair[rows], time[rows], where[rows]
    order = np.lexsort((pair, time, where))
    firsts = order[np.concatenate([[True], np.diff(where[order]) > 0])]
    k = where[firsts]
    met[k], met_at[0][k], met_at[1][k] = value[firsts], pair[firsts], time[firsts]


def interval_speeds(trajectory: Trajectory) -> FloatArray:
    """Returns the greatest speed of each joint between knots [rad/s], shape (max(1, k - 1), n)."""
    v, a = np.abs(trajectory.velocity), trajectory.acceleration
    if len(v) == 1:
        return v
    fastest = np.maximum(v[:-1], v[1:])
    # Speed is a parabola between knots; its vertex counts where acceleration changes its sign.
    # At a jump of it, two knots at one time, there is no parabola.
    turns = (a[:-1] * a[1:] < 0) & (np.diff(trajectory.time)[:, None] > 0)
    step = np.divide(
        np.square(a[:-1]), 2.0 * trajectory.jerk, out=np.zeros_like(fastest), where=turns
    )
    vertex = np.abs(trajectory.velocity[:-1] - step)
    return np.where(turns, np.maximum(fastest, vertex), fastest)


def speeds_within(
    knots: FloatArray, speeds: FloatArray, begin: FloatArray, end: FloatArray
) -> FloatArray:
    """Find the greatest speed of each joint within intervals [rad/s], shape (n, joints).

    Args:
        knots: their times [s], shape (k,).
        speeds: between knots (`interval_speeds`).
        begin: where the intervals begin [s], shape (n,).
        end: where they end [s], shape (n,).
    """
    first = np.clip(np.searchsorted(knots, begin, side="right") - 1, 0, len(speeds) - 1)
    last = np.clip(np.searchsorted(knots, end, side="left") - 1, first, len(speeds) - 1)
    return _range_maximum(speeds, first, last)


def _range_maximum(values: FloatArray, first: IntArray, last: IntArray) -> FloatArray:
    """Returns the maximum of the rows from first to last (included), shape (n, columns): doubling tables."""
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
    """Returns how far each joint can move a pair's solids against each other per radian [m], shape (pairs, joints).

    A joint that carries only one of the two moves its points by no more than their distance from the joint's origin:
    at most the way along the chain of joints to the solid's own, and its extent there. Sliding joints move by one.

    Args:
        model: of the robot's URDF; one velocity per joint.
        solids: of the cell.
        pairs: of solids.
    """
    reach = [reaches(model, solid) for solid in solids]
    table = np.zeros((len(pairs), model.nv))
    for row, pair in enumerate(pairs):
        one, other = reach[pair.first], reach[pair.second]
        for joint in set(one) ^ set(other):
            table[row, model.idx_vs[joint]] = one.get(joint, 0.0) + other.get(joint, 0.0)
    return table


def reaches(model: pin.Model, solid: Solid) -> dict[int, float]:
    """Returns for every joint that carries a solid how far its points may be from the joint's origin [m]."""
    found: dict[int, float] = {}
    joint, reach = solid.joint, solid.extent
    while joint != WORLD:
        slides = "P" in model.joints[joint].shortname().removeprefix("JointModel")[:1]
        if slides:
            reach += max(
                abs(model.lowerPositionLimit[model.idx_qs[joint]]),
                abs(model.upperPositionLimit[model.idx_qs[joint]]),
            )
        found[joint] = 1.0 if slides else reach
        reach += float(norm(model.jointPlacements[joint].translation))
        joint = model.parents[joint]
    return found
