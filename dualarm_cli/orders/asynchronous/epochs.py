"""Asynchronous arms on a platform that turns now and then: which tasks are done while it stands where."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, replace
from itertools import combinations, pairwise, permutations

import numpy as np

from dualarm_cli.effort import EpochEffort
from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.orders.asynchronous.exact import exact_order
from dualarm_cli.orders.asynchronous.problem import SequencingProblem
from dualarm_cli.orders.asynchronous.recreate import Recreator
from dualarm_cli.orders.asynchronous.times import Timed
from dualarm_cli.orders.rules.stores import Stores
from dualarm_cli.orders.rules.tool_stands import ToolStands
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class Epoch:
    """What is done while the platform stands."""

    angle: int
    """Number of its angle."""
    tasks: tuple[int, ...]
    """Tasks, rising."""


@dataclass(frozen=True)
class EpochOrder:
    """An answer: epochs one after the other, with the order of each."""

    epochs: tuple[Epoch, ...]
    """In time order."""
    rows: tuple[tuple[tuple[int, ...], ...], ...]
    """By epoch and arm, the tasks in their order."""
    total: float
    """When all is done [s]; infinite where it cannot be."""
    late: float
    """By how much windows are missed, together [s]."""

    @property
    def objective(self) -> tuple[float, float]:
        """What is minimised: what is late, then the total [s]."""
        return (self.late, self.total)


@dataclass
class EpochProblem:
    """A job whose tasks are to be shared out to epochs."""

    problems: Mapping[int, SequencingProblem]
    """The whole job with the platform at each angle, by the angle's number."""
    turn: FloatArray
    """Platform times between angles [s], shape (f, f); angle 0 is where it starts."""
    seed: int
    """Of all randomness."""
    _known: dict[tuple[object, ...], Timed | None] = field(default_factory=dict)

    @property
    def sample(self) -> SequencingProblem:
        """The job at one of the angles, for what is the same at all of them."""
        return next(iter(self.problems.values()))

    @property
    def stands(self) -> tuple[ToolStands | None, ...]:
        """By arm, the tools that it changes, None for none; empty where no arm changes tools."""
        return self.sample.stands

    def evaluated(self, epochs: tuple[Epoch, ...], iterations: int) -> EpochOrder:
        """Returns epochs with the order of each, from where the one before leaves the arms.

        Args:
            epochs: what is done where.
            iterations: how often something is removed and put back in an epoch of many tasks.
        """
        starts = [np.asarray(arm.start) for arm in self.sample.arms]
        tools = [0 if one is None else one.start for one in self.stands]
        clock, late = 0.0, 0.0
        rows: list[tuple[tuple[int, ...], ...]] = []
        for k, one in enumerate(epochs):
            problem = self.restricted(epochs, k, starts, clock, tools)
            if problem.stores is not None and not problem.stores.is_possible:
                return EpochOrder(epochs, (), np.inf, np.inf)
            key = (
                one,
                problem.turn,
                problem.returns,
                iterations,
                round(clock, 6) if problem.windows else 0.0,
                b"" if problem.stores is None else problem.stores.initial.tobytes(),
                *(start.tobytes() for start in starts),
                *tools,
            )
            if key not in self._known:
                self._known[key] = _ordered(problem, iterations, self.seed)
            found = self._known[key]
            if found is None or not np.isfinite(found.total):
                return EpochOrder(epochs, (), np.inf, np.inf)
            own = found.order.tasks(problem.options)
            rows.append(tuple(tuple(one.tasks[k] for k in row) for row in own))
            clock += max(found.total, _idle_return(problem, found) if k == len(epochs) - 1 else 0.0)
            late += found.late
            starts = leaving(problem, found, starts)
            tools = _tools_after(problem, found, tools)
        return EpochOrder(epochs, tuple(rows), clock, late)

    def restricted(
        self,
        epochs: Sequence[Epoch],
        k: int,
        starts: Sequence[FloatArray],
        clock: float,
        tools: Sequence[int] = (),
    ) -> SequencingProblem:
        """Restrict the job to the tasks of one epoch.

        Args:
            epochs: all of them: those before it have filled and emptied buffers; after the last one all return where
                the job returns.
            k: number of the epoch.
            starts: each arm's joints before it [rad].
            clock: when it begins [s].
            tools: by arm the tool that is on before it; empty where no arm changes tools.
        """
        epoch, here = epochs[k], epochs[k - 1].angle if k else 0
        done = [t for before in epochs[:k] for t in before.tasks]
        whole, own = self.problems[epoch.angle], list(epoch.tasks)
        number = {t: k for k, t in enumerate(own)}
        arms = tuple(
            replace(
                arm,
                entry=arm.entry[own],
                leaving=arm.leaving[own],
                first=arm.first[own],
                second=arm.second[own],
                start=start,
                home=arm.start,
            )
            for arm, start in zip(whole.arms, starts, strict=True)
        )
        back = whole.returns and k == len(epochs) - 1
        return SequencingProblem(
            arms,
            tuple(whole.stops[t] for t in own),
            back,
            tuple((number[a], number[b]) for a, b in whole.before if a in number and b in number),
            tuple(
                tuple(number[t] for t in row)
                for row in whole.sequences
                if all(t in number for t in row)
            ),
            np.maximum(0.0, whole.not_before[own] - clock) if whole.windows else np.zeros(0),
            whole.not_after[own] - clock if whole.windows else np.zeros(0),
            whole.in_file_order,
            (
                float(self.turn[here, epoch.angle]),
                float(self.turn[epoch.angle, 0]) if back else 0.0,
            ),
            *self._buffers(whole, own, done),
            stands=tuple(
                None if stands is None else replace(stands, tool=stands.tool[own], start=tool)
                for stands, tool in zip(whole.stands, tools, strict=True)
            ),
        )

    def _buffers(
        self, whole: SequencingProblem, own: Sequence[int], done: Sequence[int]
    ) -> tuple[Stores | None, FloatArray]:
        """Returns the buffers of some tasks after others, and how long before their ends stops' events are."""
        if whole.stores is None:
            return None, np.zeros((0, 2))
        first = np.concatenate([[0], np.cumsum(whole.stops)])
        rows, before = (
            [k for t in some for k in range(first[t], first[t + 1])] for some in (own, done)
        )
        return whole.stores.of(rows, before), whole.lasts[rows]


