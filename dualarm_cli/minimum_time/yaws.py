"""Yaws of stops where any will do and only the last joint turns: shared out between their neighbours."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.minimum_time.nodes import yaw_turns_last_joint
from dualarm_cli.minimum_time.postures import Postures, postures
from dualarm_cli.minimum_time.problem import ArmDecisions, ArmWork, Decisions, SequenceProblem
from dualarm_cli.minimum_time.stops import StopTable
from dualarm_cli.minimum_time.times import Chain

TRIED = 48
"""Yaws around the circle that are tried where the shared-out one cannot be."""
MARGIN = 0.02
"""What is kept free of the last joint's limits for what it does along the lines [rad]."""
LAST = 6
"""Column of the last joint."""


def with_yaws(
    problem: SequenceProblem, tables: tuple[StopTable, ...], decisions: Decisions
) -> Decisions:
    """Returns decisions whose free yaws share the last joint's turns out evenly over the transfers.

    Between two stops of fixed yaw every transfer then turns the last joint equally far. A stop that would leave its
    limits takes the nearest yaw that does not; one that cannot be at all takes the nearest of TRIED yaws.
    """
    arms = []
    for a, work in enumerate(problem.arms):
        free = np.array(
            [s is not None and s.free_yaw and s.configurations is None for s in work.stops]
        )
        rows = decisions.arms[a]
        if free.any() and yaw_turns_last_joint(work):
            rows = _shared_out(problem, a, tables[a], decisions.angle, rows, free)
            rows = _mended(problem, a, tables[a], decisions.angle, rows, free)
        arms.append(rows)
    return Decisions(decisions.angle, tuple(arms))


def _sense(work: ArmWork) -> float:
    """Returns +1 if a positive yaw is a positive turn of the last joint, else -1."""
    geometry = work.kinematics.geometry
    axis = geometry.R_flange.T @ geometry.axes[LAST]
    return float(np.sign(axis @ work.R_tool_flange.T[:, 2]))


def _evaluate(
    problem: SequenceProblem,
    a: int,
    table: StopTable,
    angle: FloatArray,
    rows: ArmDecisions,
    stages: IntArray,
) -> Postures:
    return postures(problem, a, table, stages, angle[stages], rows)


def _shared_out(
    problem: SequenceProblem,
    a: int,
    table: StopTable,
    angle: FloatArray,
    rows: ArmDecisions,
    free: BoolArray,
) -> ArmDecisions:
    work = problem.arms[a]
    stages = Chain.of(work).active
    found = _evaluate(problem, a, table, angle, rows.take(stages), stages)
    q = np.column_stack([found.q_approach, found.q_target, found.q_retract]).reshape(-1, 3, 7)
    last = q[:, :, LAST]
    loose = free[stages]
    low, high = work.limits.lower[LAST] + MARGIN, work.limits.upper[LAST] - MARGIN
    turn = np.zeros(len(stages))
    begin = None if problem.free_start else float(work.start[LAST])
    for k in range(len(stages)):
        if loose[k]:
            here = last[k, 0] if begin is None else begin + _share(k, last, loose, begin)
            room = low - last[k].min(), high - last[k].max()
            turn[k] = float(np.clip(here - last[k, 0], min(room), max(room)))
        begin = float(last[k, 2] + turn[k])
    yaw = rows.yaw.copy()
    near = rows.near.copy()
    yaw[stages] += _sense(work) * turn
    near[stages, LAST] = last[:, 1] + turn
    return replace(rows, yaw=yaw, near=near)


def _share(k: int, last: FloatArray, loose: BoolArray, begin: float) -> float:
    """Returns how far the last joint turns in the transfer to a loose stop: its share of what is to come [rad]."""
    ahead = np.nonzero(~loose[k:])[0]
    if not len(ahead):
        return 0.0
    run = k + np.arange(ahead[0])
    along = (last[run, 2] - last[run, 0]).sum()
    total = last[k + ahead[0], 0] - begin - along
    return float(total / (len(run) + 1))


def _mended(
    problem: SequenceProblem,
    a: int,
    table: StopTable,
    angle: FloatArray,
    rows: ArmDecisions,
    free: BoolArray,
) -> ArmDecisions:
    stages = np.nonzero(free)[0]
    found = _evaluate(problem, a, table, angle, rows.take(stages), stages)
    for k in stages[~found.possible]:
        same = np.full(TRIED, k)
        turns = np.linspace(-np.pi, np.pi, TRIED, endpoint=False)
        turns = turns[np.argsort(np.abs(turns), kind="stable")]
        tried = rows.take(same)
        tried = replace(tried, yaw=tried.yaw + turns)
        possible = np.nonzero(_evaluate(problem, a, table, angle, tried, same).possible)[0]
        if len(possible):
            rows = rows.put(np.array([k]), tried.take(possible[:1]))
    return rows
