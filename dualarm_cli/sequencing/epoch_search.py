"""Which tasks are done while the platform stands where: combinations of angles, and tasks moved about between them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise, permutations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.sequencing.epochs import Epoch, EpochOrder, EpochProblem

MOST_EPOCHS = 3
"""So many angles are combined in all ways; more only where fewer do not reach all tasks."""
HOT = 0.1
"""Up to what share of the total a change may cost at first."""
SETS = 40
"""Combinations of angles that are looked at at all."""


@dataclass(frozen=True)
class EpochEffort:
    """How hard epochs are searched for."""

    sets: int
    """Combinations of angles whose tasks are moved about."""
    moves: int
    """How often tasks are moved to another epoch, for each of them."""
    glance: int
    """How often something is removed and put back in an epoch while tasks are moved about."""
    close: int
    """The same for the best ones at last."""


@dataclass(frozen=True)
class EpochSearch:
    """The search for epochs of one job."""

    problem: EpochProblem
    """The job."""
    effort: EpochEffort
    """How hard to try."""
    stop: Callable[[], bool] = lambda: False
    """Whether to stop early."""

    def best(self, most: int) -> list[EpochOrder]:
        """Returns some good answers of at least two epochs, the best one first, at most so many."""
        found: list[EpochOrder] = []
        random = np.random.default_rng(self.problem.seed)
        for angles in self._angle_orders()[: self.effort.sets]:
            first = self._first(angles)
            if first is None:
                continue
            one = self._moved(first, random)
            if np.isfinite(one.total) and len(one.epochs) > 1:
                found.append(one)
            if self.stop() and found:
                break
        found.sort(key=lambda one: one.worth)
        found = list({one.epochs: one for one in reversed(found)}.values())[::-1]
        some = [self.problem.evaluated(one.epochs, self.effort.close) for one in found[:most]]
        return sorted(some, key=lambda one: one.worth)

    def _costs(self) -> FloatArray:
        """Returns about what each task costs at each angle [s], infinite where it is not reached, shape (tasks, f)."""
        n = self.problem.sample.tasks
        found = np.full((n, len(self.problem.turn)), np.inf)
        for f, problem in self.problem.problems.items():
            for arm in problem.arms:
                found[:, f] = np.minimum(found[:, f], (arm.first + arm.second).min(axis=1))
        return found

    def _angle_orders(self) -> list[tuple[int, ...]]:
        """Returns combinations of angles from which all tasks are reached, each in the order of its shortest way."""
        cost = self._costs()
        arms = len(self.problem.sample.arms)
        ranked: list[tuple[float, tuple[int, ...]]] = []
        for count in range(2, MOST_EPOCHS + 1):
            for some in combinations(sorted(self.problem.problems), count):
                work = cost[:, some].min(axis=1).sum() / arms
                if not np.isfinite(work):
                    continue
                way, path = min((self._way(path), path) for path in permutations(some))
                ranked.append((float(work) + way, path))
        if not ranked:
            cover = self._cover(cost)
            return [] if cover is None else [cover]
        return [path for _, path in sorted(ranked)[:SETS]]

    def _way(self, path: Sequence[int]) -> float:
        """Returns how long the platform turns in all [s]."""
        back = self.problem.sample.returns
        stations = [0, *path, *((0,) if back else ())]
        return float(sum(self.problem.turn[a, b] for a, b in pairwise(stations)))

    def _cover(self, cost: FloatArray) -> tuple[int, ...] | None:
        """Returns few angles from which all tasks are reached, each time that which reaches most of the rest."""
        left = np.ones(len(cost), dtype=np.bool_)
        chosen: list[int] = []
        while left.any():
            reach = np.isfinite(cost[left]).sum(axis=0)
            f = int(reach.argmax())
            if reach[f] == 0:
                return None
            chosen.append(f)
            left &= ~np.isfinite(cost[:, f])
        return tuple(sorted(chosen, key=lambda f: float(self.problem.turn[0, f])))

    def _first(self, angles: tuple[int, ...]) -> tuple[Epoch, ...] | None:
        """Returns each task where it costs least, then as precedence asks; None where that cannot be."""
        cost = self._costs()[:, angles]
        place = cost.argmin(axis=1)
        sample = self.problem.sample
        for row in sample.sequences:
            place[list(row)] = int(cost[list(row)].sum(axis=0).argmin())
        for _ in range(len(place) + 1):
            wrong = [(a, b) for a, b in self._before() if place[a] > place[b]]
            if not wrong:
                break
            for a, b in wrong:
                later = [e for e in range(place[a], len(angles)) if np.isfinite(cost[b, e])]
                if later:
                    place[b] = later[0]
                else:
                    earlier = [e for e in range(place[b], -1, -1) if np.isfinite(cost[a, e])]
                    if not earlier:
                        return None
                    place[a] = earlier[0]
        reached = np.isfinite(cost[np.arange(len(place)), place]).all()
        kept = all(place[a] <= place[b] for a, b in self._before())
        return _epochs(angles, place.tolist()) if reached and kept else None

    def _before(self) -> list[tuple[int, int]]:
        """Returns pairs of tasks of which the first must not be in a later epoch than the second."""
        sample = self.problem.sample
        found = list(sample.before)
        for row in sample.sequences:
            found += [pair for a, b in pairwise(row) for pair in ((a, b), (b, a))]
        if sample.in_file_order:
            for a in range(len(sample.arms)):
                able = [one.arms[a].allowed for one in self.problem.problems.values()]
                found += list(pairwise(np.flatnonzero(np.any(able, axis=0)).tolist()))
        return found

    def _moved(self, epochs: tuple[Epoch, ...], random: np.random.Generator) -> EpochOrder:
        """Returns a better answer: units of tasks moved to other epochs, angles to others."""
        best = current = self.problem.evaluated(epochs, self.effort.glance)
        cost, units = self._costs(), self._units()
        before = self._before()
        for k in range(self.effort.moves):
            if self.stop():
                break
            tried = self._neighbour(current.epochs, units, cost, before, random)
            if tried is None:
                continue
            found = self.problem.evaluated(tried, self.effort.glance)
            heat = HOT * (1.0 - k / self.effort.moves) * random.random()
            if found.late <= current.late and found.total <= (1.0 + heat) * current.total:
                current = found
                best = min(best, current, key=lambda one: one.worth)
        return best

    def _units(self) -> list[tuple[int, ...]]:
        sample = self.problem.sample
        within = {t for row in sample.sequences for t in row}
        return [*sample.sequences, *((t,) for t in range(sample.tasks) if t not in within)]

    def _neighbour(
        self,
        epochs: tuple[Epoch, ...],
        units: list[tuple[int, ...]],
        cost: FloatArray,
        before: list[tuple[int, int]],
        random: np.random.Generator,
    ) -> tuple[Epoch, ...] | None:
        """Returns epochs with units elsewhere, or another angle; None where rules or reach forbid it."""
        angles = [one.angle for one in epochs]
        place: IntArray = np.empty(len(cost), dtype=np.int64)
        for e, one in enumerate(epochs):
            place[list(one.tasks)] = e
        kind, e = random.random(), int(random.integers(len(epochs)))
        if kind < 0.2:
            own = list(epochs[e].tasks)
            able = [f for f in self.problem.problems if np.isfinite(cost[own, f]).all()]
            near = sorted(able, key=lambda f: float(self.problem.turn[angles[e], f]))[1:5]
            if not near:
                return None
            angles[e] = near[int(random.integers(len(near)))]
        elif kind < 0.3:
            # The same epochs the other way round.
            angles.reverse()
            place = len(epochs) - 1 - place
        else:
            moved, other = (list(units[int(random.integers(len(units)))]) for _ in range(2))
            if kind < 0.6:
                # Two units change places.
                place[other], e = place[moved[0]], int(place[other[0]])
            place[moved] = e
        reached = np.isfinite(cost[np.arange(len(cost)), np.array(angles)[place]]).all()
        if not reached or any(place[a] > place[b] for a, b in before):
            return None
        return _epochs(angles, place.tolist())


def _epochs(angles: Sequence[int], place: list[int]) -> tuple[Epoch, ...]:
    """Returns the epochs in which something is done; those at one angle right after one another are one."""
    found: list[Epoch] = []
    for e, angle in enumerate(angles):
        own = tuple(t for t, k in enumerate(place) if k == e)
        if own and found and found[-1].angle == angle:
            found[-1] = Epoch(angle, tuple(sorted((*found[-1].tasks, *own))))
        elif own:
            found.append(Epoch(angle, own))
    return tuple(found)