def leaving(
    problem: SequencingProblem, found: Timed, starts: Sequence[FloatArray]
) -> list[FloatArray]:
    """Returns where each arm is after its last task [rad]."""
    return [
        np.asarray(arm.leaving[nodes[-1] // problem.options, nodes[-1] % problem.options])
        if nodes
        else start
        for arm, nodes, start in zip(problem.arms, found.order.nodes, starts, strict=True)
    ]


def _tools_after(problem: SequencingProblem, found: Timed, tools: Sequence[int]) -> list[int]:
    """Returns by arm the tool that is on after its last task."""
    return (
        [
            int(stands.tool[nodes[-1] // problem.options]) if nodes and stands is not None else tool
            for stands, nodes, tool in zip(problem.stands, found.order.nodes, tools, strict=True)
        ]
        if tools
        else []
    )


def _idle_return(problem: SequencingProblem, found: Timed) -> float:
    """Returns how long arms without a task take to where they go back to [s]."""
    if not problem.returns:
        return 0.0
    ways = [
        arm.law.duration(arm.home - arm.start)
        for arm, nodes in zip(problem.arms, found.order.nodes, strict=True)
        if not nodes and arm.home is not None
    ]
    return max(map(float, ways), default=0.0)


def _ordered(problem: SequencingProblem, iterations: int, seed: int) -> Timed | None:
    """Returns a good order of one epoch's tasks."""
    if problem.tasks <= 5:  # few enough for all orders
        return exact_order(problem)
    search = Recreator(problem, seed)
    first = search.first()
    return None if first is None else search.improve(first, iterations)


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
        found.sort(key=lambda one: one.objective)
        found = list({one.epochs: one for one in reversed(found)}.values())[::-1]
        some = [self.problem.evaluated(one.epochs, self.effort.close) for one in found[:most]]
        return sorted(some, key=lambda one: one.objective)

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
        for count in range(2, self.effort.most_epochs + 1):
            for some in combinations(sorted(self.problem.problems), count):
                work = cost[:, some].min(axis=1).sum() / arms
                if not np.isfinite(work):
                    continue
                way, path = min((self._way(path), path) for path in permutations(some))
                ranked.append((float(work) + way, path))
        if not ranked:
            cover = self._cover(cost)
            return [] if cover is None else [cover]
        return [path for _, path in sorted(ranked)[: self.effort.combinations]]

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
            heat = self.effort.hot * (1.0 - k / self.effort.moves) * random.random()
            if found.late <= current.late and found.total <= (1.0 + heat) * current.total:
                current = found
                best = min(best, current, key=lambda one: one.objective)
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
