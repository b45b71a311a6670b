"""Output files: a schedule's set, a calibrated base, and a curve as CSV.

A schedule's files are written as one set. The base is the transform of a calibration that a
cell file can name as `base`; the CSV has a curve's points and frames.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np

from dualarm_cli.errors import OutputError
from dualarm_cli.exporting.schedule_json import to_json
from dualarm_cli.exporting.whole_files import place_in, replace_all
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.rotations import rpy_angles, to_quaternion
from dualarm_cli.model.curves.discretisation import Points
from dualarm_cli.model.schedule import Schedule

SCHEDULE, URDF, REPORT = "schedule.json", "robot.urdf", "report.json"
SAMPLES, EVENTS, TARGETS = "schedule.csv", "events.csv", "targets.csv"


def check_writable(folder: Path, force: bool, option: str = "--out") -> None:
    """Raise OutputError before planning if `write_schedule_set` would fail.

    Args:
        folder: where to.
        force: whether a schedule that already exists may be replaced.
        option: option or Python argument that names the folder.

    Raises:
        OutputError: the folder cannot be made or holds results already, with what to do.
    """
    if folder.exists() and not folder.is_dir():
        raise OutputError(f"{option} {folder}: is a file; name a folder")
    if not force:
        meshes = sorted(path.name for path in folder.glob("mesh_*.stl"))
        names = (SCHEDULE, URDF, REPORT, SAMPLES, EVENTS, TARGETS, *meshes)
        _refuse_existing(folder, names, option)
    parent = folder
    while not parent.exists():
        parent = parent.parent
    if not parent.is_dir():
        raise OutputError(f"{option} {folder}: {parent} is a file, not a folder")
    if not os.access(parent, os.W_OK | os.X_OK):
        raise OutputError(f"{option} {folder}: no permission to write in {parent}")


def write_schedule_set(
    folder: Path, schedule: Schedule, others: Mapping[str, Iterable[bytes]], force: bool
) -> None:
    """Write a schedule with its URDF and other files; schedule.json comes last.

    schedule.json carries the SHA-256 of the others, so that a set torn apart is noticed.

    Args:
        folder: where to; made if need be.
        schedule: what to write.
        others: further files by name, in parts.
        force: whether a schedule that already exists is replaced.

    Raises:
        OutputError: nothing could be written, or not everything; what was there is whole.
    """
    check_writable(folder, force, "folder")
    given = {URDF: [schedule.robot.urdf.encode()], **others}
    if not force:
        _refuse_existing(folder, given, "folder")
    # Filled while the files are written; schedule.json, the last file, reads the hashes.
    hashes = dict.fromkeys(sorted(given), "")
    files = {name: _hashed(name, content, hashes) for name, content in given.items()}
    files[SCHEDULE] = to_json(schedule, URDF, hashes)
    replace_all(folder, files)


def _hashed(name: str, content: Iterable[bytes], hashes: dict[str, str]) -> Iterator[bytes]:
    """Yield a file's parts, and store its SHA-256 after the last one."""
    digest = hashlib.sha256()
    for part in content:
        digest.update(part)
        yield part
    hashes[name] = digest.hexdigest()


def _refuse_existing(folder: Path, names: Iterable[str], option: str) -> None:
    """Raise OutputError if a folder already holds one of the files."""
    for name in names:
        if place_in(folder, name).exists():
            what = "a schedule" if name == SCHEDULE else f"a file {name}"
            force = "add --force" if option.startswith("-") else "pass force=True"
            raise OutputError(
                f"{option} {folder}: already holds {what}; {force} to replace it, or name another"
            )


def base_file(rotation: FloatArray, translation: FloatArray, remarks: list[str]) -> bytes:
    """Render the right robot's base in the left one's as a `dualarm: base/1` file.

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


def curve_csv(s: FloatArray, points: Points) -> bytes:
    """Render the points of a curve as CSV: length, position and unit quaternion.

    Lengths and positions are in m, poses in the part's frame. A task's `curve: {kind: poses, file: …}` takes the file.
    Numbers are written so that reading them gives the same double; neighbouring quaternions are on the same side, so
    that a reader may interpolate between them.

    Args:
        s: lengths along the curve [m], shape (k,).
        points: its points.
    """
    quaternion = to_quaternion(points.R)
    # q and -q are one rotation: each is taken on the side of the one before.
    away = (quaternion[1:] * quaternion[:-1]).sum(axis=1) < 0.0
    quaternion[1:][np.cumsum(away) % 2 == 1] *= -1.0
    # Adding zero turns -0.0 into 0.0.
    rows = (np.column_stack([s, points.p, quaternion]) + 0.0).tolist()
    return (
        "\n".join(["s,x,y,z,qx,qy,qz,qw", *(",".join(map(repr, row)) for row in rows)]).encode()
        + b"\n"
    )
