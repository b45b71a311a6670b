"""JSON Schemas of input files and result files.

Schemas of input files come from the models that read them; those of results from the tables of their members.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any

from pydantic import BaseModel

from dualarm_cli.files.calibration.points import BaseFile, PointsFile
from dualarm_cli.files.cells.cells import cell_schema
from dualarm_cli.files.robots.schema_robot import RobotFile
from dualarm_cli.files.studies.schema_study import StudyFile
from dualarm_cli.files.tasks.task_reader import schemas_of
from dualarm_cli.kinds import of_kinds

_NUMBERS = {"type": "array", "items": {"type": "number"}}
_TYPES: Mapping[str, dict[str, Any]] = {
    "text": {"type": "string"},
    "texts": {"type": "array", "items": {"type": "string"}},
    "number": {"type": "number"},
    "numbers": _NUMBERS,
    "three numbers": {**_NUMBERS, "minItems": 3, "maxItems": 3},
    "four numbers": {**_NUMBERS, "minItems": 4, "maxItems": 4},
    "whole numbers": {"type": "array", "items": {"type": "integer"}},
    "rows": {"type": "array", "items": _NUMBERS},
    "whole": {"type": "integer"},
    "flag": {"type": "boolean"},
}
"""JSON Schema of each type of a member."""
_MEMBERS: Mapping[str, str] = {
    "texts": r"notes|assumed(_limits)?|assumptions|without_jerk_limit|sliding_joints|robot\.(platform|groups\.<group>)|"
    r".*\.(joints|tasks|bodies|arms|checked|without_shape|without_part|caveats)",
    "number": r"gap|blending\.share|grid_gap|order_grid_gap|elbow_imbalance|speed|"
    r".*\.(utilisation|speed_share|measured|allowed|value)|"
    r".*manipulability(_together|\.<arm>)|limits_used\..*",
    "numbers": r"motion\.<group>\.time|.*\.ramps",
    "whole numbers": r"motion\.<group>\.anchor",
    "three numbers": r".*\.(xyz|part_xyz|part_rpy)|events\[\]\.velocity",
    "four numbers": r".*\.quat_xyzw",
    "rows": r"motion\.<group>\.(position|velocity|acceleration)",
    "whole": r"parts|(.*\.)?seed|.*\.stage|bottlenecks\..*|.*\.(changes|visits|capacity|initial|final|most)|"
    r"budget\[\]\.(line|column)",
    "flag": r"closes|open|platform_slides|.*\.(passed|kept|platform_slides|limit_slides)",
}
"""Patterns of the members of each type.

