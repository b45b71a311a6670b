"""When everything begins and ends for given orders of asynchronous arms."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.orders.asynchronous.problem import Order, SequencingProblem
from dualarm_cli.orders.paired.times import LATE
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class Leg:
    """One stop of an arm, with the way to it."""

    task: int
    """Its task."""
    node: int
    """Its task's node."""
    length: float
    """From the end of the arm's stop before to its own end [s]."""
    work: float
    """What of that is its own, lines and dwell [s]; of a task's second stop the way there as well."""
    lasts: tuple[float, float]
    """How long before its end the tool is at the target, and its dwell is over [s]."""
    store: int
    """Number of its buffer."""
    sign: int
    """1 for a part that is put in, -1 for one that is taken out, 0 for neither."""
    begins: bool
    """Whether it is its task's first stop."""
    ends: bool
    """Whether it is its task's last one."""


@dataclass(frozen=True)
class State:
    """How far all arms have got."""

    at: tuple[int, ...]
    """By arm, so many stops are made."""
    ends: tuple[float, ...]
    """By arm, when the last of them is over [s]."""
    event: float = 0.0
    """When the last event of all was [s]."""
    late: float = 0.0
    """By how much windows are missed so far [s]."""
    before: State | None = None
    """The state before; None at the start."""

    def is_no_later(self, other: State) -> bool:
        """Returns whether nothing is later than in another state which has got as far."""
        mine, others = (*self.ends, self.event, self.late), (*other.ends, other.event, other.late)
        return all(one <= two + 1e-12 for one, two in zip(mine, others, strict=True))


