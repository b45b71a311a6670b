"""One path, from one start: the joints by a path follower, then the trajectory with every limit looked at."""

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
from dualarm_cli.kinds.path.joining import Joined, instants, leaves, strays
from dualarm_cli.model.curves.tool_path import TURN_LENGTH
from dualarm_cli.model.path_work import PathWork
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.postures.holding import Holding
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal
from dualarm_cli.registry import Solver


def evened_out(problem: PathProblem, found: PathMotion, window: float) -> PathMotion:
    """Returns the same motion of the tools with joints that are means over a short time.

    Where a method comes to a limit, or leaves one, velocities have kinks and accelerations jump. A mean over W spreads
    a jump evenly over W; what that does to the tools is undone by Newton steps of least norm, so that only self-motion
    is evened out. At both ends, where all is at rest, the joints stay as they are.

    Args:
        problem: what was asked.
        found: the joints.
        window: W [s]; 0 for none.
    """
    half = int(window / (2.0 * problem.step))
    count = problem.instants
    if half < 2 or count < 6 * half:
        return found
    position = _means(np.array(found.position), half)
    body, which = problem.body, np.flatnonzero(problem.follows)
    for k in range(1, count - 1):
        if np.array_equal(position[k], found.position[k]):
            continue
        R_there, p_there = body.tools(found.position[k])
        state = body.at(position[k])
        J = state.J[problem.rows] * problem.free
        try:
            plus = product(J.T, inverse(product(J, J.T)))
        except SingularMatrixError:
            return found
        position[k] = corrected(problem, position[k], plus, R_there[which], p_there[which])
    return PathMotion(position)


def _means(position: FloatArray, half: int) -> FloatArray:
    """Returns means over 2 half + 1 instants, the outermost counting half, fading to nothing at both ends, (k, n)."""
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
    """Numbers that steer the timing of a followed path."""

    smoothed: tuple[float, ...] = (0.0, 0.04, 0.08, 0.16, 0.32)
    """Times over which self-motion is evened out, where joints would exceed their limits without [s]."""
    hopeless: float = 3.0
    """Factor too fast above which self-motion is not evened out. Above it a method's limits are not tightened
    either."""
    hopeless_yet: float = 1.3
    """Factor too fast above which a slowed path is not evened out."""
    finest: int = 8
    """Maximum refinement of the instants where a curve through them strays [factor]."""
    tolerated: float = 0.2
    """Share of a path's tolerance that is reserved for deviations between knots."""
    stray: float = 2e-5
    """Largest deviation of a trajectory from its path between knots [m]. `tolerated` may allow less."""
    gentler: tuple[float, ...] = (2.0, 4.0)
    """Stretch factors of ramps that are tried next where the file leaves them open."""
    slower: float = 0.9
    """Largest share of the speed that is tried next where easing off locally does not do."""
    halved: float = 0.5
    """Factor on the speed where the method does not report the necessary reduction."""
    bisections: int = 3
    """Number of bisections between the last infeasible and the first feasible speed. They follow a reduction by
    `halved` or more."""
    slowest: float = 0.05
    """Least share of its speed at which a path is tried."""
    rounds: int = 16
    """Maximum number of attempts at lower speed."""
    gently: float = 1.3
    """Growth of the time in which a path eases off, per attempt [factor]."""
    eased: int = 8
    """Maximum number of attempts that slow a path only where it was too fast."""
    gained: float = 0.98
    """Share of what exceeds the limits above which evening out has gained nothing."""
    near_junction: float = 0.02
    """Distance from a junction of pieces within which it is to blame [m]."""
    ample: float = 1.02
    """Factor by which speed is reduced more than needed."""
    tightened: int = 3
    """Maximum number of times that a method's limits are tightened. This is for methods that keep the limits
    themselves, where the curve through their instants exceeds them."""
    looked_at: float = 0.02
    """Time between the postures of a path that are looked at [s]."""


FOLLOW = FollowSettings()


Remedy = Literal["slower", "limit", "other", "clear", "tolerance"]
"""What may help against a refusal: less speed, another path or start (and another method), more room, or a larger
tolerance."""


