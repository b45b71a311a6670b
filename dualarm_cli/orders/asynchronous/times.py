"""Start and end times of given orders of asynchronous arms."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.orders.asynchronous.problem import Order, SequencingProblem
from dualarm_cli.orders.paired.times import LATE
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class Leg:
    """Stop of an arm, with the transfer to it."""

    task: int
    """Its task."""
    node: int
    """Its task's node."""
    length: float
    """Time between the ends of the previous and this stop [s]."""
    work: float
    """Time of lines and dwell [s].

    For a task's second stop it includes the transfer to it.
    """
    lasts: tuple[float, float]
    """Times of arrival and dwell end before the stop's end [s]."""
    store: int
    """Number of the stop's buffer."""
    sign: int
    """Buffer change: 1 for a part put in, -1 for one out."""
    begins: bool
    """Whether it is the first stop of its task."""
    ends: bool
    """Whether it is the last stop of its task."""


@dataclass(frozen=True)
class State:
    """Progress of all arms."""

    at: tuple[int, ...]
    """Number of finished stops of each arm."""
    ends: tuple[float, ...]
    """End of the last finished stop of each arm [s]."""
    event: float = 0.0
    """Time of the last event [s]."""
    late: float = 0.0
    """Total lateness so far [s]."""
    before: State | None = None
    """Previous state; None at the start."""

    def is_no_later(self, rival: State) -> bool:
        """Test whether this state dominates another one with the same progress."""
        values, rival_values = (
            (*self.ends, self.event, self.late),
            (*rival.ends, rival.event, rival.late),
        )
        return all(
            value <= rival_value + 1e-12
            for value, rival_value in zip(values, rival_values, strict=True)
        )


