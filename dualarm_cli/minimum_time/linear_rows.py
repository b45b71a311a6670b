"""A plan's times and limits as rows of a linear program: what its continuous decisions do to first order."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.minimum_time.postures import Postures
from dualarm_cli.minimum_time.problem import SequenceProblem
from dualarm_cli.minimum_time.sparse_rows import Program, Rows
from dualarm_cli.minimum_time.stops import StopTable
from dualarm_cli.minimum_time.times import Chain, Evaluated, start_angle, start_joints
from dualarm_cli.minimum_time.variables import Slopes, Variables, slopes
from dualarm_cli.timing.rest_to_rest import RestToRest

NEAR_CRITICAL = 0.55
"""Share of a stage's transfer time from which on a joint's own time is watched."""
RATE_STEP = 1e-7
"""Step of the difference that gives a transfer time's slope [rad]."""
LIMIT_MARGIN = 1e-6
"""What is kept free of a joint's position limits [rad]."""


def linear_rows(
    problem: SequenceProblem,
    tables: tuple[StopTable, ...],
    variables: Variables,
    best: Evaluated,
    radius: FloatArray,
) -> Program:
    """Returns the rows over (variables, lengths of stages and return, times of lines), in order of their stages.

    Args:
        problem: the sequence.
        tables: the arms' stops.
        variables: numbering of its variables.
        best: a possible plan.
        radius: how far the variables of each stage may move [rad], shape (n + 1,).
    """
    rates = [
        slopes(problem, a, tables[a], best.decisions, best.arms[a]) for a in range(len(tables))
    ]
    rows = Rows()
    for a in range(len(problem.arms)):
        _transfer_rows(rows, problem, tables, variables, best, rates[a], a)
        _line_rows(rows, problem, variables, best, rates[a], a)
        _limit_rows(rows, problem, variables, best, rates[a], a, radius)
    if problem.returns:
        _return_rows(rows, problem, variables, best, rates)
    return rows.by_stage()


def _columns(variables: Variables, arm: int, stages: IntArray) -> IntArray:
    """Returns the columns of (platform angle, FIELDS) in some stages, shape (m, 5)."""
    return np.column_stack([variables.angle[stages], variables.arms[arm][stages]])


