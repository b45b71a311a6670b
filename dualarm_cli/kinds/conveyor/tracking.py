"""Tracking of a conveyor: ramp to its velocity, dwell, ramp to rest.

The approach, the dwell and the retract are in motion between the ramps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.geometry.elementary import cbrt, cube
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.kinds.conveyor.tracking_torques import TrackingTorques
from dualarm_cli.model.motion.trajectory import SAME_TIME, Trajectory
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.postures import StopPosture, StopProblem
from dualarm_cli.postures.stop_lines import flange_poses
from dualarm_cli.postures.tracked import Tracked, TrackingPhases
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal
from dualarm_cli.timing.spline import largest_rates, rest_to_rest_spline


@dataclass(frozen=True)
class TrackingSettings:
    """Settings of tracking: line shapes, knots, phase stretching and permitted tool errors."""

    line_shapes: tuple[tuple[int, ...], ...] = ((2, 0), (1, 2), (1, 1), (1, 0))
    """Double-S shapes of lines, in eighths of the line's time.

    Each has the length of its jerks, and of constant acceleration between two of them; the middle has constant speed.
    """
    checks_per_knot: int = 4
    """Number of instants per interval at which the tool is checked."""
    parts: tuple[int, ...] = (16, 32, 64, 128)
    """Knots per phase, tried until the tool stays with the part.

    Every change of jerk is at a knot.
    """
    first_ramp: float = 0.04
    """First trial duration of every phase of motion at full speed [s].

    Less than any arm can do.
    """
    tries: int = 40
    """Maximum number of stretches until every limit holds."""
    growth: float = 1.002
    """Extra factor on the stretch of a phase."""
    slowest: float = 20.0
    """Longest total of the phases around the dwell at full speed [s]."""
    with_part: float = 4e-7
    """Largest distance [m] and angle [rad] between tool and part in the dwell.

    Less than half of the error that the verifier allows.
    """
    with_belt: float = 5e-5
    """Largest error of the tool outside the dwell, distance [m] and angle [rad].

    Half of the error that the verifier allows.
    """
    speed_margin: float = 2e-4
    """Fraction of a cap on the tool's speed that is kept free."""
    least_factor: float = 0.9
    """Smallest factor by which a phase is shortened at a time."""
    shrinks: int = 6
    """Maximum number of shortenings after every limit holds."""
    used: float = 0.98
    """Ratio of shortest to actual duration from which no phase is shortened.

    The shortest duration is that under the joints' limits; all phases but the dwell have to reach the ratio.
    """
    dwell: int = 2
    """Number of the phase of fixed duration."""
    rounding: float = 1e-9
    """Relative excess of a rate in the dwell that makes the other phases longer."""


TRACKING = TrackingSettings()


def ramp_progress(share: FloatArray) -> FloatArray:
    """Compute the normalised distance of an S-shaped velocity ramp: 1/2 at 1.

    The ramp has two opposite jerks.

    Arguments are fractions of time from 0 to 1.
    """
    back = 1.0 - share
    return np.where(share < 0.5, 2.0 / 3.0 * cube(share), share - 0.5 + 2.0 / 3.0 * cube(back))


def line_progress(share: FloatArray, shape: int) -> FloatArray:
    """Compute the progress along a line by one of the double-S `line_shapes`.

    Args:
        share: fractions of the time, from 0 to 1.
        shape: number of one of `line_shapes`.
    """
    time, jerk = _pieces(shape)
    state = np.zeros((3, len(time)))
    for k, (dt, j) in enumerate(zip(np.diff(time), jerk, strict=True)):
        q, v, a = state[:, k]
        state[:, k + 1] = (
            q + dt * (v + dt * (a / 2.0 + dt * j / 6.0)),
            v + dt * (a + dt * j / 2.0),
            a + dt * j,
        )
    piece = np.clip(np.searchsorted(time, share, side="right") - 1, 0, len(jerk) - 1)
    q, v, a = state[:, piece]
    dt, j = share - time[piece], jerk[piece]
    progress: FloatArray = (q + dt * (v + dt * (a / 2.0 + dt * j / 6.0))) / state[0, -1]
    return progress


