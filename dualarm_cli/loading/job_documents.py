"""The documents that a job is read from, unchecked: what a study's paths lead into."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from dualarm_cli.errors import InputError
from dualarm_cli.loading.documents import read_document
from dualarm_cli.loading.projects import BadReferenceError, Project, display_name
from dualarm_cli.loading.robots import find_robot
from dualarm_cli.loading.yaml_source import Document


def job_documents(project: Project, path: Path, name: str) -> dict[str, Document]:
    """Returns the documents of a job by their roles; without those that cannot be read.

    Args:
        project: where the reading is recorded.
        path: the task file.
        name: what the user calls it.

    Raises:
        InputError: the task file cannot be read.
    """
    tasks = read_document(project, path, name, "tasks/1")
    found = {"tasks": tasks}
    try:
        reference = _text(tasks.data.get("cell"))
        cell_path = project.follow(reference, path)
        cell_name = display_name(reference, name)
        found["cell"] = cell = read_document(project, cell_path, cell_name, "cell/1")
    except (BadReferenceError, InputError):
        return found
    robot = cell.data.get("robot")
    if not isinstance(robot, dict):
        _add_robot(found, "robot", robot, project, cell_path, cell_name)
        return found
    for side in ("left", "right"):
        member = robot.get(side)
        if not isinstance(member, dict):
            continue
        _add_robot(found, f"robot.{side}", member.get("robot"), project, cell_path, cell_name)
        if isinstance(member.get("base"), str):
            _add_base(found, f"base.{side}", member["base"], project, cell_path, cell_name)
    return found


def _add_robot(
    found: dict[str, Document], role: str, value: Any, project: Project, cell: Path, name: str
) -> None:
    try:
        place = find_robot(project, _text(value), cell, name)
        found[role] = read_document(place.project, place.path, place.name, "robot/1", role)
    except (BadReferenceError, InputError):
        return


def _add_base(
    found: dict[str, Document], role: str, value: str, project: Project, cell: Path, name: str
) -> None:
    try:
        path = project.follow(value, cell)
        found[role] = read_document(project, path, display_name(value, name), "base/1", role)
    except (BadReferenceError, InputError):
        return


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise BadReferenceError("not the name of a file")
    return value
