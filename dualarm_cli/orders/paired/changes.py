"""Stages of paired arms with tool changes: lengths that have whole changes in them, and stages with their stops."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray, distinct
from dualarm_cli.orders.paired.alignment import Alignments
from dualarm_cli.orders.paired.problem import IDLE, StageOrder, StageProblem
from dualarm_cli.orders.rules.tool_stands import NO_TOOL
from dualarm_cli.records import dataclass


def closed(problem: StageProblem, found: StageOrder) -> StageOrder:
    """Returns an order with a total in which every arm goes back to where its first stop is begun.

    The search counts the least way back to any stop there is; the angles stay as it chose them.

    Args:
        problem: what is asked; with a free start, and there and back.
        found: an order, with its angles.
    """
    if not len(found.angles) or not np.isfinite(found.total):
        return found
    begin, end = int(found.angles[0]), int(found.angles[-1])
    counted, real = 0.0, float(problem.turn[end, begin])
    for length, work, own in zip(problem.length, problem.work, found.slots.T, strict=True):
        stops = own[own != IDLE]
        if not len(stops):
            continue
        first, last = int(stops[0]), int(stops[-1])
        least = float(length[last, problem.stops, end, 0])
        counted = max(counted, least)
        way = float(length[last, first, end, begin]) - float(work[first, begin])
        # An arm whose first stop comes later begins somewhere else.
        real = max(real, way if np.isfinite(way) else least)
    return replace(found, total=found.total + max(0.0, real - counted))


EARLY = 1e-5
"""What it counts that an arm with stops left is idle for a stage [s]: of equal orders the early one is taken."""


def best_stages(problem: StageProblem, rows: Sequence[Sequence[int]]) -> IntArray:
    """Returns the quickest stages of arms whose orders are given, shape (n, arms).

    Where no stages are possible, those of one arm after those of the other.

    Args:
        problem: what is asked, without hand-overs; of its rules of order those between arms, which rows do not say.
        rows: by arm, its stops one after the other.
    """
    queues = [np.array(row, dtype=np.int64)[None] for row in rows]
    every = Alignments(problem, queues, EARLY)
    if np.isfinite(every.totals()[0]):
        return every.best()
    whole = np.full((sum(map(len, rows)), len(rows)), IDLE, dtype=np.int64)
    at = 0
    for a, row in enumerate(rows):
        whole[at : at + len(row), a] = row
        at += len(row)
    return whole


@dataclass(frozen=True)
class StageTools:
    """One arm's tools: with which each of s stops is made, and which stops leave and take each tool at its stand."""

    tool: tuple[int, ...]
    """Number of each stop's tool, NO_TOOL for none, shape (s,)."""
    start: int
    """The tool that is on before the first stop, and at the end of a cycle."""
    leave: Mapping[int, int]
    """By tool, the stop that leaves it, a number beyond those of the tasks."""
    take: Mapping[int, int]
    """By tool, the stop that takes it."""

    def changes(self, old: int, new: int) -> tuple[int, ...]:
        """Returns the stops between two tools."""
        if old == new:
            return ()
        return tuple(
            stops[tool] for stops, tool in ((self.leave, old), (self.take, new)) if tool != NO_TOOL
        )


@dataclass(frozen=True)
class StageStands:
    """All stops, those at stands among them, and what they are for."""

    whole: StageProblem
    """First the tasks, then those that take or leave a tool at its stand, one stop each."""
    tools: tuple[StageTools | None, ...]
    """By arm, None for an arm that changes none."""


def with_whole_changes(stands: StageStands, tasks: int) -> StageProblem:
    """Returns the stages of the tasks' stops alone; where another tool is asked for, the transfer has the change in it.

    The other arm waits meanwhile: how both go on in one stage is for `stages_with_changes`.

    Args:
        stands: all stops.
        tasks: how many tasks there are without those at stands.
    """
    whole, tools = stands.whole, stands.tools
    stops = sum(len(own) for own in whole.tasks[:tasks])
    kept = [*range(stops), whole.length[0].shape[0] - 1]
    columns = [*range(stops), *range(whole.length[0].shape[1] - 2, whole.length[0].shape[1])]
    lengths = []
    for length, own in zip(whole.length, tools, strict=True):
        plain = np.array(length[np.ix_(kept, columns)])
        lengths.append(
            plain if own is None else _changed(plain, length, own, returns=whole.returns)
        )
    apart = whole.pair_cost
    if apart is not None:
        apart = apart[np.ix_(columns, columns)]
    return replace(
        whole,
        tasks=whole.tasks[:tasks],
        length=tuple(lengths),
        work=tuple(work[:stops] for work in whole.work),
        not_before=None if whole.not_before is None else whole.not_before[:stops],
        not_after=None if whole.not_after is None else whole.not_after[:stops],
        pair_cost=apart,
        stores=None if whole.stores is None else whole.stores.of(range(stops), ()),
    )


def _changed(
    plain: FloatArray, length: FloatArray, own: StageTools, *, returns: bool
) -> FloatArray:
    """Returns one arm's lengths with whole changes in them, at the platform angles that suit them best."""
    count, home = len(plain) - 1, length.shape[1] - 2
    tool = np.array([*own.tool, own.start])
    for old in distinct(tool).tolist():
        rows = np.flatnonzero(tool == old)
        # The start's row is that of the whole as well, behind the stands.
        sources = np.where(rows == count, len(length) - 1, rows)
        for new in distinct(tool).tolist():
            columns = np.flatnonzero(tool == new)
            if not returns:
                columns = columns[columns != count]
            stops = own.changes(old, new)
            if not stops or not len(columns):
                continue
            goals = np.where(columns == count, home, columns)
            value = length[sources, stops[0]].astype(np.float64)
            for one, other in pairwise(stops):
                value = _over_angles(value, length[one, other][None])[:, 0]
            found = _over_angles(value, length[stops[-1], goals])
            plain[np.ix_(rows, columns)] = found
    return plain


def _over_angles(one: FloatArray, other: FloatArray) -> FloatArray:
    """Returns the least sums over the platform angle in between, (i, j, f, f), of shapes (i, f, f) and (j, f, f)."""
    f = one.shape[1]
    found = np.full((len(one), len(other), f, f), np.inf)
    for k in range(f):
        np.minimum(found, one[:, None, :, k, None] + other[None, :, None, k, :], out=found)
    return found


def stages_with_changes(stands: StageStands, slots: IntArray) -> IntArray:
    """Returns an order's stages with the stops of its tool changes, each arm's stops in one stage as is quickest.

    Args:
        stands: all stops.
        slots: stops of the tasks, IDLE where an arm has none, shape (n, arms).
    """
    whole, rows = stands.whole, list[list[int]]()
    for column, own in zip(slots.T, stands.tools, strict=True):
        stops = [stop for stop in column.tolist() if stop != IDLE]
        rows.append(stops if own is None else _row(stops, own, returns=whole.returns))
    return best_stages(whole, rows)


def _row(stops: Sequence[int], own: StageTools, *, returns: bool) -> list[int]:
    """Returns one arm's stops with its changes."""
    found, on = list[int](), own.start
    for stop in stops:
        found += [*own.changes(on, own.tool[stop]), stop]
        on = own.tool[stop]
    return found + (list(own.changes(on, own.start)) if returns else [])
