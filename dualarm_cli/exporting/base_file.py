"""The transform of a calibration as a file that a cell file can name as `base`."""

from __future__ import annotations

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.rotations import rpy_angles


def base_file(rotation: FloatArray, translation: FloatArray, remarks: list[str]) -> bytes:
    """Returns a `dualarm: base/1` file: where the right robot's base stands in the left one's.

    Args:
        rotation: R_left_right, shape (3, 3).
        translation: the right base's origin in the left base frame [m], shape (3,).
        remarks: lines of comment about where it comes from.
    """
    xyz, rpy = (
        "[" + ", ".join(repr(float(value) + 0.0) for value in values) + "]"
        for values in (translation, rpy_angles(rotation))
    )
    lines = [
        "dualarm: base/1",
        *(f"# {' '.join(remark.split())}" for remark in remarks),
        "# In a cell file: robot: {left: {robot: …, base: …}, right: {robot: …, base: THIS_FILE}}",
        "relative_to: left        # the right robot's root link in the left robot's",
        f"base: {{xyz: {xyz}, rpy: {rpy}}}",
    ]
    return ("\n".join(lines) + "\n").encode()
