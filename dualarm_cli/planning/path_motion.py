"""One path, from one start: the joints by a path follower, then the trajectory with every limit looked at."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.kinematics.dynamics import Dynamics
from dualarm_cli.kinematics.srs_arm import SrsArm
from dualarm_cli.kinematics.whole_body import WholeBody
from dualarm_cli.model.job import Job, PathWork
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.model.tool_path import TURN_LENGTH
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.path_following import NoPath, PathMotion, PathProblem
from dualarm_cli.path_following.problem import Spring
from dualarm_cli.planning.path_clock import PathClock
from dualarm_cli.planning.path_joining import Joined, instants, leaves, strays
from dualarm_cli.planning.path_smoothing import evened_out
from dualarm_cli.planning.path_targets import SHARE as ROUNDED
from dualarm_cli.planning.path_targets import tool_targets
from dualarm_cli.registry import Solver

STEP, LONGEST_STEP = 1e-3, 1e-2
"""Time between the instants at which joints are found [s]; on long paths more, up to the second."""
MOST = 12_000
"""Instants beyond which the time between them grows."""
PER_KNOT = (4, 8)
"""Instants per knot of the trajectory."""
SMOOTHED = (0.0, 0.04, 0.08, 0.16, 0.32)
"""Times over which self-motion is evened out, where joints would exceed their limits without [s]."""
HOPELESS, HOPELESS_YET = 3.0, 1.3
"""Factors too fast above which no evening out helps, or slowing down is tried first."""
TOLERATED = 0.2
"""Share of its tolerance by which the trajectory may leave a path between knots."""
GENTLER = (2.0, 4.0)
"""How many times as long as usual ramps take that are tried next where the file leaves them open."""
SLOWER = 0.9
"""Share of the speed that is tried next where limits do not say how much slower it has to be."""
SLOWEST = 0.05
"""Least share of its speed at which a path is tried."""
ROUNDS = 16
"""How often a path is tried slower."""
EASED = 8
"""How often it is tried slower only where it was too fast."""
GAINED = 0.98
"""Share of what exceeds the limits above which evening out has gained nothing."""
NEAR_JUNCTION = 0.02
"""Distance from a junction of pieces within which it is to blame [m]."""
AMPLE = 1.02
"""By how much more than needed speed is reduced."""


Remedy = Literal["slower", "other", "clear", "tolerance"]
"""What may help against a refusal: less speed, another path or start, more room, or a larger tolerance."""


@dataclass(frozen=True)
class Followed:
    """A path as it is followed."""

    trajectory: Trajectory
    """All joints of the robot."""
    clock: PathClock
    """Where the tools are when."""
    asked: float
    """How long it would take if the joints' limits did not ask for less speed [s]."""


@dataclass(frozen=True)
class Refused:
    """Why a path cannot be followed from a start."""

    reason: str
    """In words, with time and place."""
    share: float
    """How much of the path can be."""
    remedy: Remedy = "other"
    """What may help."""


