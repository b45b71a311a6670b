"""Export as a ROS 2 bag in MCAP, for RViz and Foxglove.

`ros2 bag play` plays it.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from heapq import merge
from pathlib import Path
from typing import Any

import numpy as np

from dualarm_cli.errors import MissingDependencyError
from dualarm_cli.exporting.schedule_json import event_row
from dualarm_cli.formats.markers import LinkFrame, link_frames, marker_rows
from dualarm_cli.formats.request import ExportRequest, stamp
from dualarm_cli.formats.ros2_files import points, trajectories
from dualarm_cli.formats.sampling import NANO, Samples
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.records import dataclass

BAG = "bag"
"""Name of the bag's folder and file."""
METADATA_VERSION = 8
"""Version of rosbag2's metadata.yaml, readable since Iron."""


@dataclass(frozen=True)
class _Message:
    """Message of the bag."""

    time: int
    """Time of the message [ns]."""
    topic: str
    kind: str
    content: Mapping[str, Any]
    """Fields by name; times in the form of `stamp`."""


LATCHED = ("/robot_description", "/tf_static")
"""Topics whose last message late subscribers receive."""


def files(request: ExportRequest) -> Mapping[str, Iterable[bytes]]:
    """Build `bag/bag.mcap` and `bag/metadata.yaml`; the clock starts at 0.

    Raises:
        MissingDependencyError: rosbags is not installed.
    """
    try:
        from rosbags.interfaces import (
            Qos,
            QosDurability,
            QosHistory,
            QosLiveliness,
            QosReliability,
            QosTime,
        )
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise MissingDependencyError("rosbags", "export") from None
    store = get_typestore(Stores.ROS2_HUMBLE)
    build = _Builder(store)
    never = QosTime(0, 0)
    latched = Qos(
        QosHistory.KEEP_LAST,
        1,
        QosReliability.RELIABLE,
        QosDurability.TRANSIENT_LOCAL,
        never,
        never,
        QosLiveliness.AUTOMATIC,
        never,
        avoid_ros_namespace_conventions=False,
    )
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / BAG
        with Writer(place, version=METADATA_VERSION, storage_plugin=StoragePlugin.MCAP) as writer:
            connections: dict[str, Any] = {}
            for message in merge(*_streams(request), key=lambda message: message.time):
                if message.topic not in connections:
                    connections[message.topic] = writer.add_connection(
                        message.topic,
                        message.kind,
                        typestore=store,
                        offered_qos_profiles=[latched] if message.topic in LATCHED else [],
                    )
                value = build(message.kind, message.content)
                data = store.serialize_cdr(value, message.kind)
                writer.write(connections[message.topic], message.time, data)
        names = (f"{BAG}.mcap", "metadata.yaml")
        return {f"{BAG}/{name}": [(place / name).read_bytes()] for name in names}


def _streams(request: ExportRequest) -> list[Iterator[_Message]]:
    """List the messages of each topic in order of time.

    They are built when they are written.
    """
    schedule, samples = request.schedule, request.samples()
    world, frames = link_frames(schedule.robot)
    return [
        _at_start(request, frames),
        _joint_states(samples),
        _moving_frames(samples, frames),
        _events(schedule),
        _markers(request, world, frames),
    ]


def _at_start(request: ExportRequest, frames: list[LinkFrame]) -> Iterator[_Message]:
    """Yield the cell's description, its fixed frames, and each controller's trajectory."""
    text = {"data": request.schedule.robot.urdf}
    yield _Message(0, "/robot_description", "std_msgs/msg/String", text)
    fixed = [_transform(frame, 0, *frame.poses(np.zeros(1))) for frame in frames if not frame.joint]
    yield _Message(0, "/tf_static", "tf2_msgs/msg/TFMessage", {"transforms": fixed})
    for group, samples in trajectories(request).items():
        content = {
            "header": _header(0, ""),
            "joint_names": list(samples.joints),
            "points": list(points(samples, request)),
        }
        topic = f"/{group}/joint_trajectory"
        yield _Message(0, topic, "trajectory_msgs/msg/JointTrajectory", content)


