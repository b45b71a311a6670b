"""What candidates mean in joints and seconds: postures at the ends of their lines, and the lines' times."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.stages.search.problem import ArmDecisions, SequenceProblem
from dualarm_cli.stages.search.stops import StopTable, flange_poses, platform_positions
from dualarm_cli.timing.line_profile import joint_line_durations

LINE_SAMPLES = 7
"""Samples of a line."""
BETWEEN = (2, 4, LINE_SAMPLES + 1, LINE_SAMPLES + 3)
"""Samples of both lines, approach first, that are kept for clearance; the target is between the middle ones."""
LARGEST_STEP = np.pi / 2
"""A joint that turns more than this between two samples of a line has jumped [rad]."""
SAME_POSTURE = 1e-9
"""Difference of a given configuration from the solution for its pose up to which they are one [rad]."""
_BLOCK = 4096
"""Candidates that are followed at a time: their joints stay in the cache."""


@dataclass(frozen=True)
class CandidatePostures:
    """Many candidates of one arm, in joints and seconds."""

    q_approach: FloatArray
    """Joints where the approach starts [rad], shape (n, 7)."""
    q_target: FloatArray
    """Joints at the target [rad], shape (n, 7)."""
    q_retract: FloatArray
    """Joints where the retract ends [rad], shape (n, 7)."""
    work: FloatArray
    """Time of approach, dwell and retract [s]; infinite where the candidate cannot be, shape (n,)."""
    approach: FloatArray
    """What each joint asks for on the approach [s], shape (n, 7); the largest is its time."""
    retract: FloatArray
    """What each joint asks for on the retract [s], shape (n, 7)."""
    q_between: FloatArray
    """Joints at two places on the approach and at two on the retract [rad], shape (n, 4, 7)."""

    @property
    def possible(self) -> BoolArray:
        """Which candidates are within reach and limits all along, shape (n,)."""
        return np.isfinite(self.work)

    def of_plan(self, m: int) -> CandidatePostures:
        """Returns one of several plans' postures, where arrays are of shape (stages, plans, ...)."""
        return CandidatePostures(*(getattr(self, field.name)[:, m] for field in fields(self)))

    def where(self, mask: BoolArray, other: CandidatePostures) -> CandidatePostures:
        """Returns these where the mask (stages, plans) says so, else the other ones, which have one plan only."""
        parts = {}
        for field in fields(self):
            mine, theirs = getattr(self, field.name), getattr(other, field.name)[:, None]
            wide = mask.reshape(*mask.shape, *(1,) * (mine.ndim - 2))
            parts[field.name] = np.where(wide, mine, theirs)
        return CandidatePostures(**parts)

    def take(self, rows: IntArray) -> CandidatePostures:
        """Returns some rows."""
        return CandidatePostures(*(getattr(self, field.name)[rows] for field in fields(self)))


def postures(
    problem: SequenceProblem,
    arm: int,
    table: StopTable,
    stage: IntArray,
    angle: FloatArray,
    candidates: ArmDecisions,
) -> CandidatePostures:
    """Returns joints and line times of many candidates.

    Exact inverse kinematics at LINE_SAMPLES samples of each line, the branch fixed and the angles unwrapped from the
    target outward; lines timed by the closed-form estimate.

    Args:
        problem: the sequence.
        arm: index of the arm.
        table: its stops.
        stage: stage of each candidate, shape (n,).
        angle: platform angle of each candidate [rad], shape (n,).
        candidates: n of them.
    """
    n = len(stage)
    if n <= _BLOCK:
        return _postures(problem, arm, table, stage, angle, candidates)
    blocks = [slice(k, k + _BLOCK) for k in range(0, n, _BLOCK)]
    parts = [_postures(problem, arm, table, stage[b], angle[b], candidates.take(b)) for b in blocks]
    return CandidatePostures(
        *(
            np.concatenate([getattr(part, field.name) for part in parts])
            for field in fields(CandidatePostures)
        )
    )