class StoredOrder:
    """One order of asynchronous arms, with buffers."""

    def __init__(self, problem: SequencingProblem, order: Order) -> None:
        """Prepares it."""
        assert problem.stores is not None  # callers have looked
        self._problem, self._stores = problem, problem.stores
        self._legs = [_legs(problem, a, nodes) for a, nodes in enumerate(order.nodes)]
        self._puts = [self._counts(own, 1) for own in self._legs]
        self._takes = [self._counts(own, -1) for own in self._legs]
        self._over = {
            leg.task: (a, k + 1)
            for a, own in enumerate(self._legs)
            for k, leg in enumerate(own)
            if leg.ends
        }
        self._first: dict[int, list[int]] = {}
        for one, other in problem.before:
            self._first.setdefault(other, []).append(one)

    def _counts(self, own: list[Leg], sign: int) -> list[list[int]]:
        """Returns how many of an arm's first k stops change each buffer by a sign, shape (n + 1, K)."""
        found: IntArray = np.zeros((len(own) + 1, len(self._stores.initial)), dtype=np.int64)
        for k, leg in enumerate(own):
            found[k + 1] = found[k]
            found[k + 1, leg.store] += leg.sign == sign
        return found.tolist()

    def played(self) -> State:
        """Returns the best last state found: where arms wait forever, one in which not all is done."""
        served = self._served()
        count = sum(len(own) for own in self._legs)
        short = count <= 24  # few enough stops for all interleavings
        # Of tasks in the file's order there are few orders: none of them is given up too early.
        if self._is_contended() and (short or (self.left(served) and self._problem.in_file_order)):
            return self._best() or served
        return served

    def left(self, state: State) -> int:
        """Returns how many stops are not made."""
        return sum(len(own) for own in self._legs) - sum(state.at)

    def _is_contended(self) -> bool:
        """Returns whether several arms put parts into one buffer, or take them out of one."""
        return any(
            sum(arm[-1][k] > 0 for arm in counts) > 1
            for counts in (self._puts, self._takes)
            for k in range(len(self._stores.initial))
        )

    def _start(self) -> State:
        return State(tuple(0 for _ in self._legs), tuple(0.0 for _ in self._legs))

    def _served(self) -> State:
        """Returns the last state where whoever can be at the target first is served first."""
        state = self._start()
        while True:
            tries = [self._next(state, a) for a in range(len(self._legs))]
            found = [one for one in tries if one is not None]
            if not found:
                return state
            state = min(found, key=lambda one: one.event)

    def _best(self) -> State | None:
        """Returns the best last state of all interleavings, None where none leads to the end."""
        sizes = tuple(len(own) for own in self._legs)
        fronts: dict[tuple[int, ...], list[State]] = {self._start().at: [self._start()]}
        for at in np.ndindex(*(n + 1 for n in sizes)):
            for state in fronts.get(at, ()):
                for a in range(len(sizes)):
                    found = self._next(state, a)
                    if found is None:
                        continue
                    front = fronts.setdefault(found.at, [])
                    if not any(one.is_no_later(found) for one in front):
                        front[:] = [one for one in front if not found.is_no_later(one)]
                        front.append(found)
        last = fronts.get(sizes, [])
        return min(last, key=lambda one: (one.late, self.done(one)), default=None)

    def done(self, state: State) -> float:
        """Returns when all arms are back from where they are [s]."""
        home, backs = self._problem.start_node, []
        for a, own in enumerate(self._legs):
            k = state.at[a]
            back = float(self._problem.between[a][own[k - 1].node, home]) if k else 0.0
            backs.append(state.ends[a] + back)
        return max(backs)

    def times(
        self, state: State
    ) -> tuple[tuple[tuple[float, ...], ...], tuple[tuple[float, ...], ...]]:
        """Returns by arm when its tasks begin their first approach, and when they are over [s]."""
        begins: list[list[float]] = [[] for _ in self._legs]
        ends: list[list[float]] = [[] for _ in self._legs]
        one: State = state
        while one.before is not None:
            a = next(a for a, k in enumerate(one.at) if k != one.before.at[a])
            leg = self._legs[a][one.at[a] - 1]
            if leg.begins:
                begins[a].insert(0, one.ends[a] - leg.work)
            if leg.ends:
                ends[a].insert(0, one.ends[a])
            one = one.before
        return tuple(map(tuple, begins)), tuple(map(tuple, ends))

    def _next(self, state: State, a: int) -> State | None:
        """Returns what follows where an arm makes its next stop, its event after all others; None where it cannot."""
        k = state.at[a]
        if k == len(self._legs[a]):
            return None
        leg = self._legs[a][k]
        end = state.ends[a] + leg.length
        if leg.begins:
            opens = self._opens(state, leg.task)
            if opens is None:
                return None
            end = max(end, opens + leg.work)
        served = self._served_from(state, leg)
        if served is None:
            return None
        event = max(end - leg.lasts[0], state.event, served)
        end = max(end, event + leg.lasts[0])
        late = state.late
        if leg.ends and len(self._problem.not_after):
            late += max(0.0, end - float(self._problem.not_after[leg.task]))
        at = tuple(n + (b == a) for b, n in enumerate(state.at))
        ends = tuple(end if b == a else one for b, one in enumerate(state.ends))
        return State(at, ends, event, late, state)

    def _opens(self, state: State, task: int) -> float | None:
        """Returns when a task's first approach may begin [s]; None where a task before it is not yet done."""
        early = self._problem.not_before
        found = float(early[task]) if len(early) else 0.0
        for first in self._first.get(task, ()):
            if first not in self._over:
                return None
            a, k = self._over[first]
            if state.at[a] < k:
                return None
            one = state
            while one.at[a] > k:
                assert one.before is not None  # that stop has been made
                one = one.before
            found = max(found, one.ends[a])
        return found

    def _served_from(self, state: State, leg: Leg) -> float | None:
        """Returns from when on there is a part, or room, for a stop [s]; None where another stop has to come first.

        Of what arms have done only the last stop of each may not be over at the last event.
        """
        if leg.sign == 0:
            return 0.0
        stores, k = self._stores, leg.store
        # What a take needs are puts that are over, what a put needs are takes that are.
        gives, uses = (self._takes, self._puts) if leg.sign > 0 else (self._puts, self._takes)
        capacity, initial = int(stores.capacity[k]), int(stores.initial[k])
        there = capacity - initial if leg.sign > 0 else initial
        pending = []
        for b, n in enumerate(state.at):
            there -= uses[b][n][k]
            if not n:
                continue
            there += gives[b][n - 1][k]
            if gives[b][n][k] > gives[b][n - 1][k]:
                pending.append(state.ends[b] - self._legs[b][n - 1].lasts[1])
        if there > 0:
            return 0.0
        # Some of these are used already.
        pending.sort()
        return pending[-there] if -there < len(pending) else None


