"""The joints anywhere along a seam: the solver's nodes joined smoothly, the chain closed at every place."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from dualarm_cli.closed_chain.chain import Chain
from dualarm_cli.closed_chain.closing import close
from dualarm_cli.closed_chain.problem import NODES, SeamMotion, SeamProblem
from dualarm_cli.closed_chain.starts import part_poses, standing_joints
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, readonly
from dualarm_cli.kinematics.whole_body import WholeBody
from dualarm_cli.model.cell import Cell
from dualarm_cli.timing.steady_profile import PathRates
from dualarm_cli.timing.steady_search import steady_limit

PLACES = 641
"""Places along a seam at which the chain is closed."""
CLOSING_STEPS = 6
"""Newton steps there."""
CLOSED = 1e-9
"""Residual that counts as closed [m, radians by TURN]."""
EVENED_OUT = (0.0, 0.6, 1.2, 2.0, 3.0)
"""Half widths over which joints are evened out, in distances of nodes; the one that allows most speed is taken."""
FARTHEST = 0.05
"""Joints that closing the chain moves by more have come to another way [rad]."""
FADED = 0.2
"""Share of a seam within which it comes to its own from where another one ended."""
STANDS = 1e-9
"""Joints that move less along the nodes stand [rad]."""


@dataclass(frozen=True)
class SeamPath:
    """Joints along a seam as a smooth function of the share."""

    chain: Chain
    """Whose equations it keeps."""
    position: FloatArray
    """All joints at equidistant places [rad], shape (PLACES, n)."""

    def __post_init__(self) -> None:
        """Freezes the array."""
        object.__setattr__(self, "position", readonly(self.position))

    @classmethod
    def of(cls, problem: SeamProblem, motion: SeamMotion) -> SeamPath | None:
        """Returns the joints anywhere along a seam by those at the nodes; None where the chain opens in between."""
        from scipy.interpolate import make_interp_spline

        share = np.linspace(0.0, 1.0, PLACES)
        position = make_interp_spline(problem.shares, motion.position, k=5)(share)
        best, highest = None, 0.0
        for width in EVENED_OUT:
            closed = _closed(problem, motion, _evened_out(position, width))
            if closed is None:
                continue
            if problem.begin is not None:
                closed = _from(problem.begin, closed)
            found = cls(problem.chain, closed)
            speed = steady_limit(found.rates, problem.limits).speed
            if speed > highest:
                best, highest = found, speed
        return best

    @cached_property
    def _spline(self) -> Any:
        from scipy.interpolate import make_interp_spline

        return make_interp_spline(np.linspace(0.0, 1.0, PLACES), self.position, k=5)

    def at(self, share: FloatArray) -> FloatArray:
        """Returns all joints at shares (k,) of the seam [rad], shape (k, n)."""
        return np.asarray(self._spline(share), dtype=np.float64)

    @cached_property
    def rates(self) -> PathRates:
        """How the joints change with the share, at the places."""
        share = np.linspace(0.0, 1.0, PLACES)
        first, second, third = (self._spline(share, order) for order in (1, 2, 3))
        return PathRates(first, second, third)

    def tool_rates(self, cell: Cell) -> FloatArray:
        """Returns how far the tool that moves most goes in the world per unit of the share, at the places, [m] (k,).

        Args:
            cell: with the arms' own tools; in the chain the master's is the part.
        """
        body, first = WholeBody(cell), self.rates.first
        J = np.array([body.at(q).J for q in self.position])
        velocity = (J @ first[..., None]).reshape(len(first), -1, 6)[..., :3]
        found: FloatArray = np.linalg.norm(velocity, axis=2).max(axis=1)
        return found


def _closed(problem: SeamProblem, motion: SeamMotion, position: FloatArray) -> FloatArray | None:
    """Returns joints (PLACES, n) [rad] with the chain closed; None where it cannot be, or beyond a limit or freedom."""
    chain, limits, share = problem.chain, problem.limits, np.linspace(0.0, 1.0, PLACES)
    found = close(
        chain,
        position,
        share,
        limits.velocity**2 * (chain.closes & ~_stands(problem, motion)),
        CLOSING_STEPS,
        part=_poses(problem, share),
        exact=True,
    )
    q = found.position
    inside = ((q >= limits.lower) & (q <= limits.upper))[:, chain.closes].all()
    moved = float(np.abs(q - position).max())
    good = inside and found.residual.max() < CLOSED and moved < FARTHEST
    return q if good and not chain.leans_too_far(chain.bodies(q), share) else None


def _from(begin: FloatArray, position: FloatArray) -> FloatArray:
    """Returns joints (PLACES, n) that begin exactly where they have to (n,), and come to their own over FADED.

    Where a seam goes on from another, what files round away opens the chain a little at first.
    """
    x = np.clip(np.linspace(0.0, 1.0, len(position)) / FADED, 0.0, 1.0)
    fade = 1.0 - x**4 * (35.0 - 84.0 * x + 70.0 * x**2 - 20.0 * x**3)
    return position + fade[:, None] * (begin - position[0])


def _evened_out(position: FloatArray, width: float) -> FloatArray:
    """Returns means of joints (k, n) over some nodes' distance, fading to nothing at both ends.

    A solver's accelerations have corners where a limit decides, and the chain's closing between nodes adds more: a
    mean over W takes away what is shorter than W.
    """
    half = round(width * (len(position) - 1) / (NODES - 1))
    if half == 0:
        return position
    window = np.hanning(2 * half + 3)[1:-1]
    # Turned about the end points, so that straight ways stay straight.
    padded = np.pad(position, ((half, half), (0, 0)), mode="reflect", reflect_type="odd")
    means = np.stack(
        [np.convolve(column, window / window.sum(), mode="valid") for column in padded.T], axis=1
    )
    return np.asarray(means)


def _stands(problem: SeamProblem, motion: SeamMotion) -> BoolArray:
    """Returns the joints that are the same at all nodes, shape (n,)."""
    still = np.ptp(motion.position, axis=0) < STANDS
    return standing_joints(problem, moving=True) | still


def _poses(problem: SeamProblem, share: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Returns where the part has to be; a part that stands does so by its master's joints, which stand."""
    return None if problem.chain.work.hold.stands else part_poses(problem, share)
