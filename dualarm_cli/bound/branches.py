"""Cells of six-axis arms with closed forms on a platform that stands still: each pose's postures, finitely many."""

from __future__ import annotations

import numpy as np

from dualarm_cli.bound.cells import ROUNDING, Cells, free_cells
from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.geometry.linear_systems import singular_values
from dualarm_cli.kinematics.closed_arm import ClosedArm
from dualarm_cli.stages.plans.problem import ArmWork, StopTarget
from dualarm_cli.stages.search.transfer_table import TransferTable

SINGULAR = 1e-4
"""Least singular value of the Jacobian, lengths over the arm's, below which a pose's postures count as unknown."""
MOST_TURNS = 3
"""A joint of which so many turns are within its limits, or more, may be anywhere within them."""
TURN = 2.0 * np.pi
HERE = np.zeros(2)
"""Borders of the only cell of a platform that stands still."""


def branch_cells(
    work: ArmWork,
    table: TransferTable,
    stop: StopTarget,
    pose: tuple[FloatArray, FloatArray, FloatArray],
    free_last: bool,
) -> list[Cells]:
    """Returns the cells at both outer ends of a pose's lines: points, one for each posture and whole turn.

    A line takes at least the rest-to-rest time from its outer posture to the nearest one at the target. Where a pose is
    singular, or nearly, its postures are a continuum, or not known to ROUNDING: its cell is everything within limits.

    Args:
        work: an arm with closed forms.
        table: its transfer times.
        stop: what it does.
        pose: of the flange at the target, and the tool's direction, as of `flange_poses`, shape (1, ...).
        free_last: whether the last joint is free.
    """
    arm = work.kinematics
    assert isinstance(arm, ClosedArm)  # callers have looked
    R, p, z = (x[0] for x in pose)
    target = _postures(arm, R, p, free_last)
    ends = []
    for length in dict.fromkeys((stop.approach, stop.retract)):
        found = target if length == 0.0 else _postures(arm, R, p - length * z, free_last)
        if found is None:
            ends.append(free_cells(arm, HERE))
            continue
        branch, low, high = found
        line = np.zeros(len(low))
        if length and target is not None:
            # What is free may be anywhere in either cell.
            line = table.gap_times(*table.box(low, high), *table.box(*target[1:])).min(axis=1)
        here = np.zeros((len(low), 1))
        number = np.zeros(len(low), dtype=np.int64)
        ends.append(Cells(number, branch, np.hstack([low, here]), np.hstack([high, here]), line))
    return [ends[0], ends[-1]]


def _postures(
    arm: ClosedArm, R: FloatArray, p: FloatArray, free_last: bool
) -> tuple[IntArray, FloatArray, FloatArray] | None:
    """Returns branches (n,), lowest and highest joints (n, 6) [rad] of all that may reach a pose; None for unknown."""
    found = arm.solve(R, p)
    branch = np.flatnonzero(found.reachable)
    q = found.q[branch]
    if not len(q) or found.singular.any():
        return None
    J = arm.jacobian(q)
    J[:, :3] /= arm.length
    if singular_values(J)[:, -1].min() < SINGULAR:
        return None
    low, high = q - ROUNDING, q + ROUNDING
    for joint in range(arm.axes):
        bottom, top = arm.lower[joint], arm.upper[joint]
        if (free_last and joint == arm.axes - 1) or not top - bottom < MOST_TURNS * TURN:
            low[:, joint], high[:, joint] = bottom, top
            continue
        first = np.ceil((bottom - high[:, joint]) / TURN)
        count = (np.floor((top - low[:, joint]) / TURN) - first + 1).astype(np.int64)
        rows = np.repeat(np.arange(len(low)), np.maximum(count, 0))
        place = np.arange(len(rows)) - np.searchsorted(rows, rows)
        branch, low, high = branch[rows], low[rows], high[rows]
        shift = TURN * (first[rows] + place)
        low[:, joint] += shift
        high[:, joint] += shift
    return (branch, low, high) if len(low) else None
