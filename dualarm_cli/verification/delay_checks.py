"""Tolerated delay of one arm, as proven and as required.

Proof of the least delay of one arm at which clearance is lost.

If both arms stand on the same base or platform, the solids of each arm depend on its own clock alone. Squares of the
plane of both clocks are halved in both directions, small delays first, until they are proven clear or a centre lacks
clearance. The proof compares the boxes swept by two solids, or their distance at the centre less their motion.
Our own; the bound is that of `clearance_proof`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import coal
import numpy as np
import pinocchio as pin

from dualarm_cli.collision.solids import (
    Pair,
    Solid,
    bodies_without_shape,
    cell_solids,
    pairs_that_must_keep_apart,
)
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray, distinct
from dualarm_cli.kinds import of_kinds
from dualarm_cli.model.job import Job
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.schedule import Schedule, ScheduleRobot
from dualarm_cli.model.verification import LONGEST_DELAY, ArmDelay, Check, Verdict
from dualarm_cli.records import dataclass
from dualarm_cli.verification.clearance_checks import touching_spans
from dualarm_cli.verification.clearance_proof import (
    PROOF,
    interval_speeds,
    reaches,
    speeds_within,
)
from dualarm_cli.verification.measuring.criteria import not_checked
from dualarm_cli.verification.measuring.holding_spans import carrying_spans
from dualarm_cli.verification.measuring.line_spans import LineSpan
from dualarm_cli.verification.measuring.tolerances import TOL
from dualarm_cli.verification.measuring.tool_model import tool_chain

SKEW = "skew"
"""Name of the check, which is made only if the job requires a skew."""


def arm_delays(schedule: Schedule, job: Job, spans: Sequence[LineSpan]) -> tuple[ArmDelay, ...]:
    """Prove the tolerated delay of each of two arms with shapes.

    The arm's joints, its tool and its part are late. The other arm and a platform keep to the plan's time, and both
    arms stay at the end of the plan. Not counted are bodies that may touch in a hand-over or on a seam, parts on the
    lines of their pick and place, and parts that are fed to their picks. Other parts that wait or lie collide first
    while an arm carries them, as long as the platform stands.

    Args:
        schedule: with finite numbers and rising times.
        job: as it was done.
        spans: of the job's stops.
    """
    robot = job.cell.robot
    if len(robot.arms) != 2 or any("links" in body for body in bodies_without_shape(job.cell)):
        return ()
    schedule = replace(schedule, robot=ScheduleRobot.of_job(job))
    model = pin.buildModelFromXML(robot.urdf)
    solids = cell_solids(job.cell, model, job.carried())
    touches = [touch for kind in of_kinds("checks") for touch in kind.touches(job, spans)]
    joints = [{model.getJointId(name) for name in arm.joints} for arm in robot.arms]
    pairs = []
    for pair in pairs_that_must_keep_apart(model, solids, job.cell):
        solid_a, solid_b = solids[pair.first], solids[pair.second]
        if solid_a.joint in joints[1] and solid_b.joint in joints[0]:
            pair, solid_a, solid_b = Pair(pair.second, pair.first, pair.required), solid_b, solid_a
        if solid_a.joint not in joints[0] or solid_b.joint not in joints[1]:
            continue
        existing = [
            _to_the_ends(schedule, carrying_spans(schedule, job, solid))
            if solid.carrier
            else ALWAYS
            for solid in (solid_a, solid_b)
        ]
        excused = _to_the_ends(
            schedule,
            [
                span
                for gripped in (False, True)
                for span in touching_spans(touches, solid_a, solid_b, gripped=gripped)
            ],
        )
        pairs.append(ArmPair(pair, (existing[0], existing[1]), excused))
    if not pairs:
        return ()
    required = [figure for figure in (job.skew, job.budget and job.budget.skew) if figure]
    proof = DelayProof(model, schedule.trajectory, solids, pairs, max([LONGEST_DELAY, *required]))
    delays = []
    for late, arm in enumerate(robot.arms):
        least, bodies = proof.bracket(late, required), None
        if least.pair >= 0:
            pair = pairs[least.pair].pair
            bodies = solids[pair.first].label, solids[pair.second].label
        lacking = None if bodies is None else least.broken
        time = None if bodies is None else least.time
        delays.append(ArmDelay(arm.name, least.proven, lacking, bodies, time))
    return tuple(delays)


def check_skew(job: Job, delays: Sequence[ArmDelay]) -> list[Check]:
    """Judge the tolerated delay that a job requires, if any.

    Args:
        job: as it was done.
        delays: delays that the motion tolerates; empty if none was proven.
    """
    if not job.skew:
        return []
    if not delays:
        return [not_checked(SKEW)]
    worst = min(delays, key=lambda delay: delay.clear)
    verdict: Verdict = "passed" if worst.clear >= job.skew else "failed"
    return [Check(SKEW, verdict, worst.clear, job.skew, "s", str(worst))]


def _to_the_ends(schedule: Schedule, spans: Spans) -> Spans:
    """Extend spans that reach an end of the motion beyond it."""
    first, last = schedule.trajectory.time[0], schedule.trajectory.time[-1]
    return [
        (-np.inf if begin <= first else begin, np.inf if end >= last else end)
        for begin, end in spans
    ]


Spans = Sequence[tuple[float, float]]
"""Starts and ends of spans [s]."""
ALWAYS = ((-np.inf, np.inf),)
"""Spans of a solid that always exists."""


@dataclass(frozen=True)
class DelaySearch:
    """Settings of the search for the least delay that lacks clearance."""

    grid: float = 0.02
    """Shortest stretch of a bounding box [s], longer beyond `most` stretches."""
    most: int = 8_000
    """Maximum number of stretches."""
    levels: int = 5
    """Number of halvings from the first squares to those of one stretch."""
    boxes: int = 3
    """Number of halvings before distances are measured as well."""
    shortest: float = 5e-5
    """Side below which squares are not halved [s]."""
    precision: float = 5e-4
    """Largest gap between proven and refuted delay that ends the search [s]."""
    share: float = 0.01
    """Relative form of `precision`; the greater one counts."""
    distances: int = 1_000_000
    """Maximum number of measured distances; bundled jobs need up to 80,000.

    Beyond it nothing more is proven.
    """


@dataclass(frozen=True)
class ArmPair:
    """A solid of each arm."""

    pair: Pair
    """Their numbers, that of the first arm first, and the required distance."""
    there: tuple[Spans, Spans] = (ALWAYS, ALWAYS)
    """Spans in which each one exists, by its own arm's clock [s]."""
    excused: Spans = ()
    """Spans in which they touch by design, by either clock [s]."""

    @property
    def counts_always(self) -> bool:
        """Flag of pairs that count at any time."""
        return self.there == (ALWAYS, ALWAYS) and not self.excused

    def counts_at(self, clocks: Sequence[float]) -> bool:
        """Return whether it counts at an instant of each clock [s]."""
        return all(
            any(start <= clock <= end for start, end in there)
            and not any(start <= clock <= end for start, end in self.excused)
            for clock, there in zip(clocks, self.there, strict=True)
        )


