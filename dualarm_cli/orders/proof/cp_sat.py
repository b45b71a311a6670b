"""Constraint programme of orders for CP-SAT [ms]: a bound, and good orders.

Times are whole milliseconds; CP-SAT is the solver of OR-Tools.

Times are rounded down, so the bound holds for the problem itself. Waits of paired arms for each other are left out for
the same reason.
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
"""Interval between checks of the stop callback [s]."""


@dataclass(frozen=True)
class Proven:
    """Result of CP-SAT."""

    bound: float
    """Lower bound of all orders [s]; infinite if there is none."""
    tasks: tuple[tuple[int, ...], ...] | None
    """Each arm's tasks in the best order found, or None."""
    impossible: bool = False
    """Whether infeasibility is proven."""


def prove(
    problem: Relaxation,
    start: Sequence[Sequence[int]] | None,
    effort: float,
    seed: int,
    stop: Callable[[], bool] = lambda: False,
    bounded: Callable[[float], None] = lambda _: None,
) -> Proven:
    """Compute a lower bound of the makespan, and a good order.

    Args:
        problem: relaxation of the job.
        start: each arm's tasks in a good first order.
        effort: time limit in CP-SAT's deterministic seconds.
        seed: random seed.
        stop: whether to stop early; called every POLL.
        bounded: receives every better bound [s].
    """
    from ortools.sat.python import cp_model

    model = _Model(problem, cp_model.CpModel())
    if start is not None:
        model.hint(start)
    solver = cp_model.CpSolver()
    # One worker and a deterministic time limit make the result reproducible.
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
    is_feasible = status in (cp_model.OPTIMAL, cp_model.FEASIBLE)
    return Proven(bound, model.orders(solver) if is_feasible else None)


def _solved(solver: Any, model: Any, stop: Callable[[], bool]) -> Any:
    """Solve a model in a thread, and return its status.

    Python handles signals in the main thread between its own instructions only, so none would be handled while CP-SAT
    runs.
    """
    with ThreadPoolExecutor(1) as pool:
        solving = pool.submit(solver.solve, model)
        try:
            while not solving.done():
                wait([solving], POLL)
                if stop():
                    solver.stop_search()
        finally:
            # A request before the start of the solver is lost, so it is repeated.
            while not solving.done():
                solver.stop_search()
                wait([solving], POLL)
        return solving.result()


