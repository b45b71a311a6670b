"""Copies of a job's files with the values of levers; comments and layout stay."""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dualarm_cli.errors import UsageError
from dualarm_cli.files.source.bundled import robots_folder
from dualarm_cli.files.source.projects import Project
from dualarm_cli.files.source.text_source import recorded_reads
from dualarm_cli.files.source.value_paths import from_pointer, value_at
from dualarm_cli.files.source.yaml_source import Document, Loc
from dualarm_cli.files.studies.studies import job_documents
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.records import dataclass

SCALAR = re.compile(r"\"(?:[^\"\\]|\\.)*\"|'(?:[^']|'')*'|(?:[^,\]}#\n]|(?<=\S)#)+")
"""Text of a quoted or plain scalar from its first character; no number has a comma."""


@dataclass(frozen=True)
class AppliedFiles:
    """Files of a job with changed values."""

    contents: Mapping[str, bytes]
    """Contents by name in the new folder; bundled robots are left out."""
    tasks: str
    """Name of the task file in the new folder."""
    difference: str
    """Lines that were changed, as a unified diff."""


def applied(tasks: Path, values: Mapping[str, Any]) -> AppliedFiles:
    """Change values in copies of a job's task and cell file.

    Args:
        tasks: the task file.
        values: new values by role and JSON pointer; those of other files are refused.

    Raises:
        UsageError: a value of another file than task and cell file.
    """
    project = Project.of(tasks)
    with recorded_reads() as reads:
        job = load_job(tasks)
    documents = job_documents(project, tasks, tasks.name)
    names = dict(zip(documents, project.inputs, strict=False))
    by_role: dict[str, dict[str, Any]] = {}
    for key, value in values.items():
        role, _, pointer = key.partition(":")
        by_role.setdefault(role, {})[pointer] = value
    if beyond := [role for role in by_role if role not in ("tasks", "cell")]:
        raise UsageError(f"{beyond[0]}: only task and cell file are changed; edit the robot file")
    places = {name: (project.folder / name).absolute() for name in names.values()}
    bundled = robots_folder().resolve()
    # The job's own list of files has no meshes; those that are only shown are read with the page.
    shown = [mesh.file for mesh in job.cell.robot.visuals]
    files = dict.fromkeys(
        path.absolute()
        for path in (*map(Path, reads), *shown)
        if not path.resolve().is_relative_to(bundled)
    )
    top = os.path.commonpath([path.parent for path in files])
    inside = {
        name: path.relative_to(top).as_posix() for name, path in places.items() if path in files
    }
    contents = {path.relative_to(top).as_posix(): path.read_bytes() for path in files}
    difference = ""
    for role, changes in by_role.items():
        document, name = documents[role], inside[names[role]]
        text = edited(document, changes)
        lines = document.source.text.splitlines(), text.splitlines()
        rows = difflib.unified_diff(*lines, name, name, n=0, lineterm="")
        difference += "".join(f"{row}\n" for row in rows)
        contents[name] = text.encode()
    return AppliedFiles(contents, inside[names["tasks"]], difference)


def edited(document: Document, changes: Mapping[str, Any]) -> str:
    """Replace values in a file's text, or add them where missing."""
    text = document.source.text
    edits = []
    for pointer, value in changes.items():
        loc = from_pointer(document.data, pointer, may_add=True)
        is_new = isinstance(loc[-1], str) and loc[-1] not in value_at(document.data, loc[:-1])
        edits.append((_added if is_new else _replaced)(document, loc, value))
    for begin, end, new in sorted(edits, reverse=True):
        text = text[:begin] + new + text[end:]
    return text


def _begin(document: Document, loc: Loc, key: bool = False) -> tuple[int, int]:
    """Find where a value or its key begins in the text, and its column from 0."""
    line, column = document.place(loc, key)
    above = document.source.text.split("\n")[: line - 1]
    return sum(len(row) + 1 for row in above) + column - 1, column - 1


def _end(document: Document, loc: Loc) -> int:
    """Find where a scalar or a list of scalars ends in the text."""
    text, (begin, _) = document.source.text, _begin(document, loc)
    value = value_at(document.data, loc)
    if not isinstance(value, list):
        return begin + len(SCALAR.match(text, begin)[0].rstrip())  # type: ignore[index]
    last = _end(document, (*loc, len(value) - 1))
    return text.index("]", last) + 1 if text[begin] == "[" else last


def _replaced(document: Document, loc: Loc, value: Any) -> tuple[int, int, str]:
    """Return begin, end and new text of a value."""
    begin, column = _begin(document, loc)
    new, end = _text(value), _end(document, loc)
    if isinstance(value, list) and document.source.text[begin:end].startswith("- "):
        new = f"\n{' ' * column}".join(f"- {_text(item)}" for item in value)
    return begin, end, new


def _added(document: Document, loc: Loc, value: Any) -> tuple[int, int, str]:
    """Return place, twice, and text of a new key of a mapping."""
    keys = list(value_at(document.data, loc[:-1]))
    begin, column = _begin(document, (*loc[:-1], keys[min(1, len(keys) - 1)]), key=True)
    flow = document.source.text[begin - column : begin].rstrip(" ").endswith(("{", ","))
    follows = ", " if flow else "\n" + " " * column
    return begin, begin, f"{loc[-1]}: {_text(value)}{follows}"


def _text(value: Any) -> str:
    """Write a scalar or a list of scalars in YAML."""
    if isinstance(value, list):
        return f"[{', '.join(map(_text, value))}]"
    return str(value).lower() if isinstance(value, bool) else str(value)
