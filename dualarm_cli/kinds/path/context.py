"""A job's cell as path followers need it: kinematics, clocks, targets, critical points."""

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
from dualarm_cli.model.path_work import PathWork
from dualarm_cli.model.rest_to_rest import RestToRest
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
    """Spacing of the times at which a clock that eases off is kept [s]."""
    slowest: float = 0.02
    """Least factor on the speed."""
    easing: float = 0.15
    """Half-width of the filters that slow a clock near slower places [s].

    First the least speed within the window is taken, then a mean over the window.
    """
    cap_margin: float = 5e-4
    """Share of a cap on the tools' speed that is kept free: knots are joined by curves."""
    rise: float = 0.1
    """Time in which the acceleration is reached, where the file gives no jerk [s]."""
    longest: float = 0.15
    """Time over which a jump of acceleration is spread, at most [s]."""
    smallest: float = 0.01
    """Jumps of acceleration that need no rounding [m/s²]."""
    fade: float = 4.0
    """Windows from a junction after which the path is followed to the letter again."""
    rounds: int = 12
    """Maximum number of windows that are tried until the rounding keeps the tolerance."""
    beside: int = 3
    """Instants before and after a junction at which its accelerations are looked at."""
    step: float = 1e-3
    """Time between the instants at which joints are computed [s]."""
    longest_step: float = 1e-2
    """Longest time between the instants at which joints are computed, on long paths [s]."""
    most: int = 5_000
    """Instants beyond which the time between them grows."""
    rounded: float = 0.7
    """Share of the tolerance by which rounding may leave the path."""
    per_knot: tuple[int, int] = (4, 8)
    """Instants per knot of the trajectory."""


PATH = PathSettings()


