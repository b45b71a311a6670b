"""JSON Schema of input files, from the models that read them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from pydantic import BaseModel

from dualarm_cli.files.calibration.points import BaseFile, PointsFile
from dualarm_cli.files.cells.cells import cell_schema
from dualarm_cli.files.robots.schema_robot import RobotFile
from dualarm_cli.files.studies.schema_study import StudyFile
from dualarm_cli.files.tasks.task_reader import schemas_of
from dualarm_cli.kinds import of_kinds

INPUT_FILES: Mapping[str, Callable[[], type[BaseModel]]] = {
    "tasks": lambda: schemas_of(tuple(of_kinds("reading"))).file,
    "cell": lambda: cell_schema(tuple(of_kinds("cell_reading"))),
    "robot": lambda: RobotFile,
    "study": lambda: StudyFile,
    "points": lambda: PointsFile,
    "base": lambda: BaseFile,
}
"""The model of each kind of input file, with the keys of all kinds of work."""


def input_schema(kind: str) -> dict[str, Any]:
    """Returns the JSON Schema of a kind of input file: every key with its description, default and values.

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
    """Removes what tells nothing, and says of keys that are names that all others are refused."""
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
    """Removes a default that says nothing: none, and keys of a mapping that are not given."""
    if "default" not in key:
        return
    default = key["default"]
    if isinstance(default, dict):
        default = key["default"] = {k: v for k, v in default.items() if v is not None}
    if default in (None, {}):
        del key["default"]
