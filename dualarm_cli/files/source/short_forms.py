"""Field annotations of short forms: plain value for mapping, item for list, list for mapping."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from pydantic import BaseModel, GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import core_schema

from dualarm_cli.files.source.diagnostics import Findings
from dualarm_cli.files.source.text_source import quote
from dualarm_cli.files.source.yaml_source import Document, Loc, Node
from dualarm_cli.records import dataclass

NAME = "name"
"""Key of the name of a list entry."""
_TEXT = "text (in quotes, if it looks like a number)"


@dataclass(frozen=True)
class ShortForm:
    """Short form of a mapping: the value of one key, as a number or text."""

    key: str
    """The key."""
    of: tuple[type, ...] = (int, float, str)
    """Types of values that are expanded."""

    def read(self, value: object) -> object:
        """Expand the value to a mapping."""
        return {self.key: value} if isinstance(value, self.of) else value

    def __get_pydantic_core_schema__(
        self, source: type[Any], handler: GetCoreSchemaHandler
    ) -> core_schema.CoreSchema:
        """Expand the value to a mapping before pydantic checks it."""
        return core_schema.no_info_before_validator_function(
            self.read, handler(source), metadata={"mapping": source}
        )

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """Build the JSON Schema: that of the key, or of the mapping."""
        # A reference to the mapping may come before its definition.
        whole = handler(schema["metadata"]["mapping"].__pydantic_core_schema__)
        short = dict(handler.resolve_ref_schema(whole)["properties"][self.key])
        for note in ("title", "default"):
            short.pop(note, None)
        return {"anyOf": [short, handler(schema)]}


@dataclass(frozen=True)
class OneOrMore:
    """Short form of a list: its only entry, as text."""

    def __get_pydantic_core_schema__(
        self, source: type[Any], handler: GetCoreSchemaHandler
    ) -> core_schema.CoreSchema:
        """Expand the text to a list before pydantic checks it."""
        return core_schema.no_info_before_validator_function(
            lambda value: [value] if isinstance(value, str) else value, handler(source)
        )

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """Build the JSON Schema: an entry, or a list of entries."""
        several = handler(schema)
        return {"anyOf": [several["items"], several]}


@dataclass(frozen=True)
class ByName:
    """Entries by name; a list of entries that have a `name` means the same."""

    what: str
    """Kind of entry, for messages."""

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """Build the JSON Schema: the mapping, or the list."""
        mapping = handler(schema)
        inside = handler.resolve_ref_schema(mapping)
        by_key = inside.get("properties", {}).values()
        of_any = [*inside.get("patternProperties", {}).values(), inside.get("additionalProperties")]
        entries = [_present(entry) for entry in by_key] or of_any
        entry = dict(handler.resolve_ref_schema(entries[0]))
        name = {"type": "string", "description": f"Name of the {self.what}."}
        entry["properties"] = {NAME: name, **entry["properties"]}
        entry["required"] = [NAME, *entry.get("required", [])]
        return {"anyOf": [mapping, {"type": "array", "items": entry}]}


def _present(optional: dict[str, Any]) -> dict[str, Any]:
    """Extract the part of a schema besides null."""
    parts: list[dict[str, Any]] = optional.get("anyOf", [optional])
    return next(part for part in parts if part.get("type") != "null")


def name_entries(document: Document, model: type[BaseModel], findings: Findings) -> None:
    """Convert named lists of a document to mappings, with their places; note errors.

    Args:
        document: the file; its data change.
        model: its schema.
        findings: where errors are noted.
    """
    for key, field in model.model_fields.items():
        by_name = next((note for note in field.metadata if isinstance(note, ByName)), None)
        if by_name is None or not isinstance(document.data.get(key), list):
            continue
        node, mapping = document.root.children[key], dict[str, Any]()
        places, steps = dict[str | int, Node](), dict[int, str]()
        for k, name in _names(document, key, by_name.what, findings):
            entry, place = document.data[key][k], node.children[k]
            line, column = document.place((key, k, NAME))
            mapping[name] = {inner: value for inner, value in entry.items() if inner != NAME}
            places[name] = Node(place.line, place.column, (line, column))
            places[name].children = place.children
            steps[k] = name
        document.data[key], node.children = mapping, places
        for loc in [loc for loc in document.replaced if loc[0] == key and len(loc) > 1]:
            name = steps.get(int(loc[1]), str(loc[1]))
            document.replaced[(key, name, *loc[2:])] = document.replaced.pop(loc)


def _names(
    document: Document, key: str, what: str, findings: Findings
) -> Iterator[tuple[int, str]]:
    """Yield index and name of the list entries with a unique name; note the others."""
    first: dict[str, int] = {}
    for k, entry in enumerate(document.data[key]):
        loc: Loc = (key, k)
        if not isinstance(entry, dict):
            message = f"must be a mapping, such as {{key: value}}, not {quote(entry)}"
            findings.add(document, loc, message, "E200")
        elif NAME not in entry:
            findings.add(document, loc, f"'{NAME}' is missing", "E202")
        elif not isinstance(entry[NAME], str):
            message = f"must be {_TEXT}, not {quote(entry[NAME])}"
            findings.add(document, (*loc, NAME), message, "E200")
        elif entry[NAME] in first:
            name = entry[NAME]
            message = f"duplicate {what} {quote(name)}, first at line {first[name]}"
            findings.add(document, (*loc, NAME), message, "E102")
        else:
            first[entry[NAME]] = document.place((*loc, NAME))[0]
            yield k, entry[NAME]