@dataclass(frozen=True)
class PathContext:
    """A job's cell as path followers need it."""

    model: CellModel
    """In closed form, where its arms have one."""
    body: WholeBody
    """Kinematics of all joints."""
    job: Job
    """What is to be done."""
    limits: JointLimits
    """Limits at the job's speed."""
    dynamics: Dynamics | None
    """For paths that keep torques within limits; None where nothing asks for them."""

    @classmethod
    def of(cls, model: CellModel, job: Job) -> PathContext:
        """Prepares a job."""
        torque = any(task.path is not None and task.path.torque for task in job.tasks)
        return cls(
            model,
            WholeBody(job.cell),
            job,
            job.cell.robot.limits.scaled(job.speed),
            Dynamics(job.cell) if torque else None,
        )

    @property
    def closed_form(self) -> bool:
        """Whether all arms are spherical-revolute-spherical."""
        return all(isinstance(arm.kinematics, SrsArm) for arm in self.model.arms.values())

    def clock(self, work: PathWork, slower: float = 1.0, gentle: float = 1.0) -> PathClock:
        """Returns the clock of a path at the job's speed and under its cap on the tools.

        Args:
            work: the path.
            slower: share of that speed at which it is followed.
            gentle: how many times as long as usual ramps take that the file leaves open.
        """
        cap = self.job.tool_speed
        if cap is not None and slower < 1.0:
            cap = cap * slower
        return PathClock.of(work, self.job.speed * slower, gentle, cap)

    def problem(self, work: PathWork, start: FloatArray, clock: PathClock) -> PathProblem:
        """Returns what a follower is asked.

        Args:
            work: the path.
            start: joints where it begins [rad], shape (n,).
            clock: where the tools are when.
        """
        widest = PER_KNOT[-1]
        step = min(max(STEP, clock.duration / MOST), LONGEST_STEP)
        count = widest * max(5, int(np.ceil(clock.duration / (step * widest))))
        step = clock.duration / count
        share, pace = clock.at(instants(count + 1, step))
        arms = [arm for arm in self.body.arms if arm in work.paths]
        poses = [tool_targets(work.paths[arm], share, step, work.tolerance) for arm in arms]
        return PathProblem(
            body=self.body,
            limits=self.limits,
            start=start,
            step=step,
            follows=np.array([arm in work.paths for arm in self.body.arms]),
            R=np.stack([R for R, _ in poses], axis=1),
            p=np.stack([p for _, p in poses], axis=1),
            share=share,
            pace=pace,
            spring=Spring(self.critical_points(work.critical_points), 2.0 * work.stiffness**2),
            model=self.model if self.closed_form else None,
            tool_speed=self.job.tool_speed,
            torque=self.dynamics.limit if work.torque and self.dynamics else None,
            dynamics=self.dynamics.at if work.torque and self.dynamics else None,
        )

    def critical_points(self, given: Mapping[str, FloatArray]) -> FloatArray:
        """Returns the critical points of all arms in the carried frame [m], shape (a, 3).

        Where none is given: below the shoulder by the length of the upper arm, where an elbow hangs that nothing holds.

        Args:
            given: by arm.
        """
        shoulders, upper = self.body.shoulders()
        points = shoulders - upper[:, None] * np.array([0.0, 0.0, 1.0])
        for a, arm in enumerate(self.body.arms):
            points[a] = given.get(arm, points[a])
        return points


Follower = Solver[PathProblem, PathMotion | NoPath]


def follow_path(
    context: PathContext, work: PathWork, follower: Follower, start: FloatArray
) -> Followed | Refused:
    """Returns a path as one method follows it from one start, slower where the file allows it.

    Args:
        context: the job.
        work: the path.
        follower: the method.
        start: joints where it begins [rad], shape (n,).
    """
    slower, open_ramps = 1.0, work.acceleration is None or work.jerk is None
    clock = context.clock(work)
    tried = _once(context, work, follower, start, clock)
    # Where it may be slower it eases off in its ramps as anywhere.
    for gentle in GENTLER if open_ramps and not work.slower else ():
        if tried.slower_helps:
            clock = context.clock(work, gentle=gentle)
            tried = _once(context, work, follower, start, clock)
    full = clock.duration
    for k in range(ROUNDS if work.slower else 0):
        if not tried.slower_helps:
            break
        if tried.profile is not None and k < EASED:
            clock = clock.eased(tried.profile.time, tried.profile.excess * AMPLE)
        else:
            # It is not known where, or easing off there does not do: slower all along.
            known = np.isfinite(tried.excess)
            slower *= min(SLOWER, 1.0 / (AMPLE * tried.excess)) if known else SLOWER
            if slower < SLOWEST:
                break
            clock = context.clock(work, slower)
        tried = _once(context, work, follower, start, clock, HOPELESS_YET)
    if tried.trajectory is None:
        return tried.refused
    return Followed(tried.trajectory, clock, full)


