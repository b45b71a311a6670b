"""Stage durations of a decided sequence: closed-form unless lines pass in motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.records import dataclass
from dualarm_cli.stages.plans.candidates import CandidatePostures, platform_positions
from dualarm_cli.stages.plans.passing import transfer_times
from dualarm_cli.stages.plans.problem import ArmWork, Decisions, SequenceProblem
from dualarm_cli.stages.plans.slowing import Places, Slowing
from dualarm_cli.stages.plans.source import anchored, lines_hold, postures
from dualarm_cli.timing.stage_length import stage_length


@dataclass(frozen=True)
class TransferChain:
    """Transfers of one arm: pairs of its consecutive stops."""

    active: IntArray
    """Stages in which the arm works, shape (m,)."""
    previous: IntArray
    """Last stage before each in which the arm worked, or -1, shape (n,)."""

    @classmethod
    def of(cls, arm: ArmWork) -> TransferChain:
        """Build the transfer chain of an arm."""
        working = np.array([stop is not None for stop in arm.stops], dtype=np.bool_)
        last = np.maximum.accumulate(np.where(working, np.arange(len(working)), -1))
        return cls(np.nonzero(working)[0], np.concatenate([[-1], last[:-1]]))


@dataclass(frozen=True)
class Evaluated:
    """A plan with its joints and times."""

    decisions: Decisions
    """Platform angles and posture decisions of all stages."""
    arms: tuple[CandidatePostures, ...]
    """Postures of all stages by arm; rows of idle stages are meaningless."""
    stages: FloatArray
    """Duration of each stage [s], infinite if infeasible, shape (n,)."""
    closing: float
    """Length of the return [s]; 0 without one."""

    @property
    def total(self) -> float:
        """Cycle time [s]."""
        return float(self.stages.sum()) + self.closing


def evaluate(problem: SequenceProblem, decisions: Decisions) -> Evaluated:
    """Compute a plan's postures and times."""
    n = problem.stages
    rows = np.arange(n)
    arms = tuple(
        postures(problem, a, rows, decisions.angle, decisions.arms[a])
        for a in range(len(problem.arms))
    )
    return in_seconds(problem, decisions, arms)


def in_seconds(
    problem: SequenceProblem, decisions: Decisions, arms: tuple[CandidatePostures, ...]
) -> Evaluated:
    """Compute the times of a plan with given postures.

    Args:
        problem: the sequence.
        decisions: the plan.
        arms: its postures at every stage, by arm.
    """
    stages, closing = stage_times(problem, decisions.angle, arms)
    rows_of = zip(problem.arms, decisions.arms, arms, strict=True)
    same = Decisions(decisions.angle, tuple(anchored(*rows) for rows in rows_of))
    return Evaluated(same, arms, stages, closing)


def held(problem: SequenceProblem, plan: Evaluated) -> Evaluated:
    """Make stages infeasible whose lines fail between their samples."""
    angle = plan.decisions.angle
    holds = [lines_hold(problem, a, angle, rows) for a, rows in enumerate(plan.decisions.arms)]
    if all(is_feasible.all() for is_feasible in holds):
        return plan
    arms = tuple(
        replace(candidates, work=np.where(is_feasible, candidates.work, np.inf))
        for candidates, is_feasible in zip(plan.arms, holds, strict=True)
    )
    stages, closing = stage_times(problem, angle, arms)
    return replace(plan, arms=arms, stages=stages, closing=closing)