@dataclass(frozen=True)
class DelayBracket:
    """The least delay that lacks clearance, from below and from above."""

    proven: float
    """Every delay up to it is clear [s]."""
    broken: float = np.inf
    """A delay that lacks clearance [s]; infinite where none was found."""
    pair: int = -1
    """Number of the pair that lacks it; -1 for none."""
    time: float = 0.0
    """Instant by the clock of the punctual arm [s]."""


@dataclass(frozen=True)
class _Squares:
    """Squares of one size in the plane of both clocks, with pairs."""

    first: IntArray
    """Numbers along the first arm's clock, shape (n,)."""
    second: IntArray
    """Numbers along the second arm's clock, shape (n,)."""
    pair: IntArray
    """Numbers of the pairs, shape (n,)."""
    side: float
    """Length of a side [s]."""
    late: int
    """The arm that is late, 0 or 1."""

    @property
    def delay(self) -> IntArray:
        """Delay at the centres, in sides."""
        return self.first - self.second if self.late else self.second - self.first

    @property
    def low(self) -> FloatArray:
        """Least delay in each square [s]."""
        return np.maximum(self.delay - 1, 0) * self.side

    def select(self, which: BoolArray) -> _Squares:
        """Select some squares."""
        return replace(
            self, first=self.first[which], second=self.second[which], pair=self.pair[which]
        )

    def halved(self) -> _Squares:
        """Halve the squares in both directions."""
        first = (2 * self.first[:, None] + np.array([0, 0, 1, 1])).ravel()
        second = (2 * self.second[:, None] + np.array([0, 1, 0, 1])).ravel()
        return _Squares(first, second, np.repeat(self.pair, 4), 0.5 * self.side, self.late)


