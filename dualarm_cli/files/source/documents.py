"""Typed documents: a YAML file of a known kind, validated against its schema."""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, ValidationError

from dualarm_cli.errors import InputError, did_you_mean
from dualarm_cli.files.source.diagnostics import Findings, schema_diagnostics
from dualarm_cli.files.source.projects import Project
from dualarm_cli.files.source.short_forms import name_entries
from dualarm_cli.files.source.text_source import quote, suggest
from dualarm_cli.files.source.yaml_source import Document, Loc, parse_yaml

KINDS = ("robot/1", "cell/1", "tasks/1", "points/1", "base/1", "study/1")
"""File kinds that this version reads."""

M = TypeVar("M", bound=BaseModel)


def read_document(
    project: Project, path: Path, name: str, kind: str | None = None, role: str | None = None
) -> Document:
    """Return the document in a file and makes sure of what kind it is.

    Args:
        project: where the reading is recorded.
        path: the file.
        name: what the user calls it.
        kind: what it must be, such as `cell/1`; None for any kind that this version reads.
        role: what it is to the job, such as `robot.left`; None for what its kind says.

    Raises:
        InputError: it cannot be read, is not YAML, is something else, or lacks a value that is to be replaced.
    """
    document = parse_yaml(project.read(path, name))
    problem = _kind_problem(document.data, kind)
    if problem is not None:
        loc, code, message = problem
        raise InputError([document.diagnostic(loc, code, message), *document.diagnostics])
    project.overrides.apply(document, role or str(document.data["dualarm"]).partition("/")[0])
    return document


def _kind_problem(data: object, kind: str | None) -> tuple[Loc, str, str] | None:
    """Return place, code and message of what is wrong with a file's kind."""
    wanted = kind or "tasks/1"
    if not isinstance(data, dict):
        return (
            (),
            "E200",
            f"must be a mapping that begins with 'dualarm: {wanted}', not {quote(data)}",
        )
    if "dualarm" not in data:
        close = [key for key in data if did_you_mean(key, ["dualarm"])]
        found = f" (there is {quote(close[0])})" if close else ""
        return (), "E202", f"'dualarm' is missing{found}; begin the file with 'dualarm: {wanted}'"
    found_kind = data["dualarm"]
    if found_kind in ((kind,) if kind else KINDS):
        return None
    if found_kind in KINDS:
        message = (
            f"this is a {str(found_kind).split('/')[0]} file ({found_kind}); needed here: {kind}"
        )
    else:
        hint = suggest(str(found_kind), [kind] if kind else list(KINDS), "this version reads")
        message = f"unknown kind {quote(found_kind)}{hint}"
    return ("dualarm",), "E200", message


def validate(
    document: Document, model: type[M], findings: Findings, data: object = None, prefix: Loc = ()
) -> M | None:
    """Return the validated part of a document, or None after noting everything wrong with it.

    Args:
        document: the file.
        model: its schema.
        findings: where errors are noted.
        data: the part that is validated; None for the whole.
        prefix: where that part stands.
    """
    if data is None:
        name_entries(document, model, findings)
    try:
        return model.model_validate(document.data if data is None else data)
    except ValidationError as error:
        findings.extend(schema_diagnostics(document, model, error, prefix))
        return None
