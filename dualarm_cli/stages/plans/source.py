"""Where an arm's postures come from: closed forms over the arm angle, or inverse kinematics of any arm."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.kinematics.general_arm import GeneralArm
from dualarm_cli.stages.plans import closed_form, general
from dualarm_cli.stages.plans.candidates import CandidatePostures, Grid, Nodes
from dualarm_cli.stages.plans.passing import passed
from dualarm_cli.stages.plans.problem import ArmDecisions, ArmWork, SequenceProblem
from dualarm_cli.stages.plans.stops import StopTable

FEW_ANGLES = 3
"""At no more platform angles all of the self-motion is looked at; arms that have none keep to a plan."""


def has_closed_form(work: ArmWork) -> bool:
    """Returns whether an arm's postures are closed forms over the arm angle."""
    return not isinstance(work.kinematics, GeneralArm)


def postures(
    problem: SequenceProblem,
    arm: int,
    table: StopTable,
    stage: IntArray,
    angle: FloatArray,
    candidates: ArmDecisions,
) -> CandidatePostures:
    """Returns joints and line times of many candidates.

    Args:
        problem: the sequence.
        arm: index of the arm.
        table: its stops.
        stage: stage of each candidate, shape (n,).
        angle: platform angle of each candidate [rad], shape (n,).
        candidates: n of them.
    """
    own = closed_form if has_closed_form(problem.arms[arm]) else general
    found = own.postures(problem, arm, table, stage, angle, candidates)
    return (
        found
        if problem.ways is None
        else passed(problem.arms[arm], problem.ways[arm][stage], found)
    )


def grid_nodes(
    problem: SequenceProblem,
    arm: int,
    table: StopTable,
    stage: int,
    grid: Grid,
    near: ArmDecisions | None = None,
) -> Nodes:
    """Returns the nodes of one arm at one stop, none where it cannot be reached.

    Args:
        problem: the sequence.
        arm: index of the arm.
        table: its stops.
        stage: number of the stage, in which the arm works.
        grid: how finely they are set.
        near: what the arm does in a plan: an arm without closed forms gets nodes around that as well.
    """
    if has_closed_form(problem.arms[arm]):
        return closed_form.grid_nodes(problem, arm, table, stage, grid)
    few, spare = len(grid.angles) <= FEW_ANGLES, problem.arms[arm].spare > 0
    # A platform that does not turn leaves the poses as they are: around a plan they have been looked at before.
    thorough = few and spare if problem.turns else near is None
    if near is None:
        return general.grid_nodes(problem, arm, table, stage, grid, thorough=thorough)
    around = general.nodes_around(problem, arm, table, stage, grid.angles, near)
    if few and not spare:
        return around
    nodes = general.grid_nodes(problem, arm, table, stage, grid, thorough=thorough)
    return general.together(nodes, around)


def anchored(work: ArmWork, candidates: ArmDecisions, found: CandidatePostures) -> ArmDecisions:
    """Returns the same candidates, counted from the postures that they were found to mean where these matter."""
    return candidates if has_closed_form(work) else general.anchored(candidates, found)


def lines_hold(
    problem: SequenceProblem, arm: int, table: StopTable, angle: FloatArray, rows: ArmDecisions
) -> BoolArray:
    """Returns in which stages lines are known to hold between their samples as well, shape (n,).

    Args:
        problem: the sequence.
        arm: index of the arm.
        table: its stops.
        angle: platform angle of each stage [rad], shape (n,).
        rows: what the arm does in each stage, `anchored`.
    """
    if has_closed_form(problem.arms[arm]):
        return np.ones(problem.stages, dtype=np.bool_)
    return general.lines_hold(problem, arm, table, angle, rows)


def given_postures(work: ArmWork, rows: ArmDecisions, q: FloatArray) -> ArmDecisions:
    """Returns candidates that are at given configurations (n, joints) [rad] to the last digit."""
    if not has_closed_form(work):
        return rows.at(q)
    return replace(rows, psi_target=work.closed_form.arm_angle(q), near=q)
