"""Motion along a path from a start: joints, then trajectory within limits.

A follower finds the joints.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from dualarm_cli.collision.clearance import SLACK
from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.geometry.elementary import cube, power
from dualarm_cli.geometry.linear_systems import SingularMatrixError, inverse
from dualarm_cli.geometry.products import product
from dualarm_cli.kinds.path.context import PATH, PathClock, PathContext
from dualarm_cli.kinds.path.following import NoPath, PathMotion, PathProblem
from dualarm_cli.kinds.path.following.position_limits import ended_by_limit
from dualarm_cli.kinds.path.following.problem import singular_there
from dualarm_cli.kinds.path.following.velocity import corrected
from dualarm_cli.kinds.path.joining import Joined, instants, path_deviation, target_error
from dualarm_cli.model.curves.tool_path import TURN_LENGTH
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.process_work import PathWork
from dualarm_cli.postures.holding import Holding
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal
from dualarm_cli.registry import Solver


def with_smooth_self_motion(problem: PathProblem, motion: PathMotion, window: float) -> PathMotion:
    """Smooth self-motion by moving means of joints; the tools' motion stays.

    Where a method reaches or leaves a limit, velocities have kinks and accelerations jump. A mean over W spreads a jump
    evenly over W. Newton steps of least norm restore the tools' poses, so that only self-motion is smoothed. At both
    ends, at rest, joints stay as they are.

    Args:
        problem: the follower's problem.
        motion: its solution.
        window: W [s]; 0 for none.
    """
    half = int(window / (2.0 * problem.step))
    count = problem.instants
    if half < 2 or count < 6 * half:
        return motion
    position = _means(np.array(motion.position), half)
    body, which = problem.body, np.flatnonzero(problem.follows)
    for k in range(1, count - 1):
        if np.array_equal(position[k], motion.position[k]):
            continue
        R_goal, p_goal = body.tools(motion.position[k])
        state = body.at(position[k])
        J = state.J[problem.rows] * problem.free
        try:
            plus = product(J.T, inverse(product(J, J.T)))
        except SingularMatrixError:
            return motion
        position[k] = corrected(problem, position[k], plus, R_goal[which], p_goal[which])
    return PathMotion(position)


def _means(position: FloatArray, half: int) -> FloatArray:
    """Compute moving means over 2 half + 1 instants, shape (k, n).

    They fade out at both ends. The outermost instants count half.
    """
    count = len(position)
    padded = np.pad(position, ((half, half), (0, 0)), mode="edge")
    sums = np.vstack([np.zeros((1, position.shape[1])), np.cumsum(padded - position[0], axis=0)])
    whole = sums[2 * half + 1 :] - sums[: -2 * half - 1]
    ends = padded[2 * half :] + padded[: -2 * half] - 2.0 * position[0]
    mean = position[0] + (whole - ends / 2.0) / (2 * half)
    x = np.clip(np.minimum(np.arange(count), count - 1 - np.arange(count)) / (2.0 * half), 0.0, 1.0)
    fade = (cube(x) * (10.0 - 15.0 * x + 6.0 * np.square(x)))[:, None]
    return position + fade * (mean - position)


@dataclass(frozen=True)
class FollowSettings:
    """Settings of smoothing, slowing and refining a followed path within its limits."""

    smoothed: tuple[float, ...] = (0.0, 0.04, 0.08, 0.16, 0.32)
    """Windows over which self-motion is smoothed to keep the joints' limits [s]."""
    smoothing_limit: float = 3.0
    """Factor too fast above which self-motion is not smoothed.

    Above it a method's limits are not tightened either.
    """
    slowed_smoothing_limit: float = 1.3
    """Factor too fast above which a slowed path is not smoothed."""
    finest: int = 8
    """Maximum refinement of the instants of curves that deviate [factor]."""
    tolerated: float = 0.2
    """Fraction of a path's tolerance that is reserved for deviations between knots."""
    stray: float = 2e-5
    """Largest deviation of a trajectory from its path between knots [m]. `tolerated` may allow less."""
    ramp_stretches: tuple[float, ...] = (2.0, 4.0)
    """Stretch factors of ramps that the file leaves open."""
    slower: float = 0.9
    """Largest fraction of the speed that is tried after local slowdown failed."""
    halved: float = 0.5
    """Factor on the speed if the method reports no necessary reduction."""
    bisections: int = 3
    """Number of bisections between the last infeasible and the first feasible speed.

    They follow a reduction by
    `halved` or more."""
    slowest: float = 0.05
    """Least fraction of its speed at which a path is tried."""
    rounds: int = 16
    """Maximum number of attempts at lower speed."""
    gently: float = 1.3
    """Growth of the slowdown's window per attempt [factor]."""
    eased: int = 8
    """Maximum number of attempts that slow a path locally."""
    gained: float = 0.98
    """Ratio of excesses above which smoothing counts as useless."""
    near_junction: float = 0.02
    """Distance from a junction within which it is named as the cause [m].

    A junction is one of two pieces of the path.
    """
    ample: float = 1.02
    """Factor by which speed is reduced more than needed."""
    tightened: int = 3
    """Maximum number of times that a method's limits are tightened.

    This is for methods that keep the limits
    themselves, where the curve through their instants exceeds them."""
    looked_at: float = 0.02
    """Time between the postures of a path that are tested for collisions [s]."""


