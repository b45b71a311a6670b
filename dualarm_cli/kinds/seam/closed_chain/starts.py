"""Starts of seams: random closed chains, followed along the seam to both ends."""

from __future__ import annotations

from functools import partial

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.kinds.seam.closed_chain.chain import TURN
from dualarm_cli.kinds.seam.closed_chain.closing import Closed, all_equations, close
from dualarm_cli.kinds.seam.closed_chain.posture_paths import nearest_turns, path_cost
from dualarm_cli.kinds.seam.closed_chain.problem import NoSeam, SeamProblem
from dualarm_cli.model.curves.tool_path import Poses
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal


@dataclass(frozen=True)
class SeamStartSettings:
    """Settings of the search for a seam's starts."""

    finer: int = 8
    """Steps per node interval in the search for the first place that fails."""
    closing_steps: int = 24
    """Newton steps that close the chain from random joints."""
    following_steps: int = 8
    """Newton steps from one node to the next."""
    pulls: int = 2
    """Number of first Newton steps per node that pull joints to mid-range."""
    width: float = 0.7
    """Fraction of the joints' ranges for random starts."""
    widest: float = 2.6
    """Largest half range of random starts [rad]."""
    about: float = 0.7
    """Standard deviation of starts around the current joints [rad]."""
    spread: float = 0.3
    """Standard deviation of starts around the file's posture [rad]."""
    beyond: float = 0.5
    """Largest violation of joint limits accepted in the search for starts [rad].

    Later steps bring the joints back.
    """
    farthest: float = 0.7
    """Largest joint difference between nodes that is no jump [rad]."""
    rounded: float = 5e-3
    """Tolerance of the bounds of decisions, which are inside the limits [rad]."""
    violation_cost: float = 5.0
    """Cost of a radian beyond limits [fraction of the time]."""


STARTS = SeamStartSettings()

CLOSED = 1e-8
"""Residual of a chain that counts as closed [m, radians by TURN]."""


@dataclass(frozen=True)
class SeamStarts:
    """Posture paths along a seam."""

    position: FloatArray
    """Joints at the nodes, quickest first [rad], shape (m, nodes, n)."""
    failure: NoSeam | None
    """Failure of the longest posture path, if none covers the seam."""


def standing_joints(problem: SeamProblem, *, moving: bool) -> BoolArray:
    """Select the joints that are constant along the seam, shape (n,).

    Args:
        problem: the seam.
        moving: whether the part, or the platform under the tool, may move.
    """
    chain, hold = problem.chain, problem.chain.work.hold
    if hold.part_path is not None or (moving and not hold.stands):
        return ~chain.closes
    return ~chain.slave_joints


def part_poses(problem: SeamProblem, share: FloatArray) -> Poses | None:
    """Return the part's required poses along the seam, or None if free."""
    work = problem.chain.work
    if work.master is None or not work.hold.given:
        return None
    return work.hold.at(share)


def seam_starts(problem: SeamProblem, *, moving: bool = False) -> SeamStarts:
    """Find posture paths along the whole seam, quickest first.

    Joints may be a little beyond limits, at a cost.

    Joints of both arms are random, and Newton steps close the chain at the seam's middle. From there the tool follows
    the seam to both ends by steps of least norm that pull joints to the middle of their ranges.

    Args:
        problem: the seam.
        moving: whether joints that carry the part may move along the seam; otherwise it stands.
    """
    stands = standing_joints(problem, moving=moving)
    middle = 0 if problem.begin is not None else problem.nodes // 2
    paths = np.empty((0, problem.nodes, len(problem.start)))
    starts = _closed_starts(problem, middle)
    if len(starts):
        paths = np.empty((len(starts), problem.nodes, starts.shape[1]))
        paths[:, middle] = starts
        active = np.arange(len(starts))
        for nodes in (range(middle + 1, problem.nodes), range(middle - 1, -1, -1)):
            for node in nodes:
                active = (
                    active[_extend(problem, paths, active, node, nodes.step, stands)]
                    if len(active)
                    else active
                )
        paths = paths[active]
    if not len(paths):
        return SeamStarts(paths, _first_failure(problem, stands))
    if problem.is_free is not None:
        clear = (
            problem.is_free(paths.reshape(-1, paths.shape[-1])).reshape(len(paths), -1).all(axis=1)
        )
        if not clear.any():
            return SeamStarts(paths[:0], _all_touch(problem, paths))
        paths = paths[clear]
    if problem.begin is None:
        paths = nearest_turns(problem, paths)
    costs = np.array([path_cost(problem, path) for path in paths])
    costs *= 1.0 + STARTS.violation_cost * beyond_limits(problem, paths).max(axis=-1, initial=0.0)
    return SeamStarts(paths[np.argsort(costs, kind="stable")], None)


