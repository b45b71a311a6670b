"""Flange poses and sampled lines of one stop."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.postures.problem import StopPosture, StopProblem
from dualarm_cli.postures.stop_batch import StopBatch


def line_path(
    problem: StopProblem, posture: StopPosture, line: str, samples: int
) -> tuple[FloatArray, FloatArray]:
    """Sample the joints along a line of a stop, in the direction of motion.

    Args:
        problem: the stop.
        posture: its solution.
        line: `approach` (ends at the target) or `retract` (starts there).
        samples: number of equidistant samples, at least 2.

    Returns:
        Joints [rad], shape (samples, n), exact inverse kinematics at every sample, and lengths [m],
        shape (samples,).
    """
    is_retract = line == "retract"
    length = problem.retract if is_retract else problem.approach
    psi_end = posture.psi_retract if is_retract else posture.psi_approach
    R, p, away = flange_poses(problem, np.array([posture.target]), np.array([posture.yaw]))
    pose = R[0], p[0], away[0, int(is_retract)]
    q = problem.arm.follow_line(posture.at_target, pose, length, psi_end, samples)
    if problem.configurations is not None:
        # Exactly, and the given one if the posture is singular.
        q[0] = problem.configurations[posture.target]
    return (q if is_retract else np.ascontiguousarray(q[::-1])), np.linspace(0.0, length, samples)


def flange_poses(
    problem: StopProblem, target: IntArray, yaw: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Compute the flange poses of targets turned by yaws.

    Args:
        problem: the stop.
        target: numbers of its targets, shape (k,).
        yaw: turns about the tool's z axis [rad], shape (k,).

    Returns:
        Rotations (k, 3, 3), positions (k, 3) [m] and directions of lines outward (k, 2, 3).
    """
    poses = StopBatch((problem,)).poses(np.zeros(len(target), dtype=np.int64), target, yaw)
    return poses.R, poses.p, poses.outward
