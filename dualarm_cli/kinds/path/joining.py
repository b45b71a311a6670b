"""Splines through joints at instants, checked against limits of position, rates, torque, tool speed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.elementary import power
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.kinds.path.following import PathMotion, PathProblem
from dualarm_cli.kinds.path.following.velocity import pose_error
from dualarm_cli.model.curves.tool_path import TURN_LENGTH
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.motion.torque_limits import SETTINGS
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal
from dualarm_cli.timing.spline import largest_rates, rest_to_rest_spline

CAP_MARGIN = 2e-4
"""Fraction of a cap on the tools' speed that is kept free between knots."""
CHECK_SPACING = 3
"""Spacing of the instants at which tool poses are compared."""


@dataclass(frozen=True)
class Joined:
    """Spline through joints at instants, with its worst limit violation and required slowdown."""

    trajectory: Trajectory
    excess: FloatArray
    """Required slowdown at every knot [factor], shape (k,)."""
    worst: float
    """Required slowdown of the whole curve [factor]."""
    reason: Refusal
    """Joint or tool that exceeds a limit, with its value."""
    when: float
    """Time of the violation [s]."""
    slower_helps: bool
    """Whether it is too fast. Torques that hold a posture are not."""

    @property
    def time(self) -> FloatArray:
        """Knots [s], shape (k,)."""
        return self.trajectory.time

    @classmethod
    def of(cls, problem: PathProblem, motion: PathMotion, stride: int) -> Joined:
        """Join every `stride`-th instant by a spline and compare it with all limits."""
        limits = problem.limits
        time = instants(problem.instants, problem.step)[::stride]
        q, v, a = rest_to_rest_spline(time, motion.position[::stride])
        trajectory = Trajectory(limits.joints, time, q, v, a)
        jerk = np.abs(np.diff(a, axis=0)) / np.diff(time)[:, None]
        # A knot has the larger jerk of its two intervals.
        jerk = np.maximum(np.vstack([jerk[:1], jerk]), np.vstack([jerk, jerk[-1:]]))
        needed = np.stack([np.abs(v), np.abs(a), jerk])
        allowed = np.stack([limits.velocity, limits.acceleration, limits.jerk])
        shares = power(needed / allowed[:, None], (1.0 / np.arange(1.0, 4.0))[:, None, None])
        kind, knot, joint = (int(i) for i in np.unravel_index(int(np.argmax(shares)), shares.shape))
        slides = bool(problem.body.slides[joint])
        unit, factor = (SLIDING_UNITS[kind], 1e3) if slides else (UNITS[kind], 1.0)
        reason = Refusal(
            "joint_exceeds",
            measured=factor * needed[kind, knot, joint],
            allowed=factor * allowed[kind, joint],
            data={"joint": limits.joints[joint], "unit": unit},
        )
        # Between knots velocity may be larger: the spline's own extrema decide.
        exact = largest_rates(time, v, a)
        worst = float(max(power((exact[i] / allowed[i]).max(), 1.0 / (i + 1)) for i in range(3)))
        curve = cls(trajectory, shares.max(axis=(0, 2)), worst, reason, float(time[knot]), True)
        if worst > 1.0:
            return curve
        return curve._with_positions(problem)._with_cap(problem)._with_torques(problem)

    def _with_positions(self, problem: PathProblem) -> Joined:
        """Refuse the curve if a joint is beyond its position limit.

        Smoothing moves joints a little.
        """
        limits, q = problem.limits, self.trajectory.position
        beyond = np.maximum(limits.lower - q, q - limits.upper).max(axis=1)
        knot = int(np.argmax(beyond))
        if beyond[knot] <= 0.0:
            return self
        when = float(self.time[knot])
        return replace(
            self, worst=np.inf, reason=Refusal("limit_between"), when=when, slower_helps=False
        )

    def _with_cap(self, problem: PathProblem) -> Joined:
        """Refuse the curve if a tool exceeds the cap on its speed.

        The cap also holds for tools that only the platform moves.
        """
        if problem.tool_speed is None or self.worst > 1.0:
            return self
        motion, body = self.trajectory, problem.body
        speed = np.empty((len(motion.time), len(body.arms)))
        for k, (q, v) in enumerate(zip(motion.position, motion.velocity, strict=True)):
            speed[k] = norm(product(body.at(q).J, v).reshape(-1, 6)[:, :3], axis=1)
        knot, arm = (int(i) for i in np.unravel_index(int(np.argmax(speed)), speed.shape))
        if speed[knot, arm] <= problem.tool_speed * (1.0 - CAP_MARGIN):
            return self
        figures = float(speed[knot, arm]), problem.tool_speed
        reason = Refusal("tool_exceeds", None, "", body.arms[arm], *figures)
        excess = speed.max(axis=1) / problem.tool_speed
        return replace(
            self,
            excess=excess,
            worst=float(excess.max()),
            reason=reason,
            when=float(motion.time[knot]),
        )

    def _with_torques(self, problem: PathProblem) -> Joined:
        """Refuse the curve if torques exceed their limits."""
        if problem.torque is None or problem.dynamics is None or self.worst > 1.0:
            return self
        motion = self.trajectory
        torques = np.empty_like(motion.position)
        for k, (q, v, a) in enumerate(
            zip(motion.position, motion.velocity, motion.acceleration, strict=True)
        ):
            mass, bias = problem.dynamics(q, v)
            torques[k] = product(mass, a) + bias
        fraction = np.abs(torques) / (problem.torque * (1.0 - SETTINGS.ahead))
        knot, joint = (int(i) for i in np.unravel_index(int(np.argmax(fraction)), fraction.shape))
        if fraction[knot, joint] <= 1.0:
            return self
        unit = "N" if problem.body.slides[joint] else "N m"
        reason = Refusal(
            "joint_exceeds",
            measured=abs(float(torques[knot, joint])),
            allowed=float(problem.torque[joint]),
            data={"joint": problem.limits.joints[joint], "unit": unit},
        )
        holding = np.abs(problem.dynamics(motion.position[knot], np.zeros(len(problem.free)))[1])
        return replace(
            self,
            excess=fraction.max(axis=1),
            worst=float(fraction[knot, joint]),
            reason=reason,
            when=float(motion.time[knot]),
            slower_helps=bool(holding[joint] < problem.torque[joint] * (1.0 - SETTINGS.ahead)),
        )