@dataclass(frozen=True)
class _Tried:
    """What came of following a path once."""

    trajectory: Trajectory | None
    refused: Refused
    excess: float = 0.0
    """By what factor it would have to be slower, infinite where that is not known, 0 where it is no help."""
    profile: Joined | None = None
    """Where it was too fast, where that is known."""

    @property
    def slower_helps(self) -> bool:
        """Whether there is no trajectory, and slower there may be one."""
        return self.trajectory is None and self.excess > 1.0


def _once(
    context: PathContext,
    work: PathWork,
    follower: Follower,
    start: FloatArray,
    clock: PathClock,
    hopeless: float = HOPELESS,
) -> _Tried:
    """Returns the trajectory by one clock, or why there is none; above a factor too fast nothing is evened out."""
    problem = context.problem(work, start, clock)
    found = follower.solve(problem)
    if isinstance(found, NoPath):
        share = float(problem.share[found.instant])
        remedy: Remedy = "slower" if found.excess > 1.0 else "other"
        refused = _refused(work, found.reason, found.instant * problem.step, share, remedy)
        return _Tried(None, refused, found.excess)
    left = leaves(problem, found)
    if left > (1.0 - ROUNDED - TOLERATED) * work.tolerance:
        reason = (
            f"{follower.name} leaves the path by {left * 1e3:.3f} mm (turns by {TURN_LENGTH:g} m/rad), tolerance "
            f"{work.tolerance * 1e3:g} mm"
        )
        return _Tried(None, Refused(reason, 1.0, "tolerance"))
    joined: list[Joined] = []
    for window in SMOOTHED:
        if len(joined) > len(PER_KNOT) and _in_vain(joined):
            break
        if joined and min(curve.worst for curve in joined) > hopeless:
            break
        even = evened_out(problem, found, window)
        for stride in PER_KNOT:
            curve = Joined.of(problem, even, stride)
            joined.append(curve)
            if curve.worst > 1.0:
                continue
            if strays(problem, found, curve.trajectory) <= TOLERATED * work.tolerance:
                return _Tried(curve.trajectory, Refused("", 1.0))
    curve = min(joined, key=lambda one: one.worst)
    if curve.worst <= 1.0:
        # Only what strays from the path keeps the limits.
        curve = joined[0]
    share = float(np.interp(curve.when, instants(problem.instants, problem.step), problem.share))
    reason = curve.reason + _junction_words(work, share)
    remedy = "slower" if curve.slower_helps else "other"
    refused = _refused(work, reason, curve.when, share, remedy)
    return _Tried(None, refused, curve.worst if curve.slower_helps else 0.0, curve)


def _in_vain(joined: list[Joined]) -> bool:
    """Returns whether the first evening out gained nothing."""
    before, after = joined[: len(PER_KNOT)], joined[len(PER_KNOT) :]
    return min(c.worst for c in after) > GAINED * min(c.worst for c in before)


def _junction_words(work: PathWork, share: float) -> str:
    """Returns that the path's curvature jumps where a limit is exceeded, or nothing."""
    for path in work.paths.values():
        for edge in path.junctions:
            if edge not in path.corners and abs(edge - share * path.length) < NEAR_JUNCTION:
                return (
                    f" near where two pieces meet with different curvature ({edge * 1e3:.1f} mm along; a larger "
                    "tolerance rounds the path more)"
                )
    return ""


def _refused(work: PathWork, reason: str, time: float, share: float, remedy: Remedy) -> Refused:
    """Returns a reason with time and place."""
    places = []
    for arm, path in work.paths.items():
        x, y, z = path.pose(share * path.length).translation
        places.append(
            f"{arm} tool {share * path.length * 1e3:.1f} mm along its path at ({x:.4f}, {y:.4f}, {z:.4f}) m"
        )
    return Refused(f"after {time:.3f} s, {' and '.join(places)}: {reason}", share, remedy)
