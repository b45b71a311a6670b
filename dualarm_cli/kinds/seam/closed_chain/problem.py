"""Problem and solution of a seam solver: joints along a seam, without time."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, readonly
from dualarm_cli.geometry.splines import quintic_spline
from dualarm_cli.kinds.seam.closed_chain.chain import Chain
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal


@dataclass(frozen=True)
class SeamProblemSettings:
    """Resolution of a seam's program."""

    fewest_nodes: int = 41
    """Minimum number of nodes along a seam."""
    most_nodes: int = 321
    """Maximum number of nodes along a seam.

    Intervals are halved until a smooth curve through the nodes represents the seam.
    """
    position_tolerance: float = 1e-4
    """Position tolerance of the smooth curve through the nodes, per coordinate [m]."""
    rotation_tolerance: float = 1e-2
    """Rotation tolerance of the smooth curve through the nodes, per matrix entry [rad]."""
    kept_free: float = 0.03
    """Margin to the joints' limits at the nodes [rad]."""


NODES = SeamProblemSettings()


@dataclass(frozen=True)
class SeamProblem:
    """Seam on one robot, for which the joints of the fastest motion are sought."""

    chain: Chain
    """Closed chain with the seam."""
    limits: JointLimits
    """Limits of the n joints."""
    start: FloatArray
    """All joints before the seam [rad], shape (n,).

    They give the platform's position.
    """
    time: float
    """Duration of the seam at the requested speed [s].

    No solver needs to be faster.
    """
    samples: int
    """Number of random starts."""
    improved_starts: int
    """Number of best starts that are improved."""
    seed: int
    """Seed of the random starts."""
    reference: FloatArray | None = None
    """Reference joints for its begin [rad], shape (n,); None for any."""
    begin: FloatArray | None = None
    """Required joints at its begin, with tool and part together [rad], shape (n,)."""
    transfer_times: Callable[[FloatArray], FloatArray] | None = None
    """Transfer times to configurations (k, n) [rad], (k,) [s]; None for a free start."""
    can_continue: Callable[[FloatArray], bool] | None = None
    """Test of joints (n,) [rad] as a start of the next seam.

    The joints are those at the end of this seam; None without a next seam.
    """
    nearest_bodies: Callable[[FloatArray], Refusal] | None = None
    """Description of the two nearest bodies at joints (n,) [rad]."""
    is_free: Callable[[FloatArray], BoolArray] | None = None
    """Test of configurations (k, n) [rad] for clearance; None without collision checking."""

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for name in ("start", "reference", "begin"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, readonly(getattr(self, name)))

    @cached_property
    def nodes(self) -> int:
        """Number of nodes along the seam, by its length and curvature.

        A quintic spline through the seam's frames at the nodes has to represent the seam between them.
        """
        count = NODES.fewest_nodes
        while count < NODES.most_nodes:
            share = np.linspace(0.0, 1.0, 2 * count - 1)
            R, p = self.chain.work.tool_frames(share)
            frame = np.concatenate(
                [p / NODES.position_tolerance, R.reshape(len(R), 9) / NODES.rotation_tolerance],
                axis=1,
            )
            between = quintic_spline(share[::2], frame[::2])(share[1::2])
            if np.abs(between - frame[1::2]).max() <= 1.0:
                break
            count = 2 * count - 1
        return count

    @property
    def shares(self) -> FloatArray:
        """Fractions of the seam at the nodes, shape (nodes,)."""
        return np.linspace(0.0, 1.0, self.nodes)

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper bounds of the joints at the nodes [rad], each (n,)."""
        return self.limits.lower + NODES.kept_free, self.limits.upper - NODES.kept_free


@dataclass(frozen=True)
class SeamMotion:
    """Joints at the nodes of a seam."""

    position: FloatArray
    """All joints [rad], shape (nodes, n)."""
    time: float
    """Least duration of the seam at a steady speed, without ramps [s]."""

    def __post_init__(self) -> None:
        """Freeze the array."""
        object.__setattr__(self, "position", readonly(self.position))


@dataclass(frozen=True)
class NoSeam:
    """Reason why no joints were found."""

    reason: Refusal
    """Cause, without its place."""
    share: float
    """Fraction of the seam that can be worked."""
