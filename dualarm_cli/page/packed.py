"""Arrays and documents as text, and joint motion with no more knots than it has."""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.trajectory import Trajectory

SAME_JERK = 1e-9
"""Jerks that differ by less than this share of the joint's largest one are the same."""
DEVIATION = 1e-11
"""How far the motion may be off at a knot that is left out [rad or m]."""


def packed(values: Any, kind: str) -> str:
    """Returns an array as base64 text.

    Args:
        values: what to pack, of any shape; row by row.
        kind: f64, f32 or u32; little-endian.
    """
    form = {"f64": "<f8", "f32": "<f4", "u32": "<u4"}[kind]
    return base64.b64encode(np.ascontiguousarray(values, dtype=form).tobytes()).decode()


def packed_document(document: Mapping[str, Any]) -> str:
    """Returns a JSON-ready document as base64 text, compressed."""
    text = json.dumps(document, allow_nan=False, separators=(",", ":"))
    return base64.b64encode(zlib.compress(text.encode())).decode()


def unpacked_document(text: str) -> dict[str, Any]:
    """Returns the document that `packed_document` made a text of."""
    document: dict[str, Any] = json.loads(zlib.decompress(base64.b64decode(text)))
    return document


def joint_knots(trajectory: Trajectory, column: int) -> FloatArray:
    """Returns the knots of one joint where its jerk changes: time, position, velocity, acceleration, shape (4, n).

    All joints of a schedule share their knots; most of them are other joints'.

    Args:
        trajectory: of a schedule.
        column: of the joint.
    """
    rows = np.stack(
        [
            trajectory.time,
            trajectory.position[:, column],
            trajectory.velocity[:, column],
            trajectory.acceleration[:, column],
        ]
    )
    count = rows.shape[1]
    if count <= 2:
        return rows
    jerk = trajectory.jerk[:, column]
    changes = np.abs(np.diff(jerk)) > SAME_JERK * max(1.0, float(np.abs(jerk).max()))
    keep = np.concatenate([[True], changes, [True]])
    # A jump of acceleration is two knots at one time; both stay.
    jumps = np.flatnonzero(np.diff(trajectory.time) <= 0.0)
    keep[jumps] = keep[jumps + 1] = True
    while True:
        kept = np.flatnonzero(keep)
        off = _deviation(rows, kept) > DEVIATION
        if not off.any():
            return rows[:, kept]
        # The first knot of each stretch that is off stays; what follows it is measured from there.
        keep |= off & ~np.concatenate([[False], off[:-1]])


def _deviation(rows: FloatArray, kept: np.ndarray) -> FloatArray:
    """Returns how far the motion from the kept knots is off at all knots, shape (n,)."""
    before = kept[np.clip(np.searchsorted(kept, np.arange(rows.shape[1]), "right") - 1, 0, None)]
    after = kept[np.clip(np.searchsorted(kept, before, "right"), 0, len(kept) - 1)]
    time, q, v, a = rows[:, before]
    span = rows[0, after] - time
    jerk = np.divide(rows[3, after] - a, span, out=np.zeros_like(span), where=span > 0.0)
    dt = rows[0] - time
    found: FloatArray = np.abs(q + dt * (v + dt * (a / 2 + dt * jerk / 6)) - rows[1])
    return found