class StoredOrder:
    """Order of asynchronous arms with buffers."""

    def __init__(self, problem: SequencingProblem, order: Order) -> None:
        """Prepare the stops of each arm."""
        assert problem.stores is not None  # callers have looked
        self._problem, self._stores = problem, problem.stores
        self._legs = [_legs(problem, a, nodes) for a, nodes in enumerate(order.nodes)]
        self._puts = [self._counts(legs, 1) for legs in self._legs]
        self._takes = [self._counts(legs, -1) for legs in self._legs]
        self._over = {
            leg.task: (a, k + 1)
            for a, legs in enumerate(self._legs)
            for k, leg in enumerate(legs)
            if leg.ends
        }
        self._first: dict[int, list[int]] = {}
        for earlier, later in problem.before:
            self._first.setdefault(later, []).append(earlier)

    def _counts(self, legs: list[Leg], sign: int) -> list[list[int]]:
        """Count an arm's buffer changes of a sign, shape (n + 1, K).

        Row i counts those of the first i stops.
        """
        counts: IntArray = np.zeros((len(legs) + 1, len(self._stores.initial)), dtype=np.int64)
        for k, leg in enumerate(legs):
            counts[k + 1] = counts[k]
            counts[k + 1, leg.store] += leg.sign == sign
        return counts.tolist()

    def played(self) -> State:
        """Simulate the order to its end, or to a deadlock.

        The best interleaving is returned if arms compete for parts and the stops are few.
        """
        served = self._served()
        count = sum(len(legs) for legs in self._legs)
        short = count <= 24  # few enough stops to enumerate all interleavings
        # In the file's order there are few orders, so all of them are searched after a deadlock.
        if self._is_contended() and (short or (self.left(served) and self._problem.in_file_order)):
            return self._best() or served
        return served

    def left(self, state: State) -> int:
        """Count the stops that are not finished."""
        return sum(len(legs) for legs in self._legs) - sum(state.at)

    def _is_contended(self) -> bool:
        """Test whether several arms put parts into, or take them from, one buffer."""
        return any(
            sum(arm[-1][k] > 0 for arm in counts) > 1
            for counts in (self._puts, self._takes)
            for k in range(len(self._stores.initial))
        )

    def _start(self) -> State:
        return State(tuple(0 for _ in self._legs), tuple(0.0 for _ in self._legs))

    def _served(self) -> State:
        """Simulate first come, first served."""
        state = self._start()
        while True:
            candidates = [self._next(state, a) for a in range(len(self._legs))]
            states = [successor for successor in candidates if successor is not None]
            if not states:
                return state
            state = min(states, key=lambda successor: successor.event)

    def _best(self) -> State | None:
        """Compute the best final state of all interleavings, or None."""
        sizes = tuple(len(legs) for legs in self._legs)
        fronts: dict[tuple[int, ...], list[State]] = {self._start().at: [self._start()]}
        for at in np.ndindex(*(n + 1 for n in sizes)):
            for state in fronts.get(at, ()):
                for a in range(len(sizes)):
                    successor = self._next(state, a)
                    if successor is None:
                        continue
                    front = fronts.setdefault(successor.at, [])
                    if not any(rival.is_no_later(successor) for rival in front):
                        front[:] = [rival for rival in front if not successor.is_no_later(rival)]
                        front.append(successor)
        last = fronts.get(sizes, [])
        return min(last, key=lambda state: (state.late, self.done(state)), default=None)

    def done(self, state: State) -> float:
        """Compute the time at which all arms are back [s]."""
        home, returns = self._problem.start_node, []
        for a, legs in enumerate(self._legs):
            k = state.at[a]
            back = float(self._problem.between[a][legs[k - 1].node, home]) if k else 0.0
            returns.append(state.ends[a] + back)
        return max(returns)

    def times(
        self, state: State
    ) -> tuple[tuple[tuple[float, ...], ...], tuple[tuple[float, ...], ...]]:
        """Trace each arm's task starts and ends [s]."""
        begins: list[list[float]] = [[] for _ in self._legs]
        ends: list[list[float]] = [[] for _ in self._legs]
        current: State = state
        while current.before is not None:
            a = next(a for a, k in enumerate(current.at) if k != current.before.at[a])
            leg = self._legs[a][current.at[a] - 1]
            if leg.begins:
                begins[a].insert(0, current.ends[a] - leg.work)
            if leg.ends:
                ends[a].insert(0, current.ends[a])
            current = current.before
        return tuple(map(tuple, begins)), tuple(map(tuple, ends))

    def _next(self, state: State, a: int) -> State | None:
        """Compute the state after an arm's next stop, its event last.

        None if the arm has to wait.
        """
        k = state.at[a]
        if k == len(self._legs[a]):
            return None
        leg = self._legs[a][k]
        end = state.ends[a] + leg.length
        if leg.begins:
            earliest = self._opens(state, leg.task)
            if earliest is None:
                return None
            end = max(end, earliest + leg.work)
        available = self._served_from(state, leg)
        if available is None:
            return None
        event = max(end - leg.lasts[0], state.event, available)
        end = max(end, event + leg.lasts[0])
        late = state.late
        if leg.ends and len(self._problem.not_after):
            late += max(0.0, end - float(self._problem.not_after[leg.task]))
        at = tuple(n + (b == a) for b, n in enumerate(state.at))
        ends = tuple(end if b == a else previous for b, previous in enumerate(state.ends))
        return State(at, ends, event, late, state)

    def _opens(self, state: State, task: int) -> float | None:
        """Compute the earliest start of a task [s].

        None while a predecessor is not finished.
        """
        not_before = self._problem.not_before
        earliest = float(not_before[task]) if len(not_before) else 0.0
        for predecessor in self._first.get(task, ()):
            if predecessor not in self._over:
                return None
            a, k = self._over[predecessor]
            if state.at[a] < k:
                return None
            past = state
            while past.at[a] > k:
                assert past.before is not None  # that stop has been made
                past = past.before
            earliest = max(earliest, past.ends[a])
        return earliest

    def _served_from(self, state: State, leg: Leg) -> float | None:
        """Compute the time at which a stop's buffer gets part or room [s].

        None if another stop has to come first. Of the finished stops only the last one of each arm may end after the
        last event.
        """
        if leg.sign == 0:
            return 0.0
        stores, k = self._stores, leg.store
        # A take requires finished puts, a put requires finished takes.
        gives, uses = (self._takes, self._puts) if leg.sign > 0 else (self._puts, self._takes)
        capacity, initial = int(stores.capacity[k]), int(stores.initial[k])
        available = capacity - initial if leg.sign > 0 else initial
        pending = []
        for b, n in enumerate(state.at):
            available -= uses[b][n][k]
            if not n:
                continue
            available += gives[b][n - 1][k]
            if gives[b][n][k] > gives[b][n - 1][k]:
                pending.append(state.ends[b] - self._legs[b][n - 1].lasts[1])
        if available > 0:
            return 0.0
        # The first of the pending events are already used.
        pending.sort()
        return pending[-available] if -available < len(pending) else None


