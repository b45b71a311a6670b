"""The text of a URDF or SRDF: as it is, or as xacro expands it."""

from __future__ import annotations

import os
import re
from importlib.util import find_spec
from pathlib import Path

from dualarm_cli.errors import Diagnostic, InputError, MissingDependencyError
from dualarm_cli.files.robots.packages import ros_folders
from dualarm_cli.files.robots.urdf_tree import parse_xml
from dualarm_cli.files.source.projects import MARKERS
from dualarm_cli.files.source.text_source import TextSource, read_text
from dualarm_cli.records import dataclass
from dualarm_cli.robot_import.confined import ConfinedError, expanded


@dataclass(frozen=True)
class ExpandedText(TextSource):
    """The text that xacro makes of a file: its lines are none of that file, so elements tell the place."""

    note: str = ""
    """Note on how it was made."""

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
        InputError: it cannot be read, is not XML, or xacro cannot expand it with the rights that it has.
        MissingDependencyError: it is a xacro file, and xacro is not installed.
    """
    source = read_text(path, str(path))
    if not any(child.tag.startswith("xacro:") for child in parse_xml(source).children):
        return source
    if find_spec("xacro") is None:
        raise MissingDependencyError("xacro", "xacro")
    file = Path(os.path.realpath(path))
    folders = _readable(file)
    try:
        text, confined = expanded(file, folders)
    except ConfinedError as error:
        advice = ""
        if "ermission denied" in str(error):
            advice = f"; it may read {folders[0]} and the packages of ROS_PACKAGE_PATH and AMENT_PREFIX_PATH"
        message = f"xacro cannot expand it: {error}{advice}"
        raise InputError([Diagnostic(str(path), 0, 0, "E400", message)]) from None
    how = f"confined to reading {folders[0]}"
    if not confined:
        how = "able to read all your files, as this kernel has no Landlock: trust its author"
    return ExpandedText(str(path), text, source.sha256, f"{path} is a program: xacro ran it {how}")


def program_notes(source: TextSource) -> tuple[str, ...]:
    """List notes on an expanded text; empty for a plain one."""
    return (source.note,) if isinstance(source, ExpandedText) else ()


def _readable(file: Path) -> list[Path]:
    """List the folders that a xacro file may read."""
    marks = ("package.xml", *MARKERS)
    own = next((f for f in file.parents if any((f / mark).exists() for mark in marks)), file.parent)
    ros = ros_folders(os.environ)
    # Installed packages may be links to their sources, beside the folder `install` of the workspace.
    spaces = [
        Path(str(folder).partition("/install/")[0]) for folder in ros if "/install/" in str(folder)
    ]
    return [own, *ros, *spaces]
