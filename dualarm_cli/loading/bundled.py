"""Bundled robots: where they are, in an installed package and in a source tree."""

from __future__ import annotations

from functools import cache
from pathlib import Path

ROBOT_FILE = "robot.yaml"
"""Name of the robot file in each robot's folder."""


@cache
def robots_folder() -> Path:
    """Returns the folder with one folder per bundled robot.

    A wheel carries it inside the package; a source tree has it beside the package.
    """
    package = Path(__file__).resolve().parent.parent
    installed = package / "bundled" / "robots"
    return installed if installed.is_dir() else package.parent / "robots"


def bundled_robots() -> list[str]:
    """Returns the names of the bundled robots, sorted."""
    folder = robots_folder()
    if not folder.is_dir():
        return []
    return sorted(entry.name for entry in folder.iterdir() if (entry / ROBOT_FILE).is_file())