def _legs(problem: SequencingProblem, a: int, nodes: tuple[int, ...]) -> list[Leg]:
    """List the stops of an arm in their order."""
    assert problem.stores is not None  # callers have looked
    first = np.concatenate([[0], np.cumsum(problem.stops)])
    arm, last, legs = problem.arms[a], problem.start_node, list[Leg]()
    for node in nodes:
        t, option = divmod(node, problem.options)
        for s in range(problem.stops[t]):
            change = problem.stores.change[first[t] + s]
            store = int(np.abs(change).argmax())
            work = float(arm.second[t, option] if s else arm.first[t, option])
            transfer = 0.0 if s else float(problem.between[a][last, node])
            at_target, over = problem.lasts[first[t] + s].tolist()
            legs.append(
                Leg(
                    t,
                    node,
                    transfer + work,
                    work,
                    (at_target, over),
                    store,
                    int(change[store]),
                    s == 0,
                    s == problem.stops[t] - 1,
                )
            )
        last = node
    return legs


@dataclass(frozen=True)
class Timed:
    """Order with its times."""

    order: Order
    """Order that was timed."""
    total: float
    """Makespan [s]; infinite if the order is infeasible."""
    busy: tuple[float, ...]
    """Time of each arm's transfers and tasks without waits [s]."""
    late: float = 0.0
    """Total lateness [s]."""
    begins: tuple[tuple[float, ...], ...] = ()
    """Start of each task's first approach [s], by arm."""
    ends: tuple[tuple[float, ...], ...] = ()
    """End of each task [s], by arm."""
    left: int = 0
    """Number of stops that are never made because of a deadlock."""

    @property
    def is_possible(self) -> bool:
        """Whether all tasks are finished, and in time."""
        return np.isfinite(self.total) and self.late <= 1e-9

    @property
    def objective(self) -> float:
        """Objective [s]: makespan, weighted lateness and a small share of the busy times."""
        if self.left:
            # Penalty of a stop that is never made [s].
            return 1e6 * self.left + sum(self.busy)
        return self.total + LATE * self.late + 1e-3 * sum(self.busy)


def timed(problem: SequencingProblem, order: Order) -> Timed:
    """Time an order, with waits for precedence, windows and buffers."""
    busy = busy_times(problem, order)
    if not problem.coupled:
        return Timed(order, max(busy), busy)
    if problem.stores is not None:
        return _stored(problem, order, busy)
    options, predecessors = problem.options, _predecessors(problem)
    clock = [0.0] * len(order.nodes)
    position = [0] * len(order.nodes)
    last = [problem.start_node] * len(order.nodes)
    finished: dict[int, float] = {}
    begins: list[list[float]] = [[] for _ in order.nodes]
    ends: list[list[float]] = [[] for _ in order.nodes]
    late = 0.0
    progressed = True
    while progressed:
        progressed = False
        for a, nodes in enumerate(order.nodes):
            while position[a] < len(nodes):
                node = nodes[position[a]]
                task = node // options
                if any(earlier not in finished for earlier in predecessors[task]):
                    break
                begin = max(
                    clock[a] + problem.between[a][last[a], node],
                    _not_before(problem, task),
                    *(finished[earlier] for earlier in predecessors[task]),
                )
                clock[a] = finished[task] = begin + problem.length[a][node]
                closes = _not_after(problem, task)
                late += clock[a] - closes if clock[a] > closes else 0.0
                begins[a].append(float(begin))
                ends[a].append(float(clock[a]))
                last[a], position[a], progressed = node, position[a] + 1, True
    if any(position[a] < len(nodes) for a, nodes in enumerate(order.nodes)):
        return Timed(order, np.inf, busy)
    total = max(
        clock[a] + problem.between[a][last[a], problem.start_node] for a in range(len(clock))
    )
    return Timed(
        order, float(total), busy, float(late), tuple(map(tuple, begins)), tuple(map(tuple, ends))
    )


