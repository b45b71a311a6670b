"""Beam search over the sampled stops of a sequence, guided by dynamic programming for each arm alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.stages.sampled_sequence import SampledSequence, time_to_go


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
    last: Mapping[str, IntArray]
    """Sample that each arm took in its own last stop, -1 at the start."""
    parent: IntArray


def beam_search(problem: SampledSequence, width: int) -> list[dict[str, int]] | None:
    """Returns by stage the sample that each arm takes, or None where no platform angle serves some stage.

    A stage lasts as long as its slower arm: max over arms of (max(transfer, platform) + lines and dwell). States are
    (platform angle, last sample of each arm); of those that lead to one state the best is kept, and of all states those
    with the least cost so far plus what each arm alone needs in any case from there on (exact, backwards over its own
    samples; the larger of both arms). A beam that is wide enough finds the best sequence, but for a free start with a
    return: what that costs depends on the first state, too. Our own combination of well-known parts.

    Args:
        problem: the samples.
        width: how many states are kept after each stage.
    """
    togo = {arm: time_to_go(problem, arm) for arm in problem.start}
    states = _States(
        np.zeros(1),
        np.zeros(1, dtype=np.int64),
        {arm: q[None] for arm, q in problem.start.items()},
        {arm: q[None] for arm, q in problem.start.items()},
        np.zeros(1, dtype=np.int64),
        {},
        dict.fromkeys(problem.start, np.full(1, -1)),
        np.zeros(1, dtype=np.int64),
    )
    history: list[_States] = []
    for k in range(len(problem.stages)):
        states = _expanded(problem, states, k, _ahead(problem, togo, k), width)
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
        return _States(np.empty(0), none, {}, {}, none, {}, {}, none)
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
    idle = [arm for arm in states.last if arm not in arms]
    if idle:
        return _beside_idle(states, a, one, idle[0], length, own[one], rest)
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


def _beside_idle(
    states: _States,
    a: int,
    one: str,
    idle: str,
    length: FloatArray,
    own: IntArray,
    rest: Mapping[str, FloatArray],
) -> tuple[FloatArray, FloatArray, IntArray, dict[str, IntArray], IntArray]:
    """Returns what `_at_angle` does where one arm has nothing to do: states with it elsewhere are others."""
    total = states.cost[:, None] + length
    costs, parents, scores = [], [], []
    for last in np.unique(states.last[idle]):
        group = np.flatnonzero(states.last[idle] == last)
        parent = group[total[group].argmin(axis=0)]
        cost = total[parent, np.arange(len(own))]
        waits = rest[idle][last] if last >= 0 and len(rest[idle]) else 0.0
        costs.append(cost)
        parents.append(parent)
        scores.append(cost + np.maximum(rest[one][own], waits))
    n = len(costs)
    index = {one: np.tile(own, n)}
    flat = [np.concatenate(values) for values in (costs, scores, parents)]
    return flat[0], flat[1], flat[2], index, np.full(len(flat[0]), a)


def _ahead(
    problem: SampledSequence, togo: Mapping[str, list[FloatArray]], k: int
) -> dict[str, FloatArray]:
    """Returns what each arm needs in any case after each of its samples in a stage, or in its own last one."""
    found = {}
    for arm, rest in togo.items():
        own = [n for n in range(k + 1) if arm in problem.stages[n]]
        found[arm] = rest[own[-1]] if own else np.empty(0)
    return found


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
    taken, last = {}, {}
    for arm, before in states.joints.items():
        joints[arm], first[arm] = before[parent], states.first[arm][parent]
        taken[arm], last[arm] = np.full(len(best), -1), states.last[arm][parent]
        if arm in chosen:
            taken[arm] = last[arm] = chosen[arm][best]
            joints[arm] = samples[arm].last[taken[arm]]
            if k == 0 and problem.free_start:
                first[arm] = samples[arm].first[taken[arm]]
    first_angle = states.first_angle[parent]
    if k == 0 and problem.free_start:
        first_angle = angle
    return _States(cost, angle, joints, first, first_angle, taken, last, parent)


def _closing(problem: SampledSequence, states: _States) -> FloatArray:
    """Returns the times of the return from each state [s]."""
    if not problem.returns:
        return np.zeros(len(states.cost))
    moved = problem.angles[states.first_angle] - problem.angles[states.angle]
    time = problem.platform_law(moved)
    for arm, q in states.joints.items():
        time = np.maximum(time, problem.arm_law[arm](states.first[arm] - q))
    return time