FOLLOW = FollowSettings()


Remedy = Literal["slower", "limit", "other", "clear", "tolerance"]
"""Remedy of a refusal.

Less speed, another path or start (and another method), more room, or a larger tolerance.
"""


@dataclass(frozen=True)
class FollowedPath:
    """Trajectory along a path."""

    trajectory: Trajectory
    """All joints of the robot."""
    clock: PathClock
    """Progress over time."""
    work: PathWork
    """Path as followed: with rounded corners, or with stops at them."""
    requested_duration: float
    """Duration at the requested speed, without the joints' limits [s]."""


@dataclass(frozen=True)
class Refused:
    """Reason why a path cannot be followed from a start."""

    reason: Refusal
    """Cause with time and place."""
    share: float
    """Fraction of the path that can be followed."""
    remedy: Remedy = "other"
    """Remedy of the cause."""
    excess: float = 0.0
    """Factor by which it is too fast, if known."""


@dataclass
class InstantBudget:
    """Number of instants that may still be solved or smoothed for one path."""

    instants: int = 120_000
    """Remaining number of instants to solve or smooth."""

    @property
    def spent(self) -> bool:
        """Whether the budget is used up."""
        return self.instants <= 0


Follower = Solver[PathProblem, PathMotion | NoPath]


def quickest_path(
    context: PathContext,
    work: PathWork,
    follower: Follower,
    start: FloatArray,
    budget: InstantBudget,
    halve: bool = True,
) -> FollowedPath | Refused:
    """Follow a path with rounded corners, or with stops if quicker.

    See `follow_path`.
    """
    rounded = follow_path(context, work, follower, start, budget, halve)
    if not work.sharp:
        return rounded
    # A tight bend can take longer than a stop.
    stopping = follow_path(context, work.stopping(), follower, start, budget, halve)
    if isinstance(stopping, Refused):
        return rounded
    if isinstance(rounded, Refused):
        return stopping
    return min(rounded, stopping, key=lambda path: path.trajectory.duration)


