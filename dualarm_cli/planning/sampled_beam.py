"""Beam search over the sampled stops of a sequence, guided by dynamic programming for each arm alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.planning.sampled_stops import StopSamples

Law = Callable[[FloatArray], FloatArray]
"""Times [s], shape (...), of displacements (..., n) [rad]."""
Costs = Callable[[int, FloatArray, Mapping[str, FloatArray], Mapping[str, IntArray]], FloatArray]
"""Stage, platform angles (s, k), joints before by arm (s, n) and samples taken by arm (s,): extra costs [s], (s,)."""


@dataclass(frozen=True)
class SampledSequence:
    """What the beam searches."""

    angles: FloatArray
    """Platform angles, shape (m, k); where the platform starts first."""
    stages: Sequence[Mapping[str, StopSamples]]
    """By stage, samples of the arms that have a stop in it."""
    start: Mapping[str, FloatArray]
    """Joints of each arm at the start [rad]."""
    arm_law: Mapping[str, Law]
    """Transfer times of each arm."""
    platform_law: Law
    """Times of the platform."""
    free_start: bool
    """Whether the first transfer is left out and a return leads to where the first approach begins."""
    returns: bool
    """Whether the sequence ends where it began."""
    extra: Costs | None = None
    """What a choice costs beyond its time."""


@dataclass(frozen=True)
class _States:
    """States after some stages; every array has one row for each."""

    cost: FloatArray
    angle: IntArray
    joints: Mapping[str, FloatArray]
    first: Mapping[str, FloatArray]
    first_angle: IntArray
    chosen: Mapping[str, IntArray]
    """Sample that each arm took in the last stage, -1 for none."""
    parent: IntArray


def beam_search(problem: SampledSequence, width: int) -> list[dict[str, int]] | None:
    """Returns by stage the sample that each arm takes, or None where no platform angle serves some stage.

    A stage lasts as long as its slower arm: max over arms of (max(transfer, platform) + lines and dwell). States are
    (platform angle, sample of each arm); of those that lead to one state the best is kept, and of all states those
    with the least cost so far plus what each arm alone needs in any case from there on (exact, backwards over its own
    samples; the larger of both arms). Our own combination of well-known parts.

    Args:
        problem: the samples.
        width: how many states are kept after each stage.
    """
    togo = {arm: _togo(problem, arm) for arm in problem.start}
    states = _States(
        np.zeros(1),
        np.zeros(1, dtype=np.int64),
        {arm: q[None] for arm, q in problem.start.items()},
        {arm: q[None] for arm, q in problem.start.items()},
        np.zeros(1, dtype=np.int64),
        {},
        np.zeros(1, dtype=np.int64),
    )
    history: list[_States] = []
    for k in range(len(problem.stages)):
        states = _expanded(problem, states, k, {arm: rest[k] for arm, rest in togo.items()}, width)
        if not len(states.cost):
            return None
        history.append(states)
    total = states.cost + _closing(problem, states)
    best = int(total.argmin())
    found: list[dict[str, int]] = []
    for states in reversed(history):
        found.append({a: int(c[best]) for a, c in states.chosen.items() if c[best] >= 0})
        best = int(states.parent[best])
    return found[::-1]


def _expanded(
    problem: SampledSequence,
    states: _States,
    k: int,
    rest: Mapping[str, FloatArray],
    width: int,
) -> _States:
    """Returns the best states after one more stage."""
    samples = problem.stages[k]
    arms = list(samples)
    turn = problem.platform_law(problem.angles[None] - problem.angles[states.angle][:, None])
    free = problem.free_start and k == 0
    each = {}
    for arm in arms:
        one = samples[arm]
        move = problem.arm_law[arm](one.first[None] - states.joints[arm][:, None])
        platform = turn[:, one.ways.row]
        each[arm] = np.maximum(move, platform) * (not free) + one.work
    found: list[tuple[FloatArray, FloatArray, IntArray, dict[str, IntArray], IntArray]] = []
    for a in range(len(problem.angles)):
        own = {arm: np.flatnonzero(samples[arm].ways.row == a) for arm in arms}
        if any(not len(index) for index in own.values()):
            continue
        found.append(_at_angle(states, a, arms, own, each, rest))
    if not found:
        none = np.empty(0, dtype=np.int64)
        return _States(np.empty(0), none, {}, {}, none, {}, none)
    cost, score, parent = (np.concatenate([one[i] for one in found]) for i in (0, 1, 2))
    angle = np.concatenate([one[4] for one in found])
    chosen = {arm: np.concatenate([one[3][arm] for one in found]) for arm in arms}
    if problem.extra is not None:
        # Extra costs are looked at for the best only: they are dear to compute.
        order = np.argsort(score, kind="stable")[: 4 * width]
        cost, score, parent, angle = cost[order], score[order], parent[order], angle[order]
        chosen = {arm: index[order] for arm, index in chosen.items()}
        before = {arm: q[parent] for arm, q in states.joints.items()}
        extra = problem.extra(k, problem.angles[angle], before, chosen)
        cost, score = cost + extra, score + extra
    best = np.argsort(score, kind="stable")[:width]
    return _taken(problem, states, k, cost[best], angle[best], parent[best], chosen, best)


def _at_angle(
    states: _States,
    a: int,
    arms: Sequence[str],
    own: Mapping[str, IntArray],
    each: Mapping[str, FloatArray],
    rest: Mapping[str, FloatArray],
) -> tuple[FloatArray, FloatArray, IntArray, dict[str, IntArray], IntArray]:
    """Returns cost, score, best parent and samples of all states at one platform angle, and that angle's number."""
    one = arms[0]
    length = each[one][:, own[one]]
    ahead = rest[one][own[one]]
    index = {one: own[one]}
    if len(arms) == 2:
        other = arms[1]
        length = np.maximum(length[:, :, None], each[other][:, own[other]][:, None])
        length = length.reshape(len(length), -1)
        ahead = np.maximum(ahead[:, None], rest[other][own[other]]).ravel()
        n, m = len(own[one]), len(own[other])
        index = {one: np.repeat(own[one], m), other: np.tile(own[other], n)}
    total = states.cost[:, None] + length
    parent = total.argmin(axis=0)
    cost = total[parent, np.arange(total.shape[1])]
    return cost, cost + ahead, parent, index, np.full(len(cost), a)