def _all_touch(problem: SeamProblem, paths: FloatArray) -> NoSeam:
    """Describe the first collision of the posture path with the fewest collisions."""
    least = []
    if problem.is_free is not None and problem.nearest_bodies is not None:
        free = problem.is_free(paths.reshape(-1, paths.shape[-1])).reshape(len(paths), -1)
        best = int(free.sum(axis=1).argmax())
        node = int(np.argmin(free[best]))
        place = problem.shares[node] * problem.chain.work.length * 1e3
        data = {"cause": problem.nearest_bodies(paths[best, node]), "mm": place}
        least = [Refusal("seam_touches_least", data=data)]
    return NoSeam(Refusal("seam_all_touch", data={"least": least}), 1.0)


def _first_failure(problem: SeamProblem, stands: BoolArray) -> NoSeam:
    """Find the seam's first failing place, by the posture path that gets farthest."""
    starts = _closed_starts(problem, 0)
    if not len(starts):
        return NoSeam(_start_failure(problem), 0.0)
    current = before = starts
    fine = np.linspace(0.0, 1.0, STARTS.finer * (problem.nodes - 1) + 1)
    for k in range(1, len(fine)):
        guess = current + (current - before) * (k > 1)
        closed = _step(problem, guess, fine[k], stands)
        continuous = (closed.residual < CLOSED) & (
            np.abs(closed.position - current).max(axis=1) < STARTS.farthest
        )
        valid = continuous & (beyond_limits(problem, closed.position) < STARTS.beyond)
        if not valid.any():
            return NoSeam(_failure_cause(problem, closed.position[continuous]), float(fine[k]))
        before, current = current[valid], closed.position[valid]
    return NoSeam(Refusal("seam_jumps"), 1.0)


def _start_failure(problem: SeamProblem) -> Refusal:
    """Explain why no random start has tool and part at the seam's start."""
    closed = _closed_draws(problem, 0)
    nearest = int(np.argmin(closed.residual))
    if closed.residual[nearest] > CLOSED:
        data = {"mm": closed.residual[nearest] * 1e3, "turn": TURN}
        return Refusal("seam_apart", data=data)
    closed_joints = closed.position[closed.residual < CLOSED]
    nearest = int(np.argmin(beyond_limits(problem, closed_joints)))
    return _failure_cause(problem, closed_joints[nearest : nearest + 1])


def _closed_starts(problem: SeamProblem, node: int) -> FloatArray:
    """Find joints that close the chain at a node, (m, n) [rad]."""
    if problem.begin is not None:
        return problem.begin[None]
    closed = _closed_draws(problem, node)
    valid = (closed.residual < CLOSED) & (beyond_limits(problem, closed.position) < STARTS.beyond)
    return closed.position[valid]


def _closed_draws(problem: SeamProblem, node: int) -> Closed:
    """Draw random joints and close the chain at a node where possible."""
    chain, limits = problem.chain, problem.limits
    random = np.random.default_rng(problem.seed)
    count, n = problem.samples, len(limits.joints)
    q = np.tile(problem.start, (count, 1))
    is_drawn = chain.closes
    middle = (limits.lower + limits.upper) / 2.0
    middle = np.where(np.isfinite(middle), middle, 0.0)
    if problem.reference is not None:
        spread = STARTS.spread * np.linspace(0.0, 1.0, count)[:, None]
        q = np.where(is_drawn, problem.reference + spread * random.normal(size=(count, n)), q)
        towards = problem.reference
    else:
        half = np.minimum((limits.upper - limits.lower) / 2.0 * STARTS.width, STARTS.widest)
        wide = middle + half * random.uniform(-1.0, 1.0, size=(count, n))
        about = problem.start + STARTS.about * random.normal(size=(count, n))
        # Half of the starts are around the current joints, to find the nearest of equal posture paths.
        is_local = (np.arange(count) % 2 == 0)[:, None] & (problem.transfer_times is not None)
        q = np.where(is_drawn, np.where(is_local, about, wide), q)
        towards = middle
    share = np.full(count, problem.shares[node])
    weight = np.square(limits.velocity) * is_drawn
    return close(
        partial(all_equations, chain, share=share, part=part_poses(problem, share)),
        q,
        weight,
        STARTS.closing_steps,
        towards=towards,
        pulls=STARTS.closing_steps // 2,
    )


