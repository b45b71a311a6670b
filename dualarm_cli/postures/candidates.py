"""One stop's flange poses and lines, sampled as finely as wanted."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.postures.problem import StopPosture, StopProblem
from dualarm_cli.postures.stop_batch import StopBatch


def line_path(
    problem: StopProblem, posture: StopPosture, line: str, samples: int
) -> tuple[FloatArray, FloatArray]:
    """Returns the joints along a line that a stop has, in the direction of motion, and the length travelled.

    Args:
        problem: the stop.
        posture: its solution.
        line: `approach` (ends at the target) or `retract` (starts there).
        samples: number of equidistant samples, at least 2.

    Returns:
        Joints [rad], shape (samples, n), exact inverse kinematics at every sample, and lengths [m],
        shape (samples,).
    """
    away = line == "retract"
    length = problem.retract if away else problem.approach
    psi_end = posture.psi_retract if away else posture.psi_approach
    R, p, z = flange_poses(problem, np.array([posture.target]), np.array([posture.yaw]))
    pose = R[0], p[0], z[0]
    q = problem.arm.follow_line(posture.at_target, pose, length, psi_end, samples)
    if problem.configurations is not None:
        # To the last digit, and in a singular posture the one that was given.
        q[0] = problem.configurations[posture.target]
    return (q if away else np.ascontiguousarray(q[::-1])), np.linspace(0.0, length, samples)


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
