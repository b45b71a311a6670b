"""Joints that close a chain: Newton steps from joints that nearly do, for many configurations at once."""

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
    """Newton steps that close a chain."""

    converged: float = 1e-11
    """Residual below which no more steps are taken [m, radians by TURN]."""
    longest_step: float = 0.4
    """Longest Newton step of a joint [rad]."""
    pull: float = 0.15
    """Share of the way to where joints should rather be that a step takes."""
    damping: float = 1e-3
    """Of steps far from closed, by the square of the residual: singular starts must not fly off."""


CLOSING = ClosingSettings()


@dataclass(frozen=True)
class Closed:
    """Configurations after Newton steps."""

    position: FloatArray
    """Joints [rad], shape (k, n)."""
    residual: FloatArray
    """What is left of the equations [m, radians by TURN], shape (k,)."""


def close(
    equations: Callable[[FloatArray], Equations],
    position: FloatArray,
    weight: FloatArray,
    steps: int,
    *,
    towards: FloatArray | None = None,
    pulls: int = 0,
) -> Closed:
    """Returns the nearest joints that close the chain, by Newton steps of least weighted norm.

    Args:
        equations: what joints (k, n) [rad] leave of being closed.
        position: joints to begin with [rad], shape (k, n).
        weight: how readily each joint moves, 0 for joints that stand, shape (n,).
        steps: how many steps at most.
        towards: joints that the first steps pull to, as far as the equations leave them free [rad], (n,).
        pulls: how many steps pull.
    """
    q = np.array(position)
    for step in range(steps + 1):
        found = equations(q)
        left = found.size
        if step == steps or left.max(initial=0.0) < CLOSING.converged:
            break
        wish = np.zeros_like(q)
        if towards is not None and step < pulls:
            wish = (weight > 0.0) * (q - towards) * CLOSING.pull
        dq = wish + least_norm(found, weight, wish)
        longest = np.abs(dq).max(axis=1)
        q -= dq * np.minimum(1.0, CLOSING.longest_step / np.maximum(longest, 1e-300))[:, None]
    return Closed(q, left)


def all_equations(
    chain: Chain,
    position: FloatArray,
    share: FloatArray,
    part: Poses | None = None,
) -> Equations:
    """Returns the seam's equations, and the part's where its pose is given.

    Args:
        chain: the seam's.
        position: joints [rad], shape (k, n).
        share: of the seam, shape (k,).
        part: rotations (k, 3, 3) and positions (k, 3) [m] of the part in the world, or None where it may be anywhere.
    """
    bodies = chain.bodies(position)
    found = chain.equations(bodies, share)
    return found if part is None else found.after(chain.part_equations(bodies, *part))


def least_norm(equations: Equations, weight: FloatArray, wish: FloatArray) -> FloatArray:
    """Returns what has to be added to joint steps (k, n) for them to remove what is left, of least weighted norm."""
    J = equations.slope
    JW = J * weight
    gram = product(JW, np.swapaxes(J, -1, -2))
    damp = 1e-12 + CLOSING.damping * np.square(np.minimum(equations.size, 1.0))
    gram = gram + damp[:, None, None] * np.eye(gram.shape[-1])
    right = equations.left - product(J, wish[..., None])[..., 0]
    found: FloatArray = product(np.swapaxes(JW, -1, -2), solve(gram, right[..., None]))[..., 0]
    return found
