"""Ways to make a stop: candidates in arrays, followed along their lines and timed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.kinematics.platform_chain import rotation_z
from dualarm_cli.redundancy.problem import StopPosture, StopProblem

LINE_SAMPLES = 7
"""Samples of a line while postures are compared."""
LARGEST_STEP = np.pi / 2
"""A joint that turns more than this between two samples of a line has jumped [rad]."""
SAME_POSTURE = 1e-6
"""Difference of a given configuration from the solution for its pose up to which they are one [rad]."""
TRAVEL_WEIGHT = 1e-3
"""Share of the summed joint times in the cost: among equals, the one that moves least."""


@dataclass(frozen=True)
class Candidates:
    """Ways to make one stop; every array has shape (n,)."""

    target: IntArray
    """Which nominal target."""
    yaw: FloatArray
    """Turn about the tool's z axis [rad]."""
    branch: IntArray
    """Branch of the inverse kinematics."""
    psi_target: FloatArray
    """Arm angle at the target [rad]."""
    psi_approach: FloatArray
    """Arm angle where the approach starts [rad]."""
    psi_retract: FloatArray
    """Arm angle where the retract ends [rad]."""

    def take(self, index: IntArray) -> Candidates:
        """Returns some of the candidates, in the order of the index."""
        return Candidates(*(getattr(self, name)[index] for name in self.__dataclass_fields__))


@dataclass(frozen=True)
class Evaluation:
    """What n candidates cost, infinite where they are infeasible."""

    approach_cost: FloatArray
    """Time of transfer and approach [s], shape (n,)."""
    retract_cost: FloatArray
    """Time of the retract [s], shape (n,)."""
    q_approach: FloatArray
    """Joints where the approach starts [rad], shape (n, 7)."""
    q_target: FloatArray
    """Joints at the target [rad], shape (n, 7)."""
    q_retract: FloatArray
    """Joints where the retract ends [rad], shape (n, 7)."""


def line_path(
    problem: StopProblem, posture: StopPosture, line: str, samples: int
) -> tuple[FloatArray, FloatArray]:
    """Returns the joints along a line in the direction of motion, and the length travelled.

    Args:
        problem: the stop.
        posture: its solution.
        line: `approach` (ends at the target) or `retract` (starts there).
        samples: number of equidistant samples, at least 2.

    Returns:
        Joints [rad], shape (samples, 7), exact inverse kinematics at every sample, and lengths [m],
        shape (samples,).
    """
    away = line == "retract"
    length = problem.retract if away else problem.approach
    psi_end = posture.psi_retract if away else posture.psi_approach
    candidate = Candidates(
        np.array([posture.target]),
        np.array([posture.yaw]),
        np.array([posture.branch]),
        np.array([posture.psi_target]),
        np.array([psi_end]),
        np.array([psi_end]),
    )
    q = follow_line(problem, candidate, candidate.psi_approach, np.array([length]), samples)[0][0]
    return (q if away else q[::-1]), np.linspace(0.0, length, samples)


def flange_poses(
    problem: StopProblem, target: IntArray, yaw: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns flange rotations, positions and tool directions for targets turned by yaws."""
    R_tool = problem.R_base_tool[target] @ rotation_z(yaw)
    R = R_tool @ problem.R_tool_flange
    p = problem.p_base_tool[target] + R_tool @ problem.p_tool_flange
    return R, p, R_tool[..., :, 2]


def follow_line(
    problem: StopProblem,
    candidates: Candidates,
    psi_end: FloatArray,
    length: FloatArray,
    samples: int,
) -> tuple[FloatArray, BoolArray]:
    """Returns joints from the target outward along a line, (n, samples, 7), and feasibility (n,).

    The branch is fixed and angles are unwrapped from the target, so that the joints are continuous.
    """
    R, p, z = flange_poses(problem, candidates.target, candidates.yaw)
    share = np.linspace(0.0, 1.0, samples)
    points = p[:, None, :] - z[:, None, :] * (share * length[:, None])[:, :, None]
    psi = candidates.psi_target[:, None] + (psi_end - candidates.psi_target)[:, None] * share
    q, reachable = problem.arm.solve_branch(R[:, None], points, psi, candidates.branch[:, None])
    reference = problem.start
    if problem.configurations is not None:
        reference = problem.configurations[candidates.target]
    first = problem.arm.nearest_turns(q[:, 0], reference)
    turn = 2.0 * np.pi
    steps = np.diff(q, axis=1)
    steps -= turn * np.round(steps / turn)
    q = np.concatenate([first[:, None], first[:, None] + np.cumsum(steps, axis=1)], axis=1)
    jumps = np.abs(steps).max(axis=(1, 2), initial=0.0) > LARGEST_STEP
    ok = reachable.all(axis=1) & ~jumps
    if problem.configurations is not None:
        # The configuration itself counts, also where a singular wrist has others for the same pose; a line
        # must start in it.
        ok &= (np.abs(first - reference).max(axis=1) < SAME_POSTURE) | (length == 0)
        q[length == 0] = reference[length == 0, None]
        q[:, 0] = reference
        ok |= length == 0
    return q, ok & problem.arm.within_limits(q).all(axis=1)


def evaluate(problem: StopProblem, candidates: Candidates) -> Evaluation:
    """Returns times and postures of the candidates."""
    q_in, time_in, ok_in, q_out, time_out, ok_out = _both_lines(problem, candidates)
    displacement = q_in[:, -1] - problem.start
    transfer = np.maximum(problem.waiting, problem.transfer_time(displacement))
    travel = TRAVEL_WEIGHT * np.abs(displacement).sum(axis=1)
    return Evaluation(
        np.where(ok_in, transfer + time_in + travel, np.inf),
        np.where(ok_out, time_out, np.inf),
        q_in[:, -1],
        q_in[:, 0],
        q_out[:, -1],
    )


def _both_lines(
    problem: StopProblem, candidates: Candidates
) -> tuple[FloatArray, FloatArray, BoolArray, FloatArray, FloatArray, BoolArray]:
    """Returns joints, time and feasibility of approach and retract: in one pass for speed."""
    n = len(candidates.branch)
    same = problem.approach == problem.retract and np.array_equal(
        candidates.psi_approach, candidates.psi_retract
    )
    if same:
        length = np.full(n, problem.approach)
        line = _line(problem, candidates, candidates.psi_approach, length)
        return (*line, *line)
    twice = candidates.take(np.tile(np.arange(n), 2))
    psi_end = np.concatenate([candidates.psi_approach, candidates.psi_retract])
    length = np.repeat([problem.approach, problem.retract], n)
    q, time, ok = _line(problem, twice, psi_end, length)
    return q[:n], time[:n], ok[:n], q[n:], time[n:], ok[n:]


def _line(
    problem: StopProblem, candidates: Candidates, psi_end: FloatArray, length: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Returns joints, time and feasibility of one line per candidate; no time for no length."""
    # Where there is no line the arm angle has nothing to vary along.
    psi_end = np.where(length > 0, psi_end, candidates.psi_target)
    samples = LINE_SAMPLES if length.any() else 1
    q, ok = follow_line(problem, candidates, psi_end, length, samples)
    time = np.zeros(len(q))
    timed = ok & (length > 0)
    if timed.any():
        time[timed] = problem.line_time(q[timed], np.linspace(0.0, 1.0, samples))
    return q, time, ok