@dataclass(frozen=True)
class PathClock:
    """The share of the path at every instant, from rest to rest, with a stop at every corner."""

    starts: FloatArray
    """When phases of constant jerk begin [s], shape (m,)."""
    states: FloatArray
    """Length, speed, acceleration and jerk along the longest path at their begin, shape (m, 4)."""
    full: float
    """When the path would be done if it never eased off [s]."""
    duration: float
    """When the path is done [s]."""
    length: float
    """Length of the longest path [m]."""
    speed: float
    """Largest speed [m/s]."""
    ease: FloatArray
    """Factors on the speed at equal parts of the full time, shape (g,); all 1 where it never eases off."""

    def __post_init__(self) -> None:
        """Freezes the arrays."""
        for name in ("starts", "states", "ease"):
            object.__setattr__(self, name, readonly(getattr(self, name)))

    @classmethod
    def of(
        cls, work: PathWork, pace: float = 1.0, gentle: float = 1.0, cap: float | None = None
    ) -> PathClock:
        """Returns the clock of a path.

        Args:
            work: the path, with its speed and perhaps acceleration and jerk.
            pace: share of its speed at which it is followed; everything then takes as much longer.
            gentle: how many times as long as usual ramps take whose acceleration or jerk the file does not give.
            cap: largest speed of any tool [m/s], or None.
        """
        speed = work.speed * pace
        if cap is not None:
            speed = min(speed, cap * (1.0 - PATH.cap_margin))
        # Followed slower, everything takes longer in the same way.
        acceleration = (
            work.acceleration * np.square(pace)
            if work.acceleration
            else speed / (PATH.ramp * gentle / pace)
        )
        jerk = work.jerk * cube(pace) if work.jerk else acceleration / (PATH.rise * gentle / pace)
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
        """Returns share of the path, 0 to 1, and speed as a share of the largest, at instants (k,) [s]."""
        own, factor = self._own_time(time)
        share, pace = self._at_full(own)
        return share, pace * factor

    def eased(self, time: FloatArray, excess: FloatArray, gently: float = 1.0) -> PathClock:
        """Returns a clock that eases off where it went too fast by some factors, and a while before and after.

        Args:
            time: instants [s], rising, shape (k,).
            excess: by what factor the speed was too high there, below 1 where it was not, shape (k,).
            gently: how many times as long as usual it takes to ease off.
        """
        grid = np.linspace(0.0, self.full, len(self.ease))
        own, _ = self._own_time(time)
        wanted = np.interp(grid, own, 1.0 / np.maximum(excess, 1.0))
        # The more it eases off, the longer this takes in real time: a shorter while of its own time will do.
        window = (
            PATH.easing * gently * float(np.sqrt(np.clip((wanted * self.ease).min(), 0.04, 1.0)))
        )
        half = max(2, int(window / (grid[1] - grid[0])))
        # The least within the window about each instant, then a mean over it: never above what is wanted there.
        padded = np.pad(wanted, 2 * half, mode="edge")
        least = np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1).min(axis=1)
        weight = np.hanning(2 * half + 3)[1:-1]
        about = np.lib.stride_tricks.sliding_window_view(least, len(weight))
        mean = product(about, weight / weight.sum())
        ease = np.maximum(self.ease * mean, PATH.slowest)
        slowness = 1.0 / ease
        duration = float((slowness[1:] + slowness[:-1]).sum() * 0.5 * (grid[1] - grid[0]))
        return replace(self, ease=ease, duration=duration)

    def _own_time(self, time: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Returns the times of the clock that never eases off at instants (k,) [s], and the factors on the speed."""
        grid = np.linspace(0.0, self.full, len(self.ease))
        if (self.ease == 1.0).all():
            return time, np.ones_like(time)
        h = grid[1] - grid[0]
        slowness = 1.0 / self.ease
        real = np.concatenate([[0.0], np.cumsum((slowness[1:] + slowness[:-1]) * 0.5 * h)])
        k = np.clip(np.searchsorted(real, time, side="right") - 1, 0, len(grid) - 2)
        gap = real[k + 1] - real[k]
        x = np.clip((time - real[k]) / gap, 0.0, 1.0)
        # Cubic Hermite: the clock's own time passes at the factor's rate.
        m0, m1 = gap * self.ease[k], gap * self.ease[k + 1]
        own = (
            grid[k]
            + h * np.square(x) * (3.0 - 2.0 * x)
            + m0 * x * np.square(1.0 - x)
            - m1 * np.square(x) * (1.0 - x)
        )
        rate = (
            h * 6.0 * x * (1.0 - x) + m0 * (1.0 - x) * (1.0 - 3.0 * x) - m1 * x * (2.0 - 3.0 * x)
        ) / gap
        return own, rate

    def _at_full(self, time: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Returns share of the path and speed as a share of the largest where the clock never eases off."""
        k = np.clip(np.searchsorted(self.starts, time, side="right") - 1, 0, len(self.starts) - 1)
        h = np.clip(time, 0.0, self.full) - self.starts[k]
        s, v, a, j = self.states[k].T
        length = s + h * (v + h * (a / 2.0 + h * j / 6.0))
        speed = v + h * (a + h * j / 2.0)
        return np.clip(length / self.length, 0.0, 1.0), np.clip(speed / self.speed, 0.0, 1.0)


def tool_targets(path: ToolPath, share: FloatArray, step: float, tolerance: float) -> Poses:
    """Returns a tool's poses at instants, rotations (k, 3, 3) and positions (k, 3) [m].

    Where pieces meet without a corner but with different curvature (a line and an arc, say) the tool's acceleration
    would jump, and the joints' jerk be infinite. There the pose is replaced by its mean over a short time W, which
    spreads the jump evenly over it and leaves the path by a W² / 24 at most, a being the largest acceleration near by.
    W is the longest that keeps within the tolerance's share. Near corners and the ends nothing is rounded.

    Args:
        path: the tool's way.
        share: how much of it is done at each instant, shape (k,).
        step: time between instants [s].
        tolerance: how far the tool may leave its path [m].
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
    # Turns as vectors in the tool's own frame, one after the other: over a short while they add up.
    way = np.hstack([p, TURN_LENGTH * turned])
    joints = np.array(
        [k for k in np.searchsorted(share, places).tolist() if _jumps(way, k, step)], dtype=np.int64
    )
    if not len(joints):
        return R, p
    stops = np.array([0, *np.searchsorted(share, np.array(path.corners) / path.length), len(p) - 1])
    window = PATH.longest
    for _ in range(PATH.rounds):
        half = int(window / (2.0 * step))
        if half < 2:
            break
        change = _fade(len(p), joints, stops, half)[:, None] * (_means(way, half) - way)
        off = max(norm(change[:, :3], axis=1).max(), norm(change[:, 3:], axis=1).max())
        if off <= PATH.rounded * tolerance:
            return product(R, exp_rotation(change[:, 3:] / TURN_LENGTH)), p + change[:, :3]
        window *= min(0.9, float(np.sqrt(PATH.rounded * tolerance / off)))
    return R, p


def _jumps(way: FloatArray, k: int, step: float) -> bool:
    """Returns whether the acceleration jumps about an instant, turns counted by TURN_LENGTH."""
    if k < PATH.beside + 1 or k > len(way) - PATH.beside - 2:
        return False
    before, after = (
        (way[i + 1] - 2.0 * way[i] + way[i - 1]) / np.square(step)
        for i in (k - PATH.beside, k + PATH.beside)
    )
    return bool(norm(after - before) >= PATH.smallest)


def _means(way: FloatArray, half: int) -> FloatArray:
    """Returns means over 2 half intervals about every instant, the outermost instants counting half, shape (k, 6)."""
    padded = np.pad(way - way[0], ((half, half), (0, 0)), mode="edge")
    sums = np.vstack([np.zeros((1, way.shape[1])), np.cumsum(padded, axis=0)])
    whole = sums[2 * half + 1 :] - sums[: -2 * half - 1]
    found: FloatArray = way[0] + (whole - (padded[2 * half :] + padded[: -2 * half]) / 2.0) / (
        2 * half
    )
    return found


def _fade(count: int, joints: IntArray, stops: IntArray, half: int) -> FloatArray:
    """Returns how much of the rounding counts at each instant, shape (k,): 1 near junctions, 0 near stops."""
    instants = np.arange(count)
    near = np.abs(instants[:, None] - joints).min(axis=1) / half
    far = np.abs(instants[:, None] - stops).min(axis=1) / half
    return _smooth((2.0 * PATH.fade - near) / (2.0 * PATH.fade - 1.0)) * _smooth(far - 1.0)


def _smooth(x: FloatArray) -> FloatArray:
    """Returns 0 below 0, 1 above 1, and a step with two continuous derivatives in between."""
    x = np.clip(x, 0.0, 1.0)
    found: FloatArray = cube(x) * (10.0 - 15.0 * x + 6.0 * np.square(x))
    return found


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
            job.limits,
            Dynamics(job.cell) if torque else None,
        )

    def clock(
        self,
        work: PathWork,
        slower: float = 1.0,
        gentle: float = 1.0,
        peak: float | None = None,
    ) -> PathClock:
        """Returns the clock of a path at the job's speed and under its cap on the tools.

        Args:
            work: the path.
            slower: share of that speed at which it is followed.
            gentle: how many times as long as usual ramps take that the file leaves open.
            peak: speed that is not exceeded, with ramps as long as usual [m/s]; None for the file's.
        """
        caps = [cap * slower for cap in (self.job.tool_speed, peak) if cap is not None]
        cap = min(caps, default=None)
        return PathClock.of(work, self.job.speed * slower, gentle, cap)

    def problem(
        self, work: PathWork, start: FloatArray, clock: PathClock, finer: int = 1
    ) -> PathProblem:
        """Returns what a follower is asked.

        Args:
            work: the path.
            start: joints where it begins [rad], shape (n,).
            clock: where the tools are when.
            finer: how many times as many instants as usual.
        """
        widest = PATH.per_knot[-1]
        step = min(max(PATH.step, clock.duration / PATH.most), PATH.longest_step) / finer
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
            spring=Spring(
                self.critical_points(work.critical_points), 2.0 * np.square(work.stiffness)
            ),
            model=self.model if self.model.has_arm_angles else None,
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
