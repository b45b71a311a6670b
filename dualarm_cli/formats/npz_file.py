"""Export of samples and events as NumPy arrays."""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from dualarm_cli.formats.request import ExportRequest


def files(request: ExportRequest) -> Mapping[str, Iterable[bytes]]:
    """Build one file that np.load reads without pickle; units [s], [rad] or [m]."""
    samples, events = request.samples(), request.schedule.events
    arrays: dict[str, Any] = {
        "joints": np.array(samples.joints),
        "time": samples.time,
        "position": samples.position,
        "velocity": samples.velocity,
        "acceleration": samples.acceleration,
        "event_time": np.array([event.time for event in events]),
        "event_dwell": np.array([event.dwell for event in events]),
        **{
            f"event_{name}": np.array([getattr(event, name) for event in events], dtype=np.str_)
            for name in ("arm", "task", "action", "signal", "grasp")
        },
        "event_width": np.array([event.width for event in events]),
        "event_pose": np.array([event.pose.homogeneous for event in events]).reshape(-1, 4, 4),
    }
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return {"schedule.npz": [buffer.getvalue()]}
