"""Where seams may be worked: closed chains drawn at random, then followed along the seam to both sides."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dualarm_cli.closed_chain.closing import close
from dualarm_cli.closed_chain.problem import NODES, SeamProblem
from dualarm_cli.closed_chain.rates import steady_times
from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.model.tool_path import Poses

MIDDLE = NODES // 2
"""Node at which chains are drawn."""
CLOSING_STEPS, FOLLOWING_STEPS, PULLS = 24, 8, 2
"""Newton steps from drawn joints, and from one node to the next; of these so many pull joints to the middle."""
CLOSED = 1e-8
"""Residual of a chain that counts as closed [m, radians by TURN]."""
WIDTH = 0.7
"""Share of the joints' ranges from which starts are drawn."""
WIDEST = 2.6
"""Widest half range from which starts are drawn [rad]."""
SPREAD = 0.3
"""Standard deviation of starts about joints that the file names [rad]."""
BEYOND = 0.5
"""Starts may be beyond joints' limits by this, as the steps that follow bring joints back [rad]."""
ROUNDED = 5e-3
"""How far joints may be beyond the bounds for decisions, which lie inside the limits [rad]."""
DEAR = 5.0
"""What a radian beyond limits counts, as a share of the time."""
FARTHEST = 0.7
"""Joints that differ by more from node to node jump [rad]."""


@dataclass(frozen=True)
class Starts:
    """Ways along a seam."""

    position: FloatArray
    """Joints at the nodes, quickest first [rad], shape (m, NODES, n)."""
    reached: float
    """Share of the seam that the farthest of all ways covers, from its middle."""
    reason: str
    """What ends the farthest way, where none covers the seam."""


def standing_joints(problem: SeamProblem, *, moving: bool) -> BoolArray:
    """Returns the joints that are the same all along the seam, shape (n,).

    Args:
        problem: the seam.
        moving: whether the part, or the platform under the tool, may move.
    """
    chain, hold = problem.chain, problem.chain.work.hold
    if hold.way is not None or (moving and not hold.stands):
        return ~chain.closes
    return ~chain.slave_joints


def part_poses(problem: SeamProblem, share: FloatArray) -> Poses | None:
    """Returns where the part has to be at shares of the seam, or None where the file leaves it open."""
    work = problem.chain.work
    if work.master is None or not work.hold.given:
        return None
    return work.hold.at(share)


def seam_starts(problem: SeamProblem, *, moving: bool = False) -> Starts:
    """Returns ways along the whole seam, quickest first; joints may be a little beyond their limits, which counts as slow.

    Joints of both arms are drawn at random, Newton steps close the chain at the seam's middle, and from there the tool
    follows the seam to both ends by steps of least norm that pull joints to the middle of their ranges.

    Args:
        problem: the seam.
        moving: whether joints that carry the part may move along the seam; the part stands else.
    """
    middle = _drawn(problem)
    stands = standing_joints(problem, moving=moving)
    ways, reached, reason = _followed(problem, middle, stands)
    if problem.clear is not None and len(ways):
        clear = problem.clear(ways.reshape(-1, ways.shape[-1])).reshape(len(ways), -1).all(axis=1)
        if not clear.any():
            return Starts(ways[:0], reached, "every way along it touches something or comes too near")
        ways = ways[clear]
    times = steady_times(ways, problem.limits).max(axis=-1)
    times *= 1.0 + DEAR * beyond_limits(problem, ways).max(axis=-1, initial=0.0)
    return Starts(ways[np.argsort(times, kind="stable")], reached, reason)


