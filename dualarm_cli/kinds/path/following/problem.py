"""Problem and solution of a path follower: all joints while the tools follow given motions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import field

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, readonly
from dualarm_cli.geometry.linear_systems import singular_values
from dualarm_cli.geometry.products import product
from dualarm_cli.geometry.rotations import log_rotation
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.kinematics.whole_body import WholeBody
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal


@dataclass(frozen=True)
class Spring:
    """Virtual springs that pull the elbows ([Choi2020] Eq. 6-13)."""

    points: FloatArray
    """Critical points of the arms in the carried frame [m], shape (a, 3)."""
    gain: float = 10.0
    """Factor on half the squared distances' gradient, 2 K² of Eq. 28 [1/(m² s)]."""

    def __post_init__(self) -> None:
        """Freeze the points."""
        object.__setattr__(self, "points", readonly(self.points))


@dataclass(frozen=True)
class ManipulabilityWeights:
    """Parameters of the acceleration-level method ([Zhang2024] Eq. 17-24, corrected)."""

    gain: float = 4.0
    """a_2: weight of the gradient of log M as a velocity."""
    damping: float = 5.0
    """k: rate at which the joints' velocity approaches it [1/s]."""
    printed_bounds: bool = False
    """Whether the acceleration bounds are those of Eq. 23 as printed."""


@dataclass(frozen=True)
class PathProblem:
    """Given tool poses at equally spaced instants, for which joints are sought.

    The a arms are those of the body. Where only one has a path, the joints of the other do not move.
    """

    body: WholeBody
    """Kinematics of all n joints."""
    limits: JointLimits
    """Limits of the n joints."""
    start: FloatArray
    """Joints at the start of the tools' paths [rad], shape (n,)."""
    step: float
    """Time between instants [s]."""
    follows: BoolArray
    """Flags of arms with a path, shape (a,)."""
    R: FloatArray
    """Rotations of the following tools at the k instants, shape (k, b, 3, 3)."""
    p: FloatArray
    """Their tool centre points [m], shape (k, b, 3)."""
    share: FloatArray
    """Fractions of the paths at each instant, 0 to 1, shape (k,)."""
    pace: FloatArray
    """Speeds along the paths as fractions of full speed, shape (k,).

    Self-motion has the same pace.
    """
    spring: Spring
    """Springs, for methods that pull elbows."""
    weights: ManipulabilityWeights = field(default_factory=ManipulabilityWeights)
    """Weights, for methods that seek manipulability."""
    damping: float = 0.05
    """lambda of damped least squares ([Choi2020] Eq. 3)."""
    model: CellModel | None = None
    """Cell model in closed form; None where its arms have none."""
    tool_speed: float | None = None
    """Largest speed of every tool [m/s], or None for no cap.

    It also holds for arms without a path.
    """
    torque: FloatArray | None = None
    """Largest torque of every joint [N m], shape (n,); None for no torque limits."""
    dynamics: Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]] | None = None
    """Mass matrix (n, n) and bias torques (n,) at positions and velocities (n,)."""
    torque_in_method: bool = False
    """Whether methods for torques use them; otherwise only curves are compared with them."""

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for name in ("start", "R", "p", "share", "pace"):
            object.__setattr__(self, name, readonly(getattr(self, name)))
        if self.torque is not None:
            object.__setattr__(self, "torque", readonly(self.torque))

    @property
    def instants(self) -> int:
        """Number of instants."""
        return len(self.pace)

    @property
    def free(self) -> BoolArray:
        """Flags of joints that move a following tool, shape (n,)."""
        return np.asarray(self.body.moves[self.follows].any(axis=0))

    @property
    def rows(self) -> BoolArray:
        """Flags of the rows of the body's Jacobian for following tools, shape (6 a,)."""
        return np.repeat(self.follows, 6)

    def twists(self) -> tuple[FloatArray, FloatArray]:
        """Compute velocities and accelerations of the tools, each (k, 6 b), by central differences."""
        k, b = self.p.shape[:2]
        ahead = np.minimum(np.arange(k) + 1, k - 1)
        turn = log_rotation(product(self.R[ahead], np.swapaxes(self.R, -1, -2)))
        rise = np.concatenate([self.p[ahead] - self.p, turn], axis=-1).reshape(k, 6 * b)
        before = np.vstack([np.zeros((1, 6 * b)), rise[:-1]])
        return (rise + before) / (2.0 * self.step), (rise - before) / np.square(self.step)


@dataclass(frozen=True)
class PathMotion:
    """Joints at the problem's instants."""

    position: FloatArray
    """All joints [rad], shape (k, n)."""
    keeps_rates: bool = False
    """Whether the method kept the problem's velocity and acceleration limits.

    A curve through the instants that exceeds them does so by the method's self-motion, which no slower path changes.
    """

    def __post_init__(self) -> None:
        """Freeze the array."""
        object.__setattr__(self, "position", readonly(self.position))


@dataclass(frozen=True)
class NoPath:
    """Reason why the joints cannot follow, and its first instant."""

    reason: Refusal
    """Cause, without its place."""
    instant: int
    """Number of the instant."""
    excess: float = 0.0
    """Required slowdown [factor]; infinite where unknown, 0 where it is no help."""


SLACK = 1e-6
"""Rounding error that is allowed beyond a position limit [rad]."""
SINGULAR = 0.02
"""Smallest singular value of the tools' Jacobian below which a posture is called singular."""


def within_limits(problem: PathProblem, position: FloatArray) -> PathMotion | NoPath:
    """Check position limits; return the motion or the first instant beyond one.

    Speeds are checked later, on the curve through the instants.

    Args:
        problem: the follower's problem.
        position: joints at the instants [rad], shape (k, n); fewer if a method gave up.
    """
    limits = problem.limits
    beyond = np.maximum(limits.lower - position, position - limits.upper)
    if not (beyond > SLACK).any():
        return PathMotion(position)
    k = int(np.argmax((beyond > SLACK).any(axis=1)))
    joint = int(np.argmax(beyond[k]))
    return NoPath(limit_reached(problem, joint, float(position[k, joint])), k)


def limit_reached(problem: PathProblem, joint: int, position: float) -> Refusal:
    """Describe the position limit that a joint reaches."""
    limits = problem.limits
    lower, upper = float(limits.lower[joint]), float(limits.upper[joint])
    bound = upper if position > 0.5 * (lower + upper) else lower
    slides = problem.body.slides[joint]
    data = {
        "joint": limits.joints[joint],
        "bound": bound * 1e3 if slides else np.rad2deg(bound),
        "unit": "mm" if slides else "deg",
    }
    return Refusal("joint_limit", data=data)


def singular_there(problem: PathProblem, q: FloatArray) -> list[Refusal]:
    """Describe a nearly singular posture (n,) [rad], or return nothing."""
    if not np.isfinite(q).all():
        return []
    J = problem.body.at(q).J[problem.rows][:, problem.free]
    smallest = float(singular_values(J)[-1])
    return [Refusal("singular", measured=smallest)] if smallest <= SINGULAR else []