@dataclass(frozen=True)
class FollowedPath:
    """A path as it is followed."""

    trajectory: Trajectory
    """All joints of the robot."""
    clock: PathClock
    """Where the tools are when."""
    work: PathWork
    """What was followed: with rounded corners, or with stops at them."""
    asked: float
    """How long it would take if the joints' limits did not ask for less speed [s]."""


@dataclass(frozen=True)
class Refused:
    """Why a path cannot be followed from a start."""

    reason: Refusal
    """With time and place."""
    share: float
    """How much of the path can be."""
    remedy: Remedy = "other"
    """What may help."""
    excess: float = 0.0
    """By what factor it is too fast, where that is known."""


@dataclass
class TrialBudget:
    """How much more may be tried to follow one path, from all its starts."""

    instants: int = 120_000
    """Instants for which joints may still be sought or evened out."""

    @property
    def spent(self) -> bool:
        """Whether nothing more is to be tried."""
        return self.instants <= 0


Follower = Solver[PathProblem, PathMotion | NoPath]


def quickest_path(
    context: PathContext,
    work: PathWork,
    follower: Follower,
    start: FloatArray,
    budget: TrialBudget,
    halve: bool = True,
) -> FollowedPath | Refused:
    """Returns a path with rounded corners, or with stops at them where that is quicker; see `follow_path`."""
    found = follow_path(context, work, follower, start, budget, halve)
    if not work.sharp:
        return found
    # A tight bend can take longer than a stop.
    stopping = follow_path(context, work.stopping(), follower, start, budget, halve)
    if isinstance(stopping, Refused):
        return found
    if isinstance(found, Refused):
        return stopping
    return min(found, stopping, key=lambda one: one.trajectory.duration)


def follow_path(
    context: PathContext,
    work: PathWork,
    follower: Follower,
    start: FloatArray,
    budget: TrialBudget,
    halve: bool = True,
) -> FollowedPath | Refused:
    """Returns a path as one method follows it from one start, slower where the file allows it.

    Args:
        context: the job.
        work: the path.
        follower: the method.
        start: joints where it begins [rad], shape (n,).
        budget: how much may be tried; less is left afterwards.
        halve: whether less speed is tried as well where the method does not say how much less helps.
    """
    open_ramps = work.acceleration is None or work.jerk is None
    clock = context.clock(work)
    full = clock.duration
    trials = _Trials(context, work, follower, start, budget)
    # Without self-motion the joints are where the path has them: nothing has to be followed to see a limit.
    if not trials.has_self_motion and (refused := trials.ended_by_limit(clock)):
        return refused
    tried = trials.once(clock)
    if np.isinf(tried.excess) and trials.has_self_motion:
        refused = trials.ended_by_limit(clock)
        if refused is not None:
            return refused
    # Where it may be slower it eases off in its ramps as anywhere.
    for gentle in FOLLOW.gentler if open_ramps and not work.slower else ():
        if tried.slower_helps:
            clock = context.clock(work, gentle=gentle)
            full = clock.duration
            tried = trials.once(clock)
    if work.slower and tried.slower_helps and (halve or np.isfinite(tried.excess)):
        tried, clock = trials.eased(clock, tried)
        if tried.trajectory is not None:
            # Ramps up to a speed that is never reached are too steep, and easing off in them takes long.
            reached = float(clock.at(clock.duration * np.linspace(0.0, 1.0, 201))[1].max())
            gentle = FOLLOW.gentler[0] if open_ramps else 1.0
            lower = context.clock(work, gentle=gentle, peak=reached * clock.speed)
            again = trials.once(lower, FOLLOW.hopeless_yet)
            if np.isfinite(again.excess):
                again, lower = trials.eased(lower, again)
            if again.trajectory is not None and lower.duration < clock.duration:
                tried, clock = again, lower
    if tried.trajectory is None:
        assert tried.refused is not None  # one of the two is there
        return tried.refused
    return FollowedPath(tried.trajectory, clock, work, full)


@dataclass(frozen=True)
class _Tried:
    """What came of following a path once."""

    trajectory: Trajectory | None
    refused: Refused | None
    """Why there is none."""
    excess: float = 0.0
    """By what factor it would have to be slower, infinite where that is not known, 0 where it is no help."""
    profile: Joined | None = None
    """Where it was too fast, where that is known."""
    share: float = 1.0
    """Pace of the limits that the method was given."""
    tighter_helps: bool = False
    """Whether the same at the limits of a slower pace may keep the limits."""

    @property
    def slower_helps(self) -> bool:
        """Whether there is no trajectory, and slower there may be one."""
        return self.trajectory is None and self.excess > 1.0


