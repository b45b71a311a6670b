"""Starts of seams: closed chains drawn at random, followed along the seam to both sides."""

from __future__ import annotations

from functools import partial

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.kinds.seam.closed_chain.chain import TURN
from dualarm_cli.kinds.seam.closed_chain.closing import Closed, all_equations, close
from dualarm_cli.kinds.seam.closed_chain.problem import NoSeam, SeamProblem
from dualarm_cli.kinds.seam.closed_chain.ways import turned_back, way_cost
from dualarm_cli.model.curves.tool_path import Poses
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal


@dataclass(frozen=True)
class SeamStartSettings:
    """Numbers that steer the search for a seam's starts."""

    finer: int = 8
    """Steps from node to node where the first place that fails is looked for."""
    closing_steps: int = 24
    """Newton steps that close the chain from drawn joints."""
    following_steps: int = 8
    """Newton steps from one node to the next."""
    pulls: int = 2
    """First Newton steps from node to node that pull joints to their middle."""
    width: float = 0.7
    """Share of the joints' ranges from which starts are drawn."""
    widest: float = 2.6
    """Widest half range from which starts are drawn [rad]."""
    about: float = 0.7
    """Standard deviation of starts about where the robot is [rad]."""
    spread: float = 0.3
    """Standard deviation of starts about joints that the file names [rad]."""
    beyond: float = 0.5
    """Largest violation of joint limits accepted in the search for starts [rad].

    Later steps bring the joints back.
    """
    farthest: float = 0.7
    """Joints that differ by more from node to node jump [rad]."""
    rounded: float = 5e-3
    """How far joints may be beyond the bounds for decisions, which lie inside the limits [rad]."""
    dear: float = 5.0
    """What a radian beyond limits counts, as a share of the time."""


STARTS = SeamStartSettings()

CLOSED = 1e-8
"""Residual of a chain that counts as closed [m, radians by TURN]."""


@dataclass(frozen=True)
class SeamStarts:
    """Ways along a seam."""

    position: FloatArray
    """Joints at the nodes, quickest first [rad], shape (m, nodes, n)."""
    failure: NoSeam | None
    """What ends the farthest way, where none covers the seam."""


def standing_joints(problem: SeamProblem, *, moving: bool) -> BoolArray:
    """Returns the joints that are the same all along the seam, shape (n,).

    Args:
        problem: the seam.
        moving: whether the part, or the platform under the tool, may move.
    """
    chain, hold = problem.chain, problem.chain.work.hold
    if hold.part_path is not None or (moving and not hold.stands):
        return ~chain.closes
    return ~chain.slave_joints


def part_poses(problem: SeamProblem, share: FloatArray) -> Poses | None:
    """Returns where the part has to be at shares of the seam, or None where the file leaves it open."""
    work = problem.chain.work
    if work.master is None or not work.hold.given:
        return None
    return work.hold.at(share)


def seam_starts(problem: SeamProblem, *, moving: bool = False) -> SeamStarts:
    """Returns ways along the whole seam, quickest first; joints may be a little beyond limits, which counts as slow.

    Joints of both arms are drawn at random, Newton steps close the chain at the seam's middle, and from there the tool
    follows the seam to both ends by steps of least norm that pull joints to the middle of their ranges.

    Args:
        problem: the seam.
        moving: whether joints that carry the part may move along the seam; the part stands else.
    """
    stands = standing_joints(problem, moving=moving)
    middle = 0 if problem.begin is not None else problem.nodes // 2
    ways = np.empty((0, problem.nodes, len(problem.start)))
    drawn = _drawn(problem, middle)
    if len(drawn):
        ways = np.empty((len(drawn), problem.nodes, drawn.shape[1]))
        ways[:, middle] = drawn
        alive = np.arange(len(drawn))
        for nodes in (range(middle + 1, problem.nodes), range(middle - 1, -1, -1)):
            for node in nodes:
                alive = (
                    alive[_next(problem, ways, alive, node, nodes.step, stands)]
                    if len(alive)
                    else alive
                )
        ways = ways[alive]
    if not len(ways):
        return SeamStarts(ways, _first_failure(problem, stands))
    if problem.clear is not None:
        clear = problem.clear(ways.reshape(-1, ways.shape[-1])).reshape(len(ways), -1).all(axis=1)
        if not clear.any():
            return SeamStarts(ways[:0], _all_touch(problem, ways))
        ways = ways[clear]
    if problem.begin is None:
        ways = turned_back(problem, ways)
    costs = np.array([way_cost(problem, way) for way in ways])
    costs *= 1.0 + STARTS.dear * beyond_limits(problem, ways).max(axis=-1, initial=0.0)
    return SeamStarts(ways[np.argsort(costs, kind="stable")], None)


