"""`dualarm init`: every bundled robot gets targets that it reaches; nothing is overwritten or half-written."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yaml
from jsonschema import Draft202012Validator

from dualarm_cli.cli.run import run
from dualarm_cli.files.cells.cells import load_cell
from dualarm_cli.files.source.bundled import bundled_robots, robots_folder
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.kinematics.general_arm import GeneralArm
from dualarm_cli.model.cell import Cell, Tool
from dualarm_cli.model.robot import Arm, JointLimits, Robot
from dualarm_cli.robot_import.importing import ImportRequest
from dualarm_cli.starting.layout import LAYOUT
from dualarm_cli.starting.robot_source import robot_path, robot_source
from dualarm_cli.starting.table import room_for_table
from tests.checked_files import check_file

ROOT = Path(__file__).parents[2]
FILES = {
    "cell.yaml",
    "tasks.yaml",
    "study.yaml",
    "requirements.txt",
    ".github/workflows/score.yaml",
    ".dualarm/cell.schema.json",
    ".dualarm/tasks.schema.json",
    ".dualarm/study.schema.json",
}
QUICK = "iiwa7"
"""The robot that is planned quickest."""
FEW = (QUICK, "sda10f", "yumi")
"""One of one arm, one with a platform, one without closed forms."""


@pytest.fixture(autouse=True)
def own_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def content(folder):
    """Returns the bytes of all files of a folder."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in Path(folder).rglob("*")
        if path.is_file()
    }


def reaches_with_tool_down(job, task, stop):
    """Returns whether an arm reaches a target with the platform at home; from many starts, over eight turns."""
    model = CellModel.from_cell(job.cell, numeric=True)
    arm = model.arms[task.arm]
    assert isinstance(arm.kinematics, GeneralArm)
    home = job.cell.robot.postures["home"]
    R_world, p_world = model.platform.pose(home[model.platform_columns])
    turns = [np.eye(3)]
    for angle in np.radians(np.arange(45.0, 360.0, 45.0)):
        c, s = np.cos(angle), np.sin(angle)
        turns.append(np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]))
    T = arm.T_flange_tcp.inverse()
    R = R_world.T @ stop.target.pose.rotation @ np.array(turns)
    p = R_world.T @ (stop.target.pose.translation - p_world) + R @ T.translation
    return bool((arm.kinematics.postures(R @ T.rotation, p).miss == 0.0).all(axis=1).any())


@pytest.mark.parametrize(
    "robot",
    [
        pytest.param(name, marks=[] if name in FEW else pytest.mark.slow)
        for name in bundled_robots()
    ],
)
def test_every_bundled_robot_gets_a_project(robot):
    """Its files are valid; six picks at targets that inverse kinematics reaches, all on the table and apart."""
    assert run(["init", "demo", "--robot", robot]) == 0
    assert set(content("demo")) == FILES
    for name in ("cell.yaml", "tasks.yaml", "study.yaml"):
        assert check_file(Path("demo") / name) == []
    job = load_job(Path("demo/tasks.yaml"))
    assert len(job.tasks) == 6
    [table] = job.cell.obstacles
    points = []
    for task in job.tasks:
        for stop in task.stops:
            at = stop.target.pose.translation
            points.append(at)
            below = at - table.shape.pose.translation
            assert np.abs(below[:2]).max() < 0.5 * max(table.shape.size[:2])
            assert (np.abs(below[:2]) < 0.5 * np.array(table.shape.size[:2])).all()
            assert below[2] > 0.5 * table.shape.size[2]
            assert reaches_with_tool_down(job, task, stop), (task.id, stop.action)
    distance = np.linalg.norm(np.array(points)[:, None] - np.array(points)[None], axis=-1)
    assert distance[np.triu_indices(len(points), 1)].min() > 0.009


def test_comments_of_a_cell_file_are_valid_keys():
    """The part at its end, without the marks of comments."""
    assert run(["init", "demo", "--robot", QUICK]) == 0
    file = Path("demo/cell.yaml")
    lines = file.read_text().splitlines()
    first = next(k for k, line in enumerate(lines) if line.startswith("# parts:"))
    file.write_text("\n".join([*lines[:first], *(line[2:] for line in lines[first:])]) + "\n")
    assert check_file(file) == []
    cell = load_cell(file).cell
    assert cell.width("cup") == 0.04 and set(cell.grasps["cup"]) == {"top"}
    assert cell.care["cup"].tilt == pytest.approx(np.radians(15.0))


def test_a_project_plans_at_once(capsys):
    """In an empty folder: two commands, a verified plan; the last lines of the first name the second."""
    assert run(["init", "demo", "--robot", QUICK]) == 0
    said = capsys.readouterr().err
    assert "dualarm plan demo/tasks.yaml" in said.splitlines()[-3]
    assert run(["plan", "demo/tasks.yaml"]) == 0
    assert "verification: passed" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize("robot", bundled_robots())
