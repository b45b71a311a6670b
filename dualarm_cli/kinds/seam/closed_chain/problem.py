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
    """Smallest number of nodes, the places along the seam at which joints are decided."""
    most_nodes: int = 321
    """Largest number of nodes along a seam.

    Intervals are halved until a smooth curve through the nodes represents the seam.
    """
    told: float = 1e-4
    """Position tolerance of the smooth curve through the nodes, per coordinate [m]."""
    told_turn: float = 1e-2
    """Rotation tolerance of the smooth curve through the nodes, per matrix entry [rad]."""
    kept_free: float = 0.03
    """Distance from the joints' limits that is kept where they are decided [rad]."""


NODES = SeamProblemSettings()


@dataclass(frozen=True)
class SeamProblem:
    """A seam on one robot: which joints work it as fast as asked, or faster than any others."""

    chain: Chain
    """The equations of part and tool, with the seam."""
    limits: JointLimits
    """Of the n joints."""
    start: FloatArray
    """All joints where the seam's plan begins [rad], shape (n,); the platform stands as there."""
    time: float
    """How long the whole seam takes at the speed that is asked for [s]: no solver need be faster."""
    samples: int
    """Configurations that are drawn as starts."""
    tried: int
    """How many of the best starts are improved."""
    seed: int
    """Of what is drawn."""
    near: FloatArray | None = None
    """Joints near which it is to begin [rad], shape (n,); None where any will do."""
    begin: FloatArray | None = None
    """Joints in which it has to begin, where the robot already has tool and part together [rad], shape (n,)."""
    coming: Callable[[FloatArray], FloatArray] | None = None
    """How long it takes to get to configurations (k, n) [rad] from where the robot is, (k,) [s]; None where it may be
    anywhere."""
    goes_on: Callable[[FloatArray], bool] | None = None
    """Whether what comes next can be done from joints (n,) [rad] in which the seam ends; None where nothing depends on
    it."""
    what_touches: Callable[[FloatArray], Refusal] | None = None
    """Which two bodies come nearest at joints (n,) [rad], and how near; for reasons."""
    clear: Callable[[FloatArray], BoolArray] | None = None
    """Which configurations (k, n) [rad] are clear of everything; None where nothing has to."""

    def __post_init__(self) -> None:
        """Freezes the arrays."""
        for name in ("start", "near", "begin"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, readonly(getattr(self, name)))

    @cached_property
    def nodes(self) -> int:
        """Number of places along the seam at which joints are decided: as many as its length and curvature ask for.

        A quintic through the seam's frames at the nodes tells where the seam is between them.
        """
        count = NODES.fewest_nodes
        while count < NODES.most_nodes:
            share = np.linspace(0.0, 1.0, 2 * count - 1)
            R, p = self.chain.work.tool_frames(share)
            frame = np.concatenate([p / NODES.told, R.reshape(len(R), 9) / NODES.told_turn], axis=1)
            between = quintic_spline(share[::2], frame[::2])(share[1::2])
            if np.abs(between - frame[1::2]).max() <= 1.0:
                break
            count = 2 * count - 1
        return count

    @property
    def shares(self) -> FloatArray:
        """Shares of the seam at the nodes, shape (nodes,)."""
        return np.linspace(0.0, 1.0, self.nodes)

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Lowest and highest joint positions that are taken [rad], each (n,)."""
        return self.limits.lower + NODES.kept_free, self.limits.upper - NODES.kept_free


@dataclass(frozen=True)
class SeamMotion:
    """The joints at the nodes of a seam."""

    position: FloatArray
    """All joints [rad], shape (nodes, n)."""
    time: float
    """Least time for the whole seam at a steady speed, ramps not counted [s]."""

    def __post_init__(self) -> None:
        """Freezes the array."""
        object.__setattr__(self, "position", readonly(self.position))


@dataclass(frozen=True)
class NoSeam:
    """Why no joints were found."""

    reason: Refusal
    """Cause, without its place."""
    share: float
    """How much of the seam can be worked."""
