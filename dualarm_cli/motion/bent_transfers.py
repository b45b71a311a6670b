"""Transfers that are not straight: along a curve, by a posture, or all joints along one path; within a tool's cap."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise
from math import comb

import numpy as np

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.elementary import power
from dualarm_cli.geometry.products import product
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.model.trajectory import Trajectory
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
    """Numbers that steer the search for curved detours."""

    controls: int = 4
    """Control points between start and goal: curves of degree five."""
    timed_samples: int = 9
    """Points of a curve from which its time is estimated."""
    population: int = 40
    """Curves of a round."""
    elite: int = 8
    """Best ones of a round, about which the next one is drawn."""
    rounds: int = 20
    """Rounds of a search."""
    spreads: tuple[float, ...] = (0.15, 0.3, 0.6, 1.0)
    """Standard deviations of the first control points about the straight way [rad]."""
    first: int = 50
    """First curves of each spread."""
    least_spread: float = 0.01
    """Standard deviation below which nothing is to be gained [rad]."""
    missing_weight: float = 350.0
    """Penalty of missing clearance at full speed [s/m]."""
    curve_points: int = 65
    """Points of a curve that is passed along."""
    curve_knots: int = 48
    """Knots of its motion at least."""


CURVES = CurveSettings()


Missing = Callable[[FloatArray], FloatArray]
"""How much clearance curves (c, points, 7) lack, at their points on the average [m], shape (c,); 0 for free ones."""
ToolTimes = Callable[[FloatArray], FloatArray]
"""How long the tool needs along curves (c, points, 7) at least [s], shape (c,)."""


def curve(start: FloatArray, controls: FloatArray, goal: FloatArray, count: int) -> FloatArray:
    """Returns points of Bezier curves, shape (..., count, 7) [rad].

    Args:
        start: where they begin [rad], shape (n,).
        controls: control points between [rad], shape (..., c, 7).
        goal: where they end [rad], shape (n,).
        count: how many points, equally spaced in the parameter.
    """
    basis = _bernstein(controls.shape[-2] + 1, count)
    ends = basis[:, :1] * start + basis[:, -1:] * goal
    points: FloatArray = ends + product(basis[:, 1:-1], controls)
    return points


@lru_cache(maxsize=8)
def _bernstein(degree: int, count: int) -> FloatArray:
    """Returns Bernstein polynomials at equally spaced parameters, shape (count, degree + 1)."""
    s = np.linspace(0.0, 1.0, count)[:, None]
    k = np.arange(degree + 1)
    number = np.array([comb(degree, int(i)) for i in k], dtype=np.float64)
    return number * power(s, k) * power(1.0 - s, degree - k)


@dataclass(frozen=True)
class CurveCost:
    """What curves of an arm cost: their time, and what they lack of the clearance."""

    limits: JointLimits
    """Of the joints."""
    least: float
    """Time below which a curve gains nothing [s]."""
    missing: Missing
    """How much clearance curves lack."""
    samples: int
    """Points of a curve that are looked at."""
    pace: float
    """How much slower than at full speed the joints are."""
    tool: ToolTimes | None = None
    """How long the tool needs along them; None where its speed has no cap."""

    def of(
        self, start: FloatArray, controls: FloatArray, goal: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Returns what curves cost [s], what they lack included, and what they lack [m], both (c,)."""
        few = curve(start, controls, goal, CURVES.timed_samples)
        share = np.linspace(0.0, 1.0, CURVES.timed_samples)
        time = np.maximum(estimate_line_durations(few, share, self.limits), self.least)
        points = curve(start, controls, goal, self.samples)
        if self.tool is not None:
            time = np.maximum(time, self.tool(points))
        beyond = np.maximum(points - self.limits.upper, 0.0)
        beyond += np.maximum(self.limits.lower - points, 0.0)
        lack = self.missing(points) + beyond.sum(axis=(1, 2))
        # Of equally quick ones the one that moves least.
        travel = np.abs(np.diff(points, axis=1)).sum(axis=(1, 2))
        return time + self.pace * CURVES.missing_weight * lack + 1e-3 * travel, lack