def test_every_project_plans_at_once(robot, capsys):
    """The same for all bundled robots."""
    assert run(["init", "demo", "--robot", robot]) == 0
    assert run(["plan", "demo/tasks.yaml"]) == 0
    out = capsys.readouterr().out
    assert "verification: passed" in out
    assert "could not be checked" not in out


@pytest.mark.usefixtures("unplanned")
def test_the_same_robot_gets_the_same_bytes():
    """Whatever the folder is called, new or empty."""
    Path("two").mkdir()
    for name in ("one", "two"):
        assert run(["init", name, "--robot", QUICK]) == 0
    assert content("one") == content("two")


@pytest.mark.parametrize("robot", ["./openarm", "openarm/", "openarm"])
def test_a_folder_may_have_the_name_of_a_bundled_robot(robot):
    """`./openarm` is the folder, here with another robot; the bare name is the bundled robot."""
    shutil.copytree(robots_folder() / QUICK, "openarm")
    source = robot_source(ImportRequest(robot_path(robot)))
    assert source.reference == ("openarm" if robot == "openarm" else '"openarm/robot.yaml"')
    assert bool(source.files) is (robot != "openarm")


def test_a_folder_that_is_used_is_refused(capsys):
    """Exit code 2; what is there stays as it is, and nothing is left beside it."""
    Path("demo").mkdir()
    Path("demo/notes.txt").write_text("mine")
    assert run(["init", "demo"]) == 2
    assert "demo: is not empty; name a new folder" in capsys.readouterr().err
    Path("file").write_text("mine")
    assert run(["init", "file"]) == 2
    assert content(".") == {"demo/notes.txt": b"mine", "file": b"mine"}


def test_an_unknown_robot_is_refused(capsys):
    """With the closest name; nothing is written."""
    assert run(["init", "demo", "--robot", "yuni"]) == 2
    assert "did you mean" in (text := capsys.readouterr().err)
    assert "yumi" in text
    assert not Path("demo").exists()


@pytest.fixture
def stiff():
    """Returns the path of a robot whose arms hardly move, its tools level: no table is reached with tools down."""
    folder = Path("stiff")
    shutil.copytree(robots_folder() / "iiwa7", folder)
    urdf = next(folder.glob("*.urdf"))
    tree = yaml.safe_load((folder / "robot.yaml").read_text())
    tree["postures"] = {}
    (folder / "robot.yaml").write_text(yaml.safe_dump(tree, sort_keys=False))
    lines = []
    for line in urdf.read_text().splitlines():
        if "<limit" in line:
            words = [w for w in line.split() if not w.startswith(("lower=", "upper="))]
            line = " ".join([words[0], 'lower="-0.05"', 'upper="0.05"', *words[1:]])
        lines.append(line)
    urdf.write_text("\n".join(lines))
    return folder


def test_a_robot_that_reaches_no_table_is_told_so(stiff, capsys):
    """Exit code 3, one sentence, nothing written."""
    assert run(["init", "new/demo", "--robot", str(stiff)]) == 3
    text = capsys.readouterr().err
    assert "error[E680]: no table was found for stiff/robot.yaml" in text
    assert [path.name for path in Path().iterdir()] == ["stiff"]


@pytest.mark.usefixtures("unplanned")
def test_a_robot_s_folder_comes_along():
    """The project needs nothing else: it is checked after the folder that it came from is gone."""
    shutil.copytree(robots_folder() / "yumi", "mine")
    assert run(["init", "demo", "--robot", "mine"]) == 0
    shutil.rmtree("mine")
    assert check_file(Path("demo/tasks.yaml")) == []
    assert yaml.safe_load(Path("demo/cell.yaml").read_text())["robot"] == "mine/robot.yaml"


def test_a_robot_file_that_reads_elsewhere_is_refused(capsys):
    """It would not be complete; the message says what makes it so."""
    Path("robot").mkdir()
    for path in (robots_folder() / "yumi").iterdir():
        shutil.copy(path, "robot" if path.suffix == ".yaml" else ".")
    text = Path("robot/robot.yaml").read_text().replace("urdf: ", "urdf: ../")
    Path("robot/robot.yaml").write_text(text)
    assert run(["init", "demo", "--robot", "robot"]) == 2
    assert "which is not in its folder" in capsys.readouterr().err
    assert not Path("demo").exists()


@pytest.mark.usefixtures("unplanned")
def test_editors_find_the_schema_of_each_file():
    """The first line names it, and by it the file is valid."""
    assert run(["init", "demo", "--robot", QUICK]) == 0
    for kind in ("cell", "tasks", "study"):
        text = Path(f"demo/{kind}.yaml").read_text()
        schema = text.splitlines()[0].partition("$schema=")[2]
        validator = Draft202012Validator(json.loads((Path("demo") / schema).read_text()))
        assert list(validator.iter_errors(yaml.safe_load(text))) == []