def _drawn(problem: SeamProblem) -> FloatArray:
    """Returns joints that close the chain at the seam's middle, (m, n) [rad]."""
    chain, limits = problem.chain, problem.limits
    random = np.random.default_rng(problem.seed)
    count, n = problem.samples, len(limits.joints)
    q = np.tile(problem.start, (count, 1))
    drawn = chain.closes
    middle = (limits.lower + limits.upper) / 2.0
    middle = np.where(np.isfinite(middle), middle, 0.0)
    if problem.near is not None:
        spread = SPREAD * np.linspace(0.0, 1.0, count)[:, None]
        q = np.where(drawn, problem.near + spread * random.normal(size=(count, n)), q)
        towards = problem.near
    else:
        half = np.minimum((limits.upper - limits.lower) / 2.0 * WIDTH, WIDEST)
        q = np.where(drawn, middle + half * random.uniform(-1.0, 1.0, size=(count, n)), q)
        towards = middle
    share = np.full(count, problem.shares[MIDDLE])
    weight = limits.velocity**2 * drawn
    found = close(
        chain,
        q,
        share,
        weight,
        CLOSING_STEPS,
        part=part_poses(problem, share),
        towards=towards,
        pulls=CLOSING_STEPS // 2,
    )
    good = (found.residual < CLOSED) & (beyond_limits(problem, found.position) < BEYOND)
    return found.position[good]


def beyond_limits(problem: SeamProblem, position: FloatArray) -> FloatArray:
    """Returns how far the joints of the chain are beyond their bounds, the farthest of each (..., n), shape (...) [rad]."""
    low, high = problem.bounds
    # Closing the chain moves joints a little from where they were decided; the margin to the limits has room for it.
    beyond = np.maximum(np.maximum(low - position, position - high) - ROUNDED, 0.0)
    found: FloatArray = (beyond * problem.chain.closes).max(axis=-1)
    return found


def _followed(
    problem: SeamProblem, middle: FloatArray, stands: BoolArray
) -> tuple[FloatArray, float, str]:
    """Returns whole ways (m, NODES, n), the share that the farthest covers, and what ends it."""
    ways = np.empty((len(middle), NODES, len(problem.start)))
    ways[:, MIDDLE] = middle
    if not len(middle):
        return ways, 0.0, "no joints bring tool and part together in the middle of the seam"
    alive = np.arange(len(middle))
    farthest, reason = 0, ""
    for side in (1, -1):
        for k in range(1, MIDDLE + 1):
            node = MIDDLE + side * k
            alive, why = _next(problem, ways, alive, node, side, stands)
            if not len(alive):
                share = (k - 1) / MIDDLE * 0.5 + (0.5 if side < 0 else 0.0)
                return ways[:0], share, why
    return ways[alive], 1.0, reason


def _next(
    problem: SeamProblem,
    ways: FloatArray,
    alive: np.ndarray,
    node: int,
    side: int,
    stands: BoolArray,
) -> tuple[np.ndarray, str]:
    """Fills in one node of the ways that are alive; returns those that still are, and what ended the last ones."""
    chain, limits = problem.chain, problem.limits
    here = ways[alive, node - side]
    guess = here
    if abs(node - MIDDLE) > 1:
        guess = here + (here - ways[alive, node - 2 * side])
    share = np.full(len(alive), problem.shares[node])
    middle = (limits.lower + limits.upper) / 2.0
    found = close(
        chain,
        guess,
        share,
        limits.velocity**2 * (chain.closes & ~stands),
        FOLLOWING_STEPS,
        part=part_poses(problem, share),
        towards=np.where(np.isfinite(middle), middle, 0.0) if problem.near is None else None,
        pulls=PULLS,
    )
    near = (found.residual < CLOSED) & (np.abs(found.position - here).max(axis=1) < FARTHEST)
    inside = beyond_limits(problem, found.position) < BEYOND
    good = near & inside
    ways[alive, node] = found.position
    return alive[good], "" if good.any() else _why(problem, found.position[near])


def _why(problem: SeamProblem, position: FloatArray) -> str:
    """Returns what ended the last ways, of which these (k, n) [rad] got there: a joint's limit, or out of reach."""
    work, limits = problem.chain.work, problem.limits
    if not len(position):
        also = "" if work.downhand is None else f" with its surface within {np.rad2deg(work.downhand):g} deg of upwards"
        return f"the {work.slave} arm does not reach it{also}, or is stretched or singular there"
    low, high = problem.bounds
    beyond = np.maximum(low - position, position - high) * problem.chain.closes
    _, joint = np.unravel_index(int(np.argmax(beyond)), beyond.shape)
    value = position[int(np.argmax(beyond[:, joint])), joint]
    bound = limits.upper[joint] if value > high[joint] else limits.lower[joint]
    return f"joint {limits.joints[joint]} comes to its limit of {np.rad2deg(bound):.1f} deg"