def _legs(problem: SequencingProblem, a: int, nodes: tuple[int, ...]) -> list[Leg]:
    """Returns an arm's stops in their order."""
    assert problem.stores is not None  # callers have looked
    first = np.concatenate([[0], np.cumsum(problem.stops)])
    arm, last, found = problem.arms[a], problem.start_node, list[Leg]()
    for node in nodes:
        t, way = divmod(node, problem.options)
        for s in range(problem.stops[t]):
            change = problem.stores.change[first[t] + s]
            store = int(np.abs(change).argmax())
            own = float(arm.second[t, way] if s else arm.first[t, way])
            to = 0.0 if s else float(problem.between[a][last, node])
            at_target, over = problem.lasts[first[t] + s].tolist()
            found.append(
                Leg(
                    t,
                    node,
                    to + own,
                    own,
                    (at_target, over),
                    store,
                    int(change[store]),
                    s == 0,
                    s == problem.stops[t] - 1,
                )
            )
        last = node
    return found


@dataclass(frozen=True)
class Timed:
    """An order's times."""

    order: Order
    """The order."""
    total: float
    """When all is done [s]; infinite where it cannot be."""
    busy: tuple[float, ...]
    """By arm, the time of its own transfers and tasks, without waiting [s]."""
    late: float = 0.0
    """By how much windows are missed, together [s]."""
    begins: tuple[tuple[float, ...], ...] = ()
    """By arm, when each task's first approach begins [s]."""
    ends: tuple[tuple[float, ...], ...] = ()
    """By arm, when each task is over [s]."""
    left: int = 0
    """Stops that are never made, as they wait for parts or for room forever."""

    @property
    def is_possible(self) -> bool:
        """Returns whether all is done, and in time."""
        return np.isfinite(self.total) and self.late <= 1e-9

    @property
    def objective(self) -> float:
        """What is minimised [s]: the total, what is late many times, and a little of the arms' own times."""
        if self.left:
            # A stop that is never made counts this much [s].
            return 1e6 * self.left + sum(self.busy)
        return self.total + LATE * self.late + 1e-3 * sum(self.busy)


def timed(problem: SequencingProblem, order: Order) -> Timed:
    """Returns the times of an order, with waits for tasks that come before, for windows to open, and for buffers."""
    own = busy_times(problem, order)
    if not problem.coupled:
        return Timed(order, max(own), own)
    if problem.stores is not None:
        return _stored(problem, order, own)
    ways, first = problem.options, _predecessors(problem)
    clock = [0.0] * len(order.nodes)
    place = [0] * len(order.nodes)
    last = [problem.start_node] * len(order.nodes)
    over: dict[int, float] = {}
    begins: list[list[float]] = [[] for _ in order.nodes]
    ends: list[list[float]] = [[] for _ in order.nodes]
    late = 0.0
    moved = True
    while moved:
        moved = False
        for a, nodes in enumerate(order.nodes):
            while place[a] < len(nodes):
                node = nodes[place[a]]
                task = node // ways
                if any(one not in over for one in first[task]):
                    break
                begin = max(
                    clock[a] + problem.between[a][last[a], node],
                    _not_before(problem, task),
                    *(over[one] for one in first[task]),
                )
                clock[a] = over[task] = begin + problem.length[a][node]
                closes = _not_after(problem, task)
                late += clock[a] - closes if clock[a] > closes else 0.0
                begins[a].append(float(begin))
                ends[a].append(float(clock[a]))
                last[a], place[a], moved = node, place[a] + 1, True
    if any(place[a] < len(nodes) for a, nodes in enumerate(order.nodes)):
        return Timed(order, np.inf, own)
    total = max(
        clock[a] + problem.between[a][last[a], problem.start_node] for a in range(len(clock))
    )
    return Timed(
        order, float(total), own, float(late), tuple(map(tuple, begins)), tuple(map(tuple, ends))
    )


