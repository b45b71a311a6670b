"""A tiny project: a robot of two arms with two joints each on a platform, a cell, a task file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from dualarm_cli.errors import InputError

ROBOT = """\
dualarm: robot/1
name: Tiny
urdf: tiny.urdf
platform: [turn]
arms:
  left:  {joints: [l1, l2], flange: l_tool, kind: general}
  right: {joints: [r1, r2], flange: r_tool, kind: general}
limits:
  turn: {acceleration: 5, jerk: 50, source: assumed}
  l1: {acceleration: 10, jerk: none, source: datasheet}
  l2: {acceleration: 10, jerk: 100, source: measured}
  r1: {acceleration: 10, jerk: none, source: datasheet}
  r2: {acceleration: 10, jerk: none, source: datasheet}
postures: {bent: {l1: 90 deg, r1: -1.5}}
"""
CELL = """\
dualarm: cell/1
robot: robot.yaml
tools:
  left: {tcp: {xyz: [0, 0, 120 mm]}, mass: 800 g}
frames:
  bin: {xyz: [0.4, 0.1, 0.7], rpy: [0, 0, 90 deg]}
  bin.slot: {in: bin, xyz: [0.1, 0, 0]}
obstacles:
  table: {box: [1, 2, 40 mm], xyz: [0.5, 0, 0.6]}
clearance: 10 mm
"""
TASKS = """\
dualarm: tasks/1
cell: cell.yaml
mode: paired
order: given
start: bent
defaults: {approach: 80 mm, retract: 60 mm, dwell: {gripper: 0.12 s, settle: 30 ms}}
tasks:
  - id: a
    arm: left
    pick: {at: bin.slot, xyz: [0, 0, 50 mm], rpy: [180 deg, 0, 0], free: yaw}
    place: {xyz: [0.2, 0.5, 0.8], symmetry: 2}
  - id: b
    arm: right
    move: {joints: [0.5, -90 deg]}
"""


def _joint(name: str, parent: str, child: str, kind: str = "revolute") -> str:
    return (
        f'<joint name="{name}" type="{kind}"><origin xyz="0.1 0 0.2"/><parent link="{parent}"/>'
        f'<child link="{child}"/><axis xyz="0 0 2"/>'
        '<limit lower="-3" upper="3" velocity="2" effort="1"/></joint>\n'
    )


URDF = (
    '<?xml version="1.0"?>\n<robot name="tiny">\n'
    + "".join(
        f'<link name="{n}"/>\n' for n in ("base", "top", "la", "lb", "l_tool", "ra", "rb", "r_tool")
    )
    + _joint("turn", "base", "top")
    + _joint("l1", "top", "la")
    + _joint("l2", "la", "lb")
    + _joint("lf", "lb", "l_tool", "fixed")
    + _joint("r1", "top", "ra")
    + _joint("r2", "ra", "rb")
    + _joint("rf", "rb", "r_tool", "fixed")
    + "</robot>\n"
)


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The tiny project's folder, which is also the working directory."""
    (tmp_path / "dualarm.toml").write_text("")
    (tmp_path / "robot.yaml").write_text(ROBOT)
    (tmp_path / "tiny.urdf").write_text(URDF)
    (tmp_path / "cell.yaml").write_text(CELL)
    (tmp_path / "tasks.yaml").write_text(TASKS)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def change(project: Path) -> Callable[..., None]:
    """Replaces text in a file of the tiny project; the text must be there."""

    def apply(file: str, *pairs: str) -> None:
        text = (project / file).read_text()
        for old, new in zip(pairs[::2], pairs[1::2], strict=True):
            assert old in text, old
            text = text.replace(old, new, 1)
        (project / file).write_text(text)

    return apply


@pytest.fixture
def messages() -> Callable[[Callable[[], object]], list[str]]:
    """Runs a loader that must refuse and returns its diagnostics as text."""

    def run(load: Callable[[], object]) -> list[str]:
        with pytest.raises(InputError) as caught:
            load()
        assert caught.value.exit_code == 2
        return [str(diagnostic) for diagnostic in caught.value.diagnostics]

    return run