def _postures(
    problem: SequenceProblem,
    arm: int,
    table: StopTable,
    stage: IntArray,
    angle: FloatArray,
    candidates: ArmDecisions,
) -> CandidatePostures:
    work, n = problem.arms[arm], len(stage)
    row = table.first[stage] + candidates.target
    position = platform_positions(problem, angle)
    R, p, z = flange_poses(problem.platform, work, table, row, candidates.yaw, position)
    share = np.linspace(1.0, 0.0, LINE_SAMPLES)
    # Approach start, ..., target, ..., retract end: both lines in one sweep.
    depth = np.concatenate(
        [table.approach[stage, None] * share, table.retract[stage, None] * share[-2::-1]], axis=1
    )
    swing = np.concatenate(
        [
            _swing(candidates.psi_approach, candidates, table.approach[stage]) * share,
            _swing(candidates.psi_retract, candidates, table.retract[stage]) * share[-2::-1],
        ],
        axis=1,
    )
    lines = bool(depth.any())
    if not lines:
        depth, swing = depth[:, :1], swing[:, :1]
    points = p[:, None, :] - z[:, None, :] * depth[:, :, None]
    psi = candidates.psi_target[:, None] + swing
    q, reachable = work.kinematics.solve_branch(R[:, None], points, psi, candidates.branch[:, None])
    middle = LINE_SAMPLES - 1 if lines else 0
    first = work.kinematics.nearest_turns(q[:, middle], candidates.near)
    ok = np.asarray(reachable.all(axis=1))
    bulge = np.zeros((n, 1, 7))
    if lines:
        steps = np.diff(q, axis=1)
        steps -= 2.0 * np.pi * np.round(steps / (2.0 * np.pi))
        ok &= np.abs(steps).max(axis=(1, 2)) <= LARGEST_STEP
        q = np.concatenate([np.zeros_like(q[:, :1]), np.cumsum(steps, axis=1)], axis=1)
        q += (first - q[:, middle])[:, None]
        bulge = _bulges(steps, middle)
    else:
        q = first[:, None]
    carried = table.carried[row]
    if carried.any():
        q, ok = _at_configurations(table, row, carried, depth, q, ok, middle)
    ok &= work.kinematics.within_limits((q - bulge).min(axis=1))
    ok &= work.kinematics.within_limits((q + bulge).max(axis=1))
    spent = np.zeros((2, n, 7))
    if lines and ok.any():
        possible = q[ok]
        both = np.concatenate([possible[:, : middle + 1], possible[:, middle:]])
        spent[:, ok] = joint_line_durations(both, work.limits).reshape(2, -1, 7)
    time = np.where(ok, table.dwell[stage] + spent.max(axis=2).sum(axis=0), np.inf)
    between = q[:, np.array(BETWEEN) if lines else [0, 0, 0, 0]]
    return CandidatePostures(q[:, 0], q[:, middle], q[:, -1], time, spent[0], spent[1], between)


def _bulges(steps: FloatArray, middle: int) -> FloatArray:
    """Returns how far joints may be beyond each sample next to it [rad], shape (n, samples, 7).

    A parabola through three samples is beyond the chord by an eighth of the second difference at most; a little more is
    kept. The two lines meet at the middle sample with a bend that means nothing.
    """
    second = np.abs(np.diff(steps, axis=1))
    second[:, middle - 1] = 0.0
    around = np.pad(second, ((0, 0), (2, 2), (0, 0)))
    widest: FloatArray = np.maximum(np.maximum(around[:, :-2], around[:, 1:-1]), around[:, 2:])
    return 0.14 * widest


def _swing(psi_end: FloatArray, candidates: ArmDecisions, length: FloatArray) -> FloatArray:
    """Returns the change of the arm angle to a line's outer end [rad], shape (n, 1); 0 without a line."""
    return np.where(length > 0, psi_end - candidates.psi_target, 0.0)[:, None]


def _at_configurations(
    table: StopTable,
    row: IntArray,
    carried: BoolArray,
    depth: FloatArray,
    q: FloatArray,
    ok: BoolArray,
    middle: int,
) -> tuple[FloatArray, BoolArray]:
    """Returns paths and feasibility with given configurations taken as they are.

    The configuration itself counts, also where a singular wrist has others for the same pose; a line must start in it.
    """
    given = np.where(carried[:, None], table.configuration[row], q[:, middle])
    turn = 2.0 * np.pi * np.round((given - q[:, middle]) / (2.0 * np.pi))
    q = q + turn[:, None]
    still = depth.max(axis=1) == 0.0
    same = np.abs(q[:, middle] - given).max(axis=1) < SAME_POSTURE
    ok = np.where(carried, (ok & same) | still, ok)
    q[still] = given[still, None]
    q[:, middle] = given
    return q, ok