@dataclass(frozen=True)
class _Trials:
    """Following one path from one start by one method."""

    context: PathContext
    work: PathWork
    follower: Follower
    start: FloatArray
    """Joints where the path begins [rad], shape (n,)."""
    budget: TrialBudget

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

    def eased(self, clock: PathClock, tried: _Tried) -> tuple[_Tried, PathClock]:
        """Returns what comes of easing off where it was too fast, or else of less speed all along, and the clock."""
        slower = too_fast = 1.0
        for k in range(FOLLOW.rounds):
            if not tried.slower_helps or self.budget.spent:
                break
            if tried.profile is not None and k < FOLLOW.eased:
                clock = clock.eased(
                    tried.profile.time, tried.profile.excess * FOLLOW.ample, power(FOLLOW.gently, k)
                )
            else:
                # It is not known where, or easing off there does not do: slower all along.
                too_fast, known = slower, np.isfinite(tried.excess)
                slower *= (
                    min(FOLLOW.slower, 1.0 / (FOLLOW.ample * tried.excess))
                    if known
                    else FOLLOW.halved
                )
                if slower < FOLLOW.slowest:
                    break
                clock = self.context.clock(self.work, slower)
            tried = self.once(clock, FOLLOW.hopeless_yet, tried.share)
        # The step to a speed that will do may have been a long one.
        for _ in range(FOLLOW.bisections if slower <= FOLLOW.halved * too_fast else 0):
            if tried.trajectory is None or self.budget.spent:
                break
            between = float(np.sqrt(slower * too_fast))
            faster = self.context.clock(self.work, between)
            again = self.once(faster, FOLLOW.hopeless_yet, tried.share)
            if again.trajectory is None:
                too_fast = between
            else:
                tried, clock, slower = again, faster, between
        return tried, clock

    def once(
        self, clock: PathClock, hopeless: float = FOLLOW.hopeless, share: float = 1.0
    ) -> _Tried:
        """Returns the trajectory by one clock, or why there is none.

        Above a factor too fast nothing is evened out. Where a method keeps the limits itself, what exceeds them is the
        curve through its instants, most of all where self-motion is as quick as limits allow. A slower path does not
        help then: the method is given the limits of a slower pace.
        """
        tried = self._with_share(clock, hopeless, share)
        for _ in range(FOLLOW.tightened):
            if not tried.tighter_helps or not tried.slower_helps or self.budget.spent:
                break
            tighter = tried.share / (tried.excess * FOLLOW.ample)
            again = self._with_share(clock, hopeless, tighter)
            if again.trajectory is None and not 1.0 < again.excess <= FOLLOW.gained * tried.excess:
                break
            tried = again
        return tried

    def _with_share(
        self, clock: PathClock, hopeless: float, share: float, finer: int = 1
    ) -> _Tried:
        """Returns the same, the method being given the limits of a pace."""
        problem = self.context.problem(self.work, self.start, clock, finer)
        self.budget.instants -= problem.instants
        found = self.follower.solve(replace(problem, limits=problem.limits.scaled(share)))
        if isinstance(found, NoPath):
            along = float(problem.share[found.instant])
            remedy: Remedy = "slower" if found.excess > 1.0 else "other"
            refused = _refused(self.work, found.reason, found.instant * problem.step, along, remedy)
            return _Tried(None, replace(refused, excess=found.excess), found.excess, share=share)
        left = leaves(problem, found)
        rounded = PATH.rounded if any(path.junctions for path in self.work.paths.values()) else 0.0
        if left > (1.0 - rounded - FOLLOW.tolerated) * self.work.tolerance:
            more = {
                "method": self.follower.name,
                "turn": TURN_LENGTH,
                "measured_mm": left * 1e3,
                "allowed_mm": self.work.tolerance * 1e3,
            }
            reason = Refusal("path_left", measured=left, allowed=self.work.tolerance, more=more)
            return _Tried(None, Refused(reason, 1.0, "tolerance"))
        joined: list[Joined] = []
        for window in FOLLOW.smoothed:
            if len(joined) > len(PATH.per_knot) and _in_vain(joined):
                break
            if joined and min(curve.worst for curve in joined) > hopeless:
                break
            if window > 0.0:
                # About as much work as following it once more.
                if self.budget.spent:
                    break
                self.budget.instants -= problem.instants
            even = evened_out(problem, found, window)
            for stride in PATH.per_knot:
                curve = Joined.of(problem, even, stride)
                joined.append(curve)
                if curve.worst > 1.0:
                    continue
                if strays(problem, found, curve.trajectory) <= min(
                    FOLLOW.tolerated * self.work.tolerance, FOLLOW.stray
                ):
                    return _Tried(curve.trajectory, None, share=share)
        curve = min(joined, key=lambda one: one.worst)
        if curve.worst <= 1.0:
            # What keeps the limits strays from the path between instants that are too far apart.
            if finer < FOLLOW.finest:
                return self._with_share(clock, hopeless, share, 2 * finer)
            return _Tried(None, Refused(Refusal("path_not_joined"), 1.0))
        along = float(
            np.interp(curve.when, instants(problem.instants, problem.step), problem.share)
        )
        posture = found.position[min(problem.instants - 1, round(curve.when / problem.step))]
        also = [*_near_junction(self.work, along), *singular_there(problem, posture)]
        cause = Refusal("path_exceeds", more={"cause": curve.reason, "also": also})
        remedy = "slower" if curve.slower_helps else "other"
        refused = _refused(self.work, cause, curve.when, along, remedy)
        refused = replace(refused, excess=curve.worst)
        excess = curve.worst if curve.slower_helps else 0.0
        return _Tried(
            None, refused, excess, curve, share, found.keeps_rates and excess <= FOLLOW.hopeless
        )


