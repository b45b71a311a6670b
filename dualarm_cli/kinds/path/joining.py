"""From joints at instants to a trajectory, with every limit of its rates and torques looked at."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.elementary import power
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.kinds.path.following import PathMotion, PathProblem
from dualarm_cli.kinds.path.following.velocity import pose_error
from dualarm_cli.model.curves.tool_path import TURN_LENGTH
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal
from dualarm_cli.timing.spline import largest_rates, rest_to_rest_spline

CAP_KEPT_FREE = 2e-4
"""Share of a cap on the tools' speed that is kept free between knots."""
CHECKED = 3
"""Every so many instants the tools are compared with where they should be."""


@dataclass(frozen=True)
class Joined:
    """Joints at instants joined by a spline, and by how much it exceeds the limits of its rates."""

    trajectory: Trajectory
    excess: FloatArray
    """By what factor it would have to be slower, at every knot, shape (k,)."""
    worst: float
    """The same for the whole of it."""
    reason: Refusal
    """Joint or tool that exceeds a limit, with its value."""
    when: float
    """When [s]."""
    slower_helps: bool
    """Whether it is too fast; torques that hold a posture are not."""

    @property
    def time(self) -> FloatArray:
        """The knots [s], shape (k,)."""
        return self.trajectory.time

    @classmethod
    def of(cls, problem: PathProblem, found: PathMotion, stride: int) -> Joined:
        """Returns the spline through every so many-th instant."""
        limits = problem.limits
        time = instants(problem.instants, problem.step)[::stride]
        q, v, a = rest_to_rest_spline(time, found.position[::stride])
        trajectory = Trajectory(limits.joints, time, q, v, a)
        jerk = np.abs(np.diff(a, axis=0)) / np.diff(time)[:, None]
        # A knot has the larger jerk of the intervals beside it.
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
            more={"joint": limits.joints[joint], "unit": unit},
        )
        # Between knots velocity may be larger: the spline's own extrema decide.
        exact = largest_rates(time, v, a)
        worst = float(max(power((exact[i] / allowed[i]).max(), 1.0 / (i + 1)) for i in range(3)))
        curve = cls(trajectory, shares.max(axis=(0, 2)), worst, reason, float(time[knot]), True)
        if worst > 1.0:
            return curve
        return curve._with_positions(problem)._with_cap(problem)._with_torques(problem)

    def _with_positions(self, problem: PathProblem) -> Joined:
        """Returns the same, refused where a joint is beyond its position limit: evening out moves joints a little."""
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
        """Returns the same, refused where a tool, also one that only the platform moves, exceeds its cap."""
        if problem.tool_speed is None or self.worst > 1.0:
            return self
        motion, body = self.trajectory, problem.body
        speed = np.empty((len(motion.time), len(body.arms)))
        for k, (q, v) in enumerate(zip(motion.position, motion.velocity, strict=True)):
            speed[k] = norm(product(body.at(q).J, v).reshape(-1, 6)[:, :3], axis=1)
        knot, arm = (int(i) for i in np.unravel_index(int(np.argmax(speed)), speed.shape))
        if speed[knot, arm] <= problem.tool_speed * (1.0 - CAP_KEPT_FREE):
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
        """Returns the same, refused where torques exceed their limits."""
        if problem.torque is None or problem.dynamics is None or self.worst > 1.0:
            return self
        motion = self.trajectory
        torques = np.empty_like(motion.position)
        for k, (q, v, a) in enumerate(
            zip(motion.position, motion.velocity, motion.acceleration, strict=True)
        ):
            mass, rest = problem.dynamics(q, v)
            torques[k] = product(mass, a) + rest
        share = np.abs(torques) / problem.torque
        knot, joint = (int(i) for i in np.unravel_index(int(np.argmax(share)), share.shape))
        if share[knot, joint] <= 1.0:
            return self
        unit = "N" if problem.body.slides[joint] else "N m"
        reason = Refusal(
            "joint_exceeds",
            measured=abs(float(torques[knot, joint])),
            allowed=float(problem.torque[joint]),
            more={"joint": problem.limits.joints[joint], "unit": unit},
        )
        holding = np.abs(problem.dynamics(motion.position[knot], np.zeros(len(problem.free)))[1])
        return replace(
            self,
            excess=share.max(axis=1),
            worst=float(share[knot, joint]),
            reason=reason,
            when=float(motion.time[knot]),
            slower_helps=bool(holding[joint] < problem.torque[joint]),
        )


def leaves(problem: PathProblem, found: PathMotion) -> float:
    """Returns how far the tools are from where they should be by the method itself, turns by TURN_LENGTH [m]."""
    return _farthest(problem, found.position[CHECKED // 2 :: CHECKED], None)


def strays(problem: PathProblem, found: PathMotion, trajectory: Trajectory) -> float:
    """Returns how far the tools are from where the method has them between the knots, turns by TURN_LENGTH [m]."""
    looked_at = slice(CHECKED // 2, None, CHECKED)
    position = trajectory.at(instants(problem.instants, problem.step)[looked_at])[0]
    return _farthest(problem, position, found.position[looked_at])


def _farthest(problem: PathProblem, position: FloatArray, there: FloatArray | None) -> float:
    """Returns how far tools are from where others, or their targets, have them, at every CHECKED-th instant [m]."""
    which = np.flatnonzero(problem.follows)
    worst = 0.0
    for k, q in enumerate(position):
        R, p = problem.body.tools(q)
        instant = CHECKED // 2 + CHECKED * k
        R_there, p_there = problem.R[instant], problem.p[instant]
        if there is not None:
            R_there, p_there = (part[which] for part in problem.body.tools(there[k]))
        error = pose_error(R_there, p_there, R[which], p[which]).reshape(-1, 6)
        worst = max(worst, float(norm(error[:, :3], axis=1).max()))
        worst = max(worst, TURN_LENGTH * float(norm(error[:, 3:], axis=1).max()))
    return worst


UNITS = ("rad/s", "rad/s²", "rad/s³")
SLIDING_UNITS = ("mm/s", "mm/s²", "mm/s³")


def instants(count: int, step: float) -> FloatArray:
    """Returns so many instants a step apart from 0 on [s], shape (count,)."""
    found: FloatArray = np.arange(count, dtype=np.float64) * step
    return found
