from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import pytest

from dualarm_cli.files.calibration.points import BaseFile, PointsFile
from dualarm_cli.files.cells.cells import cell_schema
from dualarm_cli.files.robots.schema_robot import RobotFile
from dualarm_cli.files.source.fields import Section
from dualarm_cli.files.studies.schema_study import StudyFile
from dualarm_cli.files.tasks.task_reader import schemas_of
from dualarm_cli.kinds import of_kinds

CellFile = cell_schema(tuple(of_kinds("cell_reading")))
TasksFile = schemas_of(tuple(of_kinds("reading"))).file
FILES = [RobotFile, CellFile, TasksFile, PointsFile, BaseFile, StudyFile]


@pytest.mark.parametrize("model", FILES)
def test_every_key_has_a_description_for_editors(model: type[Section]) -> None:
    """No key is without one; no fixed tuples, which old editors do not know."""
    schema = model.model_json_schema(by_alias=True)
    text = json.dumps(schema)
    assert "prefixItems" not in text
    sections = [schema, *schema.get("$defs", {}).values()]
    keys = [(s["title"], k, v) for s in sections for k, v in s.get("properties", {}).items()]
    assert len(keys) >= 6
    assert [(title, key) for title, key, value in keys if not value.get("description")] == []
    assert all(s.get("additionalProperties") is False for s in sections)


def test_keys_are_spelled_as_in_the_files() -> None:
    """Python's reserved words do not leak into the format."""
    schema: dict[str, Any] = TasksFile.model_json_schema(by_alias=True)
    assert "return" in schema["properties"] and "return_" not in schema["properties"]
    assert "in" in schema["$defs"]["TargetSection"]["properties"]
    assert schema["required"] == ["dualarm", "cell", "tasks"]


def _every(section: type[Section]) -> Iterator[type[Section]]:
    """Yields all that are derived from one."""
    for one in section.__subclasses__():
        yield one
        yield from _every(one)


def test_defaults_that_are_sections_are_good() -> None:
    """They are made without validation: each is what reading it from a file gives."""
    checked = 0
    for section in set(_every(Section)):
        for field in section.model_fields.values():
            made = field.default
            if isinstance(made, Section):
                read = type(made).model_validate(made.model_dump(exclude_unset=True, by_alias=True))
                assert made == read and made.model_fields_set == read.model_fields_set
                checked += 1
    assert checked >= 15