def _in_vain(joined: list[Joined]) -> bool:
    """Returns whether the first evening out gained nothing."""
    before, after = joined[: len(PATH.per_knot)], joined[len(PATH.per_knot) :]
    return min(c.worst for c in after) > FOLLOW.gained * min(c.worst for c in before)


def _near_junction(work: PathWork, share: float) -> list[Refusal]:
    """List the jump of a path's curvature where a limit is exceeded, or nothing."""
    for path in work.paths.values():
        for edge in path.junctions:
            if edge not in path.corners and abs(edge - share * path.length) < FOLLOW.near_junction:
                return [Refusal("near_junction", more={"mm": edge * 1e3})]
    return []


def _refused(work: PathWork, reason: Refusal, time: float, share: float, remedy: Remedy) -> Refused:
    """Returns a reason with time and place."""
    places = []
    for arm, path in work.paths.items():
        x, y, z = path.pose(share * path.length).translation
        where = {"mm": share * path.length * 1e3, "x": x, "y": y, "z": z}
        places.append(Refusal("tool_on_path", arm=arm, more=where))
    more = {"time": time, "places": places, "cause": reason}
    return Refused(Refusal("path_fails_at", more=more), share, remedy)


def is_clear(holding: Holding, position: FloatArray) -> BoolArray:
    """Returns which configurations (k, n) [rad] are collision-free, shape (k,)."""
    held = holding.cell.loads.nothing(len(position), len(holding.cell.arms))
    return np.asarray(holding.cell.margins(position, held) >= SLACK)


def touching_path(holding: Holding, found: FollowedPath) -> Refused | None:
    """Returns where a followed path collides, or None."""
    trajectory = found.trajectory
    count = max(2, int(np.ceil(trajectory.duration / FOLLOW.looked_at)) + 1)
    time = np.linspace(0.0, trajectory.duration, count)
    position = trajectory.at(time)[0]
    held = holding.cell.loads.nothing(count, len(holding.cell.arms))
    margin = holding.cell.margins(position, held)
    k = int(np.argmin(margin))
    if margin[k] >= SLACK / 2.0:
        return None
    one, other, missing = holding.cell.nearest(position[k], held[k])
    share = float(found.clock.at(time[k : k + 1])[0][0])
    more = {"time": time[k], "one": one, "other": other}
    reason = Refusal("path_touches", measured=max(0.0, -missing), more=more)
    return Refused(reason, share, "clear")
