"""Stops on whose lines the platform turns, as the search over the sequence sees them: joints, line times, slopes."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.stages.plans.candidates import LINE_SAMPLES, CandidatePostures, bulges
from dualarm_cli.stages.plans.problem import ArmDecisions, Decisions, SequenceProblem
from dualarm_cli.stages.plans.source import has_closed_form, postures
from dualarm_cli.stages.plans.stops import StopTable, flange_poses, platform_positions
from dualarm_cli.stages.search.variables import DIFFERENCE, FIELDS, Slopes, shifted
from dualarm_cli.timing.line_profile import joint_line_durations

LARGEST_STEP = np.pi / 2
"""A joint that turns more than this between two samples of a line has jumped [rad]."""
LINES = ("approach", "retract")
"""What arms come to their targets on, and leave them on."""


def turned_postures(
    problem: SequenceProblem,
    arm: int,
    table: StopTable,
    stage: IntArray,
    side: Decisions,
    outer: FloatArray,
    line: str,
) -> CandidatePostures:
    """Returns joints and line times of many candidates, on one of whose lines the platform moves.

    Args:
        problem: the sequence.
        arm: index of the arm, which has closed forms where the platform moves.
        table: its stops.
        stage: stage of each candidate, shape (n,).
        side: n candidates, and their platform angles at the targets.
        outer: how far the platform is from there at the line's outer end [rad or m], shape (n,).
        line: one of the LINES.
    """
    own = side.arms[arm]
    found = postures(problem, arm, table, stage, side.angle, own)
    moved = np.flatnonzero((outer != 0.0) & table.active[stage])
    if not len(moved):
        return found
    platform = side.angle[moved], outer[moved]
    made = own.take(moved).at(found.q_target[moved])
    path, ok = _paths(problem, arm, table, stage[moved], platform, made, line)
    parts = {name: np.array(values) for name, values in vars(found).items()}
    work = problem.arms[arm]
    parts[f"q_{line}"][moved] = path[:, -1]
    good = moved[ok]
    if len(good):
        driven = path[ok, ::-1] if line == "approach" else path[ok]
        parts[line][good] = joint_line_durations(driven, work.limits)
    parts["work"][moved[~ok]] = np.inf
    return CandidatePostures(**parts)


def _paths(
    problem: SequenceProblem,
    arm: int,
    table: StopTable,
    stage: IntArray,
    platform: tuple[FloatArray, FloatArray],
    own: ArmDecisions,
    line: str,
) -> tuple[FloatArray, BoolArray]:
    """Returns the joints along lines (m, LINE_SAMPLES, 7) from the targets outwards, and which can be followed (m,).

    Args:
        problem: the sequence.
        arm: index of the arm.
        table: its stops.
        stage: of each candidate, shape (m,).
        platform: its angles at the targets, and how far it moves from there [rad or m], shape (m,) each.
        own: the candidates, with their joints at the targets.
        line: one of the LINES.
    """
    work, (angle, outer) = problem.arms[arm], platform
    share = np.linspace(0.0, 1.0, LINE_SAMPLES)
    length = table.approach if line == "approach" else table.retract
    psi_end = own.psi_approach if line == "approach" else own.psi_retract
    row = (table.first[stage] + own.target)[:, None]
    position = platform_positions(problem, angle[:, None] + share * outer[:, None])
    R, p, z = flange_poses(problem.platform, work, table, row, own.yaw[:, None], position)
    points = p - z * (share * length[stage, None])[:, :, None]
    psi = own.psi_target[:, None] + share * (psi_end - own.psi_target)[:, None]
    q, reached = work.closed_form.solve_branch(R, points, psi, own.branch[:, None])
    steps = np.diff(q, axis=1)
    steps -= 2.0 * np.pi * np.round(steps / (2.0 * np.pi))
    ok = reached.all(axis=1) & (np.abs(steps).max(axis=(1, 2)) <= LARGEST_STEP)
    path = own.near[:, None] + np.concatenate(
        [np.zeros_like(q[:, :1]), np.cumsum(steps, axis=1)], axis=1
    )
    # Both lines in one row, as `bulges` expects them: there and back.
    bulge = bulges(np.concatenate([-steps[:, ::-1], steps], axis=1))[:, LINE_SAMPLES - 1 :]
    within = work.kinematics.within_limits((path - bulge).min(axis=1))
    within &= work.kinematics.within_limits((path + bulge).max(axis=1))
    return path, np.asarray(ok & within)


def turned_slopes(
    problem: SequenceProblem,
    arm: int,
    table: StopTable,
    side: Decisions,
    outer: FloatArray,
    line: str,
    base: CandidatePostures,
) -> Slopes:
    """Returns derivatives by forward differences: by platform angle, FIELDS and the platform's way on a line.

    Arguments as of `turned_postures`, of all stages; `base` is what it returns for them.
    """
    n, v = problem.stages, 2 + len(FIELDS)
    spare = problem.arms[arm].spare > 0
    free = np.array([True, *(spare or name == "yaw" for name in FIELDS), problem.turns])
    # Without closed forms the platform stands on lines.
    free[-1] &= has_closed_form(problem.arms[arm])
    stage = np.repeat(np.arange(n), free.sum())
    step = np.tile(DIFFERENCE * np.eye(v)[free], (n, 1))
    arms = list(side.arms)
    arms[arm] = shifted(arms[arm].take(stage), step[:, 1:-1])
    ahead = Decisions(side.angle[stage] + step[:, 0], tuple(arms))
    found = turned_postures(problem, arm, table, stage, ahead, outer[stage] + step[:, -1], line)

    def rate(name: str) -> FloatArray:
        here = getattr(base, name)
        rates = np.zeros((n, here.shape[1], v))
        change = getattr(found, name).reshape(n, free.sum(), -1) - here[:, None]
        rates[:, :, free] = np.moveaxis(change, 1, 2) / DIFFERENCE
        return rates

    usable = np.zeros((n, 1, v), dtype=np.bool_)
    usable[:, 0, free] = found.possible.reshape(n, -1) & base.possible[:, None]
    return Slopes(
        rate("q_approach"),
        rate("q_target"),
        rate("q_retract"),
        np.where(usable, rate("approach"), 0.0),
        np.where(usable, rate("retract"), 0.0),
    )
