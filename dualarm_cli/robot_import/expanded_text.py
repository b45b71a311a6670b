"""Text of a URDF or SRDF, expanded by xacro if necessary, without ROS.

`$(find …)` leads to packages by the same search as `package://` in meshes.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

from dualarm_cli.errors import Diagnostic, InputError, MissingDependencyError, UsageError
from dualarm_cli.files.robots.packages import MANIFEST, PackageFinder
from dualarm_cli.files.robots.urdf_tree import parse_xml
from dualarm_cli.files.source.projects import MARKERS, BadReferenceError, Project
from dualarm_cli.files.source.text_source import TextSource, quote, read_text, suggest
from dualarm_cli.notes import Note, NoteTable
from dualarm_cli.records import dataclass
from dualarm_cli.robot_import.confined import (
    ConfinedError,
    Expansion,
    XacroInput,
    XacroRequest,
    expanded,
    landlock_version,
)
from dualarm_cli.system import IS_LINUX

_note = NoteTable(
    "program",
    confined="{path} is a program: xacro ran it confined to reading {folders:*, }",
    free="{path} is a program: xacro ran it able to read all your files, as this kernel has no Landlock: trust "
    "its author",
    defaults="{path}: arguments at their defaults: {values:*, }; `--xacro-arg NAME:=VALUE` changes them",
    variants="{path}: arguments with which more joints move: {values:*, }",
)


@dataclass(frozen=True)
class ExpandedText(TextSource):
    """Text expanded by xacro, with diagnostics that quote the element.

    The lines of the text differ from the file's.
    """

    path: Path = Path()
    """Xacro file."""
    given: XacroInput = XacroInput()
    """Arguments and packages given by the user."""
    expansion: Expansion = Expansion("", {}, frozenset(), {})
    """Result of xacro."""

    def diagnostic(self, line: int, column: int, code: str, message: str) -> Diagnostic:
        """Build a diagnostic that names the file and quotes the element."""
        rest = "\n".join([self.lines[line - 1][column - 1 :], *self.lines[line : line + 5]])
        element = re.match(r"<[^>]*>", rest)
        where = " ".join(element[0].split()) if element else self.snippet(line).strip()
        message = f"{message}; the element, as xacro expands it: {where}"
        return Diagnostic(self.name, 0, 0, code, message)


def parse_arguments(texts: Sequence[str], side: str = "") -> dict[str, str]:
    """Parse values of xacro arguments, `NAME:=VALUE` or for one of two robots `SIDE:NAME:=VALUE`.

    Args:
        texts: values of `--xacro-arg`.
        side: robot of a pair whose arguments are selected; "" for a single robot.

    Raises:
        UsageError: a text has another form.
    """
    arguments = {}
    for text in texts:
        name, assigned, value = text.partition(":=")
        prefix, _, rest = name.rpartition(":")
        if not assigned or not rest or prefix not in ("", *(("left", "right") if side else ())):
            allowed = (
                "NAME:=VALUE, left:NAME:=VALUE or right:NAME:=VALUE" if side else "NAME:=VALUE"
            )
            raise UsageError(f"--xacro-arg {text}: must be {allowed}")
        if prefix in ("", side):
            arguments[rest] = value
    return arguments


def check_arguments(given: Mapping[str, str], *sources: TextSource) -> None:
    """Check that xacro files have all the given arguments.

    Args:
        given: values by name.
        sources: texts of URDF and SRDF.

    Raises:
        UsageError: none has an argument of that name.
    """
    files = [source for source in sources if isinstance(source, ExpandedText)]
    names = sorted(n for source in files for n in source.expansion.arguments - given.keys())
    for name in given:
        if not files:
            raise UsageError(f"--xacro-arg {name}: {sources[0].name} is not a xacro file")
        if not any(name in source.expansion.arguments for source in files):
            raise UsageError(
                f"--xacro-arg {name}: {files[0].name} has no such argument{suggest(name, names)}"
            )


def read_expanded(path: Path, given: XacroInput = XacroInput()) -> TextSource:  # noqa: B008  frozen
    """Read the text of a URDF or SRDF, expanded if xacro.

    Args:
        path: the file.
        given: arguments and packages.

    Raises:
        InputError: it cannot be read, is not XML, or xacro cannot expand it with its rights.
        MissingDependencyError: it is a xacro file, and xacro is not installed.
    """
    source = read_text(path, str(path))
    if not any(child.tag.startswith("xacro:") for child in parse_xml(source).children):
        return source
    if find_spec("xacro") is None:
        raise MissingDependencyError("xacro", "xacro")
    if not IS_LINUX:
        message = (
            "is a xacro file, which only Linux expands safely; give the URDF that xacro writes"
        )
        raise InputError([Diagnostic(str(path), 0, 0, "E400", message)])
    expansion = _expanded_with_packages(path, given)
    return ExpandedText(str(path), expansion.text, source.sha256, path, given, expansion)


def program_notes(source: TextSource) -> tuple[Note, ...]:
    """List notes on an expanded text; empty for a plain one."""
    if not isinstance(source, ExpandedText):
        return ()
    root, path, expansion = _root(source.path), source.path, source.expansion
    folders = {Path(os.path.realpath(folder)): folder for folder in expansion.packages.values()}
    beyond = [folder for real, folder in folders.items() if not real.is_relative_to(root)]
    confined = landlock_version() > 0
    notes = [_note("confined" if confined else "free", path=path, folders=[root, *beyond])]
    if expansion.defaults:
        notes.append(_note("defaults", path=path, values=_shown(expansion.defaults)))
    return tuple(notes)


def variant_notes(source: TextSource) -> tuple[Note, ...]:
    """Note boolean arguments of a xacro file that add moving joints.

    They are those that are true or false by default.
    """
    if not isinstance(source, ExpandedText):
        return ()
    opposite = {"true": "false", "false": "true"}
    defaults = source.expansion.defaults
    switches = {n: opposite[v.lower()] for n, v in defaults.items() if v.lower() in opposite}
    given = source.given.arguments
    trials = [given, *({**given, name: value} for name, value in switches.items())]
    try:
        now, *counts = _expanded_with_packages(source.path, source.given, trials).joints
    except (InputError, ValueError):  # a limit of the process, or a program's own answer
        return ()
    values = [
        f"{name}:={value} ({count - now} more)"
        for (name, value), count in zip(switches.items(), counts, strict=False)
        if count > now
    ]
    return (_note("variants", path=source.path, values=values),) if values else ()


def _expanded_with_packages(
    path: Path, given: XacroInput, trials: Sequence[Mapping[str, str]] = ()
) -> Expansion:
    """Expand a xacro file, again for each package that it needs.

    Raises:
        InputError: xacro cannot expand it.
    """
    file, root = Path(os.path.realpath(path)), _root(path)
    finder = PackageFinder(Project.of(file), file, given.packages, beyond=True)
    request = XacroRequest(file, root, given, trials=trials)
    while True:
        try:
            return expanded(request)
        except ConfinedError as error:
            message, needed = str(error), error.package
            if needed and needed not in request.packages:
                try:
                    packages = {**request.packages, needed: finder.package(needed, root)}
                    request = replace(request, packages=packages)
                    continue
                except BadReferenceError as missing:
                    message = str(missing)
            elif "ermission denied" in str(error):
                message += (
                    f"; it may read {root} and ROS packages; name other folders with --package-dir"
                )
            if error.defaults:
                values = ", ".join(_shown(error.defaults))
                message += f"; arguments at their defaults, which --xacro-arg NAME:=VALUE changes: {values}"
            message = f"xacro cannot expand it: {message}"
            raise InputError([Diagnostic(str(path), 0, 0, "E400", message)]) from None


def _shown(arguments: Mapping[str, str]) -> list[str]:
    """Format arguments with their values for messages."""
    return [f"{quote(name)[1:-1]} {quote(value)}" for name, value in sorted(arguments.items())]


def _root(path: Path) -> Path:
    """Find a xacro file's readable folder: its package, project or folder."""
    file = Path(os.path.realpath(path))
    marks = (MANIFEST, *MARKERS)
    return next((f for f in file.parents if any((f / m).exists() for m in marks)), file.parent)
