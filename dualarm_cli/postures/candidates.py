"""One stop's flange poses and lines, sampled as finely as wanted."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.kinematics.continuation import SKELETON, FlangeLines, follow_lines
from dualarm_cli.kinematics.general_arm import GeneralArm
from dualarm_cli.postures.line_following import Lines
from dualarm_cli.postures.problem import StopPosture, StopProblem
from dualarm_cli.postures.stop_batch import StopBatch, ToolPoses

BLOCK = 64
"""So many lines are worked on at a time: their arrays stay in the processor's cache."""


def line_path(
    problem: StopProblem, posture: StopPosture, line: str, samples: int
) -> tuple[FloatArray, FloatArray]:
    """Returns the joints along one line, and the length travelled; see `line_paths`."""
    return line_paths([(problem, posture, line)], samples)[0]


def line_paths(
    asked: Sequence[tuple[StopProblem, StopPosture, str]], samples: int
) -> list[tuple[FloatArray, FloatArray]]:
    """Returns the joints along lines in the direction of motion, and the lengths travelled.

    Args:
        asked: of each line its stop, how that is made, and `approach` (ends at the target) or `retract` (starts there).
        samples: number of equidistant samples of each, at least 2.

    Returns:
        Of each line joints [rad], shape (samples, n), exact inverse kinematics at every sample, and lengths [m], shape
        (samples,). In the last digit they depend on which lines are asked for together.
    """
    groups: dict[tuple[int, bytes, bytes, bool], list[int]] = {}
    for k, (problem, _, _) in enumerate(asked):
        tool = problem.R_tool_flange.tobytes(), problem.p_tool_flange.tobytes()
        kind = id(problem.arm), *tool, problem.configurations is None
        groups.setdefault(kind, []).append(k)
    found: dict[int, tuple[FloatArray, FloatArray]] = {}
    for rows in groups.values():
        for first in range(0, len(rows), BLOCK):
            block = rows[first : first + BLOCK]
            found |= zip(block, _alike_paths([asked[k] for k in block], samples), strict=True)
    return [found[k] for k in range(len(asked))]


def _alike_paths(
    asked: Sequence[tuple[StopProblem, StopPosture, str]], samples: int
) -> list[tuple[FloatArray, FloatArray]]:
    """Returns the same for lines of one arm with one tool, all or none of them to given configurations."""
    batch = StopBatch(tuple(problem for problem, _, _ in asked))
    away = [line == "retract" for _, _, line in asked]
    length = batch.length[np.arange(len(asked)), np.array(away).astype(np.int64)]
    made = [posture for _, posture, _ in asked]
    ends = zip(made, away, strict=True)
    psi_end = np.array([one.psi_retract if out else one.psi_approach for one, out in ends])
    row, target = np.arange(len(asked)), np.array([one.target for one in made])
    poses = batch.poses(row, target, np.array([one.yaw for one in made]))
    arm = batch.problems[0].arm
    if isinstance(arm, GeneralArm):
        start = np.array([one.q_target for one in made])
        q = _continued(arm, poses, start, length, psi_end, samples)
    else:
        reference = batch.configurations(row, target) if batch.given else batch.start
        followed = Lines.of(batch, poses, length, samples).follow(
            np.array([[one.psi_target] for one in made]),
            psi_end[:, None],
            np.array([one.branch for one in made]),
            reference,
        )
        q = np.broadcast_to(followed.q[..., 0], (samples, 7, len(asked))).transpose(0, 2, 1)
    return [
        (q[:, k] if out else q[::-1, k], np.linspace(0.0, length[k], samples))
        for k, out in enumerate(away)
    ]


def _continued(
    arm: GeneralArm,
    poses: ToolPoses,
    start: FloatArray,
    length: FloatArray,
    drift: FloatArray,
    samples: int,
) -> FloatArray:
    """Returns the joints (samples, k, n) of a general arm along k lines, from the targets outward."""
    # Continuity was checked in SKELETON samples at least: the same path is followed however few are wanted.
    finer = -(-(SKELETON - 1) // (samples - 1))
    lines = FlangeLines(poses.R, poses.p, -poses.z * length[:, None])
    return follow_lines(arm, start, lines, drift, finer * (samples - 1) + 1).q[::finer]


def flange_poses(
    problem: StopProblem, target: IntArray, yaw: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns flange rotations (k, 3, 3), positions (k, 3) [m] and tool directions (k, 3) of turned targets.

    Args:
        problem: the stop.
        target: which of its targets, shape (k,).
        yaw: turns about the tool's z axis [rad], shape (k,).
    """
    poses = StopBatch((problem,)).poses(np.zeros(len(target), dtype=np.int64), target, yaw)
    return poses.R, poses.p, poses.z
