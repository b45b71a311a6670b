"""Small random problems of orders, the same for the same seed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise, permutations, product

import numpy as np
import pytest

from dualarm_cli.model.motion.rest_to_rest import RestToRest
from dualarm_cli.orders.asynchronous.problem import ArmTasks, SequencingProblem
from dualarm_cli.orders.paired.problem import StageProblem
from dualarm_cli.orders.rules.stores import Stores

Rows = tuple[tuple[int, ...], ...]


def _rules(rng: np.random.Generator, n: int, kind: str) -> dict[str, object]:
    """Returns precedence, sequences or the file's order for n tasks; `kind` names what there is."""
    found: dict[str, object] = {}
    names = rng.permutation(n).tolist()
    if "before" in kind:
        pairs = [(names[0], names[-1])]
        if n > 3 and rng.random() < 0.5:
            pairs.append((names[0], names[1]))
        found["before"] = tuple(pairs)
    if "sequences" in kind:
        row = names[1:3] if n == 4 or rng.random() < 0.5 else names[1:4]
        found["sequences"] = (tuple(sorted(row) if "file" in kind else row),)
    found["in_file_order"] = "file" in kind
    return found


@pytest.fixture(scope="session")
def by_clocks() -> Callable[..., SequencingProblem]:
    """Makes problems of asynchronous arms: two joints, some tasks of two stops, some of one arm only."""

    def made(
        seed: int,
        kind: str = "",
        n: int = 5,
        ways: int = 2,
        arms: int = 2,
        *,
        restricted: bool = True,
    ) -> SequencingProblem:
        rng = np.random.default_rng(seed)
        law = RestToRest(np.array([2.0, 3.0]), np.array([8.0, 6.0]), np.array([np.inf, np.inf]))
        stops = tuple(rng.integers(1, 3, n).tolist())
        rules = _rules(rng, n, kind)
        one_arm = {t for row in rules.get("sequences", ()) for t in row}
        who = np.where(rng.random(n) < 0.3, rng.integers(0, arms, n), -1) if restricted else -1
        who = np.broadcast_to(who, n).copy()
        who[list(one_arm)] = -1
        made = []
        for a in range(arms):
            first = rng.uniform(0.2, 0.8, (n, ways))
            first[:, 1:] = np.where(rng.random((n, ways - 1)) < 0.25, np.inf, first[:, 1:])
            first[(who >= 0) & (who != a)] = np.inf
            second = np.where(np.array(stops) == 2, rng.uniform(0.3, 0.9, n), 0.0)
            entry, leaving = rng.uniform(-2, 2, (2, n, ways, 2))
            # What there is not has no postures either.
            entry[np.isinf(first)] = leaving[np.isinf(first)] = np.nan
            second = np.repeat(second[:, None], ways, axis=1)
            made.append(ArmTasks(entry, leaving, first, second, rng.uniform(-1, 1, 2), law))
        windows = {}
        if "windows" in kind:
            early, late = np.zeros(n), np.full(n, np.inf)
            early[rng.integers(n)] = rng.uniform(1.0, 6.0)
            late[rng.integers(n)] = rng.uniform(3.0, 9.0)
            windows = {"not_before": early, "not_after": late}
        return SequencingProblem(
            tuple(made),
            stops,
            bool(rng.random() < 0.5),
            turn=(float(rng.uniform(0, 1.5)), float(rng.uniform(0, 1.5))),
            **rules,
            **windows,
        )

    return made


