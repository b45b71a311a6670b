"""Timing of a seam: steady speed, ramps, and a trajectory within limits.

The trajectory also keeps the chain closed.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from dualarm_cli.geometry.arrays import distinct
from dualarm_cli.geometry.elementary import power
from dualarm_cli.kinds.seam.closed_chain.chain import Chain
from dualarm_cli.kinds.seam.path import SeamPath
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.process_work import SeamWork, longest_ramp
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal
from dualarm_cli.timing.spline import clamped_spline, largest_rates, rest_to_rest_spline
from dualarm_cli.timing.steady_search import (
    SteadyProfile,
    fastest_profile,
    profile_of_duration,
    steady_limit,
)


@dataclass(frozen=True)
class SeamMotionSettings:
    """Tolerances and margins of a seam's motion."""

    spacings: tuple[float, ...] = (0.02, 0.01, 0.005, 0.0025, 0.00125)
    """Times between knots that are tried until the chain stays closed [s]."""
    open: float = 4e-7
    """Largest opening of the chain between knots [m, rad]."""
    uneven: float = 4e-4
    """Largest relative error of the speed between knots, ramps excluded.

    The acceleration along the seam may exceed that of the file by the same fraction.
    """
    moment: float = 2e-4
    """Time step of measured accelerations along the seam [s]."""
    per_knot: int = 3
    """Number of checked instants between knots."""
    tighter: tuple[float, ...] = (1.0, 0.97, 0.92, 0.85)
    """Fractions of the joint limits that are tried until the spline keeps them."""
    as_asked: float = 1.0 - 1e-9
    """Fraction of a requested speed, or of a cap, that counts as reached."""
    acceleration_margin: float = 0.99
    """Fraction of the file's acceleration that is used.

    The motion's spline needs a little more.
    """
    cap_margin: float = 0.999
    """Fraction of a cap on the tools' speed that is used.

    Between places and knots they are a little faster.
    """


MOTION = SeamMotionSettings()

LESS = ("less_speed", "slower")
"""Remedies for too high speed."""
DIVIDE = ("less_speed", "divide")
"""Remedies for deviations between knots."""


@dataclass(frozen=True)
class TimedSeam:
    """Seam with its trajectory."""

    trajectory: Trajectory
    """All joints of the robot along the seam."""
    profile: SteadyProfile
    """Progress along the seam over time."""
    residual: float
    """Largest residual of the chain [m, rad]."""
    capped: bool = False
    """Whether a cap on the tools' speed in the world determines the speed."""

    def speed(self, length: float) -> float:
        """Compute the steady speed along a seam of a length [m/s]."""
        return self.profile.speed * length


def timed_seam(
    path: SeamPath,
    work: SeamWork,
    limits: JointLimits,
    pace: float,
    *,
    trapezoid: bool,
    cap: float = np.inf,
) -> TimedSeam | Refusal:
    """Time a seam, or explain why it cannot be worked as required.

    Args:
        path: its joints.
        work: the seam.
        limits: of all joints, at the job's speed.
        pace: the job's fraction of full speed.
        trapezoid: whether accelerations may jump, if joints have no jerk limits.
        cap: largest steady speed at which no tool exceeds its cap in the world [1/s].
    """
    jumps = trapezoid and not np.isfinite(limits.jerk).any()
    allowed = (
        np.inf if work.acceleration is None else work.acceleration * np.square(pace) / work.length
    )
    reason = Refusal("seam_exceeds_limits", remedy=DIVIDE)
    for share in MOTION.tighter:
        tight = replace(
            limits,
            velocity=limits.velocity * (1.0 if share == 1.0 else 0.999),
            acceleration=limits.acceleration * share,
            jerk=limits.jerk * share,
        )
        profile = _profile(path, work, tight, pace, cap * MOTION.cap_margin, trapezoid=jumps)
        if isinstance(profile, Refusal):
            return profile
        for k, spacing in enumerate(MOTION.spacings):
            trajectory = _trajectory(path, profile, limits, spacing, jumps=jumps)
            worst = _largest_share(trajectory, limits)
            if worst > 1.0:
                reason = Refusal("seam_exceeds_between", measured=worst, remedy=DIVIDE)
                break
            residual, uneven, acceleration = _deviations(path.chain, profile, trajectory)
            excess = acceleration / allowed - 1.0
            if residual <= MOTION.open and max(uneven, excess) <= MOTION.uneven:
                capped = profile.speed >= cap * MOTION.cap_margin * MOTION.as_asked
                return TimedSeam(trajectory, profile, residual, capped)
            reason = (
                Refusal("seam_opens", measured=residual, remedy=DIVIDE, data={"um": residual * 1e6})
                if residual > MOTION.open
                else Refusal("seam_uneven", measured=uneven, remedy=DIVIDE)
                if uneven > MOTION.uneven
                else Refusal("seam_rushes", measured=excess, remedy=DIVIDE)
            )
            # A spline's error falls with the fourth power of its knots' distance.
            if residual > MOTION.open * 2.0 * power(16.0, len(MOTION.spacings) - 1 - k):
                return reason
    return reason


