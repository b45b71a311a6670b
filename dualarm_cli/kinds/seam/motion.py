"""A seam in time: steady speed, ramps at its ends, then the trajectory with chain and limits looked at."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from dualarm_cli.geometry.arrays import distinct
from dualarm_cli.geometry.elementary import power
from dualarm_cli.kinds.seam.closed_chain.chain import Chain
from dualarm_cli.kinds.seam.path import SeamPath
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.model.seam import SeamWork, longest_ramp
from dualarm_cli.model.trajectory import Trajectory
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
    """Times between knots that are tried until the chain is closed between them too [s]."""
    open: float = 4e-7
    """Largest opening of the chain between knots [m, rad]."""
    uneven: float = 4e-4
    """Largest relative error of the speed along the seam between knots. Ramps do not count. The acceleration along the
    seam may exceed what the file allows by the same share."""
    moment: float = 2e-4
    """Time by which accelerations along the seam are measured [s]."""
    per_knot: int = 3
    """Instants between knots that are looked at."""
    tighter: tuple[float, ...] = (1.0, 0.97, 0.92, 0.85)
    """Shares of the joint limits that are tried until a profile's spline keeps them."""
    as_asked: float = 1.0 - 1e-9
    """Share of a requested speed, or of a cap, that counts as reached."""
    acceleration_margin: float = 0.99
    """Share of the file's acceleration along the seam that is used: the motion's spline is a little dearer."""
    cap_margin: float = 0.999
    """Share of a cap on the tools' speed that is used: between places and knots they are a little faster."""


MOTION = SeamMotionSettings()

LESS = ("less_speed", "slower")
"""What helps against what is too fast."""
DIVIDE = ("less_speed", "divide")
"""What helps where the motion between knots strays."""


@dataclass(frozen=True)
class TimedSeam:
    """A seam as it is worked."""

    trajectory: Trajectory
    """All joints of the robot, from where the seam begins to where it ends."""
    profile: SteadyProfile
    """Where on the seam the tool is when."""
    residual: float
    """How far the chain is open at most [m, rad]."""
    capped: bool = False
    """Whether a cap on the tools' speed in the world decides how fast it is worked."""

    def speed(self, length: float) -> float:
        """Returns the steady speed along a seam of a length [m/s]."""
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
    """Returns the seam in time, or why it cannot be worked as the file asks.

    Args:
        path: its joints.
        work: the seam.
        limits: of all joints, at the job's speed.
        pace: the job's share of full speed.
        trapezoid: whether accelerations may jump, as far as joints have no jerk limits.
        cap: largest steady speed for which all tools keep to their cap in the world [1/s].
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
                Refusal("seam_opens", measured=residual, remedy=DIVIDE, more={"um": residual * 1e6})
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
    """Returns how fast a seam is worked, at a steady speed of cap [1/s] at most, or why not as asked."""
    length = work.length
    acceleration = None
    if work.acceleration is not None:
        acceleration = MOTION.acceleration_margin * work.acceleration * np.square(pace) / length
    if work.duration is not None:
        found = profile_of_duration(
            path.rates, limits, work.duration / pace, acceleration, trapezoid=trapezoid
        )
        if found is not None and found.speed <= cap:
            return found
        most, asked = np.inf, f"{work.duration / pace:.4g} s"
    else:
        assert work.speed is not None
        most, asked = work.speed * pace / length, f"{work.speed * pace * 1e3:.4g} mm/s"
    found = fastest_profile(path.rates, limits, min(most, cap), acceleration, trapezoid=trapezoid)
    if found is None:
        return Refusal("seam_ramps")
    if work.slower:
        return found
    if work.duration is None and found.speed >= most * MOTION.as_asked:
        longest = longest_ramp(work, pace)
        if max(found.start.time, found.end.time) <= longest:
            return found
        ramp = max(found.start.time, found.end.time)
        return Refusal("seam_ramp_long", None, "", "", ramp, longest, LESS, {"asked": asked})
    top = steady_limit(path.rates, limits)
    more = {"asked": asked, "speed": found.speed * length * 1e3, "duration": found.duration}
    if found.speed >= cap * MOTION.as_asked:
        return Refusal("seam_capped", remedy=("raise_cap", *LESS), more=more)
    if top.speed > most:
        return Refusal("seam_too_short", remedy=LESS, more=more)
    decides = {"kind": top.kind, "joint": top.joint, "mm": top.share * length * 1e3}
    return Refusal("seam_too_fast", remedy=LESS, more={**more, **decides})


def is_too_fast(refusal: Refusal) -> bool:
    """Returns whether a seam is refused for what less speed would help against."""
    return refusal.remedy[-2:] == LESS


def _trajectory(
    path: SeamPath, profile: SteadyProfile, limits: JointLimits, spacing: float, *, jumps: bool
) -> Trajectory:
    """Returns the trajectory with knots so far apart at most, four parts of each phase or more."""
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
    time, rest = np.concatenate(phases), np.zeros((1, q.shape[1]))
    # At rest before and after: there too accelerations jump.
    return Trajectory(
        limits.joints,
        np.concatenate([time[:1], time, time[-1:]]),
        np.vstack([q[:1], q, q[-1:]]),
        np.vstack([rest, v, rest]),
        np.vstack([rest, a, rest]),
    )


def _largest_share(trajectory: Trajectory, limits: JointLimits) -> float:
    """Returns the largest share of a limit that a motion uses."""
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
    """Returns how a motion strays between its knots too.

    Returns:
        How far the chain is open at most [m, rad], the share by which the steady speed is off, and the greatest
        acceleration along the seam [1/s²].
    """
    knots = distinct(trajectory.time)
    share = np.arange(MOTION.per_knot) / MOTION.per_knot
    time = np.append((knots[:-1, None] + np.diff(knots)[:, None] * share).ravel(), knots[-1])
    bodies = chain.bodies(trajectory.at(time)[0])
    nearest = chain.nearest_share(bodies, profile.at(time)[0])
    left = [chain.equations(bodies, nearest).exact.left]
    hold = chain.work.hold
    if chain.work.master is not None and hold.given:
        left.append(chain.part_equations(bodies, *hold.at(nearest)).left)
    residual = float(max(np.abs(one).max() for one in left))
    steady = (time > profile.start.time) & (time < profile.duration - profile.end.time)
    rate = np.diff(nearest[steady]) / np.diff(time[steady])
    off = np.abs(rate / profile.speed - 1.0)
    return residual, float(off.max(initial=0.0)), _acceleration(chain, profile, trajectory)


def _acceleration(chain: Chain, profile: SteadyProfile, trajectory: Trajectory) -> float:
    """Returns the greatest acceleration along the seam at a motion's knots [1/s²], where a spline has it."""
    step = min(MOTION.moment, profile.duration / 100.0)
    knots = distinct(np.clip(trajectory.time, step, profile.duration - step))
    behind, here, ahead = (
        chain.nearest_share(chain.bodies(trajectory.at(time)[0]), profile.at(time)[0])
        for time in (knots - step, knots, knots + step)
    )
    return float(np.abs(ahead - 2.0 * here + behind).max() / np.square(step))
