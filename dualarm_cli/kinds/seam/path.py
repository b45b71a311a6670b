"""Joints anywhere along a seam: the solver's nodes joined smoothly, the chain closed everywhere."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, readonly
from dualarm_cli.geometry.elementary import cube, power
from dualarm_cli.geometry.linear_systems import solve_banded
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.geometry.splines import quintic_spline
from dualarm_cli.kinds.seam.closed_chain.chain import Chain
from dualarm_cli.kinds.seam.closed_chain.closing import all_equations, close
from dualarm_cli.kinds.seam.closed_chain.problem import SeamMotion, SeamProblem
from dualarm_cli.kinds.seam.closed_chain.starts import part_poses, standing_joints
from dualarm_cli.kinematics.whole_body import WholeBody
from dualarm_cli.model.cell import Cell
from dualarm_cli.records import dataclass
from dualarm_cli.timing.steady_search import PathRates, steady_limit


@dataclass(frozen=True)
class SeamPathSettings:
    """Resolution and tolerances of a seam's joint path."""

    between: float = 5e-8
    """Residual between two places above which another one is added [m, radians by TURN]."""
    halvings: int = 6
    """Maximum number of rounds in which places are added."""
    closing_steps: int = 6
    """Newton steps at each place."""
    closed: float = 1e-9
    """Residual that counts as closed [m, radians by TURN]."""
    smoothing_widths: tuple[float, ...] = (0.0, 0.6, 1.2, 2.0, 3.0)
    """Half widths of the smoothing [node distances].

    The width that allows most speed is taken.
    """
    farthest: float = 0.05
    """Largest joint motion by closing the chain that stays on the posture path [rad]."""
    faded: float = 0.2
    """Fraction of a seam over which its joints join those of the seam before."""
    stands: float = 1e-9
    """Largest motion of a joint along the nodes that counts as standing [rad]."""
    per_node: int = 16
    """Number of initial places per node interval."""


PATH = SeamPathSettings()


@dataclass(frozen=True)
class SeamPath:
    """Joints along a seam as a quintic spline through places with a closed chain."""

    chain: Chain
    """Closed chain."""
    share: FloatArray
    """Places as fractions from 0 to 1, shape (k,).

    They are denser where the chain would open.
    """
    position: FloatArray
    """All joints at the places [rad], shape (k, n)."""

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for name in ("share", "position"):
            object.__setattr__(self, name, readonly(getattr(self, name)))

    @classmethod
    def of(cls, problem: SeamProblem, motion: SeamMotion) -> SeamPath | None:
        """Build the path from joints at the nodes.

        None if the chain opens in between.
        """
        even = np.linspace(0.0, 1.0, PATH.per_node * (len(problem.shares) - 1) + 1)
        position = quintic_spline(problem.shares, motion.position)(even)
        best, highest = None, 0.0
        for width in PATH.smoothing_widths:
            smooth = quintic_spline(even, _smoothed(position, width))
            path = cls._closed(problem, motion, even, smooth)
            if path is None:
                continue
            speed = steady_limit(path.rates, problem.limits).speed
            if speed > highest:
                best, highest = path, speed
        return best

    @classmethod
    def _closed(
        cls, problem: SeamProblem, motion: SeamMotion, share: FloatArray, smooth: Any
    ) -> SeamPath | None:
        """Close the chain along given joints, with as many places as necessary.

        Args:
            problem: the seam.
            motion: joints at its nodes.
            share: initial places, shape (k,).
            smooth: joints [rad] as a function of the place.
        """
        position = _closed(problem, motion, share, smooth(share))
        if position is None:
            return None
        for _ in range(PATH.halvings):
            middle = (share[1:] + share[:-1]) / 2.0
            between = quintic_spline(share, position)(middle)
            equations = all_equations(problem.chain, between, middle, _poses(problem, middle)).exact
            opens = equations.size > PATH.between
            if not opens.any():
                break
            # The spline between two places depends on their neighbours as well.
            opens = opens | np.append(opens[1:], False) | np.append(False, opens[:-1])
            added = _closed(problem, motion, middle[opens], smooth(middle[opens]))
            if added is None:
                return None
            share = np.concatenate([share, middle[opens]])
            order = np.argsort(share, kind="stable")
            share, position = share[order], np.concatenate([position, added])[order]
        if problem.begin is not None:
            position = _shifted_to(problem.begin, share, position)
        return cls(problem.chain, share, position)

    @cached_property
    def _joints(self) -> Any:
        return quintic_spline(self.share, self.position)

    def at(self, share: FloatArray) -> FloatArray:
        """Evaluate all joints at fractions (k,) of the seam [rad], shape (k, n)."""
        return np.asarray(self._joints(share), dtype=np.float64)

    @cached_property
    def even(self) -> FloatArray:
        """Equally spaced fractions, as close as the closest places, shape (m,)."""
        return np.linspace(0.0, 1.0, round(1.0 / float(np.diff(self.share).min())) + 1)

    @cached_property
    def rates(self) -> PathRates:
        """Derivatives of the joints by the fraction of the seam, at `even`."""
        first, second, third = (self._joints(self.even, order) for order in (1, 2, 3))
        return PathRates(first, second, third)

    def tool_rates(self, cell: Cell) -> FloatArray:
        """Compute the fastest tool's motion per fraction of the seam, at `even`, (m,) [m].

        Args:
            cell: cell with the arms' tools; the master's tool in the chain is the part.
        """
        body, first = WholeBody(cell), self.rates.first
        J = np.array([body.at(q).J for q in self.at(self.even)])
        velocity = product(J, first[..., None]).reshape(len(first), -1, 6)[..., :3]
        rates: FloatArray = norm(velocity, axis=2).max(axis=1)
        return rates


