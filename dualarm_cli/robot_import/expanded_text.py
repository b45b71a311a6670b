"""The text of a URDF or SRDF: as it is, or as xacro expands it."""

from __future__ import annotations

import re
from pathlib import Path

from dualarm_cli.errors import Diagnostic, InputError, MissingDependencyError
from dualarm_cli.files.robots.urdf_tree import parse_xml
from dualarm_cli.files.source.text_source import TextSource, read_text


class ExpandedText(TextSource):
    """The text that xacro makes of a file: its lines are none of that file, so elements tell the place."""

    def diagnostic(self, line: int, column: int, code: str, message: str) -> Diagnostic:
        """Returns a diagnostic that names the file and shows the element that is meant."""
        rest = "\n".join([self.lines[line - 1][column - 1 :], *self.lines[line : line + 5]])
        element = re.match(r"<[^>]*>", rest)
        where = " ".join(element[0].split()) if element else self.snippet(line).strip()
        message = f"{message}; the element, as xacro expands it: {where}"
        return Diagnostic(self.name, 0, 0, code, message)


def read_expanded(path: Path) -> TextSource:
    """Returns the text of a URDF or SRDF, expanded where it is a xacro file.

    Args:
        path: the file.

    Raises:
        InputError: it cannot be read, is not XML, or xacro cannot expand it.
        MissingDependencyError: it is a xacro file, and xacro is not installed.
    """
    source = read_text(path, str(path))
    if not any(child.tag.startswith("xacro:") for child in parse_xml(source).children):
        return source
    try:
        import xacro
    except ImportError:
        raise MissingDependencyError("xacro", "xacro") from None
    try:
        text = xacro.process_file(str(path)).toxml()
    except Exception as error:  # whatever its macros raise
        message = f"xacro cannot expand it: {error}"
        raise InputError([Diagnostic(str(path), 0, 0, "E400", message)]) from None
    return ExpandedText(str(path), text, source.sha256)