@pytest.fixture(scope="session")
def in_stages() -> Callable[..., StageProblem]:
    """Makes problems of stages on three platform angles: tables of random lengths, no structure to lean on."""

    def made(
        seed: int, kind: str = "", n: int = 4, arms: int = 2, f: int = 3, *, one_stop: bool = False
    ) -> StageProblem:
        rng = np.random.default_rng(seed)
        sizes = np.ones(n, dtype=int) if one_stop else rng.integers(1, 3, n)
        ends = np.cumsum(sizes)
        tasks = tuple(tuple(range(e - m, e)) for e, m in zip(ends, sizes, strict=True))
        s = int(ends[-1])
        rules = _rules(rng, n, kind)
        turn = rng.uniform(0.2, 1.0, (f, f))
        turn = np.where(np.eye(f) > 0, 0.0, turn + turn.T)
        returns, free_start = bool(rng.random() < 0.5), bool(rng.random() < 0.3)
        in_row = {t for row in rules.get("sequences", ()) for t in row}
        lengths, works = [], []
        for a in range(arms):
            work = rng.uniform(0.2, 0.8, (s, f))
            # Some stops are out of reach from some angles, some tasks of one arm altogether.
            work[(rng.random((s, f)) < 0.15) & (np.arange(f) > 0)] = np.inf
            for t in range(n):
                if arms > 1 and t % 4 == 1 + a and t not in in_row:
                    work[list(tasks[t])] = np.inf
            length = np.empty((s + 1, s + 2, f, f))
            move = rng.uniform(0.1, 2.0, (s + 1, s, f, f))
            length[:, :s] = np.maximum(move, turn) + work[:, None, :]
            length[:, s] = np.repeat(rng.uniform(0.1, 2.0, (s + 1, f, 1)), f, 2) if returns else 0.0
            # The way back is to the first angle: what it would take to others must not count.
            length[:, s, :, 1:] *= 0.5
            length[:, s + 1] = -np.inf
            # As exact as the lengths of a job, which are in single precision.
            lengths.append(length.astype(np.float32).astype(np.float64))
            works.append(work)
        windows = {}
        if "windows" in kind:
            early, late = np.zeros(s), np.full(s, np.inf)
            early[tasks[int(rng.integers(n))][0]] = rng.uniform(1.0, 6.0)
            late[tasks[int(rng.integers(n))][-1]] = rng.uniform(3.0, 12.0)
            windows = {"not_before": early, "not_after": late}
        apart = None
        if "apart" in kind and arms == 2:
            apart = np.zeros((s + 2, s + 2, f))
            apart[:s, :s] = np.where(rng.random((s, s, f)) < 0.3, np.inf, 0.0)
            apart[:s, :s] += np.where(rng.random((s, s, f)) < 0.3, 0.5, 0.0)
        return StageProblem(
            tuple(lengths),
            tuple(works),
            turn,
            tasks,
            returns,
            free_start,
            **rules,
            **windows,
            pair_cost=apart,
        )

    return made


@pytest.fixture(scope="session")
def every_row() -> Callable[[int, int], Iterator[Rows]]:
    """Yields every way to give n tasks to arms and to order what each has."""

    def rows(n: int, arms: int) -> Iterator[Rows]:
        for who in product(range(arms), repeat=n):
            own = [[t for t in range(n) if who[t] == a] for a in range(arms)]
            yield from product(*(permutations(some) for some in own))

    return rows


@pytest.fixture(scope="session")
def kept() -> Callable[..., bool]:
    """Says whether rows of tasks by arm keep every rule that can be seen from each arm's own order, word by word."""

    def keeps(problem: SequencingProblem | StageProblem, rows: Rows) -> bool:
        at = {t: (a, k) for a, row in enumerate(rows) for k, t in enumerate(row)}
        for one, other in problem.before:
            if at[one][0] == at[other][0] and at[one][1] > at[other][1]:
                return False
        for row in problem.sequences:
            for one, other in pairwise(row):
                if at[other] != (at[one][0], at[one][1] + 1):
                    return False
        if problem.in_file_order:
            for row in rows:
                if any(one > other for one, other in pairwise(row)):
                    return False
        return True

    return keeps


@pytest.fixture(scope="session")
def with_stores() -> Callable[..., SequencingProblem | StageProblem]:
    """Adds buffers to a problem: random stops put parts in (last ones of tasks) or take them out (first ones)."""

    def made(
        problem: SequencingProblem | StageProblem, seed: int, count: int = 2
    ) -> SequencingProblem | StageProblem:
        rng = np.random.default_rng(seed)
        in_stages = isinstance(problem, StageProblem)
        sizes = [len(own) for own in problem.tasks] if in_stages else list(problem.stops)
        s = sum(sizes)
        change = np.zeros((s + 1, count), dtype=np.int64)
        at = 0
        for size in sizes:
            for k in range(size):
                # A pick comes before its place; a task of one stop is either.
                sign = (-1 if k == 0 else 1) if size == 2 else rng.choice((-1, 1))
                if rng.random() < 0.75:
                    change[at + k, rng.integers(count)] = sign
            at += size
        # By the numbers alone there may be an order.
        net = change.sum(axis=0)
        capacity = np.maximum(rng.integers(1, 3, count), np.abs(net))
        initial = rng.integers(np.maximum(0, -net), np.minimum(capacity, capacity - net) + 1)
        stores = Stores(change, capacity, initial)
        if in_stages:
            return replace(problem, stores=stores)
        lasts = np.sort(rng.uniform(0.0, 0.15, (s, 2)), axis=1)[:, ::-1]
        return replace(problem, stores=stores, lasts=lasts)

    return made
