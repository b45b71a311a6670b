"""The joints anywhere along a seam: the solver's nodes joined smoothly, the chain closed at every place."""

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
    """Residual between two places above which there is one more [m, radians by TURN]."""
    halvings: int = 6
    """Maximum number of rounds in which places are added."""
    closing_steps: int = 6
    """Newton steps at each place."""
    closed: float = 1e-9
    """Residual that counts as closed [m, radians by TURN]."""
    evened_out: tuple[float, ...] = (0.0, 0.6, 1.2, 2.0, 3.0)
    """Half widths over which joints are evened out, in distances of nodes; the one that allows most speed is taken."""
    farthest: float = 0.05
    """Joints that closing the chain moves by more have come to another way [rad]."""
    faded: float = 0.2
    """Share of a seam within which it comes to its own from where another one ended."""
    stands: float = 1e-9
    """Joints that move less along the nodes stand [rad]."""
    per_node: int = 16
    """Places at which the chain is closed at first, from node to node."""


PATH = SeamPathSettings()


@dataclass(frozen=True)
class SeamPath:
    """Joints along a seam as a smooth function of the share: a quintic spline through places with the chain closed."""

    chain: Chain
    """Whose equations it keeps."""
    share: FloatArray
    """The places, rising from 0 to 1, shape (k,): closer where the chain would open between them."""
    position: FloatArray
    """All joints there [rad], shape (k, n)."""

    def __post_init__(self) -> None:
        """Freezes the arrays."""
        for name in ("share", "position"):
            object.__setattr__(self, name, readonly(getattr(self, name)))

    @classmethod
    def of(cls, problem: SeamProblem, motion: SeamMotion) -> SeamPath | None:
        """Returns the joints anywhere along a seam by those at the nodes; None where the chain opens in between."""
        even = np.linspace(0.0, 1.0, PATH.per_node * (len(problem.shares) - 1) + 1)
        position = quintic_spline(problem.shares, motion.position)(even)
        best, highest = None, 0.0
        for width in PATH.evened_out:
            near = quintic_spline(even, _evened_out(position, width))
            found = cls._closed(problem, motion, even, near)
            if found is None:
                continue
            speed = steady_limit(found.rates, problem.limits).speed
            if speed > highest:
                best, highest = found, speed
        return best

    @classmethod
    def _closed(
        cls, problem: SeamProblem, motion: SeamMotion, share: FloatArray, near: Any
    ) -> SeamPath | None:
        """Returns the path next to joints that nearly close the chain, with as many places as keep it closed.

        Args:
            problem: the seam.
            motion: joints at its nodes.
            share: the places to begin with, shape (k,).
            near: joints [rad] as a function of the share.
        """
        position = _closed(problem, motion, share, near(share))
        if position is None:
            return None
        for _ in range(PATH.halvings):
            middle = (share[1:] + share[:-1]) / 2.0
            between = quintic_spline(share, position)(middle)
            left = all_equations(problem.chain, between, middle, _poses(problem, middle)).exact
            opens = left.size > PATH.between
            if not opens.any():
                break
            # The spline between two places hangs on their neighbours too.
            opens = opens | np.append(opens[1:], False) | np.append(False, opens[:-1])
            more = _closed(problem, motion, middle[opens], near(middle[opens]))
            if more is None:
                return None
            share = np.concatenate([share, middle[opens]])
            order = np.argsort(share, kind="stable")
            share, position = share[order], np.concatenate([position, more])[order]
        if problem.begin is not None:
            position = _from(problem.begin, share, position)
        return cls(problem.chain, share, position)

    @cached_property
    def _joints(self) -> Any:
        return quintic_spline(self.share, self.position)

    def at(self, share: FloatArray) -> FloatArray:
        """Returns all joints at shares (k,) of the seam [rad], shape (k, n)."""
        return np.asarray(self._joints(share), dtype=np.float64)

    @cached_property
    def even(self) -> FloatArray:
        """Equidistant shares, as close as the closest places, shape (m,)."""
        return np.linspace(0.0, 1.0, round(1.0 / float(np.diff(self.share).min())) + 1)

    @cached_property
    def rates(self) -> PathRates:
        """How the joints change with the share, at equidistant shares."""
        first, second, third = (self._joints(self.even, order) for order in (1, 2, 3))
        return PathRates(first, second, third)

    def tool_rates(self, cell: Cell) -> FloatArray:
        """Returns how far the tool that moves most goes in the world per unit of the share, at `even`, (m,) [m].

        Args:
            cell: with the arms' own tools; in the chain the master's is the part.
        """
        body, first = WholeBody(cell), self.rates.first
        J = np.array([body.at(q).J for q in self.at(self.even)])
        velocity = product(J, first[..., None]).reshape(len(first), -1, 6)[..., :3]
        found: FloatArray = norm(velocity, axis=2).max(axis=1)
        return found


def _closed(
    problem: SeamProblem, motion: SeamMotion, share: FloatArray, position: FloatArray
) -> FloatArray | None:
    """Returns joints (k, n) [rad] with the chain closed; None where it cannot be, or beyond a limit or freedom."""
    chain, limits = problem.chain, problem.limits
    poses = _poses(problem, share)
    found = close(
        # One-sided equations are left aside: where they come and go, joints have kinks along a seam.
        lambda q: all_equations(chain, q, share, poses).exact,
        position,
        np.square(limits.velocity) * (chain.closes & ~_stands(problem, motion)),
        PATH.closing_steps,
    )
    q = found.position
    inside = ((q >= limits.lower) & (q <= limits.upper))[:, chain.closes].all()
    moved = float(np.abs(q - position).max())
    good = inside and found.residual.max() < PATH.closed and moved < PATH.farthest
    return q if good and not chain.leans_too_far(chain.bodies(q), share) else None


def _from(begin: FloatArray, share: FloatArray, position: FloatArray) -> FloatArray:
    """Shift the first part of a seam's joints to an exact begin.

    Where a seam goes on from another, what files round away opens the chain a little at first.

    Args:
        begin: joints where the other seam ended [rad], shape (n,).
        share: shares of the seam, shape (k,).
        position: joints at these shares [rad], shape (k, n); after the share `faded` they stay as they are.
    """
    x = np.clip(share / PATH.faded, 0.0, 1.0)
    fade = 1.0 - power(x, 4) * (35.0 - 84.0 * x + 70.0 * np.square(x) - 20.0 * cube(x))
    return position + fade[:, None] * (begin - position[0])


def _evened_out(position: FloatArray, width: float) -> FloatArray:
    """Returns joints (k, n) with what is shorter than about some nodes' distance taken away: a Whittaker smoother.

    A solver's accelerations have corners where a limit decides, and the chain's closing between nodes adds more. What
    is least is the square of the change plus that of fourth differences: cubics stay as they are, up to both ends,
    where means would bend the motion straight and so cost jerk.
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
    # The change is solved for, not the joints: it is small, and so is what rounding leaves of it.
    return np.asarray(position - solve_banded(rough, weight * np.diff(uneven, 4, axis=0)))


def _stands(problem: SeamProblem, motion: SeamMotion) -> BoolArray:
    """Returns the joints that are the same at all nodes, shape (n,)."""
    still = np.ptp(motion.position, axis=0) < PATH.stands
    return standing_joints(problem, moving=True) | still


def _poses(problem: SeamProblem, share: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Returns where the part has to be; a part that stands does so by its master's joints, which stand."""
    return None if problem.chain.work.hold.stands else part_poses(problem, share)