@pytest.mark.usefixtures("unplanned")
def test_the_workflow_is_that_of_the_docs():
    """But for its first lines, and the task files that it scores; no index is asked for a name that anyone may take."""
    assert run(["init", "demo", "--robot", QUICK]) == 0
    own = Path("demo/.github/workflows/score.yaml").read_text().splitlines()
    theirs = (ROOT / "docs/score-workflow.yaml").read_text().splitlines()
    pattern = "'cells/**/tasks.yaml'"
    assert own[2:] == [line.replace(pattern, "tasks.yaml") for line in theirs[2:]]
    lines = Path("demo/requirements.txt").read_text().splitlines()
    assert all(line.startswith("#") for line in lines)
    assert "dualarm @ git+https://" in lines[-1]


@pytest.mark.slow
def test_the_workflow_s_commands_work(monkeypatch):
    """The baseline of its first lines is written, and then its command passes."""
    assert run(["init", "demo", "--robot", QUICK]) == 0
    monkeypatch.chdir("demo")
    workflow = Path(".github/workflows/score.yaml").read_text()
    [first] = [line for line in workflow.splitlines() if line.startswith("#   dualarm ")]
    assert run(first.split()[2:]) == 0
    steps = yaml.safe_load(workflow)["jobs"]["score"]["steps"]
    [command] = [step["run"] for step in steps if "dualarm score" in step.get("run", "")]
    words = command.replace("'10 min'", "10min").split()[1:]
    assert run(words) == 0


@pytest.mark.usefixtures("unplanned")
def test_arms_on_rails_work_on_their_own_sides(sliding_robots):
    """Both arms slide along all of the table: each one's targets are on the side of its shoulder all the same."""
    Path("rails").mkdir()
    sliding_robots.write_robot(Path("rails"), {}, own=sliding_robots.RAIL)
    assert run(["init", "demo", "--robot", "rails"]) == 0
    job = load_job(Path("demo/tasks.yaml"))
    y = {
        arm: [
            stop.target.pose.translation[1]
            for task in job.tasks
            if task.arm == arm
            for stop in task.stops
        ]
        for arm in ("left", "right")
    }
    assert min(y["left"]) > max(y["right"])


def column(*names):
    """Returns a robot with a platform of these joints, up to 30° each way, a box 0.2 to 0.6 m before it; a bare arm."""
    text = '<robot name="column"><link name="base"/>'
    parent = "base"
    for name, axis in (("yaw", "0 0 1"), ("pitch", "0 1 0")):
        kind = "revolute" if name in names else "fixed"
        text += (
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{name}_link"/>'
            f'<axis xyz="{axis}"/><limit lower="-0.5236" upper="0.5236" velocity="1" effort="1"/></joint>'
            f'<link name="{name}_link">'
        )
        parent = f"{name}_link"
        text += "</link>" if name == "yaw" else ""
    box = '<collision><origin xyz="0.4 0 0"/><geometry><box size="0.4 0.1 0.1"/></geometry></collision>'
    arm = "".join(
        f'<joint name="arm{k}" type="revolute"><parent link="{"arm" if k else "base"}{k or ""}"/>'
        f'<child link="arm{k + 1}"/><origin xyz="0 0 0.1"/><axis xyz="{axis}"/>'
        f'<limit lower="-1" upper="1" velocity="1" effort="1"/></joint><link name="arm{k + 1}"/>'
        for k, axis in enumerate(("0 0 1", "0 1 0", "0 1 0", "0 0 1", "0 1 0", "0 0 1"))
    )
    joints = tuple(f"arm{k}" for k in range(6))
    rows = np.full(len(names) + 6, 0.5235987755982988)
    limits = JointLimits((*names, *joints), -rows, rows, rows, rows, rows, ("assumed",) * len(rows))
    arms = (Arm("left", joints, "arm6", "general"),)
    return Robot("column", f"{text}{box}</link>{arm}</robot>", names, arms, limits)


@pytest.mark.parametrize(("names", "most"), [(("yaw",), 0.3433), (("yaw", "pitch"), 0.05)])
def test_a_table_leaves_the_room_that_the_platform_may_take(names, most):
    """At 30° the corner of the box is at y = 0.6 sin 30° + 0.05 cos 30°; a platform of two joints is held.

    In both cases nothing is ever behind the axis, and a table keeps 30 mm and half a node away.
    """
    y = np.arange(-0.6, 0.6, 0.01) + 0.005
    tools = {"left": Tool(pin.SE3.Identity())}
    cell = Cell(column(*names), pin.SE3.Identity(), tools, {}, ())
    free = room_for_table(cell, y, y, (-0.01, 0.01), LAYOUT.room, arms=True)
    assert free[:, y < 0.0].all()
    taken = np.abs(y[~free.all(axis=1)])
    assert abs(taken.max() - (most + LAYOUT.room + 0.005)) < 0.0101