def follow_path(
    context: PathContext,
    work: PathWork,
    follower: Follower,
    start: FloatArray,
    budget: InstantBudget,
    halve: bool = True,
) -> FollowedPath | Refused:
    """Follow a path by a given method and start, slower if allowed.

    The file allows lower speed.

    Args:
        context: the job.
        work: the path.
        follower: the method.
        start: joints where it begins [rad], shape (n,).
        budget: remaining effort, which is reduced.
        halve: whether lower speeds are tried even if the method reports no necessary reduction.
    """
    open_ramps = work.acceleration is None or work.jerk is None
    clock = context.clock(work)
    full = clock.duration
    trials = _Trials(context, work, follower, start, budget)
    # Without self-motion the path determines the joints: position limits show before following.
    if not trials.has_self_motion and (refused := trials.ended_by_limit(clock)):
        return refused
    trial = trials.attempt(clock)
    if np.isinf(trial.excess) and trials.has_self_motion:
        refused = trials.ended_by_limit(clock)
        if refused is not None:
            return refused
    # A path that may be slower is slowed in its ramps as well.
    for stretch in FOLLOW.ramp_stretches if open_ramps and not work.slower else ():
        if trial.slower_helps:
            clock = context.clock(work, ramp_stretch=stretch)
            full = clock.duration
            trial = trials.attempt(clock)
    if work.slower and trial.slower_helps and (halve or np.isfinite(trial.excess)):
        trial, clock = trials.eased(clock, trial)
        if trial.trajectory is not None:
            # Ramps up to a speed that is never reached are too steep, and slowing down in them takes long.
            reached = float(clock.at(clock.duration * np.linspace(0.0, 1.0, 201))[1].max())
            stretch = FOLLOW.ramp_stretches[0] if open_ramps else 1.0
            lower = context.clock(work, ramp_stretch=stretch, peak=reached * clock.speed)
            retrial = trials.attempt(lower, FOLLOW.slowed_smoothing_limit)
            if np.isfinite(retrial.excess):
                retrial, lower = trials.eased(lower, retrial)
            if retrial.trajectory is not None and lower.duration < clock.duration:
                trial, clock = retrial, lower
    if trial.trajectory is None:
        assert trial.refused is not None  # either is set
        return trial.refused
    return FollowedPath(trial.trajectory, clock, work, full)


@dataclass(frozen=True)
class _Trial:
    """Result of following a path once."""

    trajectory: Trajectory | None
    refused: Refused | None
    """Reason of the failure."""
    excess: float = 0.0
    """Required slowdown [factor]; infinite where unknown, 0 where it is no help."""
    profile: Joined | None = None
    """Violations over time, where known."""
    share: float = 1.0
    """Pace of the limits that the method was given."""
    tighter_helps: bool = False
    """Whether tighter limits for the method may keep the real ones."""

    @property
    def slower_helps(self) -> bool:
        """Whether there is no trajectory, but a slower one may exist."""
        return self.trajectory is None and self.excess > 1.0