def _stored(problem: SequencingProblem, order: Order, own: tuple[float, ...]) -> Timed:
    """Returns the times of an order with buffers."""
    stored = StoredOrder(problem, order)
    last = stored.played()
    if left := stored.left(last):
        return Timed(order, np.inf, own, left=left)
    return Timed(order, stored.done(last), own, last.late, *stored.times(last))


def busy_times(problem: SequencingProblem, order: Order) -> tuple[float, ...]:
    """Returns, by arm, the time of its own transfers and tasks, without waiting [s]."""
    found = []
    for a, nodes in enumerate(order.nodes):
        if not nodes:
            # Nothing, but for an arm that has to change its tool all the same.
            found.append(float(problem.between[a][problem.start_node, problem.start_node]))
            continue
        way = np.array([problem.start_node, *nodes, problem.start_node])
        found.append(
            float(problem.between[a][way[:-1], way[1:]].sum() + problem.length[a][way].sum())
        )
    return tuple(found)


def _predecessors(problem: SequencingProblem) -> list[list[int]]:
    found: list[list[int]] = [[] for _ in range(problem.tasks)]
    for one, other in problem.before:
        found[other].append(one)
    return found


def _not_before(problem: SequencingProblem, task: int) -> float:
    return float(problem.not_before[task]) if len(problem.not_before) else 0.0


def _not_after(problem: SequencingProblem, task: int) -> float:
    return float(problem.not_after[task]) if len(problem.not_after) else np.inf


def keeps_rules(problem: SequencingProblem, tasks: Sequence[Sequence[int]]) -> bool:
    """Returns whether each arm's own order keeps precedence, sequences and, where it has to, the file's order."""
    for own in tasks:
        rank = {task: k for k, task in enumerate(own)}
        if problem.in_file_order and list(own) != sorted(own):
            return False
        if any(a in rank and b in rank and rank[a] > rank[b] for a, b in problem.before):
            return False
        for row in problem.sequences:
            ranks = [rank.get(task, -1) for task in row]
            if max(ranks) < 0:
                continue
            if ranks != list(range(ranks[0], ranks[0] + len(row))):
                return False
    return True


def best_options(problem: SequencingProblem, tasks: Sequence[Sequence[int]]) -> Order:
    """Returns each arm's tasks in the ways that make its own time least, by dynamic programming along its order."""
    return Order(tuple(_best_options(problem, a, own)[1] for a, own in enumerate(tasks)))


def _best_options(
    problem: SequencingProblem, a: int, tasks: Sequence[int]
) -> tuple[float, tuple[int, ...]]:
    if not tasks:
        return 0.0, ()
    w, between, length = problem.options, problem.between[a], problem.length[a]
    value: FloatArray = np.zeros(1)
    nodes = np.array([problem.start_node])
    came = []
    for task in tasks:
        own = np.arange(task * w, (task + 1) * w)
        total = value[:, None] + between[nodes[:, None], own]
        best = total.argmin(axis=0)
        value = total[best, np.arange(w)] + length[own]
        came.append(best)
        nodes = own
    value = value + between[nodes, problem.start_node]
    k = int(value.argmin())
    least = float(value[k])
    found = []
    for task, best in zip(reversed(tasks), reversed(came), strict=True):
        found.append(task * w + k)
        k = int(best[k])
    return least, tuple(reversed(found))