def stage_times(
    problem: SequenceProblem, angle: FloatArray, arms: tuple[CandidatePostures, ...]
) -> tuple[FloatArray, float]:
    """Compute the durations of all stages [s], shape (n,), and of the return.

    Args:
        problem: the sequence.
        angle: platform angle of each stage [rad], shape (n,).
        arms: postures of every stage, by arm.
    """
    before = np.concatenate([[start_angle(problem, angle)], angle[:-1]])
    waiting = platform_times(problem, angle - before)
    arrived, work_times = np.zeros((2, len(arms), len(angle)))
    closing = 0.0
    if problem.returns:
        closing = float(platform_times(problem, np.array([before[0] - angle[-1]]))[0])
    for a, (work, candidates) in enumerate(zip(problem.arms, arms, strict=True)):
        chain = TransferChain.of(work)
        if not len(chain.active):
            continue
        start = start_joints(problem, work, chain, candidates)
        k = chain.active
        previous = chain.previous[k]
        q_from = np.where(previous[:, None] >= 0, candidates.q_retract[previous], start)
        start_of, goal = (q_from, before[k]), (candidates.q_approach[k], angle[k])
        transfer = rest_times(problem, work, k, start_of, goal)
        if problem.launches is not None:
            leaving = q_from[:, None], left_with(candidates, previous)[:, None]
            arriving = candidates.q_approach[k, None], candidates.rates[k, None, 0]
            transfer = transfer_times(work, leaving, arriving)[:, 0, 0]
        arrived[a, k] = np.maximum(transfer, waiting[k])
        work_times[a, k] = candidates.work[k]
        if problem.returns:
            last = candidates.q_retract[k[-1:]], angle[-1:]
            home = np.array([problem.stages])
            back = rest_times(problem, work, home, last, (start[None], before[:1]))
            closing = max(closing, float(back[0]))
    return stage_length(arrived, work_times, is_handover=problem.hands_over), closing


def start_angle(problem: SequenceProblem, angle: FloatArray) -> float:
    """Platform angle before the first stage [rad]."""
    if not problem.turns:
        return 0.0
    return float(angle[0] if problem.free_start else problem.platform_start[0])


def start_joints(
    problem: SequenceProblem, work: ArmWork, chain: TransferChain, postures: CandidatePostures
) -> FloatArray:
    """Return one arm's joints before the first stage [rad], shape (joints,).

    A free start is where the first stage's transfer ends; an arm that is idle then starts in its start posture.
    """
    if problem.free_start and len(chain.active) and chain.active[0] == 0:
        return postures.q_approach[0]
    return work.start


def left_with(postures: CandidatePostures, previous: IntArray) -> FloatArray:
    """Return an arm's rates at the start of its transfers, shape (m, 2, joints).

    Args:
        postures: its postures in every stage.
        previous: those stages, -1 for the start, shape (m,).
    """
    return np.where(previous[:, None, None] >= 0, postures.rates[previous, 1], 0.0)


def rest_times(
    problem: SequenceProblem,
    work: ArmWork,
    stage: IntArray,
    start: tuple[FloatArray, FloatArray],
    goal: tuple[FloatArray, FloatArray],
) -> FloatArray:
    """Time an arm's transfers from rest to rest [s], shape (r, ...).

    Args:
        problem: the sequence.
        work: the arm.
        stage: stage of each row, shape (r,); the number of stages for the return.
        start: joints (r, ..., joints) and platform angles (r, ...) [rad] at the starts.
        goal: the same at the goals, broadcast against the starts.
    """
    if work.slowing is None:
        return work.law.duration(goal[0] - start[0])
    places = places_on_transfers(problem, work.slowing, start, goal)
    return work.slowing.transfer_times(stage, places)[0]


def places_on_transfers(
    problem: SequenceProblem,
    slowing: Slowing,
    start: tuple[FloatArray, FloatArray],
    goal: tuple[FloatArray, FloatArray],
) -> list[Places]:
    """Compute the tool's places at start, middle and goal of transfers, see `rest_times`."""
    middle = tuple(0.5 * (here + there) for here, there in zip(start, goal, strict=True))
    return [
        slowing.places(problem.platform, q, platform_positions(problem, np.asarray(angle)))
        for q, angle in (start, middle, goal)
    ]


def platform_times(problem: SequenceProblem, moved: FloatArray) -> FloatArray:
    """Compute platform times [s] for displacements [rad], shape (...)."""
    if problem.platform_law is None:
        return np.zeros(np.shape(moved))
    return problem.platform_law.duration(moved[..., None])
