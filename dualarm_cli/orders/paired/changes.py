"""Tool changes of paired arms: stage lengths with whole changes, stages with stands.

A stage with stands has the stops at stands.
"""

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


def closed(problem: StageProblem, order: StageOrder) -> StageOrder:
    """Correct an order's total: arms return to their first stops' starts.

    The search counts the shortest return to any stop; the angles stay as chosen.

    Args:
        problem: the stage problem, with free start and return.
        order: an order, with its angles.
    """
    if not len(order.angles) or not np.isfinite(order.total):
        return order
    begin, end = int(order.angles[0]), int(order.angles[-1])
    counted, actual = 0.0, float(problem.turn[end, begin])
    for length, work, column in zip(problem.length, problem.work, order.slots.T, strict=True):
        stops = column[column != IDLE]
        if not len(stops):
            continue
        first, last = int(stops[0]), int(stops[-1])
        least = float(length[last, problem.stops, end, 0])
        counted = max(counted, least)
        returning = float(length[last, first, end, begin]) - float(work[first, begin])
        # An arm whose first stop is in a later stage starts elsewhere.
        actual = max(actual, returning if np.isfinite(returning) else least)
    return replace(order, total=order.total + max(0.0, actual - counted))


EARLY = 1e-5
"""Penalty of a stage idle for an arm with remaining stops [s].

It breaks ties in favour of early stops.
"""


def best_stages(problem: StageProblem, rows: Sequence[Sequence[int]]) -> IntArray:
    """Compute the quickest stages of given orders of both arms, shape (n, arms).

    If none is feasible, the stages of one arm follow those of the other.

    Args:
        problem: the stage problem, without hand-overs; its rules between the arms apply.
        rows: stops of each arm in their order.
    """
    queues = [np.array(row, dtype=np.int64)[None] for row in rows]
    alignments = Alignments(problem, queues, EARLY)
    if np.isfinite(alignments.totals()[0]):
        return alignments.best()
    sequential = np.full((sum(map(len, rows)), len(rows)), IDLE, dtype=np.int64)
    at = 0
    for a, row in enumerate(rows):
        sequential[at : at + len(row), a] = row
        at += len(row)
    return sequential


@dataclass(frozen=True)
class StageTools:
    """Tools and changes of an arm: tools of s stops, stand stops."""

    tool: tuple[int, ...]
    """Number of each stop's tool, NO_TOOL for none, shape (s,)."""
    start: int
    """Tool before the first stop, and at the end of a cycle."""
    leave: Mapping[int, int]
    """Stop that leaves each tool; a number beyond those of the tasks."""
    take: Mapping[int, int]
    """Stop that takes each tool."""

    def changes(self, old: int, new: int) -> tuple[int, ...]:
        """List the stops of a change between two tools."""
        if old == new:
            return ()
        return tuple(
            stops[tool] for stops, tool in ((self.leave, old), (self.take, new)) if tool != NO_TOOL
        )


@dataclass(frozen=True)
class StageStands:
    """Stage problem with the stops at stands, and their tools."""

    whole: StageProblem
    """Stage problem: tasks, then single-stop tasks that take or leave tools."""
    tools: tuple[StageTools | None, ...]
    """Tools of each arm; None without tool changes."""


def with_whole_changes(stands: StageStands, tasks: int) -> StageProblem:
    """Build the stage problem without stands; tool changes are part of the transfers.

    The other arm waits during a change; `stages_with_changes` shares these stages later.

    Args:
        stands: stage problem with all stops.
        tasks: number of tasks without those at stands.
    """
    whole, tools = stands.whole, stands.tools
    stops = sum(len(task) for task in whole.tasks[:tasks])
    rows = [*range(stops), whole.length[0].shape[0] - 1]
    columns = [*range(stops), *range(whole.length[0].shape[1] - 2, whole.length[0].shape[1])]
    lengths = []
    for length, arm_tools in zip(whole.length, tools, strict=True):
        without_changes = np.array(length[np.ix_(rows, columns)])
        lengths.append(
            without_changes
            if arm_tools is None
            else _changed(without_changes, length, arm_tools, returns=whole.returns)
        )
    pair_cost = whole.pair_cost
    if pair_cost is not None:
        pair_cost = pair_cost[np.ix_(columns, columns)]
    return replace(
        whole,
        tasks=whole.tasks[:tasks],
        length=tuple(lengths),
        work=tuple(work[:stops] for work in whole.work),
        not_before=None if whole.not_before is None else whole.not_before[:stops],
        not_after=None if whole.not_after is None else whole.not_after[:stops],
        pair_cost=pair_cost,
        stores=None if whole.stores is None else whole.stores.of(range(stops), ()),
    )


def _changed(
    plain: FloatArray, length: FloatArray, tools: StageTools, *, returns: bool
) -> FloatArray:
    """Insert whole tool changes into one arm's lengths, at the best platform angles."""
    count, home = len(plain) - 1, length.shape[1] - 2
    tool = np.array([*tools.tool, tools.start])
    for old in distinct(tool).tolist():
        rows = np.flatnonzero(tool == old)
        # The row of the start is behind those of the stands.
        sources = np.where(rows == count, len(length) - 1, rows)
        for new in distinct(tool).tolist():
            columns = np.flatnonzero(tool == new)
            if not returns:
                columns = columns[columns != count]
            stops = tools.changes(old, new)
            if not stops or not len(columns):
                continue
            goals = np.where(columns == count, home, columns)
            value = length[sources, stops[0]].astype(np.float64)
            for earlier, later in pairwise(stops):
                value = _over_angles(value, length[earlier, later][None])[:, 0]
            lengths = _over_angles(value, length[stops[-1], goals])
            plain[np.ix_(rows, columns)] = lengths
    return plain


def _over_angles(first: FloatArray, second: FloatArray) -> FloatArray:
    """Compute least sums over middle angles, shapes (i, f, f), (j, f, f)."""
    f = first.shape[1]
    sums = np.full((len(first), len(second), f, f), np.inf)
    for k in range(f):
        np.minimum(sums, first[:, None, :, k, None] + second[None, :, None, k, :], out=sums)
    return sums


def stages_with_changes(stands: StageStands, slots: IntArray) -> IntArray:
    """Insert the stops of tool changes into an order, in the quickest stages.

    Args:
        stands: stage problem with all stops.
        slots: stops of the tasks, IDLE for none, shape (n, arms).
    """
    whole, rows = stands.whole, list[list[int]]()
    for column, tools in zip(slots.T, stands.tools, strict=True):
        stops = [stop for stop in column.tolist() if stop != IDLE]
        rows.append(stops if tools is None else _row(stops, tools, returns=whole.returns))
    return best_stages(whole, rows)


def _row(stops: Sequence[int], tools: StageTools, *, returns: bool) -> list[int]:
    """Insert the stops of tool changes into one arm's stops."""
    row, current = list[int](), tools.start
    for stop in stops:
        row += [*tools.changes(current, tools.tool[stop]), stop]
        current = tools.tool[stop]
    return row + (list(tools.changes(current, tools.start)) if returns else [])
