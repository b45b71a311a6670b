"""Compact text encoding of arrays, documents and joint motions."""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Mapping
from typing import Any, NoReturn

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.joint_motion import JointMotion, own_knots


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


def unpacked_document(text: str, most: int = 0) -> dict[str, Any]:
    """Return the document that `packed_document` made a text of.

    Args:
        text: packed; of a cache, anything.
        most: longest document that is unpacked [bytes]; 0 for no limit.

    Raises:
        ValueError: the text is none of those, or its document is longer.
    """
    unpacking = zlib.decompressobj()
    try:
        plain = unpacking.decompress(base64.b64decode(text, validate=True), most)
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
    one = group.select([joint])
    kept = own_knots(one)
    rates = (one.position, one.velocity, one.acceleration)
    return np.stack([one.time[kept], *(rate[kept, 0] for rate in rates)])
