"""JSON Schemas of input files and result files.

Schemas of input files come from the models that read them; those of results from the types of their members.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints, is_typeddict

from pydantic import BaseModel

from dualarm_cli.files.calibration.points import BaseFile, PointsFile
from dualarm_cli.files.cells.cells import cell_schema
from dualarm_cli.files.robots.schema_robot import RobotFile
from dualarm_cli.files.studies.schema_study import StudyFile
from dualarm_cli.files.tasks.task_reader import schemas_of
from dualarm_cli.kinds import of_kinds

_PLAIN = {str: "string", float: "number", int: "integer", bool: "boolean"}
"""Types of JSON by those of Python."""
_VERSIONS = {
    "schedule": "dualarm.schedule/2",
    "report": "dualarm.report/1",
    "schedule-comparison": "dualarm.schedule-comparison/1",
    "comparison": "dualarm.comparison/1",
    "reach": "dualarm.reach/1",
    "sweep": "dualarm.sweep/1",
    "perturbation": "dualarm.perturbation/1",
    "why": "dualarm.why/1",
}
"""Format version of each kind of file."""
_REQUIRED = (
    r"format|robot|motion|robot\.(urdf|joints|groups|base|arms)|.*\.base\.(xyz|quat_xyzw)|motion\.<>\..*|"
    r"(segments|stages|waits)\[\]\.(start|end)|events\[\]\.(time|xyz|quat_xyzw)"
)
"""Pattern of the required members."""


def result_schema(kind: str, description: str, members: type) -> dict[str, Any]:
    """Build the JSON Schema of a result file.

    Args:
        kind: schedule, report, schedule-comparison, comparison, reach, sweep or why.
        description: of the file.
        members: types of its members, a TypedDict.
    """
    root = _schema(members, "")
    version = {"const": _VERSIONS[kind], "description": "Kind and version of the file."}
    root["properties"]["format"] = version
    return {"title": f"dualarm {kind}", "description": description, **root}


def _schema(kind: Any, path: str) -> dict[str, Any]:
    """Build the schema of a type, at a path of the file."""
    outer, inner = get_origin(kind), get_args(kind)
    if outer is Annotated:
        unit, text = inner[1:]
        return _schema(inner[0], path) | {"description": f"{text} [{unit}]" if unit else text}
    if outer is UnionType:
        parts = [{"type": "null"} if part is NoneType else _schema(part, path) for part in inner]
        return parts[0] | {"type": [part["type"] for part in parts]}
    if outer is Literal:
        return {"type": "string", "enum": list(inner)}
    if outer in (list, tuple):
        count = {"minItems": len(inner), "maxItems": len(inner)} if outer is tuple else {}
        return {"type": "array", "items": _schema(inner[0], f"{path}[]"), **count}
    if outer is not dict and not is_typeddict(kind):
        return {"type": _PLAIN[kind]}
    hints = get_type_hints(kind, include_extras=True) if outer is None else {}
    paths = {name: f"{path}.{name}" if path else name for name in hints}
    schema = {
        "type": "object",
        "properties": {name: _schema(inner, paths[name]) for name, inner in hints.items()},
        "additionalProperties": _schema(inner[1], f"{path}.<>") if outer is dict else False,
    }
    required = [name for name in hints if re.fullmatch(_REQUIRED, paths[name])]
    return schema | ({"required": required} if required else {})


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
