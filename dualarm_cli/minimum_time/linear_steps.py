"""Successive linear programming: all continuous decisions of a plan improved together, a small step at a time."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.minimum_time.linear_rows import linear_rows
from dualarm_cli.minimum_time.problem import SequenceProblem
from dualarm_cli.minimum_time.sparse_rows import Program
from dualarm_cli.minimum_time.stops import StopTable
from dualarm_cli.minimum_time.times import Evaluated
from dualarm_cli.minimum_time.variables import Variables

WINDOW = 24
"""Stages that are improved together; the windows of the next round lie half a window further on."""


def linear_step(
    problem: SequenceProblem,
    tables: tuple[StopTable, ...],
    variables: Variables,
    best: Evaluated,
    radius: FloatArray,
    round_number: int,
) -> FloatArray:
    """Returns the best step of all variables within a radius, everything taken as linear [rad], shape (count,).

    Joints at the ends of all transfers, transfer times and line times are linear in the platform angles, arm angles and
    free yaws; a linear program per window of stages then finds the step. (A transfer's time is concave in its
    distance: its tangent lies above it, so that a promised gain is on the safe side.)

    Args:
        problem: the sequence.
        tables: the arms' stops.
        variables: numbering of its variables.
        best: a possible plan.
        radius: how far the variables of each stage may move [rad], shape (n + 1,).
        round_number: every other round the windows lie half a window further on.
    """
    windows = _windows(problem.stages, round_number)
    program = linear_rows(problem, tables, variables, best, radius)
    return _solve(problem, variables, best, program, windows, radius)


def _windows(stages: int, round_number: int) -> list[tuple[int, int]]:
    """Returns first and past-the-last stage of each window; every other round they lie half a window further on."""
    if stages <= WINDOW + WINDOW // 2:
        return [(0, stages)]
    edges = list(range(0 if round_number % 2 == 0 else WINDOW // 2, stages, WINDOW))
    edges = [0, *edges[(edges[0] == 0) :]]
    if stages - edges[-1] < WINDOW // 3:
        edges.pop()
    return list(zip(edges, [*edges[1:], stages], strict=True))


def _stage_of_variable(variables: Variables) -> IntArray:
    stage = np.zeros(variables.count, dtype=np.int64)
    for rows in (variables.angle[:, None], *variables.arms):
        k, column = np.nonzero(rows >= 0)
        stage[rows[k, column]] = k
    return stage


def _solve(
    problem: SequenceProblem,
    variables: Variables,
    best: Evaluated,
    program: Program,
    windows: list[tuple[int, int]],
    radius: FloatArray,
) -> FloatArray:
    """Returns the best step of every window on its own [rad]."""
    from scipy.optimize import linprog
    from scipy.sparse import csc_matrix

    n, v = problem.stages, variables.count
    of_variable = _stage_of_variable(variables)
    lower, upper = _bounds(problem, variables, best, radius[of_variable])
    of_time = np.concatenate([np.arange(n + 1), *[np.repeat(np.arange(n), 2)] * len(problem.arms)])
    step = np.zeros(v)
    local = np.full(v + len(of_time), -1, dtype=np.int64)
    inner_of = np.split(
        np.argsort(of_variable, kind="stable"), np.bincount(of_variable, minlength=n).cumsum()
    )
    for first, end in windows:
        # The stage after a window starts from it; the last window has the return.
        past = end + 1
        inner = np.concatenate(inner_of[first:end])
        if not len(inner):
            continue
        times = _time_columns(n, len(problem.arms), first, past)
        columns = np.concatenate([inner, v + times])
        local[columns] = np.arange(len(columns))
        row, column, value, bound = program.within(first, past)
        kept = local[column] >= 0
        matrix = csc_matrix(
            (value[kept], (row[kept], local[column[kept]])), shape=(len(bound), len(columns))
        )
        local[columns] = -1
        limits = np.column_stack(
            [
                np.concatenate([lower[inner], np.zeros(len(times))]),
                np.concatenate([upper[inner], np.full(len(times), np.inf)]),
            ]
        )
        cost = np.concatenate([np.zeros(len(inner)), times <= n])
        result = linprog(cost, A_ub=matrix, b_ub=bound, bounds=limits, method="highs")
        if result.status == 0:
            step[inner] = result.x[: len(inner)]
    return step


def _bounds(
    problem: SequenceProblem, variables: Variables, best: Evaluated, radius: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Returns least and greatest step of every variable [rad]."""
    lower, upper = -radius, radius.copy()
    if problem.turns:
        low, high = problem.platform_range
        free = variables.angle >= 0
        columns, here = variables.angle[free], best.decisions.angle[free]
        lower[columns] = np.maximum(lower[columns], low - here)
        upper[columns] = np.minimum(upper[columns], high - here)
    return lower, upper


def _time_columns(stages: int, arms: int, first: int, past: int) -> IntArray:
    """Returns the columns, counted after the variables, of the times of the stages from first to before past."""
    lengths = np.arange(first, past)
    lines = np.arange(2 * first, 2 * min(past, stages))
    return np.concatenate([lengths, *(stages + 1 + 2 * a * stages + lines for a in range(arms))])
