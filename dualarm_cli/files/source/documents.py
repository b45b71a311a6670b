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
"""Supported kinds of files."""

M = TypeVar("M", bound=BaseModel)


def read_document(
    project: Project, path: Path, name: str, kind: str | None = None, role: str | None = None
) -> Document:
    """Read the document in a file and check its kind.

    Args:
        project: where the reading is recorded.
        path: the file.
        name: what the user calls it.
        kind: required kind, such as `cell/1`; None for any kind that this version reads.
        role: role in the job, such as `robot.left`; None for the default of its kind.

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
    """Describe a wrong kind of file by place, code and message."""
    wanted = kind or "tasks/1"
    if not isinstance(data, dict):
        return (
            (),
            "E200",
            f"must be a mapping that begins with 'dualarm: {wanted}', not {quote(data)}",
        )
    if "dualarm" not in data:
        close = [key for key in data if did_you_mean(key, ["dualarm"])]
        near_miss = f" (there is {quote(close[0])})" if close else ""
        return (
            (),
            "E202",
            f"'dualarm' is missing{near_miss}; begin the file with 'dualarm: {wanted}'",
        )
    actual = data["dualarm"]
    if actual in ((kind,) if kind else KINDS):
        return None
    if actual in KINDS:
        message = f"this is a {str(actual).split('/')[0]} file ({actual}); required here: {kind}"
    else:
        hint = suggest(str(actual), [kind] if kind else list(KINDS), "this version reads")
        message = f"unknown kind {quote(actual)}{hint}"
    return ("dualarm",), "E200", message


def validate(
    document: Document, model: type[M], findings: Findings, data: object = None, prefix: Loc = ()
) -> M | None:
    """Validate a part of a document, or return None after noting errors.

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
