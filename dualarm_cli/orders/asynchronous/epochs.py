"""Asynchronous arms on a platform that turns between epochs.

Tasks are assigned to platform angles.
"""

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
    """Tasks that are done at one platform angle."""

    angle: int
    """Number of the platform angle."""
    tasks: tuple[int, ...]
    """Tasks in ascending order."""


@dataclass(frozen=True)
class EpochOrder:
    """Consecutive epochs with the order of tasks in each."""

    epochs: tuple[Epoch, ...]
    """Epochs in the order of time."""
    rows: tuple[tuple[tuple[int, ...], ...], ...]
    """Tasks by epoch and arm, in their order."""
    total: float
    """Makespan [s]; infinite if infeasible."""
    late: float
    """Total lateness [s]."""

    @property
    def objective(self) -> tuple[float, float]:
        """Objective, in lexicographic order: lateness, then makespan [s]."""
        return (self.late, self.total)


@dataclass
class EpochProblem:
    """Job whose tasks are assigned to epochs."""

    problems: Mapping[int, SequencingProblem]
    """The whole job with the platform at each angle, by the angle's number."""
    turn: FloatArray
    """Platform times between angles [s], shape (f, f); angle 0 is where it starts."""
    seed: int
    """Random seed."""
    _cache: dict[tuple[object, ...], Timed | None] = field(default_factory=dict)

    @property
    def sample(self) -> SequencingProblem:
        """Job at an arbitrary angle, for everything that does not depend on the angle."""
        return next(iter(self.problems.values()))

    @property
    def stands(self) -> tuple[ToolStands | None, ...]:
        """Tools of each arm, or None for an arm without tool changes.

        Empty if no arm changes tools.
        """
        return self.sample.stands

    def evaluated(self, epochs: tuple[Epoch, ...], iterations: int) -> EpochOrder:
        """Order the tasks of each epoch, starting where the previous epoch ends.

        Args:
            epochs: the epochs in the order of time.
            iterations: number of ruin-and-recreate steps in an epoch of many tasks.
        """
        starts = [np.asarray(arm.start) for arm in self.sample.arms]
        tools = [0 if stand is None else stand.start for stand in self.stands]
        clock, late = 0.0, 0.0
        rows: list[tuple[tuple[int, ...], ...]] = []
        for k, epoch in enumerate(epochs):
            problem = self.restricted(epochs, k, starts, clock, tools)
            if problem.stores is not None and not problem.stores.is_possible:
                return EpochOrder(epochs, (), np.inf, np.inf)
            key = (
                epoch,
                problem.turn,
                problem.returns,
                iterations,
                round(clock, 6) if problem.windows else 0.0,
                b"" if problem.stores is None else problem.stores.initial.tobytes(),
                *(start.tobytes() for start in starts),
                *tools,
            )
            if key not in self._cache:
                self._cache[key] = _ordered(problem, iterations, self.seed)
            timed = self._cache[key]
            if timed is None or not np.isfinite(timed.total):
                return EpochOrder(epochs, (), np.inf, np.inf)
            arm_tasks = timed.order.tasks(problem.options)
            rows.append(tuple(tuple(epoch.tasks[k] for k in row) for row in arm_tasks))
            clock += max(timed.total, _idle_return(problem, timed) if k == len(epochs) - 1 else 0.0)
            late += timed.late
            starts = leaving(problem, timed, starts)
            tools = _tools_after(problem, timed, tools)
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
            epochs: all epochs. Earlier ones have changed buffers; the last one ends with the return, if any.
            k: number of the epoch.
            starts: each arm's joints before it [rad].
            clock: start of the epoch [s].
            tools: each arm's tool before the epoch; empty if no arm changes tools.
        """
        epoch, previous_angle = epochs[k], epochs[k - 1].angle if k else 0
        finished = [t for previous in epochs[:k] for t in previous.tasks]
        whole, tasks = self.problems[epoch.angle], list(epoch.tasks)
        number = {t: k for k, t in enumerate(tasks)}
        arms = tuple(
            replace(
                arm,
                entry=arm.entry[tasks],
                leaving=arm.leaving[tasks],
                first=arm.first[tasks],
                second=arm.second[tasks],
                start=start,
                home=arm.start,
            )
            for arm, start in zip(whole.arms, starts, strict=True)
        )
        returns = whole.returns and k == len(epochs) - 1
        return SequencingProblem(
            arms,
            tuple(whole.stops[t] for t in tasks),
            returns,
            tuple((number[a], number[b]) for a, b in whole.before if a in number and b in number),
            tuple(
                tuple(number[t] for t in row)
                for row in whole.sequences
                if all(t in number for t in row)
            ),
            np.maximum(0.0, whole.not_before[tasks] - clock) if whole.windows else np.zeros(0),
            whole.not_after[tasks] - clock if whole.windows else np.zeros(0),
            whole.in_file_order,
            (
                float(self.turn[previous_angle, epoch.angle]),
                float(self.turn[epoch.angle, 0]) if returns else 0.0,
            ),
            *self._buffers(whole, tasks, finished),
            stands=tuple(
                None if stands is None else replace(stands, tool=stands.tool[tasks], start=tool)
                for stands, tool in zip(whole.stands, tools, strict=True)
            ),
        )

    def _buffers(
        self, whole: SequencingProblem, tasks: Sequence[int], finished: Sequence[int]
    ) -> tuple[Stores | None, FloatArray]:
        """Restrict buffers to tasks done after others, and select their events' times."""
        if whole.stores is None:
            return None, np.zeros((0, 2))
        first = np.concatenate([[0], np.cumsum(whole.stops)])
        rows, before = (
            [k for t in group for k in range(first[t], first[t + 1])] for group in (tasks, finished)
        )
        return whole.stores.of(rows, before), whole.lasts[rows]


