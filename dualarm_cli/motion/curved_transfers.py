"""Curved transfers and transfers by a via point, within the limit of tool speed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise
from math import comb

import numpy as np

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.elementary import power
from dualarm_cli.geometry.products import product
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.motion.transfers import (
    PLATFORM,
    Drive,
    largest_tool_speed,
    slowed,
    transfers_within_tool_speed,
)
from dualarm_cli.postures.stage_plan import StagePlan
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal
from dualarm_cli.timing.line_profile import estimate_line_durations
from dualarm_cli.timing.problem import LineProblem, TransferProblem
from dualarm_cli.timing.ruckig_ import solve_moving_transfer


@dataclass(frozen=True)
class CurveSettings:
    """Settings of the search for curved detours."""

    controls: int = 4
    """Number of control points between start and goal: curves of degree five."""
    timed_samples: int = 9
    """Points of a curve from which its time is estimated."""
    population: int = 40
    """Number of curves per round."""
    elite: int = 8
    """Number of best curves from which the next round is drawn."""
    rounds: int = 20
    """Maximum number of rounds of a search."""
    spreads: tuple[float, ...] = (0.15, 0.3, 0.6, 1.0)
    """Standard deviations of the first control points about the straight line [rad]."""
    first: int = 50
    """Number of first curves per standard deviation."""
    least_spread: float = 0.01
    """Standard deviation at which the search ends [rad]."""
    missing_weight: float = 350.0
    """Penalty of missing clearance at full speed [s/m]."""
    curve_points: int = 65
    """Number of samples of the final curve."""
    curve_knots: int = 48
    """Minimum number of knots of its motion."""


CURVES = CurveSettings()


Missing = Callable[[FloatArray], FloatArray]
"""Missing clearance of curves (c, points, 7), averaged over points [m], shape (c,)."""
ToolTimes = Callable[[FloatArray], FloatArray]
"""Minimum time of the tool along curves (c, points, 7) [s], shape (c,)."""


def curve(start: FloatArray, controls: FloatArray, goal: FloatArray, count: int) -> FloatArray:
    """Evaluate Bezier curves at equally spaced parameters, shape (..., count, 7) [rad].

    Args:
        start: start of the curves [rad], shape (n,).
        controls: control points between [rad], shape (..., c, 7).
        goal: end of the curves [rad], shape (n,).
        count: number of points.
    """
    basis = _bernstein(controls.shape[-2] + 1, count)
    ends = basis[:, :1] * start + basis[:, -1:] * goal
    points: FloatArray = ends + product(basis[:, 1:-1], controls)
    return points


@lru_cache(maxsize=8)
def _bernstein(degree: int, count: int) -> FloatArray:
    """Evaluate Bernstein polynomials at equally spaced parameters, shape (count, degree + 1)."""
    s = np.linspace(0.0, 1.0, count)[:, None]
    k = np.arange(degree + 1)
    number = np.array([comb(degree, int(i)) for i in k], dtype=np.float64)
    return number * power(s, k) * power(1.0 - s, degree - k)


@dataclass(frozen=True)
class CurveCost:
    """Cost of curves of an arm: time plus a penalty for missing clearance."""

    limits: JointLimits
    """Limits of the arm's joints."""
    least: float
    """Time below which a faster curve gains nothing [s]."""
    missing: Missing
    """Missing clearance of curves."""
    samples: int
    """Number of points that are checked."""
    pace: float
    """Duration relative to full speed."""
    tool: ToolTimes | None = None
    """Minimum time of the tool along curves; None without a speed limit."""

    def of(
        self, start: FloatArray, controls: FloatArray, goal: FloatArray, best: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Compute the cost [s], penalty included, and the missing clearance [m] of curves, both (c,).

        Both are infinite for curves that cost more than the best ones whatever their clearance: it is not measured.

        Args:
            start: start of the curves [rad], shape (n,).
            controls: control points between [rad], shape (c, k, n).
            goal: end of the curves [rad], shape (n,).
            best: costs of the best curves so far [s], shape (e,).
        """
        samples = curve(start, controls, goal, CURVES.timed_samples)
        progress = np.linspace(0.0, 1.0, CURVES.timed_samples)
        time = np.maximum(estimate_line_durations(samples, progress, self.limits), self.least)
        points = curve(start, controls, goal, self.samples)
        if self.tool is not None:
            time = np.maximum(time, self.tool(points))
        violation = np.maximum(points - self.limits.upper, 0.0)
        violation += np.maximum(self.limits.lower - points, 0.0)
        beyond = violation.sum(axis=(1, 2))
        # Of equally fast curves the shortest is preferred.
        travel = 1e-3 * np.abs(np.diff(points, axis=1)).sum(axis=(1, 2))
        weight = self.pace * CURVES.missing_weight
        least = time + weight * beyond + travel
        costs, lack = np.full((2, len(controls)), np.inf)
        order = np.argsort(least, kind="stable")
        for first in range(0, len(order), CURVES.population):
            rows = order[first : first + CURVES.population]
            if len(best) >= CURVES.elite:
                rows = rows[least[rows] <= best[CURVES.elite - 1]]
            if not len(rows):
                break
            lack[rows] = self.missing(points[rows]) + beyond[rows]
            costs[rows] = time[rows] + weight * lack[rows] + travel[rows]
            best = np.sort(np.concatenate([best, costs[rows]]))
        return costs, lack


def quick_curves(
    start: FloatArray, goal: FloatArray, cost: CurveCost, seed: int
) -> list[FloatArray]:
    """Search for the quickest collision-free curves between two configurations.

    The cross-entropy method [Rubinstein1999] over the control points, with what is missing of the clearance as a
    penalty: normal distributions about the best of every round.

    Args:
        start: start of the curves [rad], shape (n,).
        goal: end of the curves [rad], shape (n,).
        cost: cost of curves.
        seed: of the random curves.

    Returns:
        Control points (`controls`, n) [rad] of collision-free curves, best first.
    """
    random, n, limits = np.random.default_rng(seed), len(start), cost.limits
    progress = np.linspace(0.0, 1.0, CURVES.controls + 2)[1:-1, None]
    straight = start + progress * (goal - start)
    # Most first curves bulge as a whole; the ends of their bulges differ.
    bulge = random.normal(size=(len(CURVES.spreads), CURVES.first, 1, n)) + 0.5 * random.normal(
        size=(len(CURVES.spreads), CURVES.first, CURVES.controls, n)
    )
    drawn = straight + (np.array(CURVES.spreads)[:, None, None, None] * bulge).reshape(
        -1, CURVES.controls, n
    )
    drawn = np.clip(drawn, limits.lower, limits.upper)
    best: FloatArray = np.empty((0, CURVES.controls, n))
    costs: FloatArray = np.empty(0)
    lacking: FloatArray = np.empty(0)
    for _ in range(CURVES.rounds):
        new_costs, new_lacking = cost.of(start, drawn, goal, costs)
        best, costs, lacking = (
            np.concatenate(pair)
            for pair in ((best, drawn), (costs, new_costs), (lacking, new_lacking))
        )
        order = np.argsort(costs, kind="stable")[: CURVES.elite]
        best, costs, lacking = best[order], costs[order], lacking[order]
        spread = best.std(axis=0) * 1.1 + CURVES.least_spread
        if spread.max() < 2.0 * CURVES.least_spread:
            break
        drawn = best.mean(axis=0) + spread * random.normal(
            size=(CURVES.population, CURVES.controls, n)
        )
        drawn = np.clip(drawn, limits.lower, limits.upper)
    return [controls for controls, lack in zip(best, lacking, strict=True) if lack == 0.0]


def detour_pieces(
    drive: Drive, plan: StagePlan, name: str, platform: Trajectory | None
) -> list[Trajectory]:
    """Time an arm's detour, by a via point with a stop or along a curve.

    Args:
        drive: of the job.
        plan: the stage, with a detour of the arm.
        name: the arm.
        platform: simultaneous motion of the platform; None if it stands still.

    Raises:
        InfeasibleError: the platform alone moves the tool faster than its limit.
    """
    detour, index, drive = plan.detours[name], drive.columns[name], drive.to(plan)
    joints = drive.joints(name)
    if not detour.stops:
        points = curve(plan.start[index], detour.points, plan.arrival[index], CURVES.curve_points)
        delay = plan.waits.get(name, 0.0)

        def position_at(piece: Trajectory, time: FloatArray) -> FloatArray:
            q = np.tile(plan.start, (len(time), 1))
            if platform is not None:
                q[:, drive.columns[PLATFORM]] = platform.clamped(time + delay)[0]
            q[:, index] = piece.clamped(time)[0]
            return q

        return [_along(drive, name, joints, points, position_at)]
    between = np.array(plan.start)
    between[index] = detour.points[0]
    goal = np.array(plan.start)
    goal[index] = plan.arrival[index]
    legs = []
    for start, end in ((plan.start, between), (between, goal)):
        alone = StagePlan(start, end, end, {}, plan.solver, 0.0)
        moved = transfers_within_tool_speed(drive, alone)
        legs.append([moved.motion[name]] if name in moved.motion else [])
    return [*legs[0], *legs[1]]


def moving_detour(drive: Drive, plan: StagePlan, name: str, least: float) -> list[Trajectory]:
    """Time an arm's transfer by a via point that begins or ends in motion.

    Args:
        drive: of the job.
        plan: the stage, with a detour of the arm that has rates.
        name: the arm.
        least: minimum duration [s].

    Raises:
        InfeasibleError: no such transfer was found.
    """
    detour, index = plan.detours[name], drive.columns[name]
    assert detour.rates is not None
    limits = drive.to(plan).group_limits[name]
    ends = plan.start[index], detour.points[0], plan.arrival[index]
    legs: list[Trajectory] = []
    for k, (start, goal) in enumerate(pairwise(ends)):
        remaining = max(0.0, least - legs[0].duration) if legs else 0.0
        problem = TransferProblem(
            limits.joints, start, goal, limits, remaining, detour.rates[k], detour.rates[k + 1]
        )
        leg = solve_moving_transfer(problem)
        if leg is None:
            raise InfeasibleError(Refusal("no_plan_on_grid"))
        legs.append(leg)
    return legs


def _along(
    drive: Drive,
    arm: str,
    joints: tuple[str, ...],
    points: FloatArray,
    position_at: Callable[[Trajectory, FloatArray], FloatArray],
) -> Trajectory:
    """Time the fastest motion along points of a curve within the tool-speed limit.

    Args:
        drive: of the job.
        arm: the arm, whose tool may be limited.
        joints: names of the joints that move along the curve.
        points: points of the curve [rad], shape (m, n).
        position_at: all joints (m, columns) [rad] with a motion along the curve at instants (m,) [s].

    Raises:
        InfeasibleError: a tool exceeds its limit at any speed along the curve.
    """
    progress, limits = np.linspace(0.0, 1.0, len(points)), drive.limits.select(joints)
    caps = {arm: drive.caps[arm]} if arm in drive.caps else {}

    def timed(factor: float) -> Trajectory:
        slower = replace(limits, velocity=limits.velocity * factor)
        return drive.timing.line(
            LineProblem(joints, points, progress, slower, None, CURVES.curve_knots)
        )

    if not caps:
        return timed(1.0)

    def speed(piece: Trajectory) -> float:
        return largest_tool_speed(
            drive.model, caps, lambda time: position_at(piece, time), piece.duration
        )

    motion = slowed(timed, speed, caps)
    if motion is None:
        raise InfeasibleError(Refusal("detour_too_fast", allowed=caps[arm]))
    return motion