def _rate(law: RestToRest, moved: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Returns each joint's time [s] and its slope by the displacement [s/rad], shape (..., n)."""
    time = law.per_joint(moved)
    ahead = law.per_joint(np.abs(moved) + RATE_STEP)
    return time, np.sign(moved) * (ahead - time) / RATE_STEP


def _transfer_rows(
    rows: Rows,
    problem: SequenceProblem,
    tables: tuple[StopTable, ...],
    variables: Variables,
    best: Evaluated,
    rates: Slopes,
    a: int,
) -> None:
    """Appends, per stage and slow joint: transfer + lines + dwell <= stage's length, all linear."""
    work, found = problem.arms[a], best.arms[a]
    chain = Chain.of(work)
    k = chain.active
    came = chain.previous[k]
    q_from = np.where(
        came[:, None] >= 0, found.q_retract[came], start_joints(problem, work, chain, found)
    )
    time, slope = _rate(work.law, found.q_approach[k] - q_from)
    here = slope[:, :, None] * rates.q_approach[k]
    there = np.where(came[:, None, None] >= 0, -slope[:, :, None] * rates.q_retract[came], 0.0)
    columns, columns_before = _columns(variables, a, k), _columns(variables, a, came)
    longest = time.max(axis=1)
    lines, dwell = _line_columns(problem, variables, a, k), tables[a].dwell[k]
    if len(problem.together):
        # In a hand-over the other arm's lines and dwell count as well.
        other, met = 1 - a, np.isin(k, problem.together)
        theirs = np.where(met[:, None], _line_columns(problem, variables, other, k), -1)
        lines = np.column_stack([lines, theirs])
        dwell = dwell + np.where(met, tables[other].dwell[k], 0.0)
    both = np.ones(lines.shape)
    if problem.platform_law is not None:
        angle = best.decisions.angle
        before = np.concatenate([[start_angle(problem, angle)], angle[:-1]])
        platform_time, platform_slope = _rate(problem.platform_law, (angle - before)[k, None])
        longest = np.maximum(longest, platform_time[:, 0])
        columns_p = np.column_stack(
            [variables.angle[k], np.where(k > 0, variables.angle[k - 1], -1)]
        )
        _add(
            rows,
            variables,
            np.column_stack([columns_p, lines]),
            np.column_stack([platform_slope, -platform_slope, both]),
            platform_time[:, 0] + dwell,
            k,
            platform_time[:, 0] >= NEAR_CRITICAL * longest,
        )
    # A free start moves with the first stop: its transfer takes no time, and only its work counts.
    if problem.free_start and len(k) and k[0] == 0:
        here[0] = 0.0
    for joint in range(7):
        _add(
            rows,
            variables,
            np.column_stack([columns, np.where(came[:, None] >= 0, columns_before, -1), lines]),
            np.column_stack([here[:, joint], there[:, joint], both]),
            time[:, joint] + dwell,
            k,
            time[:, joint] >= NEAR_CRITICAL * longest,
        )


def _line_columns(
    problem: SequenceProblem, variables: Variables, a: int, stages: IntArray
) -> IntArray:
    """Returns the columns of the times of approach and retract in some stages, shape (m, 2)."""
    first = variables.count + problem.stages + 1 + 2 * a * problem.stages
    return np.column_stack([first + 2 * stages, first + 2 * stages + 1])


def _line_rows(
    rows: Rows,
    problem: SequenceProblem,
    variables: Variables,
    best: Evaluated,
    rates: Slopes,
    a: int,
) -> None:
    """Appends, per line and slow joint: what the joint asks for <= time of the line."""
    k = Chain.of(problem.arms[a]).active
    columns, lines = _columns(variables, a, k), _line_columns(problem, variables, a, k)
    found = best.arms[a]
    pairs = ((found.approach, rates.approach), (found.retract, rates.retract))
    for end, (time, rate) in enumerate(pairs):
        watched = (time[k] >= NEAR_CRITICAL * time[k].max(axis=1, keepdims=True)) & (time[k] > 0)
        for joint in range(7):
            used = watched[:, joint]
            rows.add(
                np.column_stack([columns, lines[:, end]])[used],
                np.column_stack([rate[k, joint], -np.ones(len(k))])[used],
                -time[k, joint][used],
                k[used],
            )


def _add(
    rows: Rows,
    variables: Variables,
    columns: IntArray,
    values: FloatArray,
    now: FloatArray,
    stage: IntArray,
    watched: BoolArray,
) -> None:
    """Appends now + values @ step <= length of the stage for the watched rows."""
    columns = np.column_stack([columns, variables.count + stage])
    values = np.column_stack([values, np.full(len(stage), -1.0)])
    rows.add(columns[watched], values[watched], -now[watched], stage[watched])


def _return_rows(
    rows: Rows,
    problem: SequenceProblem,
    variables: Variables,
    best: Evaluated,
    rates: list[Slopes],
) -> None:
    """Appends the return's rows: every slow joint and the platform, back to the start."""
    n = problem.stages
    last = np.array([n])
    angle = best.decisions.angle
    if problem.platform_law is not None:
        back = np.array([[start_angle(problem, angle) - angle[-1]]])
        time, slope = _rate(problem.platform_law, back)
        first = variables.angle[0] if problem.free_start else -1
        columns = np.array([[variables.angle[-1], first]])
        values = np.column_stack([-slope, slope])
        watched = time[:, 0] >= NEAR_CRITICAL * best.closing
        _add(rows, variables, columns, values, time[:, 0], last, watched)
    for a, work in enumerate(problem.arms):
        chain, found = Chain.of(work), best.arms[a]
        if not len(chain.active):
            continue
        k = int(chain.active[-1])
        start = start_joints(problem, work, chain, found)
        time, slope = _rate(work.law, start - found.q_retract[k])
        moves = problem.free_start and chain.active[0] == 0
        for joint in range(7):
            columns = _columns(variables, a, np.array([k]))
            values = (-slope[joint] * rates[a].q_retract[k, joint])[None]
            if moves:
                columns = np.column_stack([columns, _columns(variables, a, np.array([0]))])
                values = np.column_stack([values, slope[joint] * rates[a].q_approach[:1, joint]])
            watched = time[[joint]] >= NEAR_CRITICAL * best.closing
            _add(rows, variables, columns, values, time[[joint]], last, watched)


def _limit_rows(
    rows: Rows,
    problem: SequenceProblem,
    variables: Variables,
    best: Evaluated,
    rates: Slopes,
    a: int,
    radius: FloatArray,
) -> None:
    """Appends position limits of the joints that a step could bring there."""
    work, found = problem.arms[a], best.arms[a]
    k = Chain.of(work).active
    columns = _columns(variables, a, k)
    for q, rate in _ends(found, rates):
        swing = np.abs(rate[k]).sum(axis=2) * radius[k, None]
        for joint in range(7):
            for sign, limit in ((1.0, work.limits.upper), (-1.0, work.limits.lower)):
                room = sign * (limit[joint] - q[k, joint]) - LIMIT_MARGIN
                near = room < swing[:, joint]
                if near.any():
                    values = sign * rate[k, joint]
                    rows.add(columns[near], values[near], np.maximum(room[near], 0.0), k[near])


def _ends(found: Postures, rates: Slopes) -> list[tuple[FloatArray, FloatArray]]:
    return [
        (found.q_approach, rates.q_approach),
        (found.q_target, rates.q_target),
        (found.q_retract, rates.q_retract),
    ]
