"""Job and cell as path followers need them: kinematics, clocks, targets, critical points."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray, readonly
from dualarm_cli.geometry.elementary import cube
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.geometry.rotations import exp_rotation, log_rotation
from dualarm_cli.kinds.path.following import PathProblem
from dualarm_cli.kinds.path.following.problem import Spring
from dualarm_cli.kinds.path.joining import instants
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.kinematics.dynamics import Dynamics
from dualarm_cli.kinematics.whole_body import WholeBody
from dualarm_cli.model.curves.tool_path import TURN_LENGTH, Poses, ToolPath
from dualarm_cli.model.job import Job
from dualarm_cli.model.motion.rest_to_rest import RestToRest
from dualarm_cli.model.process_work import PathWork
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.records import dataclass
from dualarm_cli.timing.double_s import fastest_phases


@dataclass(frozen=True)
class PathSettings:
    """Resolution and margins of paths."""

    ramp: float = 0.2
    """Default time to reach the speed at constant acceleration [s].

    It applies where the file gives no acceleration.
    """
    grid: float = 0.002
    """Spacing of the times at which a slowed clock is stored [s]."""
    slowest: float = 0.02
    """Least factor on the speed."""
    easing: float = 0.15
    """Half-width of the filters that slow a clock near slower places [s].

    First the least speed within the window is taken, then a mean over the window.
    """
    cap_margin: float = 5e-4
    """Fraction of a cap on the tools' speed that is kept free.

    Knots are joined by curves.
    """
    rise: float = 0.1
    """Time in which the acceleration is reached, where the file gives no jerk [s]."""
    longest: float = 0.15
    """Longest time over which a jump of acceleration is spread [s]."""
    smallest: float = 0.01
    """Smallest jump of acceleration that is rounded [m/s²]."""
    fade: float = 4.0
    """Distance from a junction at which rounding has faded out [windows]."""
    rounds: int = 12
    """Maximum number of windows that are tried."""
    junction_offset: int = 3
    """Offset from a junction at which accelerations are compared [instants]."""
    step: float = 1e-3
    """Time between the instants at which joints are computed [s]."""
    longest_step: float = 1e-2
    """Longest time between the instants at which joints are computed, on long paths [s]."""
    max_instants: int = 5_000
    """Number of instants beyond which the time between them grows."""
    rounded: float = 0.7
    """Fraction of the tolerance that rounding may use."""
    per_knot: tuple[int, int] = (4, 8)
    """Instants per knot of the trajectory."""


PATH = PathSettings()


@dataclass(frozen=True)
class PathClock:
    """Progress along a path over time, with stops at ends and corners."""

    starts: FloatArray
    """Start times of phases of constant jerk [s], shape (m,)."""
    states: FloatArray
    """Length, speed, acceleration, jerk at phase starts on the longest path, (m, 4)."""
    full: float
    """Duration of the path without local slowdown [s]."""
    duration: float
    """Duration of the path [s]."""
    length: float
    """Length of the longest path [m]."""
    speed: float
    """Largest speed [m/s]."""
    ease: FloatArray
    """Factors on the speed at equal parts of the full time, shape (g,).

    All are 1 where the path is nowhere slowed.
    """

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for name in ("starts", "states", "ease"):
            object.__setattr__(self, name, readonly(getattr(self, name)))

    @classmethod
    def of(
        cls, work: PathWork, pace: float = 1.0, ramp_stretch: float = 1.0, cap: float | None = None
    ) -> PathClock:
        """Compute the clock of a path.

        Args:
            work: the path, with its speed and perhaps acceleration and jerk.
            pace: fraction of its speed at which it is followed; ramps slow down likewise.
            ramp_stretch: stretch factor of ramps whose acceleration or jerk the file does not give.
            cap: largest speed of any tool [m/s], or None.
        """
        speed = work.speed * pace
        if cap is not None:
            speed = min(speed, cap * (1.0 - PATH.cap_margin))
        # At a lower pace ramps take longer by the same factor.
        acceleration = (
            work.acceleration * np.square(pace)
            if work.acceleration
            else speed / (PATH.ramp * ramp_stretch / pace)
        )
        jerk = (
            work.jerk * cube(pace)
            if work.jerk
            else acceleration / (PATH.rise * ramp_stretch / pace)
        )
        law = RestToRest(np.array([speed]), np.array([acceleration]), np.array([jerk]))
        edges = np.array([0.0, *work.corners(), 1.0]) * work.length
        starts, states, clock = [], [], 0.0
        for begin, end in pairwise(edges.tolist()):
            phases = fastest_phases(np.array([end - begin]), law)
            s, v = float(begin), 0.0
            for h, a, j in zip(
                phases.duration[0], phases.acceleration[0], phases.jerk[0], strict=True
            ):
                starts.append(clock)
                states.append((s, v, float(a), float(j)))
                s += h * (v + h * (a / 2.0 + h * j / 6.0))
                v += h * (a + h * j / 2.0)
                clock += float(h)
        ease = np.ones(max(2, int(np.ceil(clock / PATH.grid)) + 1))
        return cls(np.array(starts), np.array(states), clock, clock, work.length, speed, ease)

    def at(self, time: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute fractions of the path and of the largest speed at instants (k,) [s]."""
        full_time, factor = self._full_time(time)
        share, pace = self._at_full(full_time)
        return share, pace * factor

    def eased(self, time: FloatArray, excess: FloatArray, stretch: float = 1.0) -> PathClock:
        """Slow the clock around instants that were too fast.

        Args:
            time: rising instants [s], shape (k,).
            excess: ratios of the speed to the allowed one, shape (k,).
            stretch: stretch factor of the slowdown's window.
        """
        grid = np.linspace(0.0, self.full, len(self.ease))
        full_time, _ = self._full_time(time)
        needed = np.interp(grid, full_time, 1.0 / np.maximum(excess, 1.0))
        # A slower clock takes longer in real time: a shorter window of the full time is enough.
        window = (
            PATH.easing * stretch * float(np.sqrt(np.clip((needed * self.ease).min(), 0.04, 1.0)))
        )
        half = max(2, int(window / (grid[1] - grid[0])))
        # The minimum over the window, then a mean over it: never above the factor that is needed.
        padded = np.pad(needed, 2 * half, mode="edge")
        least = np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1).min(axis=1)
        weight = np.hanning(2 * half + 3)[1:-1]
        about = np.lib.stride_tricks.sliding_window_view(least, len(weight))
        mean = product(about, weight / weight.sum())
        ease = np.maximum(self.ease * mean, PATH.slowest)
        slowness = 1.0 / ease
        duration = float((slowness[1:] + slowness[:-1]).sum() * 0.5 * (grid[1] - grid[0]))
        return replace(self, ease=ease, duration=duration)

    def _full_time(self, time: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Convert instants (k,) [s] to times without slowdown; return them and the speed factors."""
        grid = np.linspace(0.0, self.full, len(self.ease))
        if (self.ease == 1.0).all():
            return time, np.ones_like(time)
        h = grid[1] - grid[0]
        slowness = 1.0 / self.ease
        real = np.concatenate([[0.0], np.cumsum((slowness[1:] + slowness[:-1]) * 0.5 * h)])
        k = np.clip(np.searchsorted(real, time, side="right") - 1, 0, len(grid) - 2)
        gap = real[k + 1] - real[k]
        x = np.clip((time - real[k]) / gap, 0.0, 1.0)
        # Cubic Hermite: the full time passes at the factor's rate.
        m0, m1 = gap * self.ease[k], gap * self.ease[k + 1]
        full_time = (
            grid[k]
            + h * np.square(x) * (3.0 - 2.0 * x)
            + m0 * x * np.square(1.0 - x)
            - m1 * np.square(x) * (1.0 - x)
        )
        rate = (
            h * 6.0 * x * (1.0 - x) + m0 * (1.0 - x) * (1.0 - 3.0 * x) - m1 * x * (2.0 - 3.0 * x)
        ) / gap
        return full_time, rate

    def _at_full(self, time: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute fractions of the path and of the largest speed without slowdown."""
        k = np.clip(np.searchsorted(self.starts, time, side="right") - 1, 0, len(self.starts) - 1)
        h = np.clip(time, 0.0, self.full) - self.starts[k]
        s, v, a, j = self.states[k].T
        length = s + h * (v + h * (a / 2.0 + h * j / 6.0))
        speed = v + h * (a + h * j / 2.0)
        return np.clip(length / self.length, 0.0, 1.0), np.clip(speed / self.speed, 0.0, 1.0)


def tool_targets(path: ToolPath, share: FloatArray, step: float, tolerance: float) -> Poses:
    """Compute tool poses at instants: rotations (k, 3, 3), positions (k, 3) [m].

    Where pieces meet without a corner but with different curvature (a line and an arc, say) the tool's acceleration
    would jump, and the joints' jerk be infinite. There the pose is replaced by its mean over a short time W, which
    spreads the jump evenly over it and leaves the path by a W² / 24 at most, a being the largest acceleration near by.
    W is the longest window within the tolerance's fraction. Near corners and the ends nothing is rounded.

    Args:
        path: the tool's path.
        share: fraction of it at each instant, shape (k,).
        step: time between instants [s].
        tolerance: largest deviation of the tool from its path [m].
    """
    R, p = path.at(share * path.length)
    corners = set(path.corners)
    places = np.array([edge for edge in path.junctions if edge not in corners]) / path.length
    turned = np.concatenate(
        [
            np.zeros((1, 3)),
            np.cumsum(log_rotation(product(np.swapaxes(R[:-1], -1, -2), R[1:])), axis=0),
        ]
    )
    # Rotation vectors in the tool's own frame: over a short time they add up.
    poses = np.hstack([p, TURN_LENGTH * turned])
    joints = np.array(
        [k for k in np.searchsorted(share, places).tolist() if _jumps(poses, k, step)],
        dtype=np.int64,
    )
    if not len(joints):
        return R, p
    stops = np.array([0, *np.searchsorted(share, np.array(path.corners) / path.length), len(p) - 1])
    window = PATH.longest
    for _ in range(PATH.rounds):
        half = int(window / (2.0 * step))
        if half < 2:
            break
        change = _fade(len(p), joints, stops, half)[:, None] * (_means(poses, half) - poses)
        off = max(norm(change[:, :3], axis=1).max(), norm(change[:, 3:], axis=1).max())
        if off <= PATH.rounded * tolerance:
            return product(R, exp_rotation(change[:, 3:] / TURN_LENGTH)), p + change[:, :3]
        window *= min(0.9, float(np.sqrt(PATH.rounded * tolerance / off)))
    return R, p


def _jumps(poses: FloatArray, k: int, step: float) -> bool:
    """Test whether the acceleration jumps about an instant, with turns scaled by TURN_LENGTH."""
    if k < PATH.junction_offset + 1 or k > len(poses) - PATH.junction_offset - 2:
        return False
    before, after = (
        (poses[i + 1] - 2.0 * poses[i] + poses[i - 1]) / np.square(step)
        for i in (k - PATH.junction_offset, k + PATH.junction_offset)
    )
    return bool(norm(after - before) >= PATH.smallest)


def _means(poses: FloatArray, half: int) -> FloatArray:
    """Compute moving means over 2 half intervals, shape (k, 6).

    The outermost instants count half.
    """
    padded = np.pad(poses - poses[0], ((half, half), (0, 0)), mode="edge")
    sums = np.vstack([np.zeros((1, poses.shape[1])), np.cumsum(padded, axis=0)])
    whole = sums[2 * half + 1 :] - sums[: -2 * half - 1]
    means: FloatArray = poses[0] + (whole - (padded[2 * half :] + padded[: -2 * half]) / 2.0) / (
        2 * half
    )
    return means


def _fade(count: int, joints: IntArray, stops: IntArray, half: int) -> FloatArray:
    """Compute the weights of the rounding, shape (k,): 1 near junctions, 0 near stops."""
    instants = np.arange(count)
    near = np.abs(instants[:, None] - joints).min(axis=1) / half
    far = np.abs(instants[:, None] - stops).min(axis=1) / half
    return _smooth((2.0 * PATH.fade - near) / (2.0 * PATH.fade - 1.0)) * _smooth(far - 1.0)


def _smooth(x: FloatArray) -> FloatArray:
    """Evaluate a step from 0 to 1 over [0, 1], twice continuously differentiable."""
    x = np.clip(x, 0.0, 1.0)
    step: FloatArray = cube(x) * (10.0 - 15.0 * x + 6.0 * np.square(x))
    return step


@dataclass(frozen=True)
class PathContext:
    """Job and cell as path followers need them."""

    model: CellModel
    """Cell model with closed-form arms, where there are any."""
    body: WholeBody
    """Kinematics of all joints."""
    job: Job
    """Job with the paths."""
    limits: JointLimits
    """Limits at the job's speed."""
    dynamics: Dynamics | None
    """Torque model; None where no path limits torques."""
    limits_torques: bool = False
    """Whether all paths keep torques, also those of methods that ignore them."""

    @classmethod
    def of(cls, model: CellModel, job: Job, *, limits_torques: bool = False) -> PathContext:
        """Prepare a job."""
        torque = limits_torques or any(
            task.path is not None and task.path.torque for task in job.tasks
        )
        return cls(
            model,
            WholeBody(job.cell),
            job,
            job.limits,
            Dynamics(job.cell, {}) if torque else None,
            limits_torques,
        )

    def clock(
        self,
        work: PathWork,
        slower: float = 1.0,
        ramp_stretch: float = 1.0,
        peak: float | None = None,
    ) -> PathClock:
        """Compute the clock of a path at the job's speed and tool-speed cap.

        Args:
            work: the path.
            slower: fraction of that speed at which it is followed.
            ramp_stretch: stretch factor of ramps that the file leaves open.
            peak: cap on the speed with ramps as long as usual [m/s]; None for the file's speed.
        """
        caps = [cap * slower for cap in (self.job.tool_speed, peak) if cap is not None]
        cap = min(caps, default=None)
        return PathClock.of(work, self.job.speed * slower, ramp_stretch, cap)

    def problem(
        self, work: PathWork, start: FloatArray, clock: PathClock, finer: int = 1
    ) -> PathProblem:
        """Build the follower's problem for a path, start and clock.

        Args:
            work: the path.
            start: joints where it begins [rad], shape (n,).
            clock: progress over time.
            finer: factor on the number of instants.
        """
        widest = PATH.per_knot[-1]
        step = min(max(PATH.step, clock.duration / PATH.max_instants), PATH.longest_step) / finer
        count = widest * max(5, int(np.ceil(clock.duration / (step * widest))))
        step = clock.duration / count
        share, pace = clock.at(instants(count + 1, step))
        arms = [arm for arm in self.body.arms if arm in work.paths]
        poses = [tool_targets(work.paths[arm], share, step, work.tolerance) for arm in arms]
        keeps_torque = work.torque or self.limits_torques
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
            spring=Spring(
                self.critical_points(work.critical_points), 2.0 * np.square(work.stiffness)
            ),
            model=self.model if self.model.has_arm_angles else None,
            tool_speed=self.job.tool_speed,
            torque=self.dynamics.limit if keeps_torque and self.dynamics else None,
            dynamics=self.dynamics.at if keeps_torque and self.dynamics else None,
            torque_in_method=work.torque,
        )

    def critical_points(self, given: Mapping[str, FloatArray]) -> FloatArray:
        """Compute all arms' critical points in the carried frame [m], shape (a, 3).

        Default: below the shoulder by the length of the upper arm, where a limp elbow hangs.

        Args:
            given: points of the file by arm [m].
        """
        shoulders, upper = self.body.shoulders()
        points = shoulders - upper[:, None] * np.array([0.0, 0.0, 1.0])
        for a, arm in enumerate(self.body.arms):
            points[a] = given.get(arm, points[a])
        return points