def _events(schedule: Schedule) -> Iterator[_Message]:
    for event in sorted(schedule.events, key=lambda event: event.time):
        row = json.dumps(event_row(event), ensure_ascii=False)
        yield _Message(round(event.time * NANO), "/events", "std_msgs/msg/String", {"data": row})


def _markers(request: ExportRequest, world: str, frames: Sequence[LinkFrame]) -> Iterator[_Message]:
    for time, rows in sorted(marker_rows(request, world, frames), key=lambda row: row[0]):
        yield _Message(time, "/markers", "visualization_msgs/msg/MarkerArray", {"markers": rows})


def _joint_states(samples: Samples) -> Iterator[_Message]:
    names = list(samples.joints)
    for k, time in enumerate(samples.nanoseconds.tolist()):
        content = {
            "header": _header(time, ""),
            "name": names,
            "position": samples.position[k],
            "velocity": samples.velocity[k],
            "effort": [],
        }
        yield _Message(time, "/joint_states", "sensor_msgs/msg/JointState", content)


def _moving_frames(samples: Samples, frames: list[LinkFrame]) -> Iterator[_Message]:
    moving = [frame for frame in frames if frame.joint]
    poses = [f.poses(samples.position[:, samples.joints.index(f.joint)]) for f in moving]
    for k, time in enumerate(samples.nanoseconds.tolist()):
        rows = [
            _transform(frame, time, translation[k : k + 1], quaternion[k : k + 1])
            for frame, (translation, quaternion) in zip(moving, poses, strict=True)
        ]
        yield _Message(time, "/tf", "tf2_msgs/msg/TFMessage", {"transforms": rows})


def _transform(
    frame: LinkFrame, time: int, translation: np.ndarray, quaternion: np.ndarray
) -> dict[str, Any]:
    return {
        "header": _header(time, frame.parent),
        "child_frame_id": frame.name,
        "transform": {
            "translation": dict(zip("xyz", translation[0].tolist(), strict=True)),
            "rotation": dict(zip("xyzw", quaternion[0].tolist(), strict=True)),
        },
    }


def _header(time: int, frame: str) -> dict[str, Any]:
    return {"stamp": stamp(time), "frame_id": frame}


class _Builder:
    """Builder of typed messages from fields by name; missing fields are zero or empty."""

    def __init__(self, store: Any) -> None:
        self._store = store
        self._made: dict[str, Callable[[Mapping[str, Any]], Any]] = {}

    def __call__(self, kind: str, content: Mapping[str, Any]) -> Any:
        """Build a message.

        Args:
            kind: its type.
            content: its fields by name.
        """
        if kind not in self._made:
            self._made[kind] = self._maker(kind)
        return self._made[kind](content)

    def _maker(self, kind: str) -> Callable[[Mapping[str, Any]], Any]:
        """Create the builder of one message type."""
        made = self._store.types[kind]
        fields = self._store.get_msgdef(kind).fields
        converters = [(name, self._converter(description)) for name, description in fields]
        names = {name for name, _ in fields}

        def make(content: Mapping[str, Any]) -> Any:
            assert names.issuperset(content), f"{kind} has no {set(content) - names}"
            return made(*(convert(content.get(name)) for name, convert in converters))

        return make

    def _converter(self, description: Any) -> Callable[[Any], Any]:
        """Create the converter of one field's values.

        Args:
            description: of the field in the type store: its kind and the details of that kind.
        """
        from rosbags.interfaces import Nodetype

        kind, about = description
        if kind == Nodetype.BASE:
            zeros: dict[str, Any] = {"string": "", "bool": False}
            zero = zeros.get(about[0], 0.0 if about[0].startswith("float") else 0)
            return lambda given: zero if given is None else given
        if kind == Nodetype.NAME:
            return lambda given: self(about, given or {})
        inner = about[0]
        if inner[0] == Nodetype.BASE and inner[1][0] != "string":
            numbers = np.dtype(inner[1][0])
            return lambda given: np.asarray([] if given is None else given, dtype=numbers)
        convert_item = self._converter(inner)
        return lambda given: [convert_item(row) for row in given or ()]
