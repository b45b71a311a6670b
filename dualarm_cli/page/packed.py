"""Compact text encoding of arrays, documents and joint motions."""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Mapping
from typing import Any, NoReturn

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.motion.joint_motion import JointMotion, jerk_knots


def packed(values: Any, kind: str) -> str:
    """Encode an array as base64 text.

    Args:
        values: what to pack, of any shape; row by row.
        kind: f64, f32 or u32; little-endian.
    """
    form = {"f64": "<f8", "f32": "<f4", "u32": "<u4"}[kind]
    return base64.b64encode(np.ascontiguousarray(values, dtype=form).tobytes()).decode()


def packed_document(document: Mapping[str, Any]) -> str:
    """Compress a JSON-ready document into base64 text."""
    text = json.dumps(document, allow_nan=False, separators=(",", ":"))
    return base64.b64encode(zlib.compress(text.encode())).decode()


def unpacked_document(text: str, max_size: int = 0) -> dict[str, Any]:
    """Decode a document encoded by `packed_document`.

    Args:
        text: encoded document; text from a cache may hold anything.
        max_size: maximum size of the decoded document [B]; 0 for no limit.

    Raises:
        ValueError: the text encodes no document, or a larger one.
    """
    unpacking = zlib.decompressobj()
    try:
        plain = unpacking.decompress(base64.b64decode(text, validate=True), max_size)
        document = json.loads(plain if unpacking.eof else b"", parse_constant=_no_number)
    except (zlib.error, RecursionError) as error:
        raise ValueError(str(error)) from None
    if not isinstance(document, dict):
        raise ValueError("a page's data are no object")
    return document


def _no_number(text: str) -> NoReturn:
    raise ValueError(f"{text} is not a number")


def joint_knots(motion: JointMotion, joint: str) -> FloatArray:
    """Select the knots of one joint at which its jerk changes.

    Returns time, position, velocity and acceleration, shape (4, n).

    Args:
        motion: of a schedule.
        joint: its name.
    """
    group = next(group for group in motion.groups.values() if joint in group.joints)
    single = group.select([joint])
    knots = jerk_knots(single)
    rates = (single.position, single.velocity, single.acceleration)
    return np.stack([single.time[knots], *(rate[knots, 0] for rate in rates)])
