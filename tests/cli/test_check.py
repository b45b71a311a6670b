from __future__ import annotations

import json
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from dualarm_cli.cli.check import check_command

URDF = """<robot name="one"><link name="a"/><link name="b"/>
<joint name="j" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" velocity="1"/></joint></robot>
"""
ROBOT = """dualarm: robot/1
name: One
urdf: one.urdf
arms: {left: {joints: [j], flange: b, kind: general}}
limits: {j: {acceleration: 1, source: assumed}}
"""
CELL = "dualarm: cell/1\nrobot: robot.yaml\n"
TASKS = """dualarm: tasks/1
cell: cell.yaml
tasks:
  - {id: a, arm: left, pick: {xyz: [1, 0, 0]}, place: {xyz: [0, 1, 0]}}
  - {id: b, arm: left, move: {joints: [0.5]}}
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A robot of one joint, a cell and two tasks, in the working directory."""
    files = {"one.urdf": URDF, "robot.yaml": ROBOT, "cell.yaml": CELL, "tasks.yaml": TASKS}
    for name, text in {**files, "dualarm.toml": ""}.items():
        (tmp_path / name).write_text(text)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(*arguments: str, charset: str = "utf-8") -> tuple[int, str]:
    """Runs the command and returns its exit code and stdout."""
    app = typer.Typer()
    app.command()(check_command)
    result = CliRunner(charset=charset).invoke(app, list(arguments))
    return result.exit_code, result.stdout


def test_good_files_get_one_line_each(folder: Path) -> None:
    """Kind and counts: two tasks, three targets, so three stages of the only arm."""
    assert run("robot.yaml", "cell.yaml", "tasks.yaml") == (
        0,
        "robot.yaml: good: robot, One, 1 arm, 1 joint, 1 posture\n"
        "cell.yaml: good: cell, One, 0 frames, 0 obstacles\n"
        "tasks.yaml: good: tasks, 2 tasks, 3 targets, 3 stages\n"
        "note: left arm has no tool: targets are for its flange, link b; `tools: {left: …}` in the cell file "
        "describes one\n"
        "note: clearance is 0 mm: bodies may touch; `clearance: 10 mm` in the cell file keeps them apart\n",
    )
    (folder / "cell.yaml").write_text(
        f"{CELL}clearance: 5 mm\ntools: {{left: {{tcp: {{xyz: [0, 0, 0.1]}}}}}}\n"
    )
    assert run("tasks.yaml")[1].count("\n") == 1


def test_quiet_prints_errors_only(folder: Path) -> None:
    """Nothing for good files."""
    assert run("--quiet", "robot.yaml") == (0, "")


def test_errors_are_the_result_and_the_exit_code_is_2(folder: Path) -> None:
    """On stdout with the source line; good files are still named."""
    (folder / "tasks.yaml").write_text(TASKS.replace("arm: left, move", "arm: lefft, move"))
    assert run("tasks.yaml", "cell.yaml") == (
        2,
        "error[E200]: tasks.yaml:5:18: 'lefft' is not allowed, did you mean 'left'? "
        "Allowed: left, right, any\n"
        "  5 |   - {id: b, arm: lefft, move: {joints: [0.5]}}\n"
        "    |                  ^\n"
        "cell.yaml: good: cell, One, 0 frames, 0 obstacles\n",
    )


def test_an_error_in_a_shared_file_is_shown_once(folder: Path) -> None:
    """Two files that stand on the same broken URDF."""
    (folder / "one.urdf").write_text("")
    assert run("tasks.yaml", "cell.yaml") == (
        2,
        "error[E400]: one.urdf: is empty; a URDF is required\n",
    )


def test_json_is_one_document(folder: Path) -> None:
    """With every diagnostic by file, line, column and code, and names that any reader can take."""
    (folder / "cell.yaml").write_text(CELL + "claerance: 1\n")
    code, text = run("--json", "cell.yaml", "robot.yaml")
    document = json.loads(text)
    assert code == 2
    assert (document["format"], document["passed"]) == ("dualarm.check/1", False)
    assert document["files"][0]["diagnostics"] == [
        {
            "file": "cell.yaml",
            "line": 3,
            "column": 1,
            "code": "E201",
            "message": "unknown key 'claerance', did you mean 'clearance'? Allowed: dualarm, "
            "robot, base, tools, frames, obstacles, clearance, clearances, allowed_contacts, parts, limits, "
            "torque, conveyors, tool_changes",
        }
    ]
    assert document["files"][1] == {
        "file": "robot.yaml",
        "kind": "robot",
        "summary": "One, 1 arm, 1 joint, 1 posture",
        "diagnostics": [],
        "notes": [],
    }
    _, text = run("--json", "robot.yaml", "tasks.yaml")
    assert json.loads(text)["files"][1]["notes"] == []  # a cell that is wrong has errors only


def test_a_joint_beyond_its_limits_is_there_as_data(folder: Path) -> None:
    """2 rad where the URDF has -1 to 1."""
    (folder / "tasks.yaml").write_text(TASKS.replace("joints: [0.5]", "joints: [2.0]"))
    [row] = json.loads(run("--json", "tasks.yaml")[1])["files"][0]["diagnostics"]
    assert [row.get(key) for key in ("joint", "value", "allowed")] == ["j", 2.0, [-1.0, 1.0]]


def test_a_terminal_that_knows_ascii_only_gets_escapes(folder: Path) -> None:
    """No crash where the message or the name of a thing has other letters."""
    (folder / "robot.yaml").write_text(ROBOT.replace("name: One", "name: Ünö"))
    code, text = run("robot.yaml", charset="ascii")
    assert (code, text) == (0, "robot.yaml: good: robot, \\xdcn\\xf6, 1 arm, 1 joint, 1 posture\n")
