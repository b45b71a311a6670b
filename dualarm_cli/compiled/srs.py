"""The compiled functions of `src/srs.c`: inverse kinematics of spherical-revolute-spherical arms.

Every function takes the arm as `SrsArm.numbers` has it, and arrays of float64 and int64.
"""

from __future__ import annotations

import ctypes
from ctypes import byref

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.native import library, numbers, pointer, whole
from dualarm_cli.records import dataclass

MOST_CUTS = 32
"""Most intervals of arm angles of one branch."""

_int64, _double = ctypes.c_int64, ctypes.c_double


def postures(
    arm: FloatArray,
    R: FloatArray,
    p: FloatArray,
    target: IntArray,
    psi: FloatArray,
    branch: IntArray | None = None,
) -> tuple[FloatArray, BoolArray]:
    """Returns postures [rad], (n, 8, 7), or (n, 7) of given branches, and whether they are within reach (n,).

    Args:
        arm: the arm.
        R: flange rotations in the base frame, shape (m, 3, 3).
        p: flange positions [m], shape (m, 3).
        target: which of the m poses, shape (n,); same ones in a row are quicker.
        psi: arm angles [rad], shape (n,).
        branch: branches, shape (n,); all eight where there are none.
    """
    n = len(target)
    q = np.empty((n, 8, 7) if branch is None else (n, 7))
    reachable = np.empty(n, dtype=np.bool_)
    held = [numbers(arm), numbers(R), numbers(p), whole(target), numbers(psi)]
    own = None if branch is None else whole(branch)
    branches = None if own is None else pointer(own)
    library().srs_solve(*map(pointer, held), branches, _int64(n), pointer(q), pointer(reachable))
    return q, reachable


@dataclass(frozen=True)
class LinePair:
    """Approach and retract of n candidates."""

    pose: tuple[FloatArray, FloatArray, FloatArray]
    """Flange at the target, and the lines' direction: (n, 3, 3), (n, 3) [m] and (n, 3)."""
    branch: IntArray
    """Branches, shape (n,)."""
    psi: FloatArray
    """Arm angles at target, approach and retract [rad], shape (n, 3)."""
    length: FloatArray
    """Of approach and retract [m], shape (n, 2)."""
    near: FloatArray
    """Joints to be near to at the target [rad], shape (n, 7)."""


def joints_along_lines(
    arm: FloatArray, lines: LinePair, largest: float, samples: int
) -> tuple[FloatArray, BoolArray]:
    """Returns joints along approach and retract [rad], (n, 2 samples - 1, 7), and whether they can be followed (n,).

    The target is in the middle, on the turn within limits that is nearest to `near`. Where there are no lines at all,
    the targets alone, shape (n, 1, 7).

    Args:
        arm: the arm.
        lines: of which candidates.
        largest: what a joint may turn between two samples [rad].
        samples: of one line.
    """
    n, any_line = len(lines.branch), bool(lines.length.any())
    q = np.empty((n, 2 * samples - 1 if any_line else 1, 7))
    ok = np.empty(n, dtype=np.bool_)
    held = [*map(numbers, (arm, *lines.pose)), whole(lines.branch)]
    held += map(numbers, (lines.psi, lines.length, lines.near))
    how = _double(largest), _int64(samples), _int64(any_line), _int64(n)
    library().srs_lines(*map(pointer, held), *how, pointer(q), pointer(ok))
    return q, ok


class _Rows(ctypes.Structure):
    """`Rows` in C."""

    _fields_ = tuple((name, ctypes.c_void_p) for name in ("pose", "step", "branch", "swing", "q"))


@dataclass(frozen=True)
class ArmAngleGrid:
    """How nodes of a stop are set over the arm angle."""

    steps: int
    """Arm angles around the circle, from -pi."""
    reference: FloatArray
    """Joints to be near to at the target [rad], shape (7,)."""
    speed: FloatArray
    """Largest joint speeds [rad/s], shape (7,): joints count by the time they need."""
    joints: int
    """So many of them have limits that count."""
    swings: int
    """Half steps of the arm angle by which a line may swing to either side."""
    largest: float
    """What a joint may turn along a line [rad]."""


def nodes(
    arm: FloatArray, R: FloatArray, points: FloatArray, grid: ArmAngleGrid
) -> tuple[IntArray, IntArray, IntArray, IntArray, FloatArray]:
    """Returns postures within limits on a grid of arm angles, with the swings along the lines that move joints least.

    Args:
        arm: the arm.
        R: flange rotations in the base frame, shape (m, 3, 3).
        points: flange positions at target, approach and retract [m], shape (m, 3, 3).
        grid: of the arm angles.

    Returns:
        Pose, arm angle and branch of each posture, shape (n,) each; half steps along approach and retract, shape
        (n, 2); joints at target, approach and retract [rad], shape (n, 3, 7).
    """
    assert grid.steps <= 256  # as many as the compiled function keeps
    most = len(R) * grid.steps * 8
    pose, step, branch = (np.empty(most, dtype=np.int64) for _ in range(3))
    swing, q = np.empty((most, 2), dtype=np.int64), np.empty((most, 3, 7))
    rows = _Rows(*map(pointer, (pose, step, branch, swing, q)))
    ends = 1 if np.array_equal(points[:, 1], points[:, 2]) else 2
    held = [numbers(x) for x in (arm, R, points, grid.reference, grid.speed)]
    call = library().srs_nodes
    call.restype = _int64
    n = call(
        *map(pointer, held[:3]),
        _int64(len(R)),
        _int64(grid.steps),
        *map(pointer, held[3:]),
        _int64(grid.joints),
        _int64(grid.swings),
        _double(grid.largest),
        _int64(ends),
        byref(rows),
    )
    # Copies: what is not used of the large arrays was never touched.
    return pose[:n].copy(), step[:n].copy(), branch[:n].copy(), swing[:n].copy(), q[:n].copy()


def arm_angle_intervals(
    arm: FloatArray, R: FloatArray, p: FloatArray
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Returns starts and ends of the intervals of arm angles within limits [rad], (n, 8, k), and their number (n, 8).

    Args:
        arm: the arm.
        R: flange rotations in the base frame, shape (n, 3, 3).
        p: flange positions [m], shape (n, 3).
    """
    n = len(R)
    start, end = (np.empty((n, 8, MOST_CUTS)) for _ in range(2))
    number = np.empty((n, 8), dtype=np.int64)
    held = [numbers(x) for x in (arm, R, p)]
    found = (pointer(x) for x in (start, end, number))
    library().srs_intervals(*map(pointer, held), _int64(n), *found)
    width = max(1, int(number.max(initial=0)))
    return start[:, :, :width].copy(), end[:, :, :width].copy(), number
