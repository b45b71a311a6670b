"""Orders as a constraint programme for OR-Tools' CP-SAT, on whole milliseconds: a bound, and good orders.

Times are rounded down: so what is proven here holds for the problem itself. Waits of paired arms for each other are
left out, for the same reason.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from itertools import pairwise
from typing import Any

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.orders.proof.relaxation import Relaxation
from dualarm_cli.records import dataclass

MILLISECONDS = 1000.0
POLL = 0.05
"""How often it is asked whether to stop [s]."""


@dataclass(frozen=True)
class Proven:
    """What CP-SAT found."""

    bound: float
    """No order is faster [s]; infinite where there is none."""
    tasks: tuple[tuple[int, ...], ...] | None
    """Each arm's tasks in the best order that it met, None for none."""
    impossible: bool = False
    """Whether it is proven that there is none."""


def prove(
    problem: Relaxation,
    start: Sequence[Sequence[int]] | None,
    effort: float,
    seed: int,
    stop: Callable[[], bool] = lambda: False,
    bounded: Callable[[float], None] = lambda _: None,
) -> Proven:
    """Returns a bound on the time that all takes, and a good order.

    Args:
        problem: what is asked.
        start: each arm's tasks in a good order to begin with.
        effort: how long to search at most, in CP-SAT's deterministic seconds.
        seed: of its randomness.
        stop: whether to stop early; asked every POLL.
        bounded: receives every better bound [s].
    """
    from ortools.sat.python import cp_model

    model = _Model(problem, cp_model.CpModel())
    if start is not None:
        model.hint(start)
    solver = cp_model.CpSolver()
    # With one worker and a limit on deterministic time the answer is always the same.
    solver.parameters.num_workers = 1
    solver.parameters.random_seed = seed
    solver.parameters.max_deterministic_time = effort
    solver.parameters.linearization_level = 2
    solver.parameters.catch_sigint_signal = False

    solver.best_bound_callback = lambda bound: bounded(float(bound) / MILLISECONDS)
    status = _solved(solver, model.model, stop)
    if status == cp_model.INFEASIBLE:
        return Proven(np.inf, None, impossible=True)
    if status == cp_model.MODEL_INVALID:
        raise ValueError(f"CP-SAT refuses the model: {model.model.validate()}")
    bound = max(0.0, float(solver.best_objective_bound) / MILLISECONDS)
    found = status in (cp_model.OPTIMAL, cp_model.FEASIBLE)
    return Proven(bound, model.orders(solver) if found else None)


def _solved(solver: Any, model: Any, stop: Callable[[], bool]) -> Any:
    """Returns the status of a model solved in a thread of its own.

    Python sees to signals in the main thread and between its own instructions only: there would be none for as long as
    CP-SAT takes.
    """
    with ThreadPoolExecutor(1) as pool:
        solving = pool.submit(solver.solve, model)
        try:
            while not solving.done():
                wait([solving], POLL)
                if stop():
                    solver.stop_search()
        finally:
            # Asked again and again: one that comes before the solver has begun is lost.
            while not solving.done():
                solver.stop_search()
                wait([solving], POLL)
        return solving.result()


