"""JSON Schemas of all files read and written, for editors and programs."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from dualarm_cli.schemas.kinds_of_files import INPUT_FILES, input_schema, result_schema
from dualarm_cli.schemas.result_fields import RESULTS

_SCHEMAS: Mapping[str, Callable[[], dict[str, Any]]] = {
    **{kind: partial(input_schema, kind) for kind in INPUT_FILES},
    **{
        kind: partial(result_schema, kind, description, members)
        for kind, (description, members) in RESULTS.items()
    },
}
KINDS = tuple(_SCHEMAS)
"""Kinds of files that have a schema."""


def schema_of(kind: str) -> dict[str, Any]:
    """Build the JSON Schema of a kind of file.

    Args:
        kind: one of KINDS.
    """
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **_SCHEMAS[kind]()}


def schema_text(kind: str) -> str:
    """Build the text of the JSON Schema of a kind of file.

    Args:
        kind: one of KINDS.
    """
    return json.dumps(schema_of(kind), indent=2, allow_nan=False, ensure_ascii=False) + "\n"


def editor_line(schema: str) -> str:
    """Compose the line of a YAML file that leads editors to its schema.

    Args:
        schema: path of the schema's file, relative to the YAML file's folder.
    """
    return f"# yaml-language-server: $schema={schema}\n"