def target_error(problem: PathProblem, motion: PathMotion) -> float:
    """Compute a follower's largest tool error against its targets [m].

    Turns are scaled by TURN_LENGTH; every CHECK_SPACING-th instant is measured.
    """
    return _largest_error(problem, motion.position[CHECK_SPACING // 2 :: CHECK_SPACING], None)


def path_deviation(problem: PathProblem, motion: PathMotion, trajectory: Trajectory) -> float:
    """Compute the largest tool error of a trajectory against the follower's postures [m].

    Turns are scaled by TURN_LENGTH.
    """
    looked_at = slice(CHECK_SPACING // 2, None, CHECK_SPACING)
    position = trajectory.clamped(instants(problem.instants, problem.step)[looked_at])[0]
    return _largest_error(problem, position, motion.position[looked_at])


def _largest_error(
    problem: PathProblem, position: FloatArray, reference: FloatArray | None
) -> float:
    """Compute the largest distance of tools from reference postures, or their targets [m].

    Every CHECK_SPACING-th instant counts.
    """
    which = np.flatnonzero(problem.follows)
    worst = 0.0
    for k, q in enumerate(position):
        R, p = problem.body.tools(q)
        instant = CHECK_SPACING // 2 + CHECK_SPACING * k
        R_goal, p_goal = problem.R[instant], problem.p[instant]
        if reference is not None:
            R_goal, p_goal = (part[which] for part in problem.body.tools(reference[k]))
        error = pose_error(R_goal, p_goal, R[which], p[which]).reshape(-1, 6)
        worst = max(worst, float(norm(error[:, :3], axis=1).max()))
        worst = max(worst, TURN_LENGTH * float(norm(error[:, 3:], axis=1).max()))
    return worst


UNITS = ("rad/s", "rad/s²", "rad/s³")
SLIDING_UNITS = ("mm/s", "mm/s²", "mm/s³")


def instants(count: int, step: float) -> FloatArray:
    """Return equally spaced times from 0 [s], shape (count,)."""
    times: FloatArray = np.arange(count, dtype=np.float64) * step
    return times