def _all_touch(problem: SeamProblem, ways: FloatArray) -> NoSeam:
    """Return that all ways touch, with the first touch of the way that touches least."""
    least = []
    if problem.clear is not None and problem.what_touches is not None:
        free = problem.clear(ways.reshape(-1, ways.shape[-1])).reshape(len(ways), -1)
        best = int(free.sum(axis=1).argmax())
        node = int(np.argmin(free[best]))
        place = problem.shares[node] * problem.chain.work.length * 1e3
        more = {"cause": problem.what_touches(ways[best, node]), "mm": place}
        least = [Refusal("seam_touches_least", more=more)]
    return NoSeam(Refusal("seam_all_touch", more={"least": least}), 1.0)


def _first_failure(problem: SeamProblem, stands: BoolArray) -> NoSeam:
    """Returns the first place of the seam that fails, from its begin, and why: that of the way that gets farthest."""
    drawn = _drawn(problem, 0)
    if not len(drawn):
        return NoSeam(_apart(problem), 0.0)
    here = before = drawn
    fine = np.linspace(0.0, 1.0, STARTS.finer * (problem.nodes - 1) + 1)
    for k in range(1, len(fine)):
        guess = here + (here - before) * (k > 1)
        found = _step(problem, guess, fine[k], stands)
        near = (found.residual < CLOSED) & (
            np.abs(found.position - here).max(axis=1) < STARTS.farthest
        )
        good = near & (beyond_limits(problem, found.position) < STARTS.beyond)
        if not good.any():
            return NoSeam(_why(problem, found.position[near]), float(fine[k]))
        before, here = here[good], found.position[good]
    return NoSeam(Refusal("seam_jumps"), 1.0)


def _apart(problem: SeamProblem) -> Refusal:
    """Returns why nothing that was drawn has tool and part together where the seam begins."""
    found = _closed_draws(problem, 0)
    nearest = int(np.argmin(found.residual))
    if found.residual[nearest] > CLOSED:
        more = {"mm": found.residual[nearest] * 1e3, "turn": TURN}
        return Refusal("seam_apart", more=more)
    held = found.position[found.residual < CLOSED]
    nearest = int(np.argmin(beyond_limits(problem, held)))
    return _why(problem, held[nearest : nearest + 1])


def _drawn(problem: SeamProblem, node: int) -> FloatArray:
    """Returns joints that close the chain at a node, (m, n) [rad]."""
    if problem.begin is not None:
        return problem.begin[None]
    found = _closed_draws(problem, node)
    good = (found.residual < CLOSED) & (beyond_limits(problem, found.position) < STARTS.beyond)
    return found.position[good]


def _closed_draws(problem: SeamProblem, node: int) -> Closed:
    """Returns joints that were drawn, after Newton steps that close the chain at a node where they can."""
    chain, limits = problem.chain, problem.limits
    random = np.random.default_rng(problem.seed)
    count, n = problem.samples, len(limits.joints)
    q = np.tile(problem.start, (count, 1))
    drawn = chain.closes
    middle = (limits.lower + limits.upper) / 2.0
    middle = np.where(np.isfinite(middle), middle, 0.0)
    if problem.near is not None:
        spread = STARTS.spread * np.linspace(0.0, 1.0, count)[:, None]
        q = np.where(drawn, problem.near + spread * random.normal(size=(count, n)), q)
        towards = problem.near
    else:
        half = np.minimum((limits.upper - limits.lower) / 2.0 * STARTS.width, STARTS.widest)
        wide = middle + half * random.uniform(-1.0, 1.0, size=(count, n))
        about = problem.start + STARTS.about * random.normal(size=(count, n))
        # Every other one about where the robot is: of ways as good as each other the nearer one shall be met.
        near = (np.arange(count) % 2 == 0)[:, None] & (problem.coming is not None)
        q = np.where(drawn, np.where(near, about, wide), q)
        towards = middle
    share = np.full(count, problem.shares[node])
    weight = np.square(limits.velocity) * drawn
    return close(
        partial(all_equations, chain, share=share, part=part_poses(problem, share)),
        q,
        weight,
        STARTS.closing_steps,
        towards=towards,
        pulls=STARTS.closing_steps // 2,
    )