@dataclass(frozen=True)
class _Trials:
    """Trials of one path from one start by one method."""

    context: PathContext
    work: PathWork
    follower: Follower
    start: FloatArray
    """Joints where the path begins [rad], shape (n,)."""
    budget: InstantBudget

    @property
    def has_self_motion(self) -> bool:
        """Flag of robots with more joints than the tools' poses need."""
        body = self.context.body
        follows = [arm in self.work.paths for arm in body.arms]
        return int(body.moves[follows].any(axis=0).sum()) > 6 * sum(follows)

    def ended_by_limit(self, clock: PathClock) -> Refused | None:
        """Find the place at which a joint's position limit ends a path, or None."""
        problem = self.context.problem(self.work, self.start, clock)
        ended = ended_by_limit(problem)
        if ended is None:
            return None
        along = float(problem.share[ended.instant])
        remedy: Remedy = "other" if self.has_self_motion else "limit"
        return _refused(self.work, ended.reason, ended.instant * problem.step, along, remedy)

    def eased(self, clock: PathClock, trial: _Trial) -> tuple[_Trial, PathClock]:
        """Slow a path until it keeps the limits, locally or as a whole.

        Returns the result and its clock.
        """
        slower = too_fast = 1.0
        for k in range(FOLLOW.rounds):
            if not trial.slower_helps or self.budget.spent:
                break
            if trial.profile is not None and k < FOLLOW.eased:
                clock = clock.eased(
                    trial.profile.time, trial.profile.excess * FOLLOW.ample, power(FOLLOW.gently, k)
                )
            else:
                # The place is unknown, or local slowdown is not enough: a lower speed everywhere.
                too_fast, is_known = slower, np.isfinite(trial.excess)
                slower *= (
                    min(FOLLOW.slower, 1.0 / (FOLLOW.ample * trial.excess))
                    if is_known
                    else FOLLOW.halved
                )
                if slower < FOLLOW.slowest:
                    break
                clock = self.context.clock(self.work, slower)
            trial = self.attempt(clock, FOLLOW.slowed_smoothing_limit, trial.share)
        # The step to a feasible speed may have been too long.
        for _ in range(FOLLOW.bisections if slower <= FOLLOW.halved * too_fast else 0):
            if trial.trajectory is None or self.budget.spent:
                break
            between = float(np.sqrt(slower * too_fast))
            faster = self.context.clock(self.work, between)
            retrial = self.attempt(faster, FOLLOW.slowed_smoothing_limit, trial.share)
            if retrial.trajectory is None:
                too_fast = between
            else:
                trial, clock, slower = retrial, faster, between
        return trial, clock

    def attempt(
        self, clock: PathClock, smoothing_limit: float = FOLLOW.smoothing_limit, share: float = 1.0
    ) -> _Trial:
        """Time a path by a clock, or find why it cannot be followed.

        Nothing is smoothed above a factor too fast. If a method keeps the limits itself, only the curve through its
        instants exceeds them, mostly where self-motion is as fast as the limits allow. A slower path does not help
        then: the method is given the limits of a slower pace.
        """
        trial = self._with_share(clock, smoothing_limit, share)
        for _ in range(FOLLOW.tightened):
            if not trial.tighter_helps or not trial.slower_helps or self.budget.spent:
                break
            tighter = trial.share / (trial.excess * FOLLOW.ample)
            retrial = self._with_share(clock, smoothing_limit, tighter)
            if (
                retrial.trajectory is None
                and not 1.0 < retrial.excess <= FOLLOW.gained * trial.excess
            ):
                break
            trial = retrial
        return trial

    def _with_share(
        self, clock: PathClock, smoothing_limit: float, share: float, finer: int = 1
    ) -> _Trial:
        """Time a path by one clock, with the method's limits at a pace."""
        problem = self.context.problem(self.work, self.start, clock, finer)
        self.budget.instants -= problem.instants
        motion = self.follower.solve(replace(problem, limits=problem.limits.scaled(share)))
        if isinstance(motion, NoPath):
            along = float(problem.share[motion.instant])
            remedy: Remedy = "slower" if motion.excess > 1.0 else "other"
            time = motion.instant * problem.step
            refused = _refused(self.work, motion.reason, time, along, remedy)
            return _Trial(None, replace(refused, excess=motion.excess), motion.excess, share=share)
        error = target_error(problem, motion)
        rounded = PATH.rounded if any(path.junctions for path in self.work.paths.values()) else 0.0
        if error > (1.0 - rounded - FOLLOW.tolerated) * self.work.tolerance:
            details = {
                "method": self.follower.name,
                "turn": TURN_LENGTH,
                "measured_mm": error * 1e3,
                "allowed_mm": self.work.tolerance * 1e3,
            }
            reason = Refusal("path_left", measured=error, allowed=self.work.tolerance, data=details)
            return _Trial(None, Refused(reason, 1.0, "tolerance"))
        joined: list[Joined] = []
        allowed = min(FOLLOW.tolerated * self.work.tolerance, FOLLOW.stray)
        for window in FOLLOW.smoothed:
            if len(joined) > len(PATH.per_knot) and _smoothing_is_useless(joined):
                break
            if joined and min(curve.worst for curve in joined) > smoothing_limit:
                break
            if window > 0.0:
                # Smoothing takes about as long as following.
                if self.budget.spent:
                    break
                self.budget.instants -= problem.instants
            even = with_smooth_self_motion(problem, motion, window)
            for stride in PATH.per_knot:
                curve = Joined.of(problem, even, stride)
                joined.append(curve)
                if curve.worst > 1.0:
                    continue
                if path_deviation(problem, motion, curve.trajectory) <= allowed:
                    return _Trial(curve.trajectory, None, share=share)
        curve = min(joined, key=lambda joint_curve: joint_curve.worst)
        if curve.worst <= 1.0:
            # The curve within limits deviates from the path: its instants are too far apart.
            if finer < FOLLOW.finest:
                return self._with_share(clock, smoothing_limit, share, 2 * finer)
            return _Trial(None, Refused(Refusal("path_not_joined"), 1.0))
        times = instants(problem.instants, problem.step)
        along = float(np.interp(curve.when, times, problem.share))
        posture = motion.position[min(problem.instants - 1, round(curve.when / problem.step))]
        also = [*_near_junction(self.work, along), *singular_there(problem, posture)]
        cause = Refusal("path_exceeds", data={"cause": curve.reason, "also": also})
        remedy = "slower" if curve.slower_helps else "other"
        refused = _refused(self.work, cause, curve.when, along, remedy)
        refused = replace(refused, excess=curve.worst)
        excess = curve.worst if curve.slower_helps else 0.0
        smoothable = motion.keeps_rates and excess <= FOLLOW.smoothing_limit
        return _Trial(None, refused, excess, curve, share, smoothable)


