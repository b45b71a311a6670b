"""Binding of `src/srs.c`: inverse kinematics of spherical-revolute-spherical arms.

Every function takes the arm as `SrsArm.numbers`, and arrays of float64 and int64.
"""

from __future__ import annotations

import ctypes
from ctypes import byref

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.native import library, numbers, pointer, whole
from dualarm_cli.records import dataclass

MAX_CUTS = 32
"""Maximum number of arm angle intervals of a branch, as in C."""

_int64, _double = ctypes.c_int64, ctypes.c_double


def postures(
    arm: FloatArray,
    R: FloatArray,
    p: FloatArray,
    target: IntArray,
    psi: FloatArray,
    branch: IntArray | None = None,
) -> tuple[FloatArray, BoolArray]:
    """Compute postures [rad] of poses at arm angles, and whether the poses are within reach.

    Args:
        arm: the arm.
        R: flange rotations in the base frame, shape (m, 3, 3).
        p: flange positions [m], shape (m, 3).
        target: indices into the m poses, shape (n,); equal consecutive ones are faster.
        psi: arm angles [rad], shape (n,).
        branch: branches, shape (n,); None for all eight.

    Returns:
        Joints, shape (n, 7), or (n, 8, 7) for all branches; reachability, shape (n,).
    """
    n = len(target)
    q = np.empty((n, 8, 7) if branch is None else (n, 7))
    reachable = np.empty(n, dtype=np.bool_)
    held = [numbers(arm), numbers(R), numbers(p), whole(target), numbers(psi)]
    indices = None if branch is None else whole(branch)
    branches = None if indices is None else pointer(indices)
    library().srs_solve(*map(pointer, held), branches, _int64(n), pointer(q), pointer(reachable))
    return q, reachable


@dataclass(frozen=True)
class LinePair:
    """Approach and retract lines of n candidates."""

    pose: tuple[FloatArray, FloatArray, FloatArray]
    """Flange rotations (n, 3, 3), positions (n, 3) [m], directions of lines outward (n, 2, 3)."""
    branch: IntArray
    """Branches, shape (n,)."""
    psi: FloatArray
    """Arm angles at target, approach and retract [rad], shape (n, 3)."""
    length: FloatArray
    """Lengths of approach and retract [m], shape (n, 2)."""
    reference: FloatArray
    """Joints that select the turns at the target [rad], shape (n, 7)."""


def joints_along_lines(
    arm: FloatArray, lines: LinePair, max_step: float, samples: int
) -> tuple[FloatArray, BoolArray]:
    """Compute the joints along approach and retract [rad], and whether the lines can be followed.

    Args:
        arm: the arm.
        lines: lines of the candidates.
        max_step: largest change of a joint between two samples [rad].
        samples: number of samples of one line.

    Returns:
        Joints, shape (n, 2 samples - 1, 7), with the target in the middle, on the turn within limits that is nearest to
        `lines.reference`; if all lengths are zero, the targets alone, shape (n, 1, 7). Feasibility, shape (n,).
    """
    n, any_line = len(lines.branch), bool(lines.length.any())
    q = np.empty((n, 2 * samples - 1 if any_line else 1, 7))
    ok = np.empty(n, dtype=np.bool_)
    held = [*map(numbers, (arm, *lines.pose)), whole(lines.branch)]
    held += map(numbers, (lines.psi, lines.length, lines.reference))
    settings = _double(max_step), _int64(samples), _int64(any_line), _int64(n)
    library().srs_lines(*map(pointer, held), *settings, pointer(q), pointer(ok))
    return q, ok


class _Rows(ctypes.Structure):
    """Nodes of a stop: `Rows` in C."""

    _fields_ = tuple((name, ctypes.c_void_p) for name in ("pose", "step", "branch", "swing", "q"))


@dataclass(frozen=True)
class ArmAngleGrid:
    """Grid of arm angles for the nodes of a stop."""

    steps: int
    """Number of arm angles around the circle, from -pi."""
    reference: FloatArray
    """Joints that select the turns at the target [rad], shape (7,)."""
    speed: FloatArray
    """Joint velocity limits [rad/s], shape (7,)."""
    joints: int
    """Number of joints with limits, the first ones."""
    swings: int
    """Maximum change of the arm angle along a line, in half steps of the grid."""
    max_change: float
    """Largest change of a joint along a line [rad]."""


def nodes(
    arm: FloatArray, R: FloatArray, points: FloatArray, grid: ArmAngleGrid
) -> tuple[IntArray, IntArray, IntArray, IntArray, FloatArray]:
    """Compute n postures within limits on a grid of arm angles, each with its fastest lines.

    Args:
        arm: the arm.
        R: flange rotations in the base frame, shape (m, 3, 3).
        points: flange positions at target, approach and retract [m], shape (m, 3, 3).
        grid: grid of arm angles.

    Returns:
        Indices of pose and arm angle, and branches, shape (n,) each; change of the arm angle along approach and retract
        in half steps, shape (n, 2); joints at target, approach and retract [rad], shape (n, 3, 7).
    """
    assert grid.steps <= 256  # size of the buffer in C
    capacity = len(R) * grid.steps * 8
    pose, step, branch = (np.empty(capacity, dtype=np.int64) for _ in range(3))
    swing, q = np.empty((capacity, 2), dtype=np.int64), np.empty((capacity, 3, 7))
    rows = _Rows(*map(pointer, (pose, step, branch, swing, q)))
    ends = 1 if np.array_equal(points[:, 1], points[:, 2]) else 2
    held = [numbers(x) for x in (arm, R, points, grid.reference, grid.speed)]
    solve = library().srs_nodes
    solve.restype = _int64
    n = solve(
        *map(pointer, held[:3]),
        _int64(len(R)),
        _int64(grid.steps),
        *map(pointer, held[3:]),
        _int64(grid.joints),
        _int64(grid.swings),
        _double(grid.max_change),
        _int64(ends),
        byref(rows),
    )
    # Copies release the large arrays, whose unused pages were never touched.
    return pose[:n].copy(), step[:n].copy(), branch[:n].copy(), swing[:n].copy(), q[:n].copy()


def arm_angle_intervals(
    arm: FloatArray, R: FloatArray, p: FloatArray
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Compute the arm-angle intervals within joint limits.

    Returns their starts and ends [rad], shape (n, 8, k), and their number, shape (n, 8).

    Args:
        arm: the arm.
        R: flange rotations in the base frame, shape (n, 3, 3).
        p: flange positions [m], shape (n, 3).
    """
    n = len(R)
    start, end = (np.empty((n, 8, MAX_CUTS)) for _ in range(2))
    number = np.empty((n, 8), dtype=np.int64)
    held = [numbers(x) for x in (arm, R, p)]
    results = (pointer(x) for x in (start, end, number))
    library().srs_intervals(*map(pointer, held), _int64(n), *results)
    width = max(1, int(number.max(initial=0)))
    return start[:, :, :width].copy(), end[:, :, :width].copy(), number