class _Model:
    """Variables and constraints; one method per kind of constraint."""

    def __init__(self, problem: Relaxation, model: Any) -> None:
        self.problem, self.model = problem, model
        self.costs = [
            np.floor(MILLISECONDS * problem.costs_with_rules(a)) for a in range(len(problem.cost))
        ]
        self.least = np.floor(
            MILLISECONDS * np.where(np.isfinite(problem.least), problem.least, 0.0)
        )
        n = problem.tasks
        self.does: list[list[Any]] = [
            [model.new_bool_var(f"does_{a}_{t}") if may else None for t, may in enumerate(allowed)]
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
        """Compute an upper bound of the end of any order [ms]."""
        largest_costs = [cost[np.isfinite(cost)].max(initial=0.0) for cost in self.costs]
        windows = [w[np.isfinite(w)].max(initial=0.0) for w in self._windows()]
        total = max(largest_costs, default=0.0) * (self.problem.tasks + 1)
        return int(total + MILLISECONDS * max(windows, default=0.0)) + 1

    def _windows(self) -> list[FloatArray]:
        return [w for w in (self.problem.not_before, self.problem.not_after) if w is not None]

    def _route(self, a: int) -> None:
        """Add the circuit of one arm: from its start through its tasks and back."""
        n, cost, does, model = self.problem.tasks, self.costs[a], self.does[a], self.model
        idle = model.new_bool_var(f"idle_{a}")
        arcs, terms = [(n, n, idle)], []
        for t, literal in enumerate(does):
            if literal is not None:
                arcs.append((t, t, literal.negated()))
                model.add_implication(idle, literal.negated())
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
                literals = [0 if does[t] is None else does[t] for t in row]
                for first, second in pairwise(literals):
                    self.model.add(first == second)

    def _times(self) -> None:
        """Add the earliest ends of tasks, with precedence and windows."""
        problem, model, n = self.problem, self.model, self.problem.tasks
        ends = [model.new_int_var(0, self.horizon, f"over_{t}") for t in range(n)]
        least = [int(x) for x in self.least]
        for cost, arcs in zip(self.costs, self.arcs, strict=True):
            for (i, j), literal in arcs.items():
                source_end = ends[i] if i < n else 0
                target_end = ends[j] if j < n else self.total
                model.add(target_end >= source_end + int(cost[i, j])).only_enforce_if(literal)
        for earlier, later in problem.before:
            model.add(ends[later] >= ends[earlier] + least[later])
        if problem.not_before is not None:
            for t, opens in enumerate(problem.not_before):
                model.add(ends[t] >= int(MILLISECONDS * opens) + least[t])
        if problem.not_after is not None:
            for t in np.flatnonzero(np.isfinite(problem.not_after)).tolist():
                model.add(ends[t] <= int(np.ceil(MILLISECONDS * problem.not_after[t])))
        self._stores(ends)

    def _stores(self, ends: list[Any]) -> None:
        """Add the buffer levels after every event.

        Each millisecond has as many ranks as it may have events, so that events of one arm are consecutive and
        simultaneous events of both arms may have either order.
        """
        stores, model = self.problem.stores, self.model
        if stores is None:
            return
        rows = np.flatnonzero(stores.change.any(axis=1)).tolist()
        ranks = len(rows) + 1
        event = {r: model.new_int_var(0, (self.horizon + 1) * ranks, f"event_{r}") for r in rows}
        task_rows = [
            [r for r in (2 * t, 2 * t + 1) if r in event] for t in range(self.problem.tasks)
        ]
        for t, event_rows in enumerate(task_rows):
            for row in event_rows:
                model.add(event[row] < (ends[t] + 1) * ranks)
            if len(event_rows) > 1:
                model.add(event[event_rows[0]] < event[event_rows[1]])
        for earlier, later in self.problem.before:
            for row in task_rows[later]:
                model.add(event[row] >= ends[earlier] * ranks)
                for last in task_rows[earlier]:
                    model.add(event[row] > event[last])
        for arcs in self.arcs:
            for (i, j), literal in arcs.items():
                if i == self.problem.tasks or j == self.problem.tasks:
                    continue
                for row in task_rows[j]:
                    model.add(event[row] >= ends[i] * ranks).only_enforce_if(literal)
                    for last in task_rows[i]:
                        model.add(event[row] > event[last]).only_enforce_if(literal)
        for k, capacity in enumerate(stores.capacity.tolist()):
            # The initial level has time 0; events begin at 1.
            times, changes = list[Any]([0]), [int(stores.initial[k])]
            for row in np.flatnonzero(stores.change[:, k]).tolist():
                times.append(event[row] + 1)
                changes.append(int(stores.change[row, k]))
            model.add_reservoir_constraint(times, changes, 0, capacity)

    def hint(self, start: Sequence[Sequence[int]]) -> None:
        """Add an order as a hint."""
        n = self.problem.tasks
        for a, tasks in enumerate(start):
            route = [n, *tasks, n]
            taken = set(pairwise(route))
            for arc, literal in self.arcs[a].items():
                self.model.add_hint(literal, arc in taken)
            for t, literal in enumerate(self.does[a]):
                if literal is not None:
                    self.model.add_hint(literal, t in tasks)

    def orders(self, solver: Any) -> tuple[tuple[int, ...], ...]:
        """Read each arm's tasks from a solution."""
        n, orders = self.problem.tasks, []
        for arcs in self.arcs:
            after = {i: j for (i, j), literal in arcs.items() if solver.value(literal)}
            route, at = list[int](), after.get(n, n)
            while at != n:
                route.append(at)
                at = after[at]
            orders.append(tuple(route))
        return tuple(orders)