def _smoothing_is_useless(joined: list[Joined]) -> bool:
    """Test whether the first smoothing gained nothing."""
    before, after = joined[: len(PATH.per_knot)], joined[len(PATH.per_knot) :]
    return min(c.worst for c in after) > FOLLOW.gained * min(c.worst for c in before)


def _near_junction(work: PathWork, share: float) -> list[Refusal]:
    """List the jump of a path's curvature where a limit is exceeded, or nothing."""
    for path in work.paths.values():
        for edge in path.junctions:
            if edge not in path.corners and abs(edge - share * path.length) < FOLLOW.near_junction:
                return [Refusal("near_junction", data={"mm": edge * 1e3})]
    return []


def _refused(work: PathWork, reason: Refusal, time: float, share: float, remedy: Remedy) -> Refused:
    """Add time and place to a reason."""
    places = []
    for arm, path in work.paths.items():
        x, y, z = path.pose(share * path.length).translation
        where = {"mm": share * path.length * 1e3, "x": x, "y": y, "z": z}
        places.append(Refusal("tool_on_path", arm=arm, data=where))
    data = {"time": time, "places": places, "cause": reason}
    return Refused(Refusal("path_fails_at", data=data), share, remedy)


def is_clear(holding: Holding, position: FloatArray) -> BoolArray:
    """Select the collision-free configurations (k, n) [rad], shape (k,)."""
    held_parts = holding.cell.loads.nothing(len(position), len(holding.cell.arms))
    return np.asarray(holding.cell.margins(position, held_parts) >= SLACK)


def touching_path(holding: Holding, path: FollowedPath) -> Refused | None:
    """Find the worst collision of a followed path, or None."""
    trajectory = path.trajectory
    count = max(2, int(np.ceil(trajectory.duration / FOLLOW.looked_at)) + 1)
    time = np.linspace(0.0, trajectory.duration, count)
    position = trajectory.clamped(time)[0]
    held_parts = holding.cell.loads.nothing(count, len(holding.cell.arms))
    margin = holding.cell.margins(position, held_parts)
    k = int(np.argmin(margin))
    if margin[k] >= SLACK / 2.0:
        return None
    body_a, body_b, missing = holding.cell.nearest(position[k], held_parts[k])
    share = float(path.clock.at(time[k : k + 1])[0][0])
    data = {"time": time[k], "body_a": body_a, "body_b": body_b}
    reason = Refusal("path_touches", measured=max(0.0, -missing), data=data)
    return Refused(reason, share, "clear")