def beyond_limits(problem: SeamProblem, position: FloatArray) -> FloatArray:
    """Returns how far the chain's joints (..., n) are beyond their bounds, the farthest of them, shape (...) [rad]."""
    low, high = problem.bounds
    # Closing the chain moves joints a little from where they were decided; the margin to the limits has room for it.
    beyond = np.maximum(np.maximum(low - position, position - high) - STARTS.rounded, 0.0)
    found: FloatArray = (beyond * problem.chain.closes).max(axis=-1)
    return found


def _next(
    problem: SeamProblem,
    ways: FloatArray,
    alive: IntArray,
    node: int,
    side: int,
    stands: BoolArray,
) -> BoolArray:
    """Fills in one node of the ways that are alive, and returns which of them still are."""
    here = ways[alive, node - side]
    # Where ways begin there is no place before.
    first = node - side == (0 if problem.begin is not None else problem.nodes // 2)
    guess = here if first else here + (here - ways[alive, node - 2 * side])
    found = _step(problem, guess, problem.shares[node], stands)
    ways[alive, node] = found.position
    near = (found.residual < CLOSED) & (np.abs(found.position - here).max(axis=1) < STARTS.farthest)
    return np.asarray(near & (beyond_limits(problem, found.position) < STARTS.beyond))


def _step(problem: SeamProblem, guess: FloatArray, share: float, stands: BoolArray) -> Closed:
    """Returns joints (k, n) [rad] that close the chain at a share of the seam, near a guess."""
    chain, limits = problem.chain, problem.limits
    shares = np.full(len(guess), share)
    middle = (limits.lower + limits.upper) / 2.0
    return close(
        partial(all_equations, chain, share=shares, part=part_poses(problem, shares)),
        guess,
        np.square(limits.velocity) * (chain.closes & ~stands),
        STARTS.following_steps,
        towards=np.where(np.isfinite(middle), middle, 0.0) if problem.near is None else None,
        pulls=STARTS.pulls,
    )


def why_impossible(problem: SeamProblem, ways: list[FloatArray]) -> NoSeam:
    """Describe the fault of the best attempt: limit, collision or end.

    Args:
        problem: the seam.
        ways: joints at its nodes, none of which can be worked, each (nodes, n) [rad].
    """
    beyond = [beyond_limits(problem, way) for way in ways]
    best = int(np.argmin([one.max() for one in beyond]))
    outside = np.flatnonzero(beyond[best] > 0.0)
    if len(outside):
        node = int(outside[0])
        return NoSeam(_why(problem, ways[best][node : node + 1]), float(problem.shares[node]))
    within = np.array([way for way, one in zip(ways, beyond, strict=True) if one.max() == 0.0])
    if problem.clear is not None:
        free = problem.clear(within.reshape(-1, within.shape[-1])).reshape(len(within), -1)
        if not free.all(axis=1).any():
            return _all_touch(problem, within)
    return NoSeam(Refusal("seam_goes_on"), 1.0)


def _why(problem: SeamProblem, position: FloatArray) -> Refusal:
    """Returns what ended the last ways, of which these (k, n) [rad] got there: a joint's limit, or out of reach."""
    work, limits = problem.chain.work, problem.limits
    if not len(position):
        downhand = []
        if work.downhand is not None:
            downhand = [Refusal("seam_upwards", more={"degrees": np.rad2deg(work.downhand)})]
        return Refusal("seam_not_reached", arm=work.slave, more={"downhand": downhand})
    low, high = problem.bounds
    beyond = np.maximum(low - position, position - high) * problem.chain.closes
    _, joint = np.unravel_index(int(np.argmax(beyond)), beyond.shape)
    value = position[int(np.argmax(beyond[:, joint])), joint]
    bound = limits.upper[joint] if value > high[joint] else limits.lower[joint]
    more = {"joint": limits.joints[joint], "degrees": np.rad2deg(bound)}
    return Refusal("seam_joint_limit", more=more)