Others are numbers where they have a unit, else text.
"""
_MAY_BE_NONE = (
    r"lower_bound|gap|grid_gap|order_grid_gap|clearance_cost|blend_gain|blending|parts_per_hour|elbow_imbalance|tool_speed_cap|"
    r"smallest_clearance|verification|robot\.tool_speed|robot\.limits\.<joint>\.(lower|upper|jerk)|"
    r"stages\[\]\.platform_angle|.*settings\.(follower|seam_solver|time_limit)|.*\.(measured|allowed)|"
    r"waits\[\]\.(task|for|for\.task)|sensitivity\[\]\.(joint|value)|(paths|seams)\[\]\.(clearance|master)|"
    r"paths\[\]\.(least_)?(elbow_distance|manipulability_together)|skew|"
    r"verification\.delays\[\]\.(lacking|bodies|time)"
)
"""Pattern of the members that may be none."""
_VERSIONS = {"schedule": "dualarm.schedule/2", "report": "dualarm.report/1"}
"""Format version of each kind of file."""
_REQUIRED = (
    r"format|robot|motion|robot\.(urdf|joints|groups|base|arms)|.*\.base\.(xyz|quat_xyzw)|motion\..*|"
    r"(segments|stages|waits)\[\]\.(start|end)|events\[\]\.(time|xyz|quat_xyzw)"
)
"""Pattern of the required members."""


def result_schema(
    kind: str, description: str, members: Mapping[str, tuple[str, str]]
) -> dict[str, Any]:
    """Build the JSON Schema of a result file.

    Args:
        kind: schedule or report.
        description: of the file.
        members: unit and meaning by member; `<name>` stands for a name that is a key, `[]` for entries of a list.
    """
    root = _object()
    for path, (unit, text) in members.items():
        steps, node = path.split("."), root
        for k, step in enumerate(steps[:-1]):
            node = _inside(node, step, ".".join(steps[: k + 1]))
        meaning = f"{text} [{unit}]" if unit else text
        _put(node, steps[-1], path, {**_type(path, unit), "description": meaning})
    version = {"const": _VERSIONS[kind], "description": "Kind and version of the file."}
    root["properties"]["format"] = version
    return {"title": f"dualarm {kind}", "description": description, **root}


def _object() -> dict[str, Any]:
    return {"type": "object", "properties": {}, "additionalProperties": False}


def _inside(node: dict[str, Any], step: str, path: str) -> dict[str, Any]:
    """Return the schema of a nested object or list entry, created on first use."""
    name = step.removesuffix("[]")
    member = node["additionalProperties"] if step.startswith("<") else node["properties"].get(name)
    if not member:
        member = {"type": "array", "items": _object()} if step.endswith("[]") else _object()
        _put(node, name, path.removesuffix("[]"), member)
    inside: dict[str, Any] = member["items"] if step.endswith("[]") else member
    return inside


def _put(node: dict[str, Any], step: str, path: str, schema: dict[str, Any]) -> None:
    """Add a member to an object."""
    if re.fullmatch(_MAY_BE_NONE, path):
        schema["type"] = [schema["type"], "null"]
    if step.startswith("<"):
        node["additionalProperties"] = schema
        return
    node["properties"][step] = schema
    if re.fullmatch(_REQUIRED, path):
        node.setdefault("required", []).append(step)


def _type(path: str, unit: str) -> dict[str, Any]:
    """Build the schema of a member's values."""
    for name, pattern in _MEMBERS.items():
        if re.fullmatch(pattern, path):
            return dict(_TYPES[name])
    return dict(_TYPES["number" if unit and unit != "`unit`" else "text"])


INPUT_FILES: Mapping[str, Callable[[], type[BaseModel]]] = {
    "tasks": lambda: schemas_of(tuple(of_kinds("reading"))).file,
    "cell": lambda: cell_schema(tuple(of_kinds("cell_reading"))),
    "robot": lambda: RobotFile,
    "study": lambda: StudyFile,
    "points": lambda: PointsFile,
    "base": lambda: BaseFile,
}
"""Model of each kind of input file, with keys of all work kinds."""


def input_schema(kind: str) -> dict[str, Any]:
    """Build the JSON Schema of a kind of input file.

    It has every key with its description, default and values.

    Args:
        kind: one of INPUT_FILES.
    """
    schema = INPUT_FILES[kind]().model_json_schema(by_alias=True)
    _tidy(schema)
    for section in schema.get("$defs", {}).values():
        section.pop("title", None)
    schema["title"] = f"dualarm {kind} file"
    return schema


def _tidy(node: Any) -> None:
    """Remove redundant titles and defaults, and restrict keys to their pattern."""
    if isinstance(node, list):
        for entry in node:
            _tidy(entry)
    if not isinstance(node, dict):
        return
    for key in node.get("properties", {}).values():
        key.pop("title", None)
        _tidy_default(key)
    by_pattern = node.pop("patternProperties", None)
    if by_pattern is not None:
        ((pattern, value),) = by_pattern.items()
        node["propertyNames"] = {**node.get("propertyNames", {}), "pattern": pattern}
        node["additionalProperties"] = value
    for inner in node.values():
        _tidy(inner)


def _tidy_default(key: dict[str, Any]) -> None:
    """Remove an empty default, and missing keys of a default mapping."""
    if "default" not in key:
        return
    default = key["default"]
    if isinstance(default, dict):
        default = key["default"] = {k: v for k, v in default.items() if v is not None}
    if default in (None, {}):
        del key["default"]