def _profile(
    path: SeamPath,
    work: SeamWork,
    limits: JointLimits,
    pace: float,
    cap: float,
    *,
    trapezoid: bool,
) -> SteadyProfile | Refusal:
    """Compute a seam's speed profile, at most `cap` [1/s], or explain its absence."""
    length = work.length
    acceleration = None
    if work.acceleration is not None:
        acceleration = MOTION.acceleration_margin * work.acceleration * np.square(pace) / length
    if work.duration is not None:
        profile = profile_of_duration(
            path.rates, limits, work.duration / pace, acceleration, trapezoid=trapezoid
        )
        if profile is not None and profile.speed <= cap:
            return profile
        target_speed, requested = np.inf, f"{work.duration / pace:.4g} s"
    else:
        assert work.speed is not None
        target_speed, requested = work.speed * pace / length, f"{work.speed * pace * 1e3:.4g} mm/s"
    profile = fastest_profile(
        path.rates, limits, min(target_speed, cap), acceleration, trapezoid=trapezoid
    )
    if profile is None:
        return Refusal("seam_ramps")
    if work.slower:
        return profile
    if work.duration is None and profile.speed >= target_speed * MOTION.as_asked:
        longest = longest_ramp(work, pace)
        if max(profile.start.time, profile.end.time) <= longest:
            return profile
        ramp = max(profile.start.time, profile.end.time)
        return Refusal("seam_ramp_long", None, "", "", ramp, longest, LESS, {"asked": requested})
    top = steady_limit(path.rates, limits)
    details = {
        "asked": requested,
        "speed": profile.speed * length * 1e3,
        "duration": profile.duration,
    }
    if profile.speed >= cap * MOTION.as_asked:
        return Refusal("seam_capped", remedy=("raise_cap", *LESS), data=details)
    if top.speed > target_speed:
        return Refusal("seam_too_short", remedy=LESS, data=details)
    decides = {"kind": top.kind, "joint": top.joint, "mm": top.share * length * 1e3}
    return Refusal("seam_too_fast", remedy=LESS, data={**details, **decides})


def is_too_fast(refusal: Refusal) -> bool:
    """Test whether less speed would help against a refusal."""
    return refusal.remedy[-2:] == LESS


def _trajectory(
    path: SeamPath, profile: SteadyProfile, limits: JointLimits, spacing: float, *, jumps: bool
) -> Trajectory:
    """Create the trajectory with knots at most `spacing` apart.

    Each phase has at least four intervals.
    """
    edges = profile.edges()
    edges = edges[np.concatenate([[True], np.diff(edges) > 1e-9])]
    phases = []
    for start, end in pairwise(edges.tolist()):
        parts = max(4, int(np.ceil((end - start) / spacing)))
        phases.append(np.linspace(start, end, parts + 1))
    if not jumps:
        time = np.concatenate([phases[0], *[phase[1:] for phase in phases[1:]]])
        q, v, a = rest_to_rest_spline(time, path.at(profile.at(time)[0]))
        return Trajectory(limits.joints, time, q, v, a)
    pieces = []
    for time in phases:
        share, speed, _ = profile.at(time)
        first = path.rates.at(share[[0, -1]])[0] * speed[[0, -1], None]
        pieces.append(clamped_spline(time, path.at(share), first[0], first[1]))
    q, v, a = (np.concatenate([piece[k] for piece in pieces]) for k in range(3))
    time, at_rest = np.concatenate(phases), np.zeros((1, q.shape[1]))
    # Accelerations also jump at rest before and after.
    return Trajectory(
        limits.joints,
        np.concatenate([time[:1], time, time[-1:]]),
        np.vstack([q[:1], q, q[-1:]]),
        np.vstack([at_rest, v, at_rest]),
        np.vstack([at_rest, a, at_rest]),
    )


def _largest_share(trajectory: Trajectory, limits: JointLimits) -> float:
    """Compute the largest ratio of a motion's rates to their limits."""
    velocity, acceleration, jerk = largest_rates(
        trajectory.time, trajectory.velocity, trajectory.acceleration
    )
    return float(
        max(
            (velocity / limits.velocity).max(),
            (acceleration / limits.acceleration).max(),
            (jerk / limits.jerk).max(),
        )
    )


def _deviations(
    chain: Chain, profile: SteadyProfile, trajectory: Trajectory
) -> tuple[float, float, float]:
    """Measure the deviations of a motion, also between its knots.

    Returns:
        Largest residual of the chain [m, rad], relative error of the steady speed, and largest acceleration along the
        seam [1/s²].
    """
    knots = distinct(trajectory.time)
    share = np.arange(MOTION.per_knot) / MOTION.per_knot
    time = np.append((knots[:-1, None] + np.diff(knots)[:, None] * share).ravel(), knots[-1])
    bodies = chain.bodies(trajectory.clamped(time)[0])
    nearest = chain.nearest_share(bodies, profile.at(time)[0])
    residuals = [chain.equations(bodies, nearest).exact.residuals]
    hold = chain.work.hold
    if chain.work.master is not None and hold.given:
        residuals.append(chain.part_equations(bodies, *hold.at(nearest)).residuals)
    residual = float(max(np.abs(errors).max() for errors in residuals))
    steady = (time > profile.start.time) & (time < profile.duration - profile.end.time)
    rate = np.diff(nearest[steady]) / np.diff(time[steady])
    speed_errors = np.abs(rate / profile.speed - 1.0)
    return residual, float(speed_errors.max(initial=0.0)), _acceleration(chain, profile, trajectory)


def _acceleration(chain: Chain, profile: SteadyProfile, trajectory: Trajectory) -> float:
    """Measure the largest acceleration along the seam at a motion's knots [1/s²]."""
    step = min(MOTION.moment, profile.duration / 100.0)
    knots = distinct(np.clip(trajectory.time, step, profile.duration - step))
    behind, middle, ahead = (
        chain.nearest_share(chain.bodies(trajectory.clamped(time)[0]), profile.at(time)[0])
        for time in (knots - step, knots, knots + step)
    )
    return float(np.abs(ahead - 2.0 * middle + behind).max() / np.square(step))