def _pieces(shape: int) -> tuple[FloatArray, FloatArray]:
    """Return the ends of a shape's pieces, from 0 to 1, and their jerks."""
    jerk, constant = TRACKING.line_shapes[shape]
    ramp = np.array([jerk, constant, jerk]) if constant else np.array([jerk, jerk])
    signs = [1.0, 0.0, -1.0] if constant else [1.0, -1.0]
    cruise = 8 - 2 * int(ramp.sum())
    lengths = np.concatenate([ramp, [cruise] if cruise else [], ramp])
    jerks = [*signs, *([0.0] if cruise else []), *(-sign for sign in signs)]
    return np.concatenate([[0.0], np.cumsum(lengths) / 8.0]), np.array(jerks)


def dense(time: FloatArray) -> FloatArray:
    """Subdivide the intervals between knots, including the knots."""
    share = np.arange(TRACKING.checks_per_knot) / TRACKING.checks_per_knot
    inside = (time[:-1, None] + np.diff(time)[:, None] * share).ravel()
    return np.append(inside, time[-1])


@dataclass(frozen=True)
class Tracking:
    """Problem of a tracked motion."""

    problem: StopProblem
    """Stop with its target at the part's place when it is met."""
    posture: StopPosture
    """Branch, yaw and arm angles of the stop."""
    velocity: FloatArray
    """Velocity of the belt in the arm's base frame [m/s], shape (3,)."""
    dwell: float
    """Time with the part [s]."""
    limits: JointLimits
    """Limits of the arm's joints."""
    cap: float | None
    """Cap on the tool's speed [m/s], or None."""
    pace: float = 1.0
    """Slowdown against full speed [factor]."""
    torques: TrackingTorques | None = None
    """Torques that limit the motion, or None."""

    def solve(self, phases: TrackingPhases | None = None) -> Tracked:
        """Compute the motion with phases about as short as the joint limits allow.

        The tool's velocity rises to the belt's by two constant jerks. Its depth above the part changes by the quickest
        of a few double-S shapes; the arm angle changes with both. Postures are exact at knots, and a cubic spline joins
        them. Phases are stretched until every limit holds, and get more knots until the tool stays with the part.
        Our own.

        Torques count in a second solution, where the first is beyond them.

        Args:
            phases: initial phases of a similar motion; None for short ones.

        Raises:
            InfeasibleError: the belt is too fast for the arm or the cap, or leaves the reach of the posture, or the
                arm cannot bear its load there.
        """
        if self.torques is not None:
            free = replace(self, torques=None).solve(phases)
            if (self._slowing(free.motion, free.phases) <= 1.0).all():
                return free
            phases = free.phases
        speed = float(norm(self.velocity))
        if self.cap is not None and speed >= self.cap * (1.0 - TRACKING.speed_margin):
            raise InfeasibleError(Refusal("conveyor_above_cap", measured=speed, allowed=self.cap))
        timed = phases or self._quickest_shape()
        for parts in TRACKING.parts:
            motion, timed = self._within_limits(timed, parts)
            if self._stays(motion, timed):
                return Tracked(motion, timed)
        data = {"micrometres": TRACKING.with_part * 1e6}
        raise InfeasibleError(Refusal("part_left", allowed=TRACKING.with_part, data=data))

    def _shapes(self) -> Sequence[int]:
        """List the line shapes to try.

        Numeric postures try one only, because they are slow.
        """
        lines = self.problem.approach > 0.0 or self.problem.retract > 0.0
        return (
            range(len(TRACKING.line_shapes)) if lines and self.problem.arm.has_arm_angle else (1,)
        )

    def _quickest_shape(self) -> TrackingPhases:
        """Select the line shape that is quickest with few knots, and return its phases."""
        short = TRACKING.first_ramp * self.pace
        lines = [
            short if length > 0.0 else 0.0
            for length in (self.problem.approach, self.problem.retract)
        ]
        best: TrackingPhases | None = None
        failure: InfeasibleError | None = None
        for shape in self._shapes():
            first = TrackingPhases(short, lines[0], self.dwell, lines[1], short, shape)
            try:
                _, phases = self._within_limits(first, TRACKING.parts[0])
            except InfeasibleError as error:
                failure = failure or error
                continue
            if best is None or phases.edges[-1] < best.edges[-1]:
                best = phases
        if best is None:
            assert failure is not None  # there is at least one shape
            raise failure
        return best

    def _within_limits(
        self, phases: TrackingPhases, parts: int
    ) -> tuple[Trajectory, TrackingPhases]:
        """Stretch or shorten phases until the motion just keeps every limit."""
        best: tuple[Trajectory, TrackingPhases] | None = None
        shrunk, excess = 0, np.ones(5)
        for _ in range(TRACKING.tries):
            motion, index = self._motion(phases, parts)
            excess = self._excess(motion, phases, index)
            used = excess[[k for k in range(5) if k != TRACKING.dwell and index[k + 1] > index[k]]]
            if (excess <= 1.0).all():
                if best is None or motion.duration < best[0].duration:
                    best = motion, phases
                shrunk += 1
                if shrunk > TRACKING.shrinks or used.min() >= TRACKING.used:
                    break
            # A phase that is much too long is shortened in steps: its limits depend on its neighbours.
            factor = np.maximum(excess * TRACKING.growth, TRACKING.least_factor)
            if excess[TRACKING.dwell] > 1.0 + TRACKING.rounding:
                # Excess in the dwell can only be reduced by longer phases around it.
                factor = np.maximum(factor, excess[TRACKING.dwell])
            phases = phases.longer(factor)
            if phases.edges[-1] - phases.dwell > TRACKING.slowest * self.pace:
                break
        if best is not None:
            return best
        data = {"speed": norm(self.velocity)}
        largest = float(excess.max())
        raise InfeasibleError(
            Refusal("conveyor_too_fast", measured=largest, allowed=1.0, data=data)
        )

    def _motion(self, phases: TrackingPhases, parts: int) -> tuple[Trajectory, list[int]]:
        """Join exact postures by a spline.

        Returns it and the knot at each edge of the phases.
        """
        pieces, index = [np.zeros(1)], [0]
        edges = phases.edges
        for low, high in pairwise(edges.tolist()):
            count = parts if high > low else 0
            pieces.append(np.linspace(low, high, count + 1)[1:])
            index.append(index[-1] + count)
        time = np.concatenate(pieces)
        q, ok = self._postures(phases, time)
        if not ok:
            raise InfeasibleError(Refusal("conveyor_leaves_reach"))
        q, v, a = rest_to_rest_spline(time, q)
        return Trajectory(self.limits.joints, time, q, v, a), index

    def _postures(self, phases: TrackingPhases, time: FloatArray) -> tuple[FloatArray, bool]:
        """Compute exact joints at instants [rad], shape (m, n), and whether all are feasible."""
        R, p, outward = flange_poses(
            self.problem, np.array([self.posture.target]), np.array([self.posture.yaw])
        )
        along, depths, away = self._course(phases, time)
        points = p[0] + along[:, None] * self.velocity + product(depths, outward[0])
        middle = self.posture.psi_target
        first, last = self.posture.psi_approach - middle, self.posture.psi_retract - middle
        drift = away[0] * first + away[1] * last
        start = min(int(np.searchsorted(time, phases.rise + phases.approach)), len(time) - 1)
        return self.problem.arm.follow_points(self.posture.at_target, R[0], points, drift, start)

    def _course(
        self, phases: TrackingPhases, time: FloatArray
    ) -> tuple[FloatArray, FloatArray, tuple[FloatArray, FloatArray]]:
        """Compute the tool's motion relative to the target: belt time [s], depths [m], progress.

        Belt time is that from the target to below the tool. Both progresses are fractions of the motion from the target
        to the begin and to the end of the stop's motion.
        """
        reached = phases.rise + phases.approach
        departed = reached + phases.dwell
        end = departed + phases.retract + phases.fall
        rise, fall = (
            ramp * ramp_progress(np.clip(fraction, 0.0, 1.0))
            for ramp, fraction in (
                (phases.rise, (phases.rise - time) / phases.rise),
                (phases.fall, (time - end + phases.fall) / phases.fall),
            )
        )
        # On ramps the tool travels less than the belt.
        along = time - reached + rise - fall
        depths = np.zeros((len(time), 2))
        if phases.approach > 0.0:
            fraction = np.clip((reached - time) / phases.approach, 0.0, 1.0)
            depths[:, 0] = self.problem.approach * line_progress(fraction, phases.shape)
        if phases.retract > 0.0:
            fraction = np.clip((time - departed) / phases.retract, 0.0, 1.0)
            depths[:, 1] = self.problem.retract * line_progress(fraction, phases.shape)
        away = (
            line_progress(np.clip((reached - time) / reached, 0.0, 1.0), 0),
            line_progress(np.clip((time - departed) / (end - departed), 0.0, 1.0), 0),
        )
        return along, depths, away

    def _slowing(self, motion: Trajectory, phases: TrackingPhases) -> FloatArray:
        """Compute the stretch of each phase that its torques require [factor], shape (5,)."""
        slowing, edges = np.zeros(5), np.searchsorted(motion.time, phases.edges - SAME_TIME)
        for k, (low, high) in enumerate(pairwise(edges.tolist())):
            if high > low and self.torques is not None:
                rows = slice(low, high + 1)
                rates = motion.position[rows], motion.velocity[rows], motion.acceleration[rows]
                part = Trajectory(motion.joints, motion.time[rows], *rates)
                slowing[k] = self.torques.slowing(part, k)
        return slowing

    def _excess(self, motion: Trajectory, phases: TrackingPhases, index: list[int]) -> FloatArray:
        """Compute the required stretch of each phase [factor], shape (5,)."""
        excess = self._slowing(motion, phases)
        limits = self.limits
        for k, (low, high) in enumerate(pairwise(index)):
            if high == low:
                continue
            rows = slice(low, high + 1)
            v, a, j = largest_rates(
                motion.time[rows], motion.velocity[rows], motion.acceleration[rows]
            )
            excess[k] = max(
                float(excess[k]),
                float((v / limits.velocity).max()),
                float(np.sqrt((a / limits.acceleration).max())),
                float(cbrt((j / limits.jerk).max())),
            )
            if self.cap is not None:
                excess[k] = max(excess[k], self._speed(motion, rows) / self.cap)
        return excess

    def _speed(self, motion: Trajectory, rows: slice) -> float:
        """Compute the largest tool speed between knots with `speed_margin` added [m/s]."""
        time = dense(motion.time[rows])
        step = 1e-6 * max(1.0, self.pace)
        at = np.clip(np.stack([time - step, time + step]), motion.time[0], motion.time[-1])
        before, after = (self._tool(motion.clamped(instants)[0])[1] for instants in at)
        speed = norm(after - before, axis=1) / (at[1] - at[0])
        return float(speed.max()) / (1.0 - TRACKING.speed_margin)

    def _tool(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute flange rotations (m, 3, 3) and tool positions (m, 3) [m].

        Both are in the base frame.
        """
        R, p = self.problem.arm.forward(q)
        return R, p - product(R, self.problem.R_tool_flange.T, self.problem.p_tool_flange)

    def _stays(self, motion: Trajectory, phases: TrackingPhases) -> bool:
        """Test whether the tool is at its target between the knots."""
        time = dense(motion.time)
        R, p = self._tool(motion.clamped(time)[0])
        R_target, p_target, outward = flange_poses(
            self.problem, np.array([self.posture.target]), np.array([self.posture.yaw])
        )
        tip = p_target[0] - product(
            R_target[0], self.problem.R_tool_flange.T, self.problem.p_tool_flange
        )
        along, depths, _ = self._course(phases, time)
        target = tip + along[:, None] * self.velocity + product(depths, outward[0])
        error = norm(p - target, axis=1)
        # |R - R0| in the Frobenius norm is 2 sqrt(2) sin(angle/2).
        angle = norm(R - R_target[0], axis=(1, 2)) / np.sqrt(2.0)
        error = np.maximum(error, angle)
        edges = phases.edges
        dwells: BoolArray = (time >= edges[2]) & (time <= edges[3])
        stays_in_dwell = error[dwells].max(initial=0.0) <= TRACKING.with_part
        return bool(stays_in_dwell and error.max() <= TRACKING.with_belt)