def _taken(
    problem: SampledSequence,
    states: _States,
    k: int,
    cost: FloatArray,
    angle: IntArray,
    parent: IntArray,
    chosen: Mapping[str, IntArray],
    best: IntArray,
) -> _States:
    """Returns the states that are kept."""
    samples, joints, first = problem.stages[k], {}, {}
    taken = {}
    for arm, before in states.joints.items():
        joints[arm], first[arm] = before[parent], states.first[arm][parent]
        taken[arm] = np.full(len(best), -1)
        if arm in chosen:
            taken[arm] = chosen[arm][best]
            joints[arm] = samples[arm].last[taken[arm]]
            if k == 0 and problem.free_start:
                first[arm] = samples[arm].first[taken[arm]]
    first_angle = states.first_angle[parent]
    if k == 0 and problem.free_start:
        first_angle = angle
    return _States(cost, angle, joints, first, first_angle, taken, parent)


def _closing(problem: SampledSequence, states: _States) -> FloatArray:
    """Returns the times of the return from each state [s]."""
    if not problem.returns:
        return np.zeros(len(states.cost))
    moved = problem.angles[states.first_angle] - problem.angles[states.angle]
    time = problem.platform_law(moved)
    for arm, q in states.joints.items():
        time = np.maximum(time, problem.arm_law[arm](states.first[arm] - q))
    return time


def _togo(problem: SampledSequence, arm: str) -> list[FloatArray]:
    """Returns by stage what the arm alone needs in any case after each of its samples there [s], (N,).

    Where it has no stop in a stage the entry is empty.
    """
    found: list[FloatArray] = [np.empty(0)] * len(problem.stages)
    later: tuple[int, StopSamples] | None = None
    for k in range(len(problem.stages) - 1, -1, -1):
        own = problem.stages[k].get(arm)
        if own is None:
            continue
        if later is None:
            closes = problem.returns and not problem.free_start
            move = problem.arm_law[arm](problem.start[arm] - own.last)
            found[k] = move if closes else np.zeros(len(own.work))
        else:
            n, then = later
            move = problem.arm_law[arm](then.first[None] - own.last[:, None])
            if n == k + 1:
                turned = problem.angles[then.ways.row][None] - problem.angles[own.ways.row][:, None]
                move = np.maximum(move, problem.platform_law(turned))
            after = move + then.work + found[n]
            found[k] = after.min(axis=1) if after.shape[1] else np.full(len(own.work), np.inf)
        later = k, own
    return found
