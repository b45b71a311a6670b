"""One path, from one start: the joints by a path follower, then the trajectory with every limit looked at."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

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
from dualarm_cli.path_following.velocity import pose_error
from dualarm_cli.planning.path_clock import PathClock
from dualarm_cli.planning.path_smoothing import evened_out
from dualarm_cli.planning.path_targets import tool_targets
from dualarm_cli.registry import Solver
from dualarm_cli.timing.spline import largest_rates, rest_to_rest_spline

STEP = 1e-3
"""Time between the instants at which joints are found [s], at most."""
PER_KNOT = (4, 8)
"""Instants per knot of the trajectory."""
SMOOTHED = (0.0, 0.04, 0.08, 0.16, 0.32)
"""Times over which self-motion is evened out, where joints would exceed their limits without [s]."""
TOLERATED = 0.5
"""Share of its tolerance by which the trajectory may leave a path between knots."""
CHECKED = 3
"""Every so many instants the tools are compared with their paths."""
GENTLER = (1.0, 2.0, 4.0)
"""How many times as long as usual ramps take that are tried where the file leaves them open."""
SLOWER = 0.9
"""Share of the speed that is tried next where limits do not say how much slower it has to be."""
SLOWEST = 0.05
"""Least share of its speed at which a path is tried."""
ROUNDS = 8
"""How often a path is tried slower."""


@dataclass(frozen=True)
class Followed:
    """A path as it is followed."""

    trajectory: Trajectory
    """All joints of the robot."""
    clock: PathClock
    """Where the tools are when."""
    pace: float
    """Share of the speed asked for."""


@dataclass(frozen=True)
class Refused:
    """Why a path cannot be followed from a start."""

    reason: str
    """In words, with time and place."""
    share: float
    """How much of the path can be."""


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

    def pace(self, work: PathWork) -> float:
        """Returns the share of a path's speed that the job's speed and its cap on the tools leave."""
        cap = self.job.tool_speed
        return min(self.job.speed, cap / work.speed if cap is not None else 1.0)

    def problem(self, work: PathWork, start: FloatArray, clock: PathClock) -> PathProblem:
        """Returns what a follower is asked.

        Args:
            work: the path.
            start: joints where it begins [rad], shape (n,).
            clock: where the tools are when.
        """
        widest = PER_KNOT[-1]
        count = widest * max(5, int(np.ceil(clock.duration / (STEP * widest))))
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
    pace, open_ramps = context.pace(work), work.acceleration is None or work.jerk is None
    gentler = list(GENTLER if open_ramps else GENTLER[:1])
    gentle = gentler.pop(0)
    refused = Refused("it cannot be followed", 0.0)
    for _ in range(ROUNDS):
        clock = PathClock.of(work, pace, gentle)
        found, excess = _once(context, work, follower, start, clock)
        if isinstance(found, Trajectory):
            return Followed(found, clock, pace)
        refused = found
        if gentler:
            gentle = gentler.pop(0)
            continue
        if not work.slower or not excess > 1.0:
            break
        pace *= min(SLOWER, 0.999 / excess) if np.isfinite(excess) else SLOWER
        if pace < SLOWEST:
            break
    return refused


def _once(
    context: PathContext,
    work: PathWork,
    follower: Follower,
    start: FloatArray,
    clock: PathClock,
) -> tuple[Trajectory | Refused, float]:
    """Returns the trajectory, or why there is none and how much slower would do, 0 where slower is no help."""
    problem = context.problem(work, start, clock)
    found = follower.solve(problem)
    if isinstance(found, NoPath):
        share = float(problem.share[found.instant])
        time = found.instant * problem.step
        return _refused(work, found.reason, time, share), found.excess
    joined = []
    for window in SMOOTHED:
        even = evened_out(problem, found, window)
        for stride in PER_KNOT:
            curve = _Joined.of(problem, even, stride)
            joined.append(curve)
            if curve.excess > 1.0:
                continue
            if _strays(problem, found, curve.trajectory) <= TOLERATED * work.tolerance:
                return curve.trajectory, 1.0
    curve = min(joined, key=lambda one: one.excess)
    if curve.excess <= 1.0:
        curve = joined[0]
    share = float(np.interp(curve.time, np.arange(problem.instants) * problem.step, problem.share))
    return _refused(work, curve.reason, curve.time, share), curve.excess


@dataclass(frozen=True)
class _Joined:
    """Joints at instants joined by a spline, and by how much it exceeds the limits of its rates."""

    trajectory: Trajectory
    excess: float
    """By what factor it would have to be slower."""
    reason: str
    """Which joint would need what, where it exceeds a limit."""
    time: float
    """When [s]."""

    @classmethod
    def of(cls, problem: PathProblem, found: PathMotion, stride: int) -> _Joined:
        """Returns the spline through every so many-th instant."""
        limits = problem.limits
        time = instants(problem.instants, problem.step)[::stride]
        q, v, a = rest_to_rest_spline(time, found.position[::stride])
        rates = largest_rates(time, v, a)
        allowed = (limits.velocity, limits.acceleration, limits.jerk)
        shares = np.array(
            [
                (rate / most) ** power
                for rate, most, power in zip(rates, allowed, (1.0, 0.5, 1.0 / 3.0), strict=True)
            ]
        )
        kind, joint = (int(i) for i in np.unravel_index(int(np.argmax(shares)), shares.shape))
        values = (v, a, np.diff(a, axis=0) / np.diff(time)[:, None])[kind]
        reason = (
            f"joint {limits.joints[joint]} would need {rates[kind][joint]:.4g} {UNITS[kind]}, "
            f"allowed {allowed[kind][joint]:.4g}"
        )
        when = float(time[int(np.argmax(np.abs(values[:, joint])))])
        trajectory = Trajectory(limits.joints, time, q, v, a)
        return cls(trajectory, float(shares.max()), reason, when)


def _strays(problem: PathProblem, found: PathMotion, trajectory: Trajectory) -> float:
    """Returns how far the tools are from where the method has them between the knots, turns by TURN_LENGTH [m]."""
    looked_at = np.arange(CHECKED // 2, problem.instants, CHECKED)
    position = trajectory.at(instants(problem.instants, problem.step)[looked_at])[0]
    which = np.flatnonzero(problem.follows)
    worst = 0.0
    for k, q in zip(looked_at, position, strict=True):
        R, p = problem.body.tools(q)
        R_there, p_there = problem.body.tools(found.position[k])
        error = pose_error(R_there[which], p_there[which], R[which], p[which]).reshape(-1, 6)
        worst = max(worst, float(np.linalg.norm(error[:, :3], axis=1).max()))
        worst = max(worst, TURN_LENGTH * float(np.linalg.norm(error[:, 3:], axis=1).max()))
    return worst


UNITS = ("rad/s", "rad/s²", "rad/s³")


def instants(count: int, step: float) -> FloatArray:
    """Returns so many instants a step apart from 0 on [s], shape (count,)."""
    found: FloatArray = np.arange(count, dtype=np.float64) * step
    return found


def _refused(work: PathWork, reason: str, time: float, share: float) -> Refused:
    """Returns a reason with time and place."""
    places = []
    for arm, path in work.paths.items():
        x, y, z = path.pose(share * path.length).translation
        places.append(
            f"{arm} tool {share * path.length * 1e3:.1f} mm along its path at ({x:.4f}, {y:.4f}, {z:.4f}) m"
        )
    return Refused(f"after {time:.3f} s, {' and '.join(places)}: {reason}", share)
