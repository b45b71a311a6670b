"""What a seam solver is asked and what it answers: the joints along a seam, in no time yet."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dualarm_cli.closed_chain.chain import Chain
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, readonly
from dualarm_cli.model.robot import JointLimits

NODES = 41
"""Places along the seam at which joints are decided."""
KEPT_FREE = 0.03
"""Distance from the joints' limits that is kept where they are decided [rad]."""


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
    what_touches: Callable[[FloatArray], str] | None = None
    """Says which two bodies come nearest at joints (n,) [rad], and how near; for reasons."""
    clear: Callable[[FloatArray], BoolArray] | None = None
    """Which configurations (k, n) [rad] keep clear of everything; None where nothing has to."""

    def __post_init__(self) -> None:
        """Freezes the arrays."""
        for name in ("start", "near", "begin"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, readonly(getattr(self, name)))

    @property
    def shares(self) -> FloatArray:
        """Shares of the seam at the nodes, shape (NODES,)."""
        return np.linspace(0.0, 1.0, NODES)

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Lowest and highest joint positions that are taken [rad], each (n,)."""
        return self.limits.lower + KEPT_FREE, self.limits.upper - KEPT_FREE


@dataclass(frozen=True)
class SeamMotion:
    """The joints at the nodes of a seam."""

    position: FloatArray
    """All joints [rad], shape (NODES, n)."""
    time: float
    """Least time for the whole seam at a steady speed, ramps not counted [s]."""

    def __post_init__(self) -> None:
        """Freezes the array."""
        object.__setattr__(self, "position", readonly(self.position))


@dataclass(frozen=True)
class NoSeam:
    """Why no joints were found."""

    reason: str
    """In words."""
    share: float
    """How much of the seam can be worked."""