def quick_curves(
    start: FloatArray, goal: FloatArray, cost: CurveCost, seed: int
) -> list[FloatArray]:
    """Search for the quickest collision-free curves between two configurations.

    The cross-entropy method [Rubinstein1999] over the control points, with what is missing of the clearance as a
    penalty: normal distributions about the best of every round.

    Args:
        start: where they begin [rad], shape (n,).
        goal: where they end [rad], shape (n,).
        cost: what curves cost.
        seed: of the random curves.

    Returns:
        Control points (`controls`, n) [rad] of the curves found that lack no clearance, best first.
    """
    random, n, limits = np.random.default_rng(seed), len(start), cost.limits
    share = np.linspace(0.0, 1.0, CURVES.controls + 2)[1:-1, None]
    straight = start + share * (goal - start)
    # Most first curves bulge as a whole; the ends of their bulges differ.
    bulge = random.normal(size=(len(CURVES.spreads), CURVES.first, 1, n)) + 0.5 * random.normal(
        size=(len(CURVES.spreads), CURVES.first, CURVES.controls, n)
    )
    drawn = straight + (np.array(CURVES.spreads)[:, None, None, None] * bulge).reshape(
        -1, CURVES.controls, n
    )
    drawn = np.clip(drawn, limits.lower, limits.upper)
    best: FloatArray = np.empty((0, CURVES.controls, n))
    worth: FloatArray = np.empty(0)
    lacking: FloatArray = np.empty(0)
    for _ in range(CURVES.rounds):
        found, lacks = cost.of(start, drawn, goal)
        best, worth, lacking = (
            np.concatenate(pair) for pair in ((best, drawn), (worth, found), (lacking, lacks))
        )
        order = np.argsort(worth, kind="stable")[: CURVES.elite]
        best, worth, lacking = best[order], worth[order], lacking[order]
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
    """Returns an arm's way by a via point, there and on, or in one curve that does not stop there.

    Args:
        drive: of the job.
        plan: the stage, with a detour of the arm.
        name: the arm.
        platform: what the platform does meanwhile; None where it stands.

    Raises:
        InfeasibleError: the tool exceeds its cap however slowly the arm goes, since the platform moves it.
    """
    detour, index = plan.detours[name], drive.columns[name]
    joints = drive.joints(name)
    if not detour.stops:
        points = curve(plan.start[index], detour.points, plan.arrival[index], CURVES.curve_points)
        late = plan.waits.get(name, 0.0)

        def position_at(piece: Trajectory, time: FloatArray) -> FloatArray:
            q = np.tile(plan.start, (len(time), 1))
            if platform is not None:
                q[:, drive.columns[PLATFORM]] = platform.at(time + late)[0]
            q[:, index] = piece.at(time)[0]
            return q

        return [_along(drive, [name], joints, points, position_at)]
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
    """Returns an arm's way by a via point that begins or ends in motion.

    Args:
        drive: of the job.
        plan: the stage, with a detour of the arm that has rates.
        name: the arm.
        least: how long it takes at least [s].

    Raises:
        InfeasibleError: there is no such transfer.
    """
    detour, index = plan.detours[name], drive.columns[name]
    assert detour.rates is not None
    limits = drive.limits.select(drive.joints(name))
    ends = plan.start[index], detour.points[0], plan.arrival[index]
    legs: list[Trajectory] = []
    for k, (start, goal) in enumerate(pairwise(ends)):
        left = max(0.0, least - legs[0].duration) if legs else 0.0
        problem = TransferProblem(
            limits.joints, start, goal, limits, left, detour.rates[k], detour.rates[k + 1]
        )
        leg = solve_moving_transfer(problem)
        if leg is None:
            raise InfeasibleError(Refusal("no_plan_on_grid"))
        legs.append(leg)
    return legs


def _along(
    drive: Drive,
    arms: Sequence[str],
    joints: tuple[str, ...],
    points: FloatArray,
    position_at: Callable[[Trajectory, FloatArray], FloatArray],
) -> Trajectory:
    """Returns the quickest motion along points of a curve [rad], shape (m, n), in which no tool exceeds its cap.

    Args:
        drive: of the job.
        arms: those whose tools count.
        joints: that move along the curve.
        points: of the curve.
        position_at: all joints (m, columns) [rad] with a motion along the curve at instants (m,) [s].

    Raises:
        InfeasibleError: a tool exceeds its cap at any speed along the curve.
    """
    share, own = np.linspace(0.0, 1.0, len(points)), drive.limits.select(joints)
    cap = drive.cap

    def made(factor: float) -> Trajectory:
        slower = replace(own, velocity=own.velocity * factor)
        return drive.timing.line(
            LineProblem(joints, points, share, slower, None, CURVES.curve_knots)
        )

    if cap is None:
        return made(1.0)

    def speed(piece: Trajectory) -> float:
        return largest_tool_speed(
            drive.model, arms, lambda time: position_at(piece, time), piece.duration
        )

    found = slowed(made, speed, cap)
    if found is None:
        raise InfeasibleError(Refusal("detour_too_fast", allowed=cap))
    return found