class _Model:
    """Variables and constraints; one method per kind of constraint."""

    def __init__(self, problem: Relaxation, model: Any) -> None:
        self.problem, self.model = problem, model
        self.costs = [np.floor(MILLISECONDS * problem.kept(a)) for a in range(len(problem.cost))]
        self.least = np.floor(
            MILLISECONDS * np.where(np.isfinite(problem.least), problem.least, 0.0)
        )
        n = problem.tasks
        self.does: list[list[Any]] = [
            [model.new_bool_var(f"does_{a}_{t}") if one else None for t, one in enumerate(allowed)]
            for a, allowed in enumerate(problem.allowed(a) for a in range(len(self.costs)))
        ]
        self.arcs: list[dict[tuple[int, int], Any]] = [{} for _ in self.costs]
        self.horizon = self._horizon()
        self.total = model.new_int_var(0, self.horizon, "total")
        for t in range(n):
            model.add_exactly_one(does[t] for does in self.does if does[t] is not None)
        for a in range(len(self.costs)):
            self._route(a)
        self._sequences()
        if problem.timed:
            self._times()
        model.minimize(self.total)

    def _horizon(self) -> int:
        """Returns a time by which any order is over [ms]."""
        dearest = [cost[np.isfinite(cost)].max(initial=0.0) for cost in self.costs]
        windows = [w[np.isfinite(w)].max(initial=0.0) for w in self._windows()]
        whole = max(dearest, default=0.0) * (self.problem.tasks + 1)
        return int(whole + MILLISECONDS * max(windows, default=0.0)) + 1

    def _windows(self) -> list[FloatArray]:
        return [w for w in (self.problem.not_before, self.problem.not_after) if w is not None]

    def _route(self, a: int) -> None:
        """One arm goes from its start through all its tasks and back; its time is part of the total."""
        n, cost, does, model = self.problem.tasks, self.costs[a], self.does[a], self.model
        idle = model.new_bool_var(f"idle_{a}")
        arcs, terms = [(n, n, idle)], []
        for t, one in enumerate(does):
            if one is not None:
                arcs.append((t, t, one.negated()))
                model.add_implication(idle, one.negated())
        for i, j in np.argwhere(np.isfinite(cost)).tolist():
            if i == j or (i < n and does[i] is None):
                continue
            literal = model.new_bool_var(f"arc_{a}_{i}_{j}")
            self.arcs[a][i, j] = literal
            arcs.append((i, j, literal))
            terms.append(int(cost[i, j]) * literal)
        model.add_circuit(arcs)
        model.add(self.total >= sum(terms))

    def _sequences(self) -> None:
        for row in self.problem.sequences:
            for does in self.does:
                own = [0 if does[t] is None else does[t] for t in row]
                for one, other in pairwise(own):
                    self.model.add(one == other)

    def _times(self) -> None:
        """When each task is over, at the earliest: what comes before it, and windows."""
        problem, model, n = self.problem, self.model, self.problem.tasks
        over = [model.new_int_var(0, self.horizon, f"over_{t}") for t in range(n)]
        least = [int(x) for x in self.least]
        for cost, arcs in zip(self.costs, self.arcs, strict=True):
            for (i, j), literal in arcs.items():
                came = over[i] if i < n else 0
                goes = over[j] if j < n else self.total
                model.add(goes >= came + int(cost[i, j])).only_enforce_if(literal)
        for one, other in problem.before:
            model.add(over[other] >= over[one] + least[other])
        if problem.not_before is not None:
            for t, opens in enumerate(problem.not_before):
                model.add(over[t] >= int(MILLISECONDS * opens) + least[t])
        if problem.not_after is not None:
            for t in np.flatnonzero(np.isfinite(problem.not_after)).tolist():
                model.add(over[t] <= int(np.ceil(MILLISECONDS * problem.not_after[t])))
        self._stores(over)

    def _stores(self, over: list[Any]) -> None:
        """Parts and room at every instant, as far as events alone tell.

        Each millisecond has as many ranks as there may be events in it, so that those of one arm come one after the
        other; of two arms' events at once one or the other could be the first.
        """
        stores, model = self.problem.stores, self.model
        if stores is None:
            return
        rows = np.flatnonzero(stores.change.any(axis=1)).tolist()
        ranks = len(rows) + 1
        event = {r: model.new_int_var(0, (self.horizon + 1) * ranks, f"event_{r}") for r in rows}
        own = [[r for r in (2 * t, 2 * t + 1) if r in event] for t in range(self.problem.tasks)]
        for t, mine in enumerate(own):
            for row in mine:
                model.add(event[row] < (over[t] + 1) * ranks)
            if len(mine) > 1:
                model.add(event[mine[0]] < event[mine[1]])
        for one, other in self.problem.before:
            for row in own[other]:
                model.add(event[row] >= over[one] * ranks)
                for last in own[one]:
                    model.add(event[row] > event[last])
        for arcs in self.arcs:
            for (i, j), literal in arcs.items():
                if i == self.problem.tasks or j == self.problem.tasks:
                    continue
                for row in own[j]:
                    model.add(event[row] >= over[i] * ranks).only_enforce_if(literal)
                    for last in own[i]:
                        model.add(event[row] > event[last]).only_enforce_if(literal)
        for k, capacity in enumerate(stores.capacity.tolist()):
            # What is there at the start comes before all; events begin at 1.
            times, changes = list[Any]([0]), [int(stores.initial[k])]
            for row in np.flatnonzero(stores.change[:, k]).tolist():
                times.append(event[row] + 1)
                changes.append(int(stores.change[row, k]))
            model.add_reservoir_constraint(times, changes, 0, capacity)

    def hint(self, start: Sequence[Sequence[int]]) -> None:
        """Tells the solver an order."""
        n = self.problem.tasks
        for a, own in enumerate(start):
            way = [n, *own, n]
            taken = set(pairwise(way))
            for arc, literal in self.arcs[a].items():
                self.model.add_hint(literal, arc in taken)
            for t, literal in enumerate(self.does[a]):
                if literal is not None:
                    self.model.add_hint(literal, t in own)

    def orders(self, solver: Any) -> tuple[tuple[int, ...], ...]:
        """Returns each arm's tasks as solved."""
        n, found = self.problem.tasks, []
        for arcs in self.arcs:
            after = {i: j for (i, j), literal in arcs.items() if solver.value(literal)}
            route, at = list[int](), after.get(n, n)
            while at != n:
                route.append(at)
                at = after[at]
            found.append(tuple(route))
        return tuple(found)
