"""One stop's flange poses and lines, sampled as finely as wanted."""

from __future__ import annotations

import numpy as np

from dualarm_cli.compiled.srs import LinePair, joints_along_lines
from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.kinematics.continuation import SKELETON, FlangeLines, follow_lines
from dualarm_cli.kinematics.general_arm import GeneralArm
from dualarm_cli.kinematics.srs_arm import closed_form
from dualarm_cli.postures.line_following import LARGEST_STEP
from dualarm_cli.postures.problem import StopPosture, StopProblem
from dualarm_cli.postures.stop_batch import StopBatch, ToolPoses


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
    batch = StopBatch((problem,))
    row, target = np.zeros(1, dtype=np.int64), np.array([posture.target])
    poses = batch.poses(row, target, np.array([posture.yaw]))
    ways = np.linspace(0.0, length, samples)
    if isinstance(problem.arm, GeneralArm):
        q = _continued(problem.arm, poses, posture.q_target, length, psi_end, samples)
        return (q if away else q[::-1]), ways
    reference = batch.configurations(row, target) if batch.given else batch.start
    both, _ = joints_along_lines(
        closed_form(problem.arm).numbers,
        LinePair(
            (poses.R, poses.p, poses.z),
            np.array([posture.branch]),
            np.array([[posture.psi_target, psi_end, psi_end]]),
            np.array([[0.0, length] if away else [length, 0.0]]),
            reference,
        ),
        LARGEST_STEP,
        samples,
    )
    if batch.given:
        # To the last digit, and in a singular posture the one that was given.
        both[0, samples - 1] = reference[0]
    return (both[0, samples - 1 :] if away else both[0, :samples]), ways


def _continued(
    arm: GeneralArm,
    poses: ToolPoses,
    q_target: FloatArray,
    length: float,
    drift: float,
    samples: int,
) -> FloatArray:
    """Returns the joints (samples, n) of a general arm along one line, from the target outward."""
    # Continuity was checked in SKELETON samples at least: the same path is followed however few are wanted.
    finer = -(-(SKELETON - 1) // (samples - 1))
    course = follow_lines(
        arm,
        q_target[None],
        FlangeLines(poses.R, poses.p, -poses.z * length),
        np.array([drift]),
        finer * (samples - 1) + 1,
    )
    return course.q[::finer, 0]


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