def _stored(problem: SequencingProblem, order: Order, busy: tuple[float, ...]) -> Timed:
    """Time an order with buffers."""
    stored = StoredOrder(problem, order)
    last = stored.played()
    if left := stored.left(last):
        return Timed(order, np.inf, busy, left=left)
    return Timed(order, stored.done(last), busy, last.late, *stored.times(last))


def busy_times(problem: SequencingProblem, order: Order) -> tuple[float, ...]:
    """Compute the time of each arm's transfers and tasks without waits [s]."""
    times = []
    for a, nodes in enumerate(order.nodes):
        if not nodes:
            # An idle arm still has to change its tool.
            times.append(float(problem.between[a][problem.start_node, problem.start_node]))
            continue
        route = np.array([problem.start_node, *nodes, problem.start_node])
        times.append(
            float(problem.between[a][route[:-1], route[1:]].sum() + problem.length[a][route].sum())
        )
    return tuple(times)


def _predecessors(problem: SequencingProblem) -> list[list[int]]:
    predecessors: list[list[int]] = [[] for _ in range(problem.tasks)]
    for earlier, later in problem.before:
        predecessors[later].append(earlier)
    return predecessors


def _not_before(problem: SequencingProblem, task: int) -> float:
    return float(problem.not_before[task]) if len(problem.not_before) else 0.0


def _not_after(problem: SequencingProblem, task: int) -> float:
    return float(problem.not_after[task]) if len(problem.not_after) else np.inf


def keeps_rules(problem: SequencingProblem, tasks: Sequence[Sequence[int]]) -> bool:
    """Test whether each arm's order satisfies precedence, sequences and the file's order."""
    for row in tasks:
        rank = {task: k for k, task in enumerate(row)}
        if problem.in_file_order and list(row) != sorted(row):
            return False
        if any(a in rank and b in rank and rank[a] > rank[b] for a, b in problem.before):
            return False
        for sequence in problem.sequences:
            ranks = [rank.get(task, -1) for task in sequence]
            if max(ranks) < 0:
                continue
            if ranks != list(range(ranks[0], ranks[0] + len(sequence))):
                return False
    return True


def best_options(problem: SequencingProblem, tasks: Sequence[Sequence[int]]) -> Order:
    """Select the options that minimise each arm's busy time.

    Dynamic programming along the given order of its tasks.
    """
    return Order(tuple(_best_options(problem, a, row)[1] for a, row in enumerate(tasks)))


def _best_options(
    problem: SequencingProblem, a: int, tasks: Sequence[int]
) -> tuple[float, tuple[int, ...]]:
    if not tasks:
        return 0.0, ()
    w, between, length = problem.options, problem.between[a], problem.length[a]
    value: FloatArray = np.zeros(1)
    nodes = np.array([problem.start_node])
    predecessors = []
    for task in tasks:
        columns = np.arange(task * w, (task + 1) * w)
        total = value[:, None] + between[nodes[:, None], columns]
        best = total.argmin(axis=0)
        value = total[best, np.arange(w)] + length[columns]
        predecessors.append(best)
        nodes = columns
    value = value + between[nodes, problem.start_node]
    k = int(value.argmin())
    least = float(value[k])
    route = []
    for task, best in zip(reversed(tasks), reversed(predecessors), strict=True):
        route.append(task * w + k)
        k = int(best[k])
    return least, tuple(reversed(route))