def _closed(
    problem: SeamProblem, motion: SeamMotion, share: FloatArray, position: FloatArray
) -> FloatArray | None:
    """Close the chain at joints (k, n) [rad]; None beyond a limit or freedom."""
    chain, limits = problem.chain, problem.limits
    poses = _poses(problem, share)
    closed = close(
        # One-sided equations are ignored: where they become active, joints would have kinks.
        lambda q: all_equations(chain, q, share, poses).exact,
        position,
        np.square(limits.velocity) * (chain.closes & ~_stands(problem, motion)),
        PATH.closing_steps,
    )
    q = closed.position
    inside = ((q >= limits.lower) & (q <= limits.upper))[:, chain.closes].all()
    moved = float(np.abs(q - position).max())
    good = inside and closed.residual.max() < PATH.closed and moved < PATH.farthest
    return q if good and not chain.leans_too_far(chain.bodies(q), share) else None


def _shifted_to(begin: FloatArray, share: FloatArray, position: FloatArray) -> FloatArray:
    """Shift the first part of a seam's joints to an exact begin.

    Where a seam continues another, the rounding of files opens the chain a little at first.

    Args:
        begin: joints where the other seam ended [rad], shape (n,).
        share: fractions of the seam, shape (k,).
        position: joints at these fractions [rad], shape (k, n); beyond the fraction `faded` they stay.
    """
    x = np.clip(share / PATH.faded, 0.0, 1.0)
    fade = 1.0 - power(x, 4) * (35.0 - 84.0 * x + 70.0 * np.square(x) - 20.0 * cube(x))
    return position + fade[:, None] * (begin - position[0])


def _smoothed(position: FloatArray, width: float) -> FloatArray:
    """Smooth joints (k, n) by a Whittaker smoother of a width in nodes.

    A solver's accelerations have corners at active limits, and closing the chain between nodes adds more. The smoother
    minimises the squares of the change and of fourth differences: cubics stay as they are, also at both ends, where
    moving means would distort the motion and cost jerk.
    """
    if width == 0.0:
        return position
    count = len(position)
    rough = np.zeros((count, 9))
    difference = np.array([1.0, -4.0, 6.0, -4.0, 1.0])
    for low in range(5):
        # The bands of the matrix DᵀD of fourth differences D, column 4 its diagonal.
        for high in range(5):
            band = rough[:, 4 + high - low]
            band[low : count - 4 + low] += difference[low] * difference[high]
    weight = power(width * PATH.per_node / np.pi, 8)
    uneven = np.zeros((count + 4, position.shape[1]))
    uneven[4:-4] = np.diff(position, 4, axis=0)
    rough *= weight
    rough[:, 4] += 1.0
    # The unknown is the change, not the joints: it is small, and so is its rounding error.
    return np.asarray(position - solve_banded(rough, weight * np.diff(uneven, 4, axis=0)))


def _stands(problem: SeamProblem, motion: SeamMotion) -> BoolArray:
    """Select the joints that are constant over all nodes, shape (n,)."""
    still = np.ptp(motion.position, axis=0) < PATH.stands
    return standing_joints(problem, moving=True) | still


def _poses(problem: SeamProblem, share: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Return the required poses of the part.

    A standing part has None, because its master's joints stand.
    """
    return None if problem.chain.work.hold.stands else part_poses(problem, share)