def leaving(
    problem: SequencingProblem, timed: Timed, starts: Sequence[FloatArray]
) -> list[FloatArray]:
    """Compute each arm's joints after its last task [rad]."""
    return [
        np.asarray(arm.leaving[nodes[-1] // problem.options, nodes[-1] % problem.options])
        if nodes
        else start
        for arm, nodes, start in zip(problem.arms, timed.order.nodes, starts, strict=True)
    ]


def _tools_after(problem: SequencingProblem, timed: Timed, tools: Sequence[int]) -> list[int]:
    """List the tool of each arm after its last task."""
    return (
        [
            int(stands.tool[nodes[-1] // problem.options]) if nodes and stands is not None else tool
            for stands, nodes, tool in zip(problem.stands, timed.order.nodes, tools, strict=True)
        ]
        if tools
        else []
    )


def _idle_return(problem: SequencingProblem, timed: Timed) -> float:
    """Compute the longest return of an arm without tasks [s]."""
    if not problem.returns:
        return 0.0
    durations = [
        arm.law.duration(arm.home - arm.start)
        for arm, nodes in zip(problem.arms, timed.order.nodes, strict=True)
        if not nodes and arm.home is not None
    ]
    return max(map(float, durations), default=0.0)


def _ordered(problem: SequencingProblem, iterations: int, seed: int) -> Timed | None:
    """Search a good order of the tasks of one epoch."""
    if problem.tasks <= 5:  # few enough for all orders
        return exact_order(problem)
    search = Recreator(problem, seed)
    first = search.first()
    return None if first is None else search.improve(first, iterations)


@dataclass(frozen=True)
class EpochSearch:
    """Search for the epochs of a job."""

    problem: EpochProblem
    """The job."""
    effort: EpochEffort
    """Limits of the search."""
    stop: Callable[[], bool] = lambda: False
    """Callback that returns whether to stop early."""

    def best(self, most: int) -> list[EpochOrder]:
        """Search the best orders with at least two epochs, at most `most`, best first."""
        orders: list[EpochOrder] = []
        random = np.random.default_rng(self.problem.seed)
        for angles in self._angle_orders()[: self.effort.sets]:
            first = self._first(angles)
            if first is None:
                continue
            candidate = self._moved(first, random)
            if np.isfinite(candidate.total) and len(candidate.epochs) > 1:
                orders.append(candidate)
            if self.stop() and orders:
                break
        orders.sort(key=lambda order: order.objective)
        orders = list({order.epochs: order for order in reversed(orders)}.values())[::-1]
        refined = [
            self.problem.evaluated(order.epochs, self.effort.close) for order in orders[:most]
        ]
        return sorted(refined, key=lambda order: order.objective)

    def _costs(self) -> FloatArray:
        """Estimate each task's time at each angle [s], shape (tasks, f).

        Infinite out of reach.
        """
        n = self.problem.sample.tasks
        costs = np.full((n, len(self.problem.turn)), np.inf)
        for f, problem in self.problem.problems.items():
            for arm in problem.arms:
                costs[:, f] = np.minimum(costs[:, f], (arm.first + arm.second).min(axis=1))
        return costs

    def _angle_orders(self) -> list[tuple[int, ...]]:
        """Rank sequences of angles from which all tasks are reached, each the shortest tour."""
        cost = self._costs()
        arms = len(self.problem.sample.arms)
        ranked: list[tuple[float, tuple[int, ...]]] = []
        for count in range(2, self.effort.most_epochs + 1):
            for angles in combinations(sorted(self.problem.problems), count):
                work = cost[:, angles].min(axis=1).sum() / arms
                if not np.isfinite(work):
                    continue
                turning, path = min(
                    (self._turning_time(path), path) for path in permutations(angles)
                )
                ranked.append((float(work) + turning, path))
        if not ranked:
            cover = self._cover(cost)
            return [] if cover is None else [cover]
        return [path for _, path in sorted(ranked)[: self.effort.combinations]]

    def _turning_time(self, path: Sequence[int]) -> float:
        """Compute the total duration of the platform's turns [s]."""
        back = self.problem.sample.returns
        stations = [0, *path, *((0,) if back else ())]
        return float(sum(self.problem.turn[a, b] for a, b in pairwise(stations)))

    def _cover(self, cost: FloatArray) -> tuple[int, ...] | None:
        """Cover all tasks greedily with few angles.

        None if a task is out of reach.
        """
        uncovered = np.ones(len(cost), dtype=np.bool_)
        chosen: list[int] = []
        while uncovered.any():
            reach = np.isfinite(cost[uncovered]).sum(axis=0)
            f = int(reach.argmax())
            if reach[f] == 0:
                return None
            chosen.append(f)
            uncovered &= ~np.isfinite(cost[:, f])
        return tuple(sorted(chosen, key=lambda f: float(self.problem.turn[0, f])))

    def _first(self, angles: tuple[int, ...]) -> tuple[Epoch, ...] | None:
        """Assign each task to its cheapest angle, then repair precedence; None if that fails."""
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
        satisfied = all(place[a] <= place[b] for a, b in self._before())
        return _epochs(angles, place.tolist()) if reached and satisfied else None

    def _before(self) -> list[tuple[int, int]]:
        """List pairs of tasks whose first task must not be in a later epoch."""
        sample = self.problem.sample
        pairs = list(sample.before)
        for row in sample.sequences:
            pairs += [pair for a, b in pairwise(row) for pair in ((a, b), (b, a))]
        if sample.in_file_order:
            for a in range(len(sample.arms)):
                able = [problem.arms[a].allowed for problem in self.problem.problems.values()]
                pairs += list(pairwise(np.flatnonzero(np.any(able, axis=0)).tolist()))
        return pairs

    def _moved(self, epochs: tuple[Epoch, ...], random: np.random.Generator) -> EpochOrder:
        """Improve epochs by annealing: move units of tasks and change angles."""
        best = current = self.problem.evaluated(epochs, self.effort.glance)
        cost, units = self._costs(), self._units()
        before = self._before()
        for k in range(self.effort.moves):
            if self.stop():
                break
            neighbour = self._neighbour(current.epochs, units, cost, before, random)
            if neighbour is None:
                continue
            candidate = self.problem.evaluated(neighbour, self.effort.glance)
            heat = self.effort.hot * (1.0 - k / self.effort.moves) * random.random()
            if candidate.late <= current.late and candidate.total <= (1.0 + heat) * current.total:
                current = candidate
                best = min(best, current, key=lambda order: order.objective)
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
        """Draw neighbouring epochs, or None if rules or reach forbid them."""
        angles = [epoch.angle for epoch in epochs]
        place: IntArray = np.empty(len(cost), dtype=np.int64)
        for e, epoch in enumerate(epochs):
            place[list(epoch.tasks)] = e
        kind, e = random.random(), int(random.integers(len(epochs)))
        if kind < 0.2:
            tasks = list(epochs[e].tasks)
            reachable = [f for f in self.problem.problems if np.isfinite(cost[tasks, f]).all()]
            near = sorted(reachable, key=lambda f: float(self.problem.turn[angles[e], f]))[1:5]
            if not near:
                return None
            angles[e] = near[int(random.integers(len(near)))]
        elif kind < 0.3:
            # Reverse the order of the epochs.
            angles.reverse()
            place = len(epochs) - 1 - place
        else:
            moved, partner = (list(units[int(random.integers(len(units)))]) for _ in range(2))
            if kind < 0.6:
                # Swap two units.
                place[partner], e = place[moved[0]], int(place[partner[0]])
            place[moved] = e
        reached = np.isfinite(cost[np.arange(len(cost)), np.array(angles)[place]]).all()
        if not reached or any(place[a] > place[b] for a, b in before):
            return None
        return _epochs(angles, place.tolist())


def _epochs(angles: Sequence[int], place: list[int]) -> tuple[Epoch, ...]:
    """Build the non-empty epochs; neighbours at the same angle are merged."""
    epochs: list[Epoch] = []
    for e, angle in enumerate(angles):
        tasks = tuple(t for t, k in enumerate(place) if k == e)
        if tasks and epochs and epochs[-1].angle == angle:
            epochs[-1] = Epoch(angle, tuple(sorted((*epochs[-1].tasks, *tasks))))
        elif tasks:
            epochs.append(Epoch(angle, tasks))
    return tuple(epochs)
