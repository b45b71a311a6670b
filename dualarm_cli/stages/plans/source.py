"""Candidates of one arm, by closed form or numeric inverse kinematics."""

from __future__ import annotations

from dataclasses import replace
from types import ModuleType

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.stages.plans import closed_form, general
from dualarm_cli.stages.plans.candidates import CandidatePostures, Grid, Nodes
from dualarm_cli.stages.plans.passing import passed
from dualarm_cli.stages.plans.problem import ArmDecisions, ArmWork, SequenceProblem
from dualarm_cli.stages.plans.slowing import Slowing


def _source(work: ArmWork) -> ModuleType:
    """Return the module that computes an arm's postures."""
    return closed_form if work.kinematics.has_arm_angle else general


def postures(
    problem: SequenceProblem,
    arm: int,
    stage: IntArray,
    angle: FloatArray,
    candidates: ArmDecisions,
) -> CandidatePostures:
    """Compute joints and line times of candidates.

    Args:
        problem: the sequence.
        arm: index of the arm.
        stage: stage of each candidate, shape (n,).
        angle: platform angle of each candidate [rad], shape (n,).
        candidates: n of them.
    """
    work = problem.arms[arm]
    at_rest = _source(work).postures(problem, arm, stage, angle, candidates)
    if work.slowing is not None:
        at_rest = _slowed(work.slowing, stage, at_rest)
    launches = problem.launches
    return at_rest if launches is None else passed(work, launches[arm][stage], at_rest)


def grid_nodes(
    problem: SequenceProblem,
    arm: int,
    stage: int,
    grid: Grid,
    near: ArmDecisions | None = None,
) -> Nodes:
    """Compute the nodes of one arm at one stop; empty if out of reach.

    Args:
        problem: the sequence.
        arm: index of the arm.
        stage: number of the stage, in which the arm works.
        grid: how finely they are set.
        near: what the arm does in a plan: an arm without closed forms gets nodes around that as well.
    """
    work = problem.arms[arm]
    nodes = _source(work).grid_nodes(problem, arm, stage, grid, near)
    if work.slowing is None:
        return nodes
    ends = nodes.q_approach, nodes.q_retract
    rest = np.stack([work.law.duration(q - nodes.q_target) for q in ends], axis=1)
    rest *= problem.settings.line_factor
    lines = work.slowing.lines(np.full(len(rest), stage), rest)
    return replace(nodes, work=nodes.work + (lines - rest).sum(axis=1))


def _slowed(slowing: Slowing, stage: IntArray, at_rest: CandidatePostures) -> CandidatePostures:
    """Slow the lines of candidates to their care."""
    rest = np.stack([at_rest.approach.max(axis=1), at_rest.retract.max(axis=1)], axis=1)
    lines = slowing.lines(stage, rest)
    shares = np.divide(lines, rest, out=np.ones(rest.shape), where=rest > 0.0)
    return replace(at_rest, work=at_rest.work + (lines - rest).sum(axis=1), shares=shares)


def anchored(work: ArmWork, candidates: ArmDecisions, joints: CandidatePostures) -> ArmDecisions:
    """Return candidates that refer to their own postures, if their arm needs that."""
    return _source(work).anchored(candidates, joints)


def lines_hold(
    problem: SequenceProblem, arm: int, angle: FloatArray, rows: ArmDecisions
) -> BoolArray:
    """Return in which stages lines are feasible between their samples, shape (n,).

    Args:
        problem: the sequence.
        arm: index of the arm.
        angle: platform angle of each stage [rad], shape (n,).
        rows: what the arm does in each stage, `anchored`.
    """
    return _source(problem.arms[arm]).lines_hold(problem, arm, angle, rows)


def given_postures(work: ArmWork, rows: ArmDecisions, q: FloatArray) -> ArmDecisions:
    """Return candidates exactly at given configurations (n, joints) [rad]."""
    return _source(work).given_postures(work, rows, q)
