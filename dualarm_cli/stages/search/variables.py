"""Continuous decisions of a plan as one vector, with derivatives of joints and times."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.records import dataclass
from dualarm_cli.stages.plans.candidates import CandidatePostures
from dualarm_cli.stages.plans.problem import ArmDecisions, Decisions, SequenceProblem
from dualarm_cli.stages.plans.source import postures

DIFFERENCE = 1e-6
"""Step of the finite differences [rad]: joints are smooth, and closed forms exact to 1e-14."""
FIELDS = ("psi_target", "psi_approach", "psi_retract", "yaw")
"""Variables of an arm at a stop.

The first one also shifts the arm angles at line ends.
"""


@dataclass(frozen=True)
class Variables:
    """Index of each variable in the vector; -1 if it is fixed."""

    angle: IntArray
    """Index of each stage's platform angle, shape (n,)."""
    arms: tuple[IntArray, ...]
    """Indices of each stage's FIELDS by arm, shape (n, 4)."""
    count: int
    """Number of variables."""

    @classmethod
    def of(cls, problem: SequenceProblem, loose: BoolArray | None = None) -> Variables:
        """Number a problem's variables stage by stage.

        Args:
            problem: the sequence.
            loose: flags of stages that may change, shape (n,); all by default.
        """
        n, count = problem.stages, 0
        angle = np.full(n, -1, dtype=np.int64)
        arms = [np.full((n, len(FIELDS)), -1, dtype=np.int64) for _ in problem.arms]
        for k in range(n) if loose is None else np.flatnonzero(loose).tolist():
            if problem.turns:
                angle[k], count = count, count + 1
            for rows, work in zip(arms, problem.arms, strict=True):
                stop = work.stops[k]
                if stop is None:
                    continue
                free = (
                    work.spare > 0 and stop.configurations is None,
                    work.spare > 0 and stop.approach > 0,
                    work.spare > 0 and stop.retract > 0,
                    stop.free_yaw and stop.configurations is None,
                )
                for column in np.flatnonzero(np.array(free)).tolist():
                    rows[k, column], count = count, count + 1
        return cls(angle, tuple(arms), count)

    def moved(self, decisions: Decisions, step: FloatArray) -> Decisions:
        """Apply a step of all variables to decisions [rad], shape (count,)."""
        padded = np.append(step, 0.0)
        arms = tuple(
            shifted(arm, padded[rows]) for arm, rows in zip(decisions.arms, self.arms, strict=True)
        )
        return Decisions(decisions.angle + padded[self.angle], arms)


def shifted(decisions: ArmDecisions, change: FloatArray) -> ArmDecisions:
    """Shift the FIELDS of candidates by (n, 4) [rad]."""
    return replace(
        decisions,
        psi_target=decisions.psi_target + change[:, 0],
        psi_approach=decisions.psi_approach + change[:, 0] + change[:, 1],
        psi_retract=decisions.psi_retract + change[:, 0] + change[:, 2],
        yaw=decisions.yaw + change[:, 3],
    )


@dataclass(frozen=True)
class Slopes:
    """Derivatives of one arm's stops by (platform angle, *FIELDS), v = 5 columns."""

    q_approach: FloatArray
    """Derivatives of the joints at the start of the approach, shape (n, joints, v)."""
    q_target: FloatArray
    """Derivatives of the joints at the target, shape (n, joints, v)."""
    q_retract: FloatArray
    """Derivatives of the joints at the end of the retract, shape (n, joints, v)."""
    approach: FloatArray
    """Derivatives of approach joint times [s/rad], (n, joints, v), 0 out of reach."""
    retract: FloatArray
    """Derivatives of joint times on the retract [s/rad], shape (n, joints, v)."""
    rates: FloatArray
    """Derivatives of velocities and accelerations at the outer ends of lines, (n, 2, 2, joints, v)."""


def slopes(
    problem: SequenceProblem,
    arm: int,
    decisions: Decisions,
    base: CandidatePostures,
) -> Slopes:
    """Compute derivatives by forward differences, all stages and variables in one batch.

    Without a spare joint the self-motion variables have zero derivatives, without launches the rates at line ends.
    """
    n, v = problem.stages, 1 + len(FIELDS)
    free = np.array([True, *(problem.arms[arm].spare > 0 or name == "yaw" for name in FIELDS)])
    stage = np.repeat(np.arange(n), free.sum())
    step = np.tile(DIFFERENCE * np.eye(v)[free], (n, 1))
    candidates = shifted(decisions.arms[arm].take(stage), step[:, 1:])
    joints = postures(problem, arm, stage, decisions.angle[stage] + step[:, 0], candidates)

    def rate(ahead: FloatArray, here: FloatArray) -> FloatArray:
        rates = np.zeros((*here.shape, v))
        change = ahead.reshape(n, free.sum(), *here.shape[1:]) - here[:, None]
        rates[..., free] = np.moveaxis(change, 1, -1) / DIFFERENCE
        return rates

    usable = np.zeros((n, 1, v), dtype=np.bool_)
    usable[:, 0, free] = joints.possible.reshape(n, -1) & base.possible[:, None]
    rates_at_ends = np.zeros((*base.rates.shape, v))
    if problem.launches is not None:
        rates_at_ends = np.where(usable[:, None, None], rate(joints.rates, base.rates), 0.0)
    return Slopes(
        rate(joints.q_approach, base.q_approach),
        rate(joints.q_target, base.q_target),
        rate(joints.q_retract, base.q_retract),
        np.where(usable, rate(joints.approach, base.approach), 0.0),
        np.where(usable, rate(joints.retract, base.retract), 0.0),
        rates_at_ends,
    )
