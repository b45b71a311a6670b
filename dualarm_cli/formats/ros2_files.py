"""Export of each controller group's trajectory_msgs/JointTrajectory, as YAML and JSON."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping
from functools import partial
from typing import Any

from dualarm_cli.formats.request import ExportRequest, FileParts, stamp
from dualarm_cli.formats.sampling import Samples

_FLOAT_WITHOUT_POINT = re.compile(r"(?<![\d.])(-?\d+)e")


def files(request: ExportRequest) -> Mapping[str, Iterable[bytes]]:
    """Build `<group>.yaml` and `<group>.json` of each group of joints."""
    contents: dict[str, Iterable[bytes]] = {}
    for group, samples in trajectories(request).items():
        contents[f"{group}.yaml"] = FileParts(partial(_yaml, samples, request))
        contents[f"{group}.json"] = FileParts(partial(_json, samples, request))
    return contents


def trajectories(request: ExportRequest) -> dict[str, Samples]:
    """Sample the points of each group's JointTrajectory."""
    return {group: request.points(joints) for group, joints in request.groups().items() if joints}


def points(samples: Samples, request: ExportRequest) -> Iterator[dict[str, Any]]:
    """Yield trajectory_msgs/JointTrajectoryPoint rows with the fields that the receiver interpolates.

    ros2_control takes points without velocities as linear, with velocities as cubic, with accelerations as quintic.
    """
    order = {"linear": 0, "cubic": 1, "quintic": 2}[request.interpolation]
    rows = (samples.position, samples.velocity, samples.acceleration)
    for k, instant in enumerate(samples.nanoseconds.tolist()):
        values = [row[k].tolist() if n <= order else [] for n, row in enumerate(rows)]
        yield {
            "positions": values[0],
            "velocities": values[1],
            "accelerations": values[2],
            "effort": [],
            "time_from_start": stamp(instant),
        }


def _json(samples: Samples, request: ExportRequest) -> Iterator[bytes]:
    names = json.dumps(list(samples.joints), ensure_ascii=False)
    head = '{"header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""},\n'
    yield f'{head}"joint_names": {names},\n"points": ['.encode("utf-8", "backslashreplace")
    separator = "\n"
    for point in points(samples, request):
        yield (separator + json.dumps(point)).encode()
        separator = ",\n"
    yield b"\n]}\n"


def _yaml(samples: Samples, request: ExportRequest) -> Iterator[bytes]:
    names = json.dumps(list(samples.joints), ensure_ascii=False)
    yield b"header: {stamp: {sec: 0, nanosec: 0}, frame_id: ''}\n"
    yield f"joint_names: {names}\npoints:\n".encode("utf-8", "backslashreplace")
    for point in points(samples, request):
        lines = [f"{key}: {json.dumps(value)}" for key, value in point.items()]
        text = "- " + "\n  ".join(lines) + "\n"
        # YAML 1.1 reads 1e-05 as text and 1.0e-05 as a number.
        yield _FLOAT_WITHOUT_POINT.sub(r"\1.0e", text.replace('"', "")).encode()
