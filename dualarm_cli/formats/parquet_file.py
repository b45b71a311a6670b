"""Export of samples and events as Apache Parquet tables."""

from __future__ import annotations

import io
import json
from collections.abc import Iterable, Mapping
from typing import Any

from dualarm_cli.errors import MissingDependencyError
from dualarm_cli.formats.request import ExportRequest

TABLE, EVENTS = "schedule.parquet", "events.parquet"


def files(request: ExportRequest) -> Mapping[str, Iterable[bytes]]:
    """Build both tables; each column's metadata names its unit.

    Raises:
        MissingDependencyError: pyarrow is not installed.
    """
    try:
        import pyarrow as pa
    except ImportError:
        raise MissingDependencyError("pyarrow", "export") from None
    schedule, samples = request.schedule, request.samples()
    number = pa.float64()
    columns: dict[str, tuple[Any, Any, str]] = {"time": (number, samples.time, "s")}
    rates = {
        "position": (samples.position, "rad"),
        "velocity": (samples.velocity, "rad/s"),
        "acceleration": (samples.acceleration, "rad/s2"),
    }
    for k, joint in enumerate(samples.joints):
        for name, (values, unit) in rates.items():
            unit = unit.replace("rad", "m") if joint in schedule.robot.sliding else unit
            columns[f"{joint}_{name}"] = (number, values[:, k], unit)
    events = schedule.events
    kinds = dict.fromkeys(("time", "dwell"), (number, "s"))
    kinds |= dict.fromkeys(("arm", "task", "action", "frame", "signal", "grasp"), (pa.string(), ""))
    kinds["width"] = number, "m"
    rows: dict[str, tuple[Any, Any, str]] = {
        name: (kind, [getattr(event, name) for event in events], unit)
        for name, (kind, unit) in kinds.items()
    }
    for k, axis in enumerate("xyz"):
        rows[axis] = (number, [float(event.pose.translation[k]) for event in events], "m")
    return {TABLE: [_table(columns, schedule.robot.name)], EVENTS: [_table(rows, "")]}


def _table(columns: Mapping[str, tuple[Any, Any, str]], robot: str) -> bytes:
    """Encode a table, given its columns with type, values and unit."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    fields = [
        pa.field(name, kind, nullable=False, metadata={"unit": unit} if unit else None)
        for name, (kind, _, unit) in columns.items()
    ]
    about = {"dualarm": json.dumps({"robot": robot}, ensure_ascii=False)} if robot else None
    arrays = [pa.array(values, kind) for kind, values, _ in columns.values()]
    buffer = io.BytesIO()
    pq.write_table(pa.table(arrays, schema=pa.schema(fields, metadata=about)), buffer)
    return buffer.getvalue()
