"""Newton steps that close a chain, for many configurations at once."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.linear_systems import solve
from dualarm_cli.geometry.products import product
from dualarm_cli.kinds.seam.closed_chain.chain import Chain, Equations
from dualarm_cli.model.curves.tool_path import Poses
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class ClosingSettings:
    """Settings of the Newton steps that close a chain."""

    converged: float = 1e-11
    """Residual at which the steps end [m, radians by TURN]."""
    longest_step: float = 0.4
    """Longest Newton step of a joint [rad]."""
    pull: float = 0.15
    """Fraction of the distance to preferred joints per step."""
    damping: float = 1e-3
    """Damping of steps per squared residual. Singular starts must not diverge."""


CLOSING = ClosingSettings()


@dataclass(frozen=True)
class Closed:
    """Configurations after Newton steps."""

    position: FloatArray
    """Joints [rad], shape (k, n)."""
    residual: FloatArray
    """Residual of the equations [m, radians by TURN], shape (k,)."""


def close(
    equations: Callable[[FloatArray], Equations],
    position: FloatArray,
    weight: FloatArray,
    steps: int,
    *,
    towards: FloatArray | None = None,
    pulls: int = 0,
) -> Closed:
    """Find the nearest joints that close the chain, by Newton steps.

    The steps have the least weighted norm.

    Args:
        equations: function of joints (k, n) [rad].
        position: initial joints [rad], shape (k, n).
        weight: mobility of each joint, 0 for joints that stand, shape (n,).
        steps: maximum number of steps.
        towards: joints to which the first steps pull in the null space [rad], (n,).
        pulls: number of steps that pull.
    """
    q = np.array(position)
    for step in range(steps + 1):
        system = equations(q)
        residual = system.size
        if step == steps or residual.max(initial=0.0) < CLOSING.converged:
            break
        pull = np.zeros_like(q)
        if towards is not None and step < pulls:
            pull = (weight > 0.0) * (q - towards) * CLOSING.pull
        dq = pull + least_norm(system, weight, pull)
        longest = np.abs(dq).max(axis=1)
        q -= dq * np.minimum(1.0, CLOSING.longest_step / np.maximum(longest, 1e-300))[:, None]
    return Closed(q, residual)


def all_equations(
    chain: Chain,
    position: FloatArray,
    share: FloatArray,
    part: Poses | None = None,
) -> Equations:
    """Assemble the seam's equations, and the part's if its pose is given.

    Args:
        chain: closed chain of the seam.
        position: joints [rad], shape (k, n).
        share: fractions of the seam, shape (k,).
        part: rotations (k, 3, 3) and positions (k, 3) [m] of the part in the world, or None if it is free.
    """
    bodies = chain.bodies(position)
    equations = chain.equations(bodies, share)
    return equations if part is None else equations.after(chain.part_equations(bodies, *part))


def least_norm(equations: Equations, weight: FloatArray, pull: FloatArray) -> FloatArray:
    """Compute least-weighted-norm corrections of joint steps (k, n) that remove the residuals."""
    J = equations.slope
    JW = J * weight
    gram = product(JW, np.swapaxes(J, -1, -2))
    damp = 1e-12 + CLOSING.damping * np.square(np.minimum(equations.size, 1.0))
    gram = gram + damp[:, None, None] * np.eye(gram.shape[-1])
    right = equations.residuals - product(J, pull[..., None])[..., 0]
    correction: FloatArray = product(np.swapaxes(JW, -1, -2), solve(gram, right[..., None]))[..., 0]
    return correction