class DelayProof:
    """Distances of two arms along one motion, one of them late."""

    def __init__(
        self,
        model: pin.Model,
        trajectory: Trajectory,
        solids: Sequence[Solid],
        pairs: Sequence[ArmPair],
        longest: float,
        search: DelaySearch | None = None,
    ) -> None:
        """Bound the solids in stretches of time by boxes.

        Args:
            model: of the robot's URDF; both arms hang on the same joint.
            trajectory: finite, with rising times; its joints are the model's, in any order.
            solids: of the cell.
            pairs: pairs that must keep apart, at least one.
            longest: longest delay of interest [s].
            search: resolution of the search.
        """
        self._trajectory, self._longest = trajectory, longest
        self._search, self._measured = search or DelaySearch(), 0
        self._speeds = interval_speeds(trajectory)
        numbers_of_pairs = np.array([(pair.pair.first, pair.pair.second) for pair in pairs])
        numbers = distinct(numbers_of_pairs.ravel())
        self._solids, bodies = (
            [solids[k] for k in numbers.tolist()],
            np.searchsorted(numbers, numbers_of_pairs),
        )
        self._chains = [
            tool_chain(model, solid.joint, pin.SE3.Identity(), [solid.pose], trajectory.joints)
            for solid in self._solids
        ]
        columns_a, columns_b = (self._chains[body].columns for body in bodies[0].tolist())
        self._carrying = sorted(set(columns_a) & set(columns_b))
        self._levers = np.array([self._levers_of(model, solid) for solid in self._solids])
        # If only one arm moves, a delay matters only to solids that exist for a while.
        moves = np.asarray(self._levers.any(axis=1))
        always = np.array([pair.counts_always for pair in pairs])
        self._rows = np.flatnonzero(moves[bodies].all(axis=1) | ~always)
        self._pairs = [pairs[k] for k in self._rows.tolist()]
        self._bodies = bodies[self._rows].T
        self._required = np.array([pair.pair.required for pair in self._pairs])
        levels, whole = self._search.levels, trajectory.duration + longest
        grid = max(self._search.grid, (whole + longest) / self._search.most)
        self._side = grid * 2**levels
        self._before = int(np.ceil(longest / self._side))
        self._after = int(np.ceil(whole / self._side))
        self._boxes = [self._finest_boxes(grid)]
        for _ in range(levels):
            low, high = self._boxes[0]
            low = np.minimum(low[:, ::2], low[:, 1::2])
            self._boxes.insert(0, (low, np.maximum(high[:, ::2], high[:, 1::2])))

    def bracket(self, late: int, required: Sequence[float] = ()) -> DelayBracket:
        """Find the least delay that lacks clearance.

        Args:
            late: number of the late arm, 0 or 1 as in the pairs.
            required: delays that the bracket must not leave undecided [s].
        """
        search, level, bracket = self._search, 0, DelayBracket(self._longest)
        offsets = np.arange(int(np.ceil(self._longest / self._side)) + 1)
        axes = np.arange(self._after), offsets, np.arange(len(self._pairs))
        number, offset, pair = (grid.ravel() for grid in np.meshgrid(*axes, indexing="ij"))
        squares = _Squares(
            number - (1 - late) * offset, number - late * offset, pair, self._side, late
        )
        while True:
            squares = squares.select(squares.low < min(bracket.proven, bracket.broken))
            squares = squares.select((squares.delay >= 0) & self._counts(squares))
            if level < len(self._boxes):
                squares = squares.select(self._near(squares, level))
            room = level < search.boxes or self._measured + len(squares.pair) <= search.distances
            if level >= search.boxes and room:
                margin, moved = self._margins(squares)
                bracket = self._lowered(bracket, squares, margin)
                # A NaN proves nothing.
                clear = margin - moved >= PROOF.numerical - TOL.clearance_slack
                squares = squares.select(~clear & (squares.low < bracket.broken))
            if not len(squares.pair):
                return replace(bracket, proven=min(bracket.proven, bracket.broken))
            low = float(squares.low.min())
            is_precise = low > bracket.broken - max(search.precision, search.share * bracket.broken)
            is_precise &= not any(low < delay <= bracket.broken for delay in required)
            if is_precise or not room or squares.side < 2.0 * search.shortest:
                return replace(bracket, proven=min(bracket.proven, low))
            squares, level = squares.halved(), level + 1

    def _counts(self, squares: _Squares) -> BoolArray:
        """Return whether a pair may count somewhere in each square."""
        counts = np.ones(len(squares.pair), dtype=np.bool_)
        for number, pair in enumerate(self._pairs):
            if pair.counts_always:
                continue
            rows = np.flatnonzero(squares.pair == number)
            for clock, spans in zip((squares.first, squares.second), pair.there, strict=True):
                begin, end = clock[rows] * squares.side, (clock[rows] + 1) * squares.side
                exists = np.zeros(len(rows), dtype=np.bool_)
                for start, stop in spans:
                    exists |= (begin <= stop) & (end >= start)
                for start, stop in pair.excused:
                    exists &= (begin < start) | (end > stop)
                counts[rows] &= exists
        return counts

    def _near(self, squares: _Squares, level: int) -> BoolArray:
        """Return whether boxes of pairs are nearer than required, by square."""
        (low, high), shift = self._boxes[level], self._before << level
        body_a, i = self._bodies[0, squares.pair], squares.first + shift
        body_b, j = self._bodies[1, squares.pair], squares.second + shift
        gap = np.maximum(low[body_a, i] - high[body_b, j], low[body_b, j] - high[body_a, i])
        distances = np.sqrt(np.square(np.maximum(gap, 0.0)).sum(axis=1))
        is_near: BoolArray = (
            distances < np.maximum(self._required[squares.pair], 0.0) + PROOF.numerical
        )
        return is_near

    def _margins(self, squares: _Squares) -> tuple[FloatArray, FloatArray]:
        """Measure margins at squares' centres by coal, and bound their change [m]."""
        side, pair, moved = squares.side, squares.pair, np.zeros(len(squares.pair))
        places: list[FloatArray] = []
        for clock, bodies in zip((squares.first, squares.second), self._bodies, strict=True):
            numbers = distinct(clock)
            rows, body = np.searchsorted(numbers, clock), bodies[pair]
            moved += (
                0.5 * side * (self._fastest(numbers, side)[rows] * self._levers[body]).sum(axis=1)
            )
            R, p = np.empty((len(pair), 3, 3)), np.empty((len(pair), 3))
            for k in distinct(body).tolist():
                rows_of_body = np.flatnonzero(body == k)
                R[rows_of_body], p[rows_of_body] = self._poses(k, clock[rows_of_body], side)
            places += [R, p]
        self._measured += len(pair)
        forms = [solid.geometry for solid in self._solids]
        request, result = coal.DistanceRequest(), coal.DistanceResult()
        T1, T2, distance = coal.Transform3s(), coal.Transform3s(), np.empty(len(pair))
        for row, (body_a, body_b, R1, p1, R2, p2) in enumerate(
            zip(*self._bodies[:, pair].tolist(), *places, strict=True)
        ):
            T1.setRotation(R1)
            T1.setTranslation(p1)
            T2.setRotation(R2)
            T2.setTranslation(p2)
            result.clear()
            distance[row] = coal.distance(forms[body_a], T1, forms[body_b], T2, request, result)
        return distance - self._required[pair], moved

    def _lowered(
        self, bracket: DelayBracket, squares: _Squares, margin: FloatArray
    ) -> DelayBracket:
        """Lower the refuted delay to the least one at squares' centres."""
        delay = squares.delay * squares.side
        # Coal's iteration fails now and then where faces touch: bodies never overlap by metres.
        lacks = (margin < -TOL.clearance_slack) & (margin > -10.0) & (delay < bracket.broken)
        rows = np.flatnonzero(lacks)
        for row in rows[np.argsort(delay[rows], kind="stable")].tolist():
            clocks = [
                (clock[row] + 0.5) * squares.side for clock in (squares.first, squares.second)
            ]
            number = int(squares.pair[row])
            if self._pairs[number].counts_at(clocks):
                return replace(
                    bracket,
                    broken=float(delay[row]),
                    pair=int(self._rows[number]),
                    time=float(max(clocks)),
                )
        return bracket

    def _finest_boxes(self, grid: float) -> tuple[FloatArray, FloatArray]:
        """Compute corners of boxes swept in short stretches [m], (solids, stretches, 3)."""
        numbers = np.arange(
            -self._before << self._search.levels, self._after << self._search.levels
        )
        moved = 0.5 * grid * np.einsum("nk,sk->sn", self._fastest(numbers, grid), self._levers)
        centre, half = np.empty((2, len(self._solids), len(numbers), 3))
        for k, solid in enumerate(self._solids):
            solid.geometry.computeLocalAABB()
            low, high = solid.geometry.aabb_local.min_, solid.geometry.aabb_local.max_
            R, p = self._poses(k, numbers, grid)
            centre[k] = p + np.einsum("nij,j->ni", R, 0.5 * (low + high))
            half[k] = np.einsum("nij,j->ni", np.abs(R), 0.5 * (high - low))
        half += moved[:, :, None]
        return centre - half, centre + half

    def _levers_of(self, model: pin.Model, solid: Solid) -> FloatArray:
        """Compute the lever of each joint on a solid [m/rad], shape (joints,)."""
        levers = np.zeros(len(self._trajectory.joints))
        for joint, reach in reaches(model, solid).items():
            levers[self._trajectory.joints.index(model.names[joint])] = reach
        levers[self._carrying] = 0.0
        return np.where(self._speeds.max(axis=0) > 0.0, levers, 0.0)

    def _poses(self, body: int, numbers: IntArray, side: float) -> tuple[FloatArray, FloatArray]:
        """Compute a solid's rotations and positions [m] at the middle of stretches.

        Joints that carry both arms are held at 0: they do not move one arm against the other.
        """
        q = self._trajectory.clamped((numbers.astype(np.float64) + 0.5) * side)[0]
        q[:, self._carrying] = 0.0
        return self._chains[body].poses(q)

    def _fastest(self, numbers: IntArray, side: float) -> FloatArray:
        """Compute the greatest joint speeds in stretches [rad/s], shape (n, joints)."""
        begin, end = (number.astype(np.float64) * side for number in (numbers, numbers + 1))
        knots = self._trajectory.time
        moves = (end > knots[0]) & (begin < knots[-1])
        return np.where(moves[:, None], speeds_within(knots, self._speeds, begin, end), 0.0)