def beyond_limits(problem: SeamProblem, position: FloatArray) -> FloatArray:
    """Compute the largest bound violation of chain joints (..., n) [rad], shape (...)."""
    low, high = problem.bounds
    # Closing the chain moves joints a little; the margin between bounds and limits covers it.
    beyond = np.maximum(np.maximum(low - position, position - high) - STARTS.rounded, 0.0)
    largest: FloatArray = (beyond * problem.chain.closes).max(axis=-1)
    return largest


def _extend(
    problem: SeamProblem,
    paths: FloatArray,
    active: IntArray,
    node: int,
    side: int,
    stands: BoolArray,
) -> BoolArray:
    """Extend active posture paths by one node; return which stay active."""
    current = paths[active, node - side]
    # Posture paths have no previous node at their begin.
    first = node - side == (0 if problem.begin is not None else problem.nodes // 2)
    guess = current if first else current + (current - paths[active, node - 2 * side])
    closed = _step(problem, guess, problem.shares[node], stands)
    paths[active, node] = closed.position
    continuous = (closed.residual < CLOSED) & (
        np.abs(closed.position - current).max(axis=1) < STARTS.farthest
    )
    return np.asarray(continuous & (beyond_limits(problem, closed.position) < STARTS.beyond))


def _step(problem: SeamProblem, guess: FloatArray, share: float, stands: BoolArray) -> Closed:
    """Close the chain at a fraction of the seam near joints (k, n) [rad]."""
    chain, limits = problem.chain, problem.limits
    shares = np.full(len(guess), share)
    middle = (limits.lower + limits.upper) / 2.0
    return close(
        partial(all_equations, chain, share=shares, part=part_poses(problem, shares)),
        guess,
        np.square(limits.velocity) * (chain.closes & ~stands),
        STARTS.following_steps,
        towards=np.where(np.isfinite(middle), middle, 0.0) if problem.reference is None else None,
        pulls=STARTS.pulls,
    )


def why_impossible(problem: SeamProblem, paths: list[FloatArray]) -> NoSeam:
    """Describe the fault of the best attempt: limit, collision or end.

    Args:
        problem: the seam.
        paths: infeasible posture paths, each (nodes, n) [rad].
    """
    beyond = [beyond_limits(problem, path) for path in paths]
    best = int(np.argmin([violation.max() for violation in beyond]))
    outside = np.flatnonzero(beyond[best] > 0.0)
    if len(outside):
        node = int(outside[0])
        return NoSeam(
            _failure_cause(problem, paths[best][node : node + 1]), float(problem.shares[node])
        )
    within = np.array(
        [path for path, violation in zip(paths, beyond, strict=True) if violation.max() == 0.0]
    )
    if problem.is_free is not None:
        free = problem.is_free(within.reshape(-1, within.shape[-1])).reshape(len(within), -1)
        if not free.all(axis=1).any():
            return _all_touch(problem, within)
    return NoSeam(Refusal("seam_goes_on"), 1.0)


def _failure_cause(problem: SeamProblem, position: FloatArray) -> Refusal:
    """Describe what ended posture paths at joints (k, n) [rad]: limit or reach."""
    work, limits = problem.chain.work, problem.limits
    if not len(position):
        downhand = []
        if work.downhand is not None:
            downhand = [Refusal("seam_upwards", data={"degrees": np.rad2deg(work.downhand)})]
        return Refusal("seam_not_reached", arm=work.slave, data={"downhand": downhand})
    low, high = problem.bounds
    beyond = np.maximum(low - position, position - high) * problem.chain.closes
    _, joint = np.unravel_index(int(np.argmax(beyond)), beyond.shape)
    value = position[int(np.argmax(beyond[:, joint])), joint]
    bound = limits.upper[joint] if value > high[joint] else limits.lower[joint]
    data = {"joint": limits.joints[joint], "degrees": np.rad2deg(bound)}
    return Refusal("seam_joint_limit", data=data)
