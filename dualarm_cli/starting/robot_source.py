"""Robot of a new project: bundled, imported by `dualarm robot import`, or a URDF."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from dualarm_cli.errors import UsageError, did_you_mean
from dualarm_cli.files.cells.cells import load_cell
from dualarm_cli.files.robots.robots import load_robot
from dualarm_cli.files.source.bundled import CELL_FILE, ROBOT_FILE, bundled_robots
from dualarm_cli.files.source.documents import read_document
from dualarm_cli.files.source.projects import Project
from dualarm_cli.files.source.text_source import read_bytes, recorded_reads
from dualarm_cli.model.robot import Robot
from dualarm_cli.records import dataclass
from dualarm_cli.robot_import.importing import ImportRequest, import_robot


@dataclass(frozen=True)
class RobotSource:
    """Robot of a new project: its reference in the cell file, and its files."""

    reference: str
    """Value of `robot:` in a cell file, as text."""
    files: Mapping[str, bytes]
    """Content of the robot's files by their path in the project."""
    name: str
    """Name of the robot in messages."""
    reasons: tuple[str, ...] = ()
    """Decisions of the robot import."""

    @property
    def entry(self) -> str:
        """Entry `robot` of a cell file, a line per robot of a pair."""
        return f"robot: {self.reference}".replace(": \n", ":\n", 1)


def robot_path(robot: str) -> Path:
    """Convert `--robot` to a path, absolute for `./openarm`: a folder, not the bundled robot."""
    path = Path(robot)
    return path.absolute() if str(path) in bundled_robots() and str(path) != robot else path


def robot_source(request: ImportRequest) -> RobotSource:
    """Find the robot of a new project.

    Args:
        request: a URDF with the choices of its import; or a bundled robot's name, a folder or a robot file.

    Raises:
        InputError: its files are wrong.
        UsageError: there is no such robot, or its files are not all in one folder.
    """
    bundled = bundled_robots()
    path, name = request.urdf, str(request.urdf)
    if name not in bundled and path.is_file() and path.suffix not in (".yaml", ".yml"):
        return _imported(request)
    if (name in bundled or path.exists()) and request != ImportRequest(path):
        raise UsageError(
            f"--robot {name}: only a URDF or xacro file takes options of the import, such as --package-dir, "
            "--xacro-arg and --platform; leave them out"
        )
    if name in bundled:
        return RobotSource(name, {}, name)
    if path.is_dir():
        if (path / CELL_FILE).is_file():
            return _pair(path)
        return _robot_file(path / ROBOT_FILE)
    if path.suffix in (".yaml", ".yml") and path.is_file():
        return _pair(path.parent) if path.name == CELL_FILE else _robot_file(path)
    hint = did_you_mean(name, bundled)
    raise UsageError(
        f"--robot {name}: there is no such file or folder, and no bundled robot of that name{hint or ';'} bundled: "
        f"{', '.join(bundled)}"
    )


def _robot_file(path: Path) -> RobotSource:
    """Load a robot file with all files that it reads."""
    if not path.is_file():
        raise UsageError(
            f"--robot {path.parent}: holds neither {ROBOT_FILE} nor {CELL_FILE}; name a folder that `dualarm robot "
            "import` wrote, or a robot file"
        )
    with recorded_reads() as read:
        robot = load_robot(path).robot
    home = path.absolute().parent.name or "robot"
    files = {f"{home}/{name}": content for name, content in _copied(path, read, robot).items()}
    return RobotSource(json.dumps(f"{home}/{path.name}"), files, str(path))


def _pair(folder: Path) -> RobotSource:
    """Load the two robots of a cell file with all files that they read."""
    path = folder / CELL_FILE
    with recorded_reads() as read:
        robot = load_cell(path).cell.robot
    value = read_document(Project.of(path), path, str(path)).data["robot"]
    if not isinstance(value, dict):
        raise UsageError(f"--robot {folder}: {CELL_FILE} names one robot, {value}; name that one")
    files = _copied(path, read, robot)
    del files[CELL_FILE]
    lines = [f"\n  {side}: {_flow(member)}" for side, member in value.items()]
    return RobotSource("".join(lines), files, str(folder))


def _flow(value: Any) -> str:
    """Write a value as YAML on one line."""
    return yaml.safe_dump([value], default_flow_style=True, sort_keys=False, width=math.inf)[1:-2]


def _copied(path: Path, read: Mapping[str, str], robot: Robot) -> dict[str, bytes]:
    """Read recorded files and visual meshes, by their paths relative to the first file's folder.

    Visual meshes elsewhere are left out: links are then drawn as their collision shapes.

    Raises:
        UsageError: a file is outside that folder.
    """
    files = {}
    for name in read:
        inside = os.path.relpath(name, path.parent)
        if inside.startswith(".."):
            raise UsageError(
                f"--robot {path}: reads {name}, which is not in its folder; `dualarm robot import` writes a robot with "
                "all its files into one"
            )
        files[Path(inside).as_posix()] = read_bytes(Path(name), name)
    for mesh in robot.visuals:
        inside = os.path.relpath(mesh.file, path.parent)
        if mesh.file.is_file() and not inside.startswith(".."):
            files[Path(inside).as_posix()] = mesh.file.read_bytes()
    return files


def _imported(request: ImportRequest) -> RobotSource:
    """Import a robot from a URDF."""
    imported = import_robot(request)
    files = {f"{imported.folder}/{name}": content for name, content in imported.files.items()}
    return RobotSource(
        json.dumps(f"{imported.folder}/{ROBOT_FILE}"), files, str(request.urdf), imported.reasons
    )
