"""A robot whose rows of joints can be named and broken at will."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from dualarm_cli.robot_import.importing import Imported, ImportRequest, import_robot

AXES = ("0 0 1", "0 1 0", "0 1 0", "0 0 1", "0 1 0", "0 0 1")
SHAPE = (
    '<collision><origin xyz="0 0 0.05"/><geometry><cylinder radius="0.03" length="0.1"/></geometry>'
    "</collision>"
)


def _row(prefix: str, y: float, mimic: str = "", shape: str = SHAPE) -> str:
    """Returns six joints and links, `{prefix}joint1` to `{prefix}l6`, at y [m]; the fourth joint may mimic another."""
    text, parent = "", "base"
    for k, axis in enumerate(AXES):
        xyz = f"0 {y} 0.2" if k == 0 else "0 0 0.3" if k in (2, 3) else "0 0 0.1"
        follows = f'<mimic joint="{mimic}"/>' if mimic and k == 3 else ""
        link = f"{prefix}l{k + 1}"
        text += (
            f'<joint name="{prefix}joint{k + 1}" type="revolute"><parent link="{parent}"/><child link="{link}"/>'
            f'<origin xyz="{xyz}"/><axis xyz="{axis}"/>'
            f'<limit lower="-2.9" upper="2.9" velocity="2" effort="1"/>{follows}</joint>'
            f'<link name="{link}">{shape}</link>\n'
        )
        parent = link
    return text


def _root(content: str) -> str:
    space = ' xmlns:xacro="http://www.ros.org/wiki/xacro"' if "xacro:" in content else ""
    return f'<robot name="odd"{space}>'


@pytest.fixture
def row() -> Callable[..., str]:
    """Makes six joints and links in a row, by prefix of their names and y."""
    return _row


@pytest.fixture
def write_rows(tmp_path: Path) -> Callable[..., Path]:
    """Writes robot.urdf with rows of joints, and what else it is to hold."""

    def write(*rows: str, more: str = "") -> Path:
        path = tmp_path / "robot.urdf"
        path.write_text(f'{_root("".join(rows))}<link name="base"/>{"".join(rows)}{more}</robot>')
        return path

    return write


@pytest.fixture
def import_with(tmp_path: Path) -> Callable[..., Imported]:
    """Imports a URDF with the content of an SRDF or a joint_limits.yaml."""

    def imported(urdf: Path, srdf: str = "", joint_limits: str = "", **more: object) -> Imported:
        files: dict[str, Path] = {}
        for key, name, text in (
            ("srdf", "robot.srdf", srdf),
            ("joint_limits", "joint_limits.yaml", joint_limits),
        ):
            if text:
                files[key] = tmp_path / name
                files[key].write_text(f"{_root(text)}{text}</robot>" if key == "srdf" else text)
        return import_robot(ImportRequest(urdf, **files, **more))  # type: ignore[arg-type]

    return imported
