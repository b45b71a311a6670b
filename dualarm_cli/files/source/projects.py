"""Project: the folder that contains a job's files, and a record of the files read."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dualarm_cli.errors import Diagnostic, InputError
from dualarm_cli.files.source.bundled import robots_folder
from dualarm_cli.files.source.overrides import Overrides
from dualarm_cli.files.source.text_source import TextSource, quote, read_text, text_source
from dualarm_cli.records import dataclass

if TYPE_CHECKING:
    from dualarm_cli.files.source.diagnostics import Findings
    from dualarm_cli.files.source.yaml_source import Document, Loc

MARKERS = ("dualarm.toml", ".git")
"""Names of the marker files of a project's top folder."""


class BadReferenceError(ValueError):
    """A path in a file that may not be followed; its text is the whole message."""


@dataclass
class Project:
    """A project folder, and the files read from it."""

    folder: Path
    """Resolved folder that relative paths must not leave."""
    label: str = ""
    """Prefix of file names within it, such as `robots` for the bundled ones."""
    inputs: dict[str, str] = field(default_factory=dict)
    """SHA-256 of every file read, by its name within the project."""
    overrides: Overrides = field(default_factory=Overrides)
    """Replacements for values of the files."""
    given: dict[Path, str] = field(default_factory=dict)
    """Texts of files that exist in memory only, by path."""

    @classmethod
    def of(cls, path: Path) -> Project:
        """Find the project of a file: its nearest marked ancestor, else its parent's parent.

        Args:
            path: a task, cell or robot file; it need not exist.

        Raises:
            InputError: no file can have that name.
        """
        try:
            resolved = Path(os.path.realpath(path))
        except ValueError:
            message = f"{quote(str(path))} is not the name of a file"
            raise InputError([Diagnostic(quote(str(path)), 0, 0, "E500", message)]) from None
        for folder in resolved.parents:
            if any((folder / marker).exists() for marker in MARKERS):
                return cls(folder)
        return cls(resolved.parent.parent)

    @classmethod
    def in_memory(cls, values: Mapping[str, Any], role: str) -> tuple[Project, Path]:
        """Write values as texts of unstored files in the working directory.

        Args:
            values: content of a task file, whose `cell` may be the content of a cell file, or of a study file.
            role: name of the file: tasks or study.

        Returns:
            The project, and the path of the file in it.

        Raises:
            InputError: values that files cannot hold.
        """
        path = Path.cwd() / role
        project, cell = cls.of(path), values.get("cell")
        if isinstance(cell, Mapping):
            project.given[path.with_name("cell")] = _json(cell, "cell")
            values = {**values, "cell": "cell"}
        project.given[path] = _json(values, role)
        return project, path

    def bundled(self) -> Project:
        """Return the bundled robots as a project that shares this record."""
        return Project(
            Path(os.path.realpath(robots_folder())), "robots", self.inputs, self.overrides
        )

    def name_of(self, path: Path) -> str:
        """Return a file's name within the project, with forward slashes."""
        resolved = Path(os.path.realpath(path))
        if not resolved.is_relative_to(self.folder):
            return resolved.name
        inside = resolved.relative_to(self.folder).as_posix()
        return f"{self.label}/{inside}" if self.label else inside

    def read(self, path: Path, name: str) -> TextSource:
        """Read the text of a file and record its hash.

        Args:
            path: file to read.
            name: what the user calls it.

        Raises:
            InputError: it cannot be read.
        """
        text = self.given.get(path)
        source = read_text(path, name) if text is None else text_source(text, name)
        self.inputs[self.name_of(path)] = source.sha256
        return source

    def follow(self, reference: str, holder: Path) -> Path:
        """Resolve a relative path in another file.

        Args:
            reference: the path as written.
            holder: the file that holds it.

        Raises:
            BadReferenceError: it is absolute, a URL, leads out of the project, or is no file.
        """
        if "://" in reference or reference.startswith(("/", "~")) or "\\" in reference:
            raise BadReferenceError(
                f"{quote(reference)} must be a relative path with forward slashes"
            )
        if not reference.strip() or "\0" in reference:
            raise BadReferenceError(f"{quote(reference)} is not the path of a file")
        path = holder.parent / reference
        if not Path(os.path.realpath(path)).is_relative_to(self.folder):
            raise BadReferenceError(
                f"{quote(reference)} leaves the project folder "
                f"{quote(self.folder.name or '/')}; keep the file inside it, or put a dualarm.toml "
                "into the folder that holds both"
            )
        if path not in self.given:
            _existing(path, reference)
        return path


def _json(values: Mapping[str, Any], name: str) -> str:
    """Write values as JSON, which is YAML; arrays become lists."""

    def listed(value: Any) -> Any:
        if hasattr(value, "tolist"):
            return value.tolist()
        raise TypeError(f"{quote(value)} is neither a number, text, list nor mapping")

    try:
        return json.dumps(values, indent=2, default=listed, ensure_ascii=False, allow_nan=False)
    except (TypeError, ValueError, RecursionError) as error:
        message = f"cannot be read: {error}"
        raise InputError([Diagnostic(name, 0, 0, "E200", message)]) from None


@contextmanager
def noted(findings: Findings, document: Document, loc: Loc) -> Iterator[None]:
    """Note faults of a referenced file instead of raising them.

    Args:
        findings: takes them.
        document: refers to the file.
        loc: place of the reference.
    """
    try:
        yield
    except BadReferenceError as error:
        findings.add(document, loc, str(error), "E500")
    except InputError as error:
        findings.extend(error.diagnostics)


def _existing(path: Path, reference: str) -> None:
    try:
        exists = path.exists()
    except OSError as error:
        raise BadReferenceError(f"{quote(reference)}: {error.strerror}") from None
    if exists and path.is_dir():
        raise BadReferenceError(f"{quote(reference)} is a directory; name a file in it")
    if not exists:
        raise BadReferenceError(f"there is no file {quote(reference)} here")


def display_name(reference: str, holder_name: str) -> str:
    """Name in messages of a file that another file refers to."""
    return os.path.normpath(Path(holder_name).parent / reference)
